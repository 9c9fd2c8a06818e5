/// Returns f32 values as a NumPy array file, version 1.0, little endian, C order.
///
/// `shape`: rows, columns and so on. Its product is the number of values. `numpy.load` reads it as float32.
pub(crate) fn encode_npy(shape: &[u32], values: impl IntoIterator<Item = f32>) -> Vec<u8> {
    let sizes: Vec<String> = shape.iter().map(u32::to_string).collect();
    // A tuple of one element needs its comma.
    let tuple = format!("({},)", sizes.join(", "));
    let header = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': {tuple}, }}");
    // Magic, version, length, header and a line feed fill a multiple of 64 bytes.
    let filled = (10 + header.len() + 1).next_multiple_of(64);
    let padded = format!("{header:<width$}\n", width = filled - 11);
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((padded.len() as u16).to_le_bytes());
    bytes.extend(padded.as_bytes());
    bytes.extend(values.into_iter().flat_map(f32::to_le_bytes));
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_header_is_what_numpy_writes_and_fills_64_bytes() {
        let bytes = encode_npy(&[2, 3], [0.0, 1.0, 2.0, 3.0, 4.0, -1.0]);
        assert_eq!(&bytes[..10], b"\x93NUMPY\x01\x00\x76\x00");
        let header = std::str::from_utf8(&bytes[10..128]).unwrap();
        assert!(header.starts_with("{'descr': '<f4', 'fortran_order': False, 'shape': (2, 3,), }"));
        assert!(header.ends_with(" \n"));
        assert_eq!(bytes.len(), 128 + 24);
        assert_eq!(&bytes[148..], (-1.0_f32).to_le_bytes());
    }

    #[test]
    fn every_shape_fills_whole_blocks() {
        for shape in [vec![0], vec![4_000_000_000], vec![1234, 5678, 3]] {
            let bytes = encode_npy(&shape, []);
            assert_eq!(bytes.len() % 64, 0, "{shape:?}");
        }
    }
}
