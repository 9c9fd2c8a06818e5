//! Things that hide the scene: a descent over the demo's Mars with something planted in its photos.

use std::sync::OnceLock;

use marf_demo::{Demo, DemoOptions};
use marf_scene::{Image, Photo, Srgb, encode_png};
use serde_json::json;

use crate::common::{Input, Output};

const PHOTOS: u32 = 40;
const SIDE_PX: u32 = 320;
/// First row of a deck at the bottom.
const DECK_ROW: u32 = 240;

/// The photos of a descent, drawn once.
fn descent() -> &'static [Image<Srgb>] {
    static DRAWN: OnceLock<Vec<Image<Srgb>>> = OnceLock::new();
    DRAWN.get_or_init(|| {
        let options = DemoOptions {
            width_px: SIDE_PX,
            height_px: SIDE_PX,
            seed: 1,
        };
        let files = Demo::new(options).unwrap().descent(PHOTOS, &|| false).unwrap();
        let photos = files.iter().filter(|file| file.name.ends_with(".png"));
        photos
            .map(|file| Photo::decode(&file.bytes).unwrap().image)
            .collect()
    })
}

/// Returns the calibration of the descent, with the pixels that `planted` gives, by photo, column and row.
fn calibrated(planted: impl Fn(usize, u32, u32) -> Option<[u8; 3]>) -> (Input, Output) {
    let mut input = Input::default();
    for (index, photo) in descent().iter().enumerate() {
        let picture = Image::<Srgb>::from_fn(SIDE_PX, SIDE_PX, |column, row| {
            planted(index, column, row).unwrap_or_else(|| photo.at(column, row))
        });
        input.plain(&format!("{index:03}.png"), &encode_png(&picture).unwrap());
    }
    let output = input.run(&json!({"method": "sfm"})).unwrap();
    (input, output)
}

/// A smooth disc over 0.6 of one photo: a heat shield that falls.
#[test]
fn a_photo_that_a_disc_hides_is_left_out_with_its_reason_and_no_other() {
    let radius = (0.6 / std::f64::consts::PI).sqrt() * f64::from(SIDE_PX);
    let (_, output) = calibrated(|index, column, row| {
        let from_middle = |at: u32| f64::from(at) - f64::from(SIDE_PX / 2);
        let distance = from_middle(column).hypot(from_middle(row));
        let gray = (150.0 - 60.0 * distance / radius) as u8;
        (index == 20 && distance < radius).then_some([gray, gray, gray - gray / 5])
    });
    let left_out: Vec<_> = output
        .metrics
        .photos
        .iter()
        .filter(|photo| !photo.registered)
        .collect();
    let [photo] = &left_out[..] else {
        panic!("{left_out:#?}")
    };
    assert_eq!(photo.file, "020.png");
    let numbers = photo
        .reason
        .split([' ', ',', '.'])
        .filter_map(|word| word.parse().ok());
    let numbers: Vec<f64> = numbers.collect();
    let [hidden, compared, expected, shown, ..] = numbers[..] else {
        panic!("{}", photo.reason)
    };
    // The disc hides 60 % of the photo, and cells at its rim are hidden or not. Neighbours show hardly anything in the corners.
    assert!(
        (20.0..=75.0).contains(&hidden) && hidden <= compared && compared <= 100.0 && shown < 0.2 * expected,
        "{}",
        photo.reason
    );
    assert!(
        photo
            .reason
            .starts_with("something that no other photo shows hides"),
        "{}",
        photo.reason
    );
    assert!(output.scene.frames.iter().all(|frame| frame.mask.is_none()));
}

/// A patterned deck over the lower quarter of all photos.
#[test]
fn a_deck_in_all_photos_is_hidden_by_masks_and_loses_none() {
    let (input, output) = calibrated(|_, column, row| {
        let plate = marf_numeric::mix(u64::from(column / 9) << 32 | u64::from(row / 7));
        (row >= DECK_ROW).then_some([100 + (plate % 120) as u8; 3])
    });
    assert_eq!(output.metrics.totals.registered, PHOTOS as usize);
    assert!(
        output.metrics.method.contains("moves with the camera"),
        "{}",
        output.metrics.method
    );
    for frame in &output.scene.frames {
        let mask = Photo::decode(&input.harness.get(&frame.mask.unwrap()).unwrap())
            .unwrap()
            .image;
        let hidden = |rows: std::ops::Range<u32>| {
            let pixels = rows
                .clone()
                .flat_map(|row| (0..SIDE_PX).map(move |column| (column, row)));
            let hidden = pixels
                .filter(|(column, row)| mask.at(*column, *row) == [0; 3])
                .count();
            hidden as f64 / (rows.len() as f64 * f64::from(SIDE_PX))
        };
        let (deck, ground) = (hidden(DECK_ROW..SIDE_PX), hidden(0..DECK_ROW));
        assert!(deck > 0.8 && ground < 0.12, "{}: {deck} {ground}", frame.file);
    }
}
