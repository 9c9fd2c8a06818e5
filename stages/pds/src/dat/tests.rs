use super::*;

const LIMIT: u64 = 1_000_000;

/// Header of a subframe that starts at column 960 and line 544.
fn header(width: u32, height: u32, color: u8, quality: u8, table: u32) -> Vec<u8> {
    let mut words = [0_u32; 16];
    words[5] = u32::from_be_bytes([120, 68, (width / 8) as u8, (height / 8) as u8]);
    words[8] = u32::from_be_bytes([0, 0, color, quality]);
    (words[9], words[15]) = (table, MAGIC);
    words.iter().flat_map(|word| word.to_be_bytes()).collect()
}

/// Huffman codes by their difference: the first 15 bits and the length.
fn encoder() -> [(u32, u8); 256] {
    let mut found = [(0, 0); 256];
    let mut next = 0;
    for (length, difference) in LENGTHS.iter().zip(&DIFFERENCES) {
        found[usize::from(*difference)] = (next, *length);
        next += 1 << (MAX_BITS - length);
    }
    assert_eq!(next, 1 << MAX_BITS, "the codes fill their space");
    found
}

/// Compresses a mosaic as the camera does.
fn compressed(samples: &[u8], width: usize) -> Vec<u8> {
    let codes = encoder();
    let mut bytes = header(width as u32, (samples.len() / width) as u32, 1, 0, 0);
    for block in samples.chunks_exact(BLOCK_LINES * width) {
        for plane in 0..4 {
            bytes.extend(SYNC);
            let (mut bits, mut before) = (String::new(), 0_u8);
            for line in (plane / 2..BLOCK_LINES).step_by(2) {
                for sample in (plane % 2..width).step_by(2) {
                    let value = block[line * width + sample];
                    let (code, length) = codes[usize::from(value.wrapping_sub(before))];
                    bits.push_str(&format!("{code:015b}")[..usize::from(length)]);
                    before = value;
                }
            }
            bits.push_str(&"0".repeat((32 - bits.len() % 32) % 32));
            let byte = |eight: &[u8]| u8::from_str_radix(std::str::from_utf8(eight).unwrap(), 2).unwrap();
            bytes.extend(bits.as_bytes().chunks(8).map(byte));
        }
    }
    bytes
}

fn mosaic(width: usize, height: usize) -> Vec<u8> {
    (0..width * height)
        .map(|at| ((at * at / 7 + 13 * at) % 256) as u8)
        .collect()
}

fn read(bytes: &[u8]) -> Result<Decompressed, DatError> {
    decompress(bytes, LIMIT).unwrap()
}

#[test]
fn a_mosaic_comes_out_of_its_huffman_codes_as_it_was() {
    let samples = mosaic(32, 24);
    let made = read(&compressed(&samples, 32)).unwrap();
    assert_eq!(made.bytes, samples);
    assert_eq!(made.array.shape, [1, 24, 32]);
    assert_eq!((made.phase.line, made.phase.sample), (544, 960));
    assert_eq!(made.array.companded_by.as_deref(), Some("MMM_LUT0"));
}

#[test]
fn every_difference_has_a_code_of_its_own() {
    let mut lengths = [0; 256];
    for (length, difference) in LENGTHS.iter().zip(&DIFFERENCES) {
        assert_eq!(lengths[usize::from(*difference)], 0, "{difference} twice");
        lengths[usize::from(*difference)] = *length;
    }
    // The frequent differences have the short codes.
    assert!(
        [0, 1, 2, 254, 255]
            .iter()
            .all(|difference| lengths[*difference] == 4),
        "{lengths:?}"
    );
    assert_eq!(codes().len(), 1 << MAX_BITS);
}

#[test]
fn raw_samples_are_taken_as_they_are_in_either_order_of_their_bytes() {
    let codes = mosaic(8, 8);
    let made = read(&[header(8, 8, 0, 0, 0), codes.clone()].concat()).unwrap();
    assert_eq!((made.bytes, made.array.sample.bytes), (codes, 1));
    let counts: Vec<u16> = (0..64).map(|at| at * 65).collect();
    let big: Vec<u8> = counts.iter().flat_map(|count| count.to_be_bytes()).collect();
    let little: Vec<u8> = counts.iter().flat_map(|count| count.to_le_bytes()).collect();
    for stored in [&big, &little] {
        let made = read(&[header(8, 8, 0, 0, NO_TABLE), stored.clone()].concat()).unwrap();
        assert_eq!(made.bytes, big);
        assert_eq!((made.array.bits, made.array.companded_by), (Some(12), None));
    }
    let noise = read(&[header(8, 8, 0, 0, NO_TABLE), vec![0xff; 128]].concat());
    assert_eq!(noise.err(), Some(DatError::Counts));
}

#[test]
fn what_is_cut_short_or_damaged_is_an_error_and_never_a_panic() {
    let whole = compressed(&mosaic(32, 24), 32);
    for length in (HEADER..whole.len() - 4).step_by(7) {
        let error = read(&whole[..length]).err();
        let is_short = matches!(error, Some(DatError::Short { lines: 24, has }) if has < 24 && has % 8 == 0);
        assert!(is_short, "{length}: {error:?}");
    }
    assert!(decompress(&whole[..HEADER - 1], LIMIT).is_none(), "no header");
    let raw = [header(8, 8, 0, 0, 0), vec![1; 40]].concat();
    assert_eq!(read(&raw).err(), Some(DatError::Short { lines: 8, has: 5 }));
    let jpeg = [header(8, 8, 2, 95, 0), b"\xff\xd8\xff\xd9".to_vec()].concat();
    assert!(matches!(read(&jpeg).err(), Some(DatError::Jpeg(_))));
}

#[test]
fn a_picture_of_another_size_than_its_header_is_refused_with_both() {
    let picture = marf_scene::Image {
        width: 2,
        height: 1,
        pixels: vec![[1, 2, 3]; 2],
    };
    let body = marf_scene::encode_png(&picture).unwrap();
    let error = read(&[header(16, 8, 2, 95, 0), body].concat()).err().unwrap();
    assert_eq!(
        error.to_string(),
        "the JPEG of the compressed product is damaged: 2 x 1 pixels, the header describes 16 x 8"
    );
}
