//! Photos that hold no depth are refused with the reason, never solved.

use marf_scene::{Image, Srgb, encode_png};
use serde_json::json;

use crate::common::Input;

/// Discs of all sizes and greys, as an integer hash of their number strews them.
fn picture() -> Image<Srgb> {
    let hash = |n: u32| {
        let n = (n ^ (n >> 16)).wrapping_mul(0x45d9_f3b5);
        let n = (n ^ (n >> 15)).wrapping_mul(0x2c1b_3c6d);
        n ^ (n >> 14)
    };
    let mut grey = vec![128_u8; 640 * 480];
    for disc in 1..1200_u32 {
        let at = |part: u32, below: u32| (hash(4 * disc + part) % below) as i64;
        let (x, y, radius) = (at(0, 640), at(1, 480), 2 + at(2, 14));
        for (index, pixel) in grey.iter_mut().enumerate() {
            let (dx, dy) = (index as i64 % 640 - x, index as i64 / 640 - y);
            if dx * dx + dy * dy <= radius * radius {
                *pixel = 30 + at(3, 200) as u8;
            }
        }
    }
    Image::from_fn(640, 480, |x, y| [grey[(y * 640 + x) as usize]; 3])
}

fn crops(count: u32) -> Input {
    let picture = picture();
    let mut input = Input::default();
    for index in 0..count {
        let crop = Image::<Srgb>::from_fn(400, 400, |x, y| picture.at(x + 60 * index, y + 20 * index));
        input.plain(&format!("{index}.png"), &encode_png(&crop).unwrap());
    }
    input
}

#[test]
fn crops_of_one_photo_are_refused_as_a_panorama() {
    let complaint = crops(4).complaint(&json!({"method": "sfm"}));
    assert!(
        complaint.contains("4 photos: panorama: pure rotation"),
        "{complaint}"
    );
}

#[test]
fn a_single_photo_is_refused_as_such() {
    let complaint = crops(1).complaint(&json!({"method": "sfm"}));
    assert!(complaint.contains("a single photo"), "{complaint}");
}
