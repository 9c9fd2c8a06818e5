use marf_scene::MAX_DECODED_BYTES;

use super::*;

fn array(shape: [u32; 3], kind: SampleKind, bytes: u32) -> Array {
    Array {
        shape,
        sample: Sample {
            kind,
            bytes,
            big_endian: true,
        },
        ..Array::default()
    }
}

#[test]
fn every_type_of_sample_is_read_in_both_orders() {
    let read = |kind, bytes: &[u8], big_endian| {
        read(
            Sample {
                kind,
                bytes: bytes.len() as u32,
                big_endian,
            },
            bytes,
            0,
        )
    };
    assert_eq!(read(SampleKind::Unsigned, &[0xff, 0xfe], true), 65534.0);
    assert_eq!(read(SampleKind::Signed, &[0xff, 0xfe], true), -2.0);
    assert_eq!(read(SampleKind::Signed, &[0xfe, 0xff], false), -2.0);
    assert_eq!(read(SampleKind::Signed, &[0x80], true), -128.0);
    assert_eq!(read(SampleKind::Unsigned, &[1, 0, 0, 0], false), 1.0);
    assert_eq!(read(SampleKind::Signed, &[0xff; 8], true), -1.0);
    assert_eq!(read(SampleKind::Float, &1.5_f32.to_be_bytes(), true), 1.5);
    assert_eq!(read(SampleKind::Float, &(-2.25_f64).to_le_bytes(), false), -2.25);
}

#[test]
fn the_three_orders_give_the_same_image() {
    let value = |band: u8, line: u8, sample: u8| 100 * band + 10 * line + sample;
    let (mut bsq, mut bil, mut bip) = (vec![9; 4], vec![9; 4], vec![9; 4]);
    for outer in 0..3 {
        for line in 0..2 {
            bsq.push(0xee); // one byte before each record
            bsq.extend((0..4).map(|sample| value(outer, line, sample)));
        }
    }
    for line in 0..2 {
        for band in 0..3 {
            bil.push(0xee);
            bil.extend((0..4).map(|sample| value(band, line, sample)));
        }
        bip.push(0xee);
        bip.extend((0..4).flat_map(|sample| (0..3).map(move |band| value(band, line, sample))));
    }
    let mut images = Vec::new();
    for (order, bytes) in [
        (BandStorage::BandSequential, bsq),
        (BandStorage::LineInterleaved, bil),
        (BandStorage::PixelInterleaved, bip),
    ] {
        let mut array = array([3, 2, 4], SampleKind::Unsigned, 1);
        (array.order, array.prefix_bytes, array.offset) = (order, 1, 4);
        images.push(
            render(&array, None, None, &bytes, MAX_DECODED_BYTES)
                .unwrap()
                .image,
        );
    }
    assert_eq!(images[0].at(3, 1), [13, 113, 213]);
    assert!(images[0] == images[1] && images[1] == images[2]);
}

#[test]
fn radiance_counts_and_missing_values_have_fixed_codes() {
    let mut radiance = array([1, 1, 4], SampleKind::Signed, 2);
    radiance.scaling = vec![(5e-6, 0.0)];
    radiance.quantity = Quantity::Radiance;
    radiance.missing = vec![0.0];
    let stored = |values: [i16; 4]| {
        values
            .iter()
            .flat_map(|value| value.to_be_bytes())
            .collect::<Vec<u8>>()
    };
    let codes = |array: &Array, values| {
        let made = render(array, None, None, &stored(values), MAX_DECODED_BYTES).unwrap();
        made.image.pixels.iter().map(|pixel| pixel[0]).collect::<Vec<_>>()
    };
    // 25,000 x 5e-6 = 0.125 is white. A quarter of it is sRGB 137.
    assert_eq!(codes(&radiance, [0, 6_250, 25_000, 32_767]), [0, 137, 255, 255]);
    // The same light as I/F: by 0.25 W / (m2 sr nm) of sunlight, I/F 0.5 is white.
    let mut reflectance = radiance.clone();
    (reflectance.quantity, reflectance.sunlight) = (Quantity::Reflectance, vec![0.25]);
    reflectance.scaling = vec![(2e-5, 0.0)];
    assert_eq!(
        codes(&reflectance, [0, 6_250, 25_000, 32_767]),
        [0, 137, 255, 255]
    );
    let mut counts = array([1, 1, 4], SampleKind::Signed, 2);
    counts.bits = Some(12);
    assert_eq!(codes(&counts, [0, 2048, 4095, 5000]), [0, 188, 255, 255]);
    counts.bits = None;
    assert_eq!(codes(&counts, [-5, 16_384, 32_767, 1]), [0, 188, 255, 0]);
}

/// Labels of MSL scale each band on its own. By hand: 0.03125 of 0.125 is sRGB 137, and 0.0625 sRGB 188.
#[test]
fn each_band_has_its_own_scale() {
    let mut radiance = array([3, 1, 1], SampleKind::Unsigned, 1);
    radiance.quantity = Quantity::Radiance;
    radiance.scaling = vec![(1.25e-3, 0.0), (6.25e-4, 0.0), (0.0, 0.125)];
    let made = render(&radiance, None, None, &[50, 50, 50], MAX_DECODED_BYTES).unwrap();
    assert_eq!(made.image.pixels, [[188, 137, 255]]);
}

