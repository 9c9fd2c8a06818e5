//! Proposed masks: a deck that stands still is found, shown, and hidden once the user agrees.

use crate::common::Input;
use marf_cache::Digest;
use marf_calibrate::Masks;
use marf_scene::{Image, Photo, PhotoFacts, Srgb, encode_png};
use marf_schema::masks::Metrics;
use marf_stage::{Define, Document, Outputs, define};
use serde_json::json;

const WIDTH: u32 = 320;
const HEIGHT: u32 = 240;

/// Numbers in 0 to 255 without order.
fn noise(a: u32, b: u32, c: u32) -> u8 {
    let mixed = a.wrapping_mul(0x9e37_79b9) ^ b.wrapping_mul(0x85eb_ca6b) ^ c.wrapping_mul(0xc2b2_ae35);
    let mixed = (mixed ^ (mixed >> 15)).wrapping_mul(0x2c1b_3c6d);
    ((mixed ^ (mixed >> 12)) & 255) as u8
}

fn in_deck(row: u32) -> bool {
    row >= HEIGHT * 4 / 5
}

/// Ground that differs from photo to photo above a deck that does not.
fn photo(index: u32, deck: bool) -> Vec<u8> {
    let image: Image<Srgb> = Image::from_fn(WIDTH, HEIGHT, |column, row| {
        let of = if deck && in_deck(row) { 99 } else { index };
        [noise(column / 16, row / 16, of); 3]
    });
    encode_png(&image).unwrap()
}

fn set(photos: u32, deck: bool) -> Input {
    let mut input = Input::default();
    for index in 0..photos {
        input.plain(&format!("images/{index:02}.png"), &photo(index, deck));
    }
    input
}

fn proposed(input: &Input) -> (Metrics, Outputs) {
    let stage = Masks::new(serde_json::from_value(json!({})).unwrap()).unwrap();
    let outputs = input.outputs_of(&stage);
    let metrics = Metrics::decode(&input.harness.get(&outputs[Metrics::OUTPUT]).unwrap()).unwrap();
    (metrics, outputs)
}

#[test]
fn a_deck_is_proposed_and_hidden_when_its_mask_lies_beside_the_photos() {
    let mut input = set(10, true);
    let (metrics, outputs) = proposed(&input);
    let [camera] = metrics.cameras.as_slice() else {
        panic!("{metrics:?}");
    };
    assert_eq!(
        (camera.name.as_str(), camera.photos, camera.pairs, camera.moved),
        ("320x240", 10, 45, 45)
    );
    assert!((0.17..0.23).contains(&camera.share), "{camera:?}");
    assert_eq!(
        camera.found,
        format!(
            "{:.1} % of the picture stands still while the camera moves",
            100.0 * camera.share
        )
    );
    let png = input.harness.get(&outputs["masks/320x240.png"]).unwrap();
    let mask = Photo::decode(&png).unwrap().image;
    assert_eq!((mask.width, mask.height), (WIDTH, HEIGHT));
    for (column, row) in [
        (0, HEIGHT - 1),
        (WIDTH - 1, HEIGHT - 1),
        (WIDTH / 2, HEIGHT * 9 / 10),
    ] {
        assert_eq!(mask.at(column, row), [0; 3], "{column} {row}");
    }
    for (column, row) in [(0, 0), (WIDTH - 1, 0), (WIDTH / 2, HEIGHT * 7 / 10)] {
        assert_eq!(mask.at(column, row), [255; 3], "{column} {row}");
    }
    let overlay = Photo::decode(&input.harness.get(&outputs["overlay/320x240.png"]).unwrap());
    let [red, green, blue] = overlay.unwrap().image.at(WIDTH / 2, HEIGHT - 1);
    assert!(red >= 128 && green < 128 && blue < 128);

    // As the user would, put the proposal next to the photos. At most the rim of the deck is then still found.
    input.companion("masks/320x240.png", &png);
    let (metrics, outputs) = proposed(&input);
    assert_eq!(metrics.cameras[0].found, "nothing stands still");
    assert!(!outputs.contains_key("masks/320x240.png"));
}

#[test]
fn a_scene_without_hardware_and_few_photos_propose_nothing_and_say_why() {
    let (metrics, outputs) = proposed(&set(10, false));
    assert_eq!(metrics.cameras[0].found, "nothing stands still");
    assert_eq!(outputs.keys().collect::<Vec<_>>(), [Metrics::OUTPUT]);
    let (metrics, _) = proposed(&set(3, true));
    let expected = "the camera moves in 3 of 3 pairs of photos, which says nothing: at least 8 are needed";
    assert_eq!(metrics.cameras[0].found, expected);
}

#[test]
fn every_camera_is_looked_at_by_itself() {
    let mut input = set(8, true);
    for index in 0..8 {
        let facts = PhotoFacts {
            file: format!("n{index}.png"),
            width: WIDTH,
            height: HEIGHT,
            instrument: Some("NAV/CAM L".to_owned()),
            ..PhotoFacts::default()
        };
        input.photo(&format!("n{index}"), &photo(index, false), facts);
    }
    let (metrics, _) = proposed(&input);
    let found: Vec<_> = metrics
        .cameras
        .iter()
        .map(|camera| (camera.name.as_str(), camera.share > 0.0))
        .collect();
    assert_eq!(found, [("320x240", true), ("NAV_CAM_L-320x240", false)]);
}

/// If this fails, `masks` answers differently: raise its VERSION, then put the new pair here.
#[test]
fn the_answer_belongs_to_the_version() {
    let (_, outputs) = proposed(&set(10, true));
    let all: Vec<String> = outputs
        .iter()
        .map(|(name, digest)| format!("{name} {digest}"))
        .collect();
    let found = (
        Masks::VERSION,
        Digest::from_content(all.join("\n").as_bytes()).short(),
    );
    assert_eq!(found, (1, "054188011960".to_owned()));
    assert_eq!(define::<Masks>().version, Masks::VERSION);
}
