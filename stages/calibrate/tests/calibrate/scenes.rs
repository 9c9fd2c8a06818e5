//! `scenes` on the built-in Mars at two sites: by labels, by what the photos show, and where labels are missing or wrong.

use std::sync::OnceLock;

use marf_demo::{Demo, DemoFile, DemoOptions};
use marf_pds::{ProductName, pds4};
use marf_scene::{Photo, PhotoFacts};
use marf_schema::scenes::{PhotoGroup, Scenes};
use marf_stage::{PHOTOS, StageError};
use serde_json::json;

use crate::common::Input;

/// A photo: id, image and facts.
type Taken = (String, Vec<u8>, PhotoFacts);

/// The good photos of the first sol at each of two sites, drawn once.
fn drawn() -> &'static [Taken] {
    static DRAWN: OnceLock<Vec<Taken>> = OnceLock::new();
    DRAWN.get_or_init(|| {
        let options = DemoOptions {
            width_px: 320,
            height_px: 240,
            seed: 1,
        };
        let demo = Demo::new(options).unwrap();
        let of_sol = |sol: u32| {
            let files = demo.files(sol, &|_, _| (), &|| false).unwrap();
            let photos = demo.ground_truth(sol).unwrap().photos.into_iter();
            let mut taken: Vec<Taken> = photos.map(|photo| taken(&files, &photo.file)).collect();
            taken.sort_by(|a, b| a.0.cmp(&b.0));
            taken
        };
        [of_sol(1), of_sol(101)].concat()
    })
}

fn taken(files: &[DemoFile], file: &str) -> Taken {
    let stem = file.rsplit_once('.').unwrap().0;
    let bytes = |name: &str| &files.iter().find(|one| one.name == name).unwrap().bytes;
    let name = ProductName::read(stem).unwrap();
    let label = pds4::read(bytes(&format!("{stem}.xml"))).unwrap();
    let photo = Photo::decode(bytes(file)).unwrap();
    let size_px = (photo.image.width, photo.image.height);
    let facts = PhotoFacts {
        file: file.to_owned(),
        width: size_px.0,
        height: size_px.1,
        bands: photo.bands,
        sol: name.sol,
        instrument: Some(name.instrument.clone()),
        prior: label.fit_camera(Some(&name), size_px.0, size_px.1, &mut Vec::new()),
        ..PhotoFacts::default()
    };
    (name.id, bytes(file).clone(), facts)
}

fn input(change: impl Fn(usize, &mut PhotoFacts)) -> Input {
    let mut input = Input::default();
    for (index, (id, bytes, facts)) in drawn().iter().enumerate() {
        let mut facts = facts.clone();
        change(index, &mut facts);
        input.photo(id, bytes, facts);
    }
    input
}

fn sizes(groups: &[PhotoGroup]) -> Vec<(&str, usize)> {
    let size = |group: &PhotoGroup| group.photos.len();
    groups
        .iter()
        .map(|group| (group.name.as_str(), size(group)))
        .collect()
}

#[test]
fn labels_give_a_scene_a_site_and_each_scene_has_its_own_photos() {
    let (outputs, scenes) = input(|_, _| ()).split(&json!({})).unwrap();
    assert_eq!(sizes(&scenes.scenes), [("site1-20", 20), ("site2-20", 20)]);
    assert_eq!(scenes.skipped, []);
    assert_eq!(scenes.scenes[1].sols, [101]);
    let names: Vec<&str> = outputs.keys().map(String::as_str).collect();
    assert_eq!(names, [PHOTOS, "photos/site1-20", "photos/site2-20", "scenes"]);
    // Three stops a site, all within the arc around the outcrop.
    let stops: Vec<(i64, Option<i64>)> = scenes.stops.iter().map(|stop| (stop.site, stop.drive)).collect();
    assert_eq!(
        stops,
        [
            (1, Some(20)),
            (1, Some(23)),
            (1, Some(26)),
            (2, Some(20)),
            (2, Some(23)),
            (2, Some(26))
        ]
    );
    let span_m = scenes.scenes[0].span_m.unwrap();
    assert!((1.0..12.0).contains(&span_m), "{span_m}");
    // A smaller span makes a scene of each stop.
    let (_, scenes) = input(|_, _| ()).split(&json!({"max_span_m": 0.5})).unwrap();
    assert_eq!(scenes.scenes.len(), 6, "{:?}", sizes(&scenes.scenes));
}

