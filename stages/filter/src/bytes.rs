//! Values as kept bytes: postcard, the same on every machine, floats exact.

use marf_cache::Digest;
use marf_stage::StageError;
use serde::de::{Deserialize, Deserializer, Error};
use serde::{Serialize, Serializer};

/// Returns a value as bytes.
///
/// # Errors
/// A value that serde cannot write.
pub(crate) fn to_bytes(value: &impl Serialize) -> Result<Vec<u8>, StageError> {
    postcard::to_allocvec(value)
        .map_err(|error| StageError::new("a value cannot be written as bytes").cause(error.to_string()))
}

/// Reads the bytes of [`to_bytes`]. `None` for other bytes.
pub(crate) fn from_bytes<'a, T: Deserialize<'a>>(bytes: &'a [u8]) -> Option<T> {
    let (value, rest) = postcard::take_from_bytes(bytes).ok()?;
    rest.is_empty().then_some(value)
}

/// Reads a list of `N` values.
///
/// # Errors
/// A list of another length, or values that cannot be read.
pub(crate) fn read_list<'a, const N: usize, T, D>(from: D) -> Result<Vec<T>, D::Error>
where
    T: Deserialize<'a>,
    D: Deserializer<'a>,
{
    let list = Vec::deserialize(from)?;
    if list.len() != N {
        return Err(D::Error::invalid_length(list.len(), &"the length of the list"));
    }
    Ok(list)
}

/// A digest as its 32 bytes: serde writes it in hexadecimal digits.
pub(crate) mod digest {
    use super::*;

    pub(crate) fn serialize<S: Serializer>(digest: &Digest, to: S) -> Result<S::Ok, S::Error> {
        digest.as_bytes().serialize(to)
    }

    pub(crate) fn deserialize<'a, D: Deserializer<'a>>(from: D) -> Result<Digest, D::Error> {
        <[u8; 32]>::deserialize(from).map(Digest::from_bytes)
    }
}

#[cfg(test)]
mod tests {
    use serde::Deserialize;

    use super::*;

    #[derive(Debug, PartialEq, Serialize, Deserialize)]
    struct Kept {
        number: f64,
        #[serde(deserialize_with = "read_list::<2, _, _>")]
        pair: Vec<u32>,
        #[serde(with = "digest")]
        digest: Digest,
    }

    fn kept(pair: &[u32]) -> Vec<u8> {
        let kept = Kept {
            number: 0.1,
            pair: pair.to_vec(),
            digest: Digest::from_content(b"a"),
        };
        to_bytes(&kept).unwrap()
    }

    /// By hand: 8 bytes of a float, the length 2, 300 as 0b10_0101100, and 32 bytes.
    #[test]
    fn a_value_comes_back_and_cut_or_longer_bytes_do_not() {
        let bytes = kept(&[7, 300]);
        assert_eq!(bytes[..8], 0.1_f64.to_le_bytes());
        assert_eq!(bytes[8..12], [2, 7, 0xac, 2]);
        assert_eq!(bytes[12..], *Digest::from_content(b"a").as_bytes());
        let read: Kept = from_bytes(&bytes).unwrap();
        assert_eq!(to_bytes(&read).unwrap(), bytes);
        for cut in 0..bytes.len() {
            assert_eq!(from_bytes::<Kept>(&bytes[..cut]), None, "cut at {cut}");
        }
        assert_eq!(from_bytes::<Kept>(&[bytes, vec![0]].concat()), None);
    }

    #[test]
    fn a_list_of_another_length_is_refused() {
        for pair in [&[][..], &[1], &[1, 2, 3]] {
            assert_eq!(from_bytes::<Kept>(&kept(pair)), None, "{pair:?}");
        }
        // 4,294,967,295 values, and two of them.
        let lying = [0xff, 0xff, 0xff, 0xff, 0x0f, 1, 2];
        assert_eq!(from_bytes::<Vec<u64>>(&lying), None);
    }
}
