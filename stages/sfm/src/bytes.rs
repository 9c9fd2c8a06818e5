//! States of long computations as bytes (postcard), exact to the bit.

use marf_numeric::{GOLDEN, mix};
use serde::Serialize;
use serde::de::DeserializeOwned;

/// Returns a state as bytes.
///
/// - `form`: eight letters that name the content and its use.
/// - `fingerprint`: that of the task that the state belongs to.
pub(crate) fn encode(form: &[u8; 8], fingerprint: u64, state: &impl Serialize) -> Vec<u8> {
    to_bytes(&(form, fingerprint, state))
}

/// Reads the bytes of [`encode`]. `None` if they are cut, have another form or are a state of another task.
pub(crate) fn decode<T: DeserializeOwned>(bytes: &[u8], form: &[u8; 8], fingerprint: u64) -> Option<T> {
    let bytes = bytes.strip_prefix(form)?;
    let ((found, state), rest) = postcard::take_from_bytes::<(u64, T)>(bytes).ok()?;
    (found == fingerprint && rest.is_empty()).then_some(state)
}

/// Returns a fingerprint: two values that differ in one bit have different ones but for one in 2^64.
pub(crate) fn fingerprint(value: &impl Serialize) -> u64 {
    let bytes = to_bytes(value);
    let (words, rest) = bytes.as_chunks::<8>();
    let words = words.iter().map(|word| u64::from_le_bytes(*word));
    let numbers = words.chain(rest.iter().map(|byte| u64::from(*byte)));
    numbers
        .chain([bytes.len() as u64])
        .fold(GOLDEN, |found, number| mix((found ^ number).wrapping_add(GOLDEN)))
}

/// Returns a value as bytes, allocated once: a matrix has half a gigabyte.
fn to_bytes(value: &impl Serialize) -> Vec<u8> {
    // Only lists of unknown length cannot be written, and derived types have none. `decode` refuses empty bytes.
    let size = postcard::experimental::serialized_size(value).unwrap_or_default();
    postcard::to_extend(value, Vec::with_capacity(size)).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use marf_scene::{Camera, Pose};
    use nalgebra::{Matrix3, Vector3};

    use super::*;

    const FORM: &[u8; 8] = b"a form 1";

    #[test]
    fn a_state_comes_back_to_the_bit_and_a_cut_or_foreign_one_does_not() {
        let camera = Camera {
            k1: -0.0,
            p2: f64::MIN_POSITIVE / 4.0,
            ..Camera::pinhole(640, 480, 500.1)
        };
        let pose = Pose {
            rotation: Matrix3::new(0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 0.1 + 0.2),
            translation: Vector3::new(1e300, -1e-300, 0.0),
        };
        type State = (Vec<bool>, Camera, Option<Pose>, Option<Pose>, Vec<f64>);
        let state: State = (
            vec![true, false],
            camera,
            Some(pose),
            None,
            vec![1.0, f64::INFINITY],
        );
        let bytes = encode(FORM, 7, &state);
        let found: State = decode(&bytes, FORM, 7).unwrap();
        assert_eq!(found, state);
        assert_eq!(found.1.k1.to_bits(), (-0.0_f64).to_bits());
        assert_eq!(decode::<State>(&bytes, FORM, 8), None);
        assert_eq!(decode::<State>(&bytes, b"a form 2", 7), None);
        for length in 0..bytes.len() {
            assert_eq!(decode::<State>(&bytes[..length], FORM, 7), None, "{length} bytes");
        }
        assert_eq!(decode::<State>(&[&bytes[..], &[0]].concat(), FORM, 7), None);
    }

    #[test]
    fn a_list_longer_than_its_bytes_is_refused() {
        let huge = encode(FORM, 7, &u64::MAX);
        assert_eq!(decode::<Vec<f64>>(&huge, FORM, 7), None);
    }

    #[test]
    fn a_fingerprint_knows_every_bit_and_the_order() {
        let of = |values: [f64; 2]| fingerprint(&values);
        for bit in 0..64 {
            let changed = f64::from_bits(2.0_f64.to_bits() ^ 1 << bit);
            assert_ne!(of([1.0, 2.0]), of([1.0, changed]), "bit {bit}");
        }
        assert_ne!(of([1.0, 2.0]), of([2.0, 1.0]));
        assert_ne!(fingerprint(&[0_u8]), fingerprint(&[0_u8; 2]));
    }
}
