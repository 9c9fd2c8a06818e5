//! Descriptions of arrays for the notes of a photo.

use crate::label::{Array, BandStorage, SampleKind};

/// Returns a description of an array: bands x lines x samples, type, interleaving, scaling.
pub fn array(array: &Array) -> String {
    let [bands, lines, samples] = array.shape;
    let kind = match array.sample.kind {
        SampleKind::Unsigned => 'u',
        SampleKind::Signed => 'i',
        SampleKind::Float => 'f',
    };
    let ends = match (array.sample.bytes, array.sample.big_endian) {
        (1, _) => "",
        (_, true) => " big-endian",
        (_, false) => " little-endian",
    };
    let order = match (bands, array.order) {
        (1, _) => "",
        (_, BandStorage::BandSequential) => " by band",
        (_, BandStorage::LineInterleaved) => " by line",
        (_, BandStorage::PixelInterleaved) => " by pixel",
    };
    let bits = array.bits.map_or(String::new(), |bits| format!(", {bits} bits"));
    let mut scaling: Vec<String> = array
        .scaling
        .iter()
        .map(|(factor, offset)| format!(", x {factor} + {offset}"))
        .collect();
    scaling.dedup();
    let scaling = scaling.concat();
    let codes = array.companded_by.as_ref();
    let codes = codes.map_or(String::new(), |table| format!(", stored by {table}"));
    let size = 8 * array.sample.bytes;
    format!("{bands} x {lines} x {samples} {kind}{size}{ends}{order}{bits}{scaling}{codes}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_array_is_told_in_words() {
        let label = "PDS_VERSION_ID = PDS3\nRECORD_BYTES = 64\n^IMAGE = 3\nOBJECT = IMAGE\nLINES = 8\nLINE_SAMPLES = 6\n\
                     BANDS = 3\nSAMPLE_BITS = 16\nSAMPLE_TYPE = MSB_INTEGER\nSCALING_FACTOR = 0.5\n\
                     SAMPLE_BIT_MASK = 2#111111111111#\nEND_OBJECT\nEND\n";
        let words = |label: &str| array(&crate::raw::head(label.as_bytes()).unwrap().array.unwrap());
        assert_eq!(
            words(label),
            "3 x 8 x 6 i16 big-endian by band, 12 bits, x 0.5 + 0"
        );
        let grey = label
            .replace("BANDS = 3\n", "")
            .replace("= 16", "= 8")
            .replace("MSB_", "UNSIGNED_");
        assert_eq!(words(&grey), "1 x 8 x 6 u8, 12 bits, x 0.5 + 0");
    }
}
