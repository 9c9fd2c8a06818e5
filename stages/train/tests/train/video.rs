//! Pictures of a path become a film.

use marf_scene::{Image, Srgb, encode_png};
use marf_schema::video::{Film, VideoParams};
use marf_stage::{Define, Document, Inputs, Outputs, Set, StageError, harness::Harness};
use marf_train::Video;
use serde_json::json;

fn picture(width: u32, height: u32, shift: u32) -> Image<Srgb> {
    Image::from_fn(width, height, |column, row| {
        [(column + shift) as u8, row as u8, 90]
    })
}

fn film(harness: &Harness, sizes: &[(u32, u32)]) -> Inputs {
    let stored = sizes.iter().zip(0..).map(|((width, height), shift)| {
        let png = encode_png(&picture(*width, *height, shift)).unwrap();
        harness.put(&png)
    });
    let film = Film(stored.collect()).encode().unwrap();
    Inputs([(Film::OUTPUT.to_owned(), harness.put(&film))].into())
}

fn run(harness: &Harness, inputs: &Inputs, params: serde_json::Value) -> Result<Outputs, StageError> {
    let params: VideoParams = serde_json::from_value(params).unwrap();
    Video::new(params).unwrap().run(&harness.ctx(), inputs)
}

#[test]
fn pictures_become_one_file_and_the_quantiser_decides_its_size() {
    let harness = Harness::default();
    let inputs = film(&harness, &[(64, 48); 5]);
    let size = |params| {
        let outputs = run(&harness, &inputs, params).unwrap();
        let video = harness.get(&outputs["video"]).unwrap();
        assert_eq!((&video[4..8], outputs.len()), (&b"ftyp"[..], 1));
        video.len()
    };
    assert!(size(json!({"quantizer": 12})) > size(json!({"quantizer": 40})));
}

/// Photos of one scene may differ in shape: `render` with `path = "heldout"`.
#[test]
fn pictures_of_other_sizes_are_cut_or_filled_to_that_of_the_first() {
    let harness = Harness::default();
    let inputs = film(&harness, &[(64, 48), (48, 64), (80, 20)]);
    assert!(run(&harness, &inputs, json!({})).is_ok());
}

#[test]
fn what_is_no_film_is_said() {
    let harness = Harness::default();
    let refused = |inputs: &Inputs| run(&harness, inputs, json!({})).unwrap_err().to_string();
    assert_eq!(
        refused(&film(&harness, &[])),
        "a video needs at least one picture"
    );
    let junk = harness.put(b"junk");
    let junk = harness.put(&Film(vec![junk]).encode().unwrap());
    let inputs = Inputs([(Film::OUTPUT.to_owned(), junk)].into());
    assert!(
        refused(&inputs).starts_with("picture `1`: not a JPEG"),
        "{}",
        refused(&inputs)
    );
}

#[test]
fn a_cancelled_film_stops_before_the_next_picture() {
    let harness = Harness::default();
    let inputs = film(&harness, &[(64, 48); 5]);
    harness.cancel.set();
    let stopped = run(&harness, &inputs, json!({}));
    assert!(matches!(stopped, Err(StageError::Cancelled)), "{stopped:?}");
}

/// If this digest changes and `Video::VERSION` does not, raise the version.
#[test]
fn the_answer_belongs_to_the_version() {
    let harness = Harness::default();
    let inputs = film(&harness, &[(62, 47); 7]);
    let outputs = run(&harness, &inputs, json!({})).unwrap();
    assert_eq!(
        (Video::VERSION, outputs["video"].short().as_str()),
        (1, "b6ee894d6f4c")
    );
}