/// A scene's photos, and all results that follow from them, do not depend on photos of other places.
#[test]
fn another_place_changes_no_byte_of_a_scene() {
    let (both, _) = input(|_, _| ()).split(&json!({})).unwrap();
    let mut alone = input(|_, _| ());
    drop(alone.split_off(20));
    let (alone, _) = alone.split(&json!({})).unwrap();
    assert_eq!(both["photos/site1-20"], alone["photos/site1-20"]);
    assert_eq!(alone["photos/site1-20"], alone[PHOTOS]);
}

#[test]
fn what_the_photos_show_gives_the_same_places_without_labels() {
    let unlabelled = input(|_, facts| facts.prior = None);
    let (_, scenes) = unlabelled.split(&json!({})).unwrap();
    let (_, by_label) = input(|_, _| ()).split(&json!({})).unwrap();
    let photos = |scenes: &Scenes| -> Vec<Vec<String>> {
        let mut all: Vec<Vec<String>> = scenes.scenes.iter().map(|scene| scene.photos.clone()).collect();
        all.sort();
        all
    };
    assert_eq!(photos(&scenes), photos(&by_label), "{:?}", sizes(&scenes.scenes));
    // The same if labels are there but not used.
    let (_, by_overlap) = input(|_, _| ()).split(&json!({"by": "overlap"})).unwrap();
    assert_eq!(photos(&by_overlap), photos(&by_label));
}

#[test]
fn photos_without_a_label_join_their_place_and_a_wrong_site_is_named() {
    let mixed = input(|index, facts| match index {
        22 | 25 => facts.prior = None,
        3 => facts.prior.as_mut().unwrap().motion_counter[0] = 77,
        _ => (),
    });
    let (_, scenes) = mixed.split(&json!({})).unwrap();
    assert_eq!(sizes(&scenes.scenes), [("site1-20", 19), ("site2-20", 20)]);
    let reason = &scenes.scenes[1].reason;
    assert!(
        reason.contains("2 without a usable label by what they show"),
        "{reason}"
    );
    assert_eq!(sizes(&scenes.skipped), [("site77-20", 1)]);
    assert_eq!(scenes.skipped[0].reason, "1 photo, `min_photos` asks for 6");
    let (_, scenes) = mixed.split(&json!({"by": "label"})).unwrap();
    assert_eq!(sizes(&scenes.skipped), [("site77-20", 1), ("unlabelled", 2)]);
    assert!(
        scenes.skipped[1].reason.contains("no label has"),
        "{:?}",
        scenes.skipped
    );
}

#[test]
fn a_place_with_too_many_photos_is_split_and_hand_made_groups_come_first() {
    let (_, scenes) = input(|_, _| ()).split(&json!({"max_photos": 12})).unwrap();
    assert!(
        scenes.scenes.iter().all(|scene| scene.photos.len() <= 12),
        "{:?}",
        sizes(&scenes.scenes)
    );
    let photos: usize = scenes
        .scenes
        .iter()
        .chain(&scenes.skipped)
        .map(|group| group.photos.len())
        .sum();
    assert_eq!(photos, 40);
    let by_hand = json!({"groups": {"delta": {"sols": [101], "ids": [drawn()[0].0]}}});
    let (_, scenes) = input(|_, _| ()).split(&by_hand).unwrap();
    assert_eq!(sizes(&scenes.scenes), [("delta", 21), ("site1-20", 19)]);
}

#[test]
fn photos_of_no_scene_stop_the_node_with_the_way_out() {
    match input(|_, _| ()).split(&json!({"min_photos": 21})).unwrap_err() {
        StageError::Failed { message, cause, hint } => {
            assert_eq!(message, "none of 2 groups of 40 photos is a scene");
            assert!(cause.unwrap().contains("20 photos, `min_photos` asks for 21"));
            assert!(hint.unwrap().contains("min_photos"));
        }
        other => panic!("{other}"),
    }
}
