//! The perceptual hash: which low frequencies of a picture are stronger than their median.
//!
//! The hash is that of the crate `image_hasher`. The transform is our own, in integers. That of the library is in
//! floats, which round differently from platform to platform, but the bits of hashes are kept in stores.

/// Cells along a side of the transformed picture.
pub(crate) const SIDE: usize = 32;
/// Frequencies along an axis that are hashed.
const LOW: usize = 8;

/// cos(k pi / 64) in units of 2^-30, rounded, for k = 0 to 32.
///
/// Written out, since the last bit of a cosine differs between platforms. A test compares them with `f64::cos`.
const COSINES: [i64; SIDE + 1] = [
    1_073_741_824,
    1_072_448_455,
    1_068_571_464,
    1_062_120_190,
    1_053_110_176,
    1_041_563_127,
    1_027_506_862,
    1_010_975_242,
    992_008_094,
    970_651_112,
    946_955_747,
    920_979_082,
    892_783_698,
    862_437_520,
    830_013_654,
    795_590_213,
    759_250_125,
    721_080_937,
    681_174_602,
    639_627_258,
    596_538_995,
    552_013_618,
    506_158_392,
    459_083_786,
    410_903_207,
    361_732_726,
    311_690_799,
    260_897_982,
    209_476_638,
    157_550_647,
    105_245_103,
    52_686_014,
    0,
];

/// Returns cos(k pi / 64) in units of 2^-30 for any k.
fn cosine(k: usize) -> i64 {
    let k = k % (4 * SIDE);
    let k = if k > 2 * SIDE { 4 * SIDE - k } else { k };
    if k > SIDE {
        -COSINES[2 * SIDE - k]
    } else {
        COSINES[k]
    }
}

/// Returns the 64-bit DCT hash of `[SIDE * SIDE]` values in [0, 255], row-major. Bit `8 v + u` is set if frequency
/// (u, v) of the DCT-II is above the median of the 64 lowest (pHash, where the `imagehash` of the paper's code
/// transforms 32 x 32 as well). In integers: the same bits on every machine.
///
/// Extremes: a flat picture has its mean alone, hence bit 0 alone. Black has no bit.
pub(crate) fn dct(values: &[i64; SIDE * SIDE]) -> u64 {
    // By column of cells: frequencies along y. At most 32 * 255 * 2^30 = 2^43.
    let mut down = [[0_i64; SIDE]; LOW];
    for (v, sums) in down.iter_mut().enumerate() {
        for (y, row) in values.chunks_exact(SIDE).enumerate() {
            let weight = cosine((2 * y + 1) * v);
            sums.iter_mut()
                .zip(row)
                .for_each(|(sum, value)| *sum += weight * value);
        }
    }
    // At most 2^43 * 32 * 2^30 = 2^78.
    let mut found = [0_i128; LOW * LOW];
    for (v, sums) in down.iter().enumerate() {
        for u in 0..LOW {
            let terms = sums.iter().enumerate();
            let terms = terms.map(|(x, sum)| i128::from(*sum) * i128::from(cosine((2 * x + 1) * u)));
            // No 1 / sqrt 2 for the mean: `imagehash` has none either.
            found[LOW * v + u] = terms.sum();
        }
    }
    let mut sorted = found;
    sorted.sort_unstable();
    // The median of 64 lies between the two in the middle. Compared twice as large it stays an integer.
    let median = sorted[LOW * LOW / 2 - 1] + sorted[LOW * LOW / 2];
    let bits = found.iter().enumerate().filter(|(_, value)| 2 * **value > median);
    bits.fold(0, |hash, (at, _)| hash | 1 << at)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_holds_cosines() {
        for k in 0..=4 * SIDE {
            let right = (k as f64 * std::f64::consts::PI / 64.0).cos() * f64::from(1 << 30);
            assert!(
                (cosine(k) as f64 - right).abs() < 0.51,
                "{k}: {} for {right}",
                cosine(k)
            );
        }
    }

    /// By hand: one wave along x is frequency (1, 0) alone, in addition to the mean (0, 0).
    #[test]
    fn one_wave_is_one_bit() {
        let wave = |at: usize| 128 + ((cosine(2 * (at % SIDE) + 1) * 100) >> 30);
        let hash = dct(&std::array::from_fn(wave));
        assert_eq!(hash & 0b11, 0b11);
        assert_eq!(dct(&[9; SIDE * SIDE]), 1, "flat");
        assert_eq!(dct(&[0; SIDE * SIDE]), 0, "black");
    }

    /// The library transforms 16 x 16 cells in f32: on the same picture it differs in a few bits of 64, on another in half
    /// of them.
    #[test]
    fn the_librarys_own_hash_is_near() {
        use img_hash::{BitOrder, HashAlg, HasherConfig, ImageHash};
        let hasher = HasherConfig::with_bytes_type::<[u8; 8]>()
            .hash_size(8, 8)
            .hash_alg(HashAlg::Median)
            .preproc_dct()
            .bit_order(BitOrder::LsbFirst)
            .to_hasher();
        let of_bits = |bits: u64| ImageHash::<[u8; 8]>::from_bytes(&bits.to_le_bytes()).unwrap();
        let picture = |seed: f64| {
            std::array::from_fn(|at| {
                let (x, y) = ((at % SIDE) as f64 / 32.0, (at / SIDE) as f64 / 32.0);
                let waves = (1..5).flat_map(|u| (0..5).map(move |v| (f64::from(u), f64::from(v))));
                let light: f64 = waves
                    .map(|(u, v)| ((seed * (7.0 * u + 3.0 * v)).sin()) * (3.0 * (u * x + v * y + seed)).cos())
                    .sum();
                (128.0 + 12.0 * light).clamp(0.0, 255.0) as i64
            })
        };
        let theirs = |values: &[i64; SIDE * SIDE]| {
            let pixels = values.iter().map(|value| *value as u8).collect();
            hasher.hash_image(&image::GrayImage::from_raw(SIDE as u32, SIDE as u32, pixels).unwrap())
        };
        for seed in [0.3, 1.1, 2.7, 4.2] {
            let (here, elsewhere) = (picture(seed), picture(seed + 10.0));
            let near = of_bits(dct(&here)).dist(&theirs(&here));
            let far = of_bits(dct(&elsewhere)).dist(&theirs(&here));
            assert!(near <= 12 && far > near + 8, "{seed}: {near} and {far} bits");
        }
    }

    /// Guards the bits: they are kept in stores.
    #[test]
    fn the_bits_of_a_known_picture_never_change() {
        let values = std::array::from_fn(|at| ((at * at / 7 + 13 * (at % 32) * (at / 32)) % 256) as i64);
        assert_eq!(dct(&values), GUARD);
    }

    const GUARD: u64 = 8_535_540_087_418_270_913;
}
