use super::*;
use crate::{Image, encode_jpeg};

fn whole() -> Vec<u8> {
    let image = Image::from_fn(70, 50, |x, y| [(x * 3) as u8, (y * 5) as u8, (x * y % 200) as u8]);
    encode_jpeg(&image, 90).unwrap()
}

/// The bytes of a JPEG before its end marker, then others, then the end marker.
fn before_end(between: &[u8]) -> Vec<u8> {
    let whole = whole();
    [&whole[..whole.len() - 2], between, &[0xff, 0xd9]].concat()
}

/// Phones append a film, cameras a second JPEG or zeros. None of it is part of the picture.
#[test]
fn what_follows_the_end_marker_is_left_out() {
    let whole = whole();
    let expected = Photo::decode(&whole).unwrap();
    let film = [b"\0\0\0\x18ftypmp42".as_slice(), &[0x5a; 9000]].concat();
    for tail in [
        film,
        vec![0; 9000],
        vec![0xff; 9000],
        whole.clone(),
        b"\xff\xd9".to_vec(),
        b"x".to_vec(),
    ] {
        let bytes = [whole.as_slice(), &tail].concat();
        assert_eq!(
            Photo::decode(&bytes).as_ref(),
            Ok(&expected),
            "{} bytes",
            tail.len()
        );
        assert_eq!(
            Photo::decode_validated(&bytes).as_ref(),
            Ok(&expected),
            "{} bytes",
            tail.len()
        );
    }
}

/// T.81, B.1.1.2: any marker may be preceded by any number of fill bytes FF. Some encoders pad with zeros.
#[test]
fn fill_bytes_and_zeros_before_the_end_marker_change_nothing() {
    let expected = Photo::decode(&whole()).unwrap();
    for between in [
        vec![0xff],
        vec![0xff; 100],
        vec![0; 100],
        [vec![0; 9], vec![0xff; 9]].concat(),
    ] {
        assert_eq!(
            Photo::decode(&before_end(&between)).as_ref(),
            Ok(&expected),
            "{between:?}"
        );
    }
}

#[test]
fn other_bytes_before_the_end_marker_are_damage() {
    let error = Photo::decode(&before_end(&[0x5a; 100])).unwrap_err().to_string();
    assert!(
        error.contains("100 bytes are left over behind the last unit of a scan: it is damaged"),
        "{error}"
    );
}

/// A photo of 70 x 50 pixels has 9 x 7 units of 8 pixels, or 5 x 4 of 16.
#[test]
fn a_scan_that_ends_early_has_the_units_that_are_there() {
    let whole = whole();
    let cut = [&whole[..whole.len() * 3 / 4], &[0xff, 0xd9]].concat();
    let said = Photo::decode(&cut).unwrap_err().to_string();
    let numbers = said.split(' ').filter_map(|word| word.parse().ok());
    let [has, needed] = numbers.collect::<Vec<u32>>()[..] else {
        panic!("{said}")
    };
    assert!(said.contains(" units: it is cut short or damaged"), "{said}");
    assert!(0 < has && has < needed && [63, 20].contains(&needed), "{said}");
}

/// A preview in a segment has a separate end marker.
#[test]
fn the_end_marker_of_a_preview_is_not_that_of_the_picture() {
    let (whole, preview) = (whole(), [0xff, 0xd8, 0xff, 0xd9]);
    let length = (preview.len() as u16 + 2).to_be_bytes();
    let segment = [&[0xff, 0xe1], length.as_slice(), &preview].concat();
    let bytes = [&whole[..2], &segment, &whole[2..]].concat();
    assert_eq!(Photo::decode(&bytes).unwrap(), Photo::decode(&whole).unwrap());
    assert!(Photo::decode(&bytes[..bytes.len() - 2]).is_err());
}

/// Building a table takes as long as reading 64 KB: a file of nothing but tables would take hours.
#[test]
fn a_table_is_built_for_the_scan_that_uses_it_and_no_other() {
    let whole = whole();
    let scan = whole.windows(2).position(|pair| pair == [0xff, 0xda]).unwrap();
    // Three codes of one bit: no table can be built.
    let with_table = |name: u8| {
        let mut table = vec![0xff, 0xc4, 0, 22, name, 3];
        table.resize(24, 0);
        [&whole[..scan], &table, &whole[scan..]].concat()
    };
    assert_eq!(
        scan::check(&with_table(0x13)),
        Ok(()),
        "the fourth AC table is not used"
    );
    let used = scan::check(&with_table(0x10));
    assert!(matches!(used, Err(scan::ScanError::Segment(_))), "{used:?}");
}

/// The decoder works through all units of a picture for each scan: few bytes would keep it busy for minutes.
#[test]
fn a_picture_of_very_many_scans_is_refused_before_it_is_decoded() {
    let whole = whole();
    let scan = whole.windows(2).position(|pair| pair == [0xff, 0xda]).unwrap();
    let again = |times: usize| {
        let scans = whole[scan..whole.len() - 2].repeat(times);
        [&whole[..scan], &scans, &[0xff, 0xd9]].concat()
    };
    let fault = |bytes: &[u8]| Photo::decode(bytes).unwrap_err().to_string();
    let error = fault(&again(65));
    assert!(
        error.contains("it has 65 scans, above the limit of 64"),
        "{error}"
    );
    let start = std::time::Instant::now();
    assert!(fault(&again(100_000)).contains("100000 scans"));
    assert!(start.elapsed().as_secs_f64() < 10.0, "{:?}", start.elapsed());
    assert_eq!(scan::count(&whole), 1);
    assert_eq!(scan::count(&[0xff, 0xd8, 0xff, 0xda]), 1);
}
