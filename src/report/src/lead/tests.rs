use marf_scene::Point;

use super::*;
use crate::fixture::{full, node};
use crate::fixture_documents::spread;

#[test]
fn the_first_screen_says_the_result_with_its_numbers() {
    let (store, nodes) = full();
    let said = store.with_report(&nodes, |report| {
        let media = crate::media::Media::Embedded;
        body(&Page::new(report, &media)).into_string()
    });
    // 255 / 10^(24.567 / 20) = 15.08.
    for text in [
        "4 of 7 photos became a field of 0 x 0 m of ground.",
        "<dt>ground with most points</dt><dd>0 x 0 m",
        "<dd>15 of 255 gray levels",
        "cameras from above <span class=\"legend\">",
        "Views were judged up to 3 m and 90° from a photo trained on. Farther away errors are not known.",
        "Photos rejected: 3 (1 by extract, 2 by duplicate).",
        "New views differ from held-out photos by 15 of 255 gray levels (root mean square, 24.57 dB), from photos trained on by 13.",
        "At sparse points of held-out photos, half of the retrainings' mean depths are off by at most 1 % (5 cm at 5 m).",
        "No photo trained on saw 1 % of what they show: there the field is invented",
        "<dt>photos kept</dt><dd>4 of 7</dd>",
        "<dt>photos placed</dt><dd>4 of 5</dd>",
        "1 of 5 photos have no camera.",
        "The error is that of 1 held-out photo at 1 place only.",
        "<video",
    ] {
        assert!(said.contains(text), "{text}: {said}");
    }
}

#[test]
fn the_photo_with_most_of_what_no_photo_saw_is_named() {
    let mut maps = spread(["a", "b"].map(str::to_owned).to_vec());
    maps.views[1].unseen_share = 0.4;
    let said = |maps: bootstrap::Metrics| {
        let maps = Some(maps);
        let facts = Facts {
            maps,
            ..Facts::default()
        };
        facts.least_seen()
    };
    let found = said(maps.clone()).unwrap();
    assert!(
        found.ends_with("no photo saw. b has most of them (40 %)."),
        "{found}"
    );
    maps.views.truncate(1);
    assert_eq!(said(maps), None);
}

/// Of two held-out photos no photo saw 1.2 % and 5 %. A path through what nobody saw says nothing of them.
#[test]
fn the_unseen_share_is_that_of_held_out_photos_whatever_else_is_mapped() {
    let mut maps = spread(["a", "b", "orbit-0001"].map(str::to_owned).to_vec());
    maps.views[1].unseen_share = 0.05;
    let path = &mut maps.views[2];
    (path.unseen_share, path.place, path.photo) = (0.9, None, None);
    maps.unseen_share = 0.32;
    let mut facts = Facts {
        maps: Some(maps),
        ..Facts::default()
    };
    let share = facts.invented_share().unwrap();
    assert!((share - 0.031).abs() < 1e-12, "{share}");
    let named = facts.least_seen().unwrap();
    assert!(named.contains(" b has most of them (5 %)."), "{named}");
    // Of a path alone nothing is known, and the scores of the held-out photos decide.
    facts.maps.as_mut().unwrap().views.drain(..2);
    assert_eq!((facts.invented_share(), facts.least_seen()), (None, None));
}

/// The deviation of a depth from pairs is no constant share of it, so that no length is right at 5 m.
#[test]
fn depths_from_pairs_are_off_by_a_share_of_the_distance() {
    let facts = Facts {
        scene: Some(Scene {
            metres_per_unit: Some(1.0),
            ..Scene::default()
        }),
        pairs_share: Some(0.02),
        ..Facts::default()
    };
    assert_eq!(
        facts.depth_words().unwrap(),
        "One standard deviation of depths from pairs of photos is 2 % of the distance in the median."
    );
}

#[test]
fn a_run_that_made_nothing_says_nothing() {
    let store = crate::fixture::Store::default();
    let said = store.with_report(&[node("train", &[])], |report| {
        let media = crate::media::Media::Embedded;
        body(&Page::new(report, &media)).into_string()
    });
    assert!(
        !said.contains("<p class=\"lead\">") && !said.contains("<li>"),
        "{said}"
    );
}

/// 101 points on a line of 10 units that stand 2 m apart each tenth: 0.5 to 9.5 units are 18 m, and across there is nothing.
#[test]
fn an_extent_leaves_stray_points_out() {
    let scene = |up| Scene {
        up,
        metres_per_unit: Some(2.0),
        points: (0..=100)
            .map(|index| Point {
                position: [f64::from(index) * 0.1, 0.0, 0.0],
                color: None,
                views: 2,
            })
            .collect(),
        ..Scene::default()
    };
    let found = extent(&scene(Some([0.0, 0.0, 1.0]))).unwrap();
    assert_eq!(found, "18 x 0 m");
    assert_eq!(extent(&scene(None)), None);
    assert_eq!(extent(&Scene::default()), None);
}