#[test]
fn shapes_that_do_not_fit_are_refused_before_memory_is_taken() {
    let refuse =
        |array: &Array, has: usize| render(array, None, None, &vec![0; has], MAX_DECODED_BYTES).unwrap_err();
    for shape in [[0, 1, 1], [1, 0, 5], [5, 256, 256]] {
        assert_eq!(
            refuse(&array(shape, SampleKind::Unsigned, 1), 10),
            PixelError::Shape(shape)
        );
    }
    for shape in [[1, 20_000, 20_000], [3, u32::MAX, u32::MAX]] {
        let error = refuse(&array(shape, SampleKind::Unsigned, 8), 10);
        assert!(matches!(error, PixelError::Short { .. }), "{error}");
    }
    let short = refuse(&array([1, 4, 4], SampleKind::Signed, 2), 31);
    assert_eq!(short, PixelError::Short { needed: 32, has: 31 });
    let mut far = array([1, 1, 1], SampleKind::Unsigned, 1);
    far.offset = u64::MAX;
    assert!(matches!(refuse(&far, 10), PixelError::Short { .. }));
    (far.offset, far.prefix_bytes) = (0, u32::MAX);
    assert!(matches!(refuse(&far, 10), PixelError::Short { .. }));
    assert_eq!(
        refuse(&array([1, 1, 1], SampleKind::Float, 4), 4),
        PixelError::UnknownQuantity
    );
}

/// By hand: 542 of 2033 counts is 0.2666 of white, sRGB 141.06, and 1274 of 2033 sRGB 207.4. As a code 128 would stay
/// 128.
#[test]
fn codes_become_counts_by_their_table_whatever_they_are_stored_in() {
    let table = crate::companding::table("MMM_LUT0", None);
    for bytes in [1, 2] {
        let mut codes = array(
            [1, 1, 4],
            if bytes == 1 {
                SampleKind::Unsigned
            } else {
                SampleKind::Signed
            },
            bytes,
        );
        codes.bits = Some(8);
        codes.companded_by = Some("MMM_LUT0".to_owned());
        let stored: Vec<u8> = [0_u8, 128, 200, 255]
            .iter()
            .flat_map(|code| if bytes == 1 { vec![*code] } else { vec![0, *code] })
            .collect();
        let made = |table| render(&codes, None, table, &stored, MAX_DECODED_BYTES).unwrap();
        let red = |made: &RenderedArray| made.image.pixels.iter().map(|pixel| pixel[0]).collect::<Vec<_>>();
        assert_eq!(red(&made(table)), [0, 141, 207, 255], "{bytes}");
        assert!(
            made(table).notes[0].contains("white at 2033"),
            "{:?}",
            made(table).notes
        );
        // Without the table the codes are not counts either: no curve.
        assert_eq!(red(&made(None)), [0, 128, 200, 255], "{bytes}");
        assert!(
            made(None).notes[0].contains("not known"),
            "{:?}",
            made(None).notes
        );
    }
}

#[test]
fn special_constants_are_black_or_white() {
    let mut special = array([1, 1, 5], SampleKind::Signed, 2);
    special.missing = vec![-32_768.0, -1.0];
    special.saturated = vec![-32_766.0];
    let stored: Vec<u8> = [-32_768_i16, -1, -32_766, 32_767, 0]
        .iter()
        .flat_map(|value| value.to_be_bytes())
        .collect();
    let made = render(&special, None, None, &stored, MAX_DECODED_BYTES).unwrap();
    let red: Vec<u8> = made.image.pixels.iter().map(|pixel| pixel[0]).collect();
    assert_eq!(red, [0, 0, 255, 255, 0]);
    assert_eq!(made.notes.len(), 1, "saturated is not clipped: {:?}", made.notes);
}

/// By hand: by 0.25 W / (m2 sr nm) of sunlight, I/F 0.125 / 0.25 is white.
#[test]
fn notes_on_tones_have_the_numbers_of_their_scale() {
    let notes =
        |array: &Array, bytes: &[u8]| render(array, None, None, bytes, MAX_DECODED_BYTES).unwrap().notes;
    let codes = array([1, 1, 2], SampleKind::Unsigned, 1);
    assert_eq!(notes(&codes, &[0, 255]), ["8-bit codes as stored"]);
    let mut radiance = array([1, 1, 4], SampleKind::Float, 4);
    radiance.quantity = Quantity::Radiance;
    let stored: Vec<u8> = [0.1_f32, 0.125, 0.126, 9.0]
        .iter()
        .flat_map(|value| value.to_be_bytes())
        .collect();
    assert_eq!(
        notes(&radiance, &stored),
        [
            "radiance to sRGB, white at 0.125 W/m2/sr/nm",
            "2 samples above white are clipped"
        ]
    );
    (radiance.quantity, radiance.sunlight) = (Quantity::Reflectance, vec![0.25]);
    assert_eq!(
        notes(&radiance, &stored),
        ["I/F to sRGB, white at 0.500", "1 samples above white are clipped"]
    );
}
