//! What holds for every filter of the table.

use crate::common::{
    Photos, bind, by_id, defaults, dynamic, encoded, ground, item, jpeg, measure_of, mixed, pixel_filters,
    png, with_orientation,
};
use image::{DynamicImage, ImageFormat};
use marf_cache::manifest::Row;
use marf_filter::{STAGES, tables};
use marf_scene::{Image, Srgb};
use marf_stage::Work;
use proptest::prelude::*;
use serde_json::json;

fn flat(width: u32, height: u32, value: u8) -> Image<Srgb> {
    Image::from_fn(width, height, |_, _| [value; 3])
}

/// A CMYK JPEG of 32 x 24 pixels, made by Pillow: no encoder here writes one.
const CMYK: &[u8] = include_bytes!("../common/cmyk.jpg");

/// An animation of two frames. Only the first is read.
fn animated() -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut encoder = image::codecs::gif::GifEncoder::new(&mut bytes);
    for seed in [21, 22] {
        encoder
            .encode_frame(image::Frame::new(dynamic(&ground(seed)).to_rgba8()))
            .unwrap();
    }
    drop(encoder);
    bytes
}

fn odd_photos() -> Photos {
    let deep = DynamicImage::from(dynamic(&ground(3)).to_luma16());
    let clear = DynamicImage::from(dynamic(&ground(4)).to_rgba8());
    let mut photos = Photos::default();
    photos
        .add("1x1", &png(&flat(1, 1, 90)))
        .add("7x2", &png(&flat(7, 2, 90)))
        .add(
            "1x400",
            &png(&Image::from_fn(1, 400, |_, y| [(y % 256) as u8, 3, 9])),
        )
        .add("black", &png(&flat(320, 240, 0)))
        .add("white", &png(&flat(320, 240, 255)))
        .add("gray", &png(&flat(320, 240, 128)))
        .add("16-bit", &encoded(&deep, ImageFormat::Png))
        .add("alpha", &encoded(&clear, ImageFormat::Png))
        .add(
            "gray-alpha",
            &encoded(&dynamic(&ground(5)).to_luma_alpha8().into(), ImageFormat::Png),
        )
        .add(
            "gif",
            &encoded(&dynamic(&ground(6)).to_rgba8().into(), ImageFormat::Gif),
        )
        .add("webp", &encoded(&dynamic(&ground(7)), ImageFormat::WebP))
        .add("jpeg", &jpeg(&dynamic(&ground(8)), 90))
        .add("animated", &animated())
        .add("turned", &with_orientation(&jpeg(&dynamic(&ground(9)), 90), 6))
        .add("cmyk", CMYK)
        .add("no-bytes", b"")
        .add("html", b"<html>404 not found</html>");
    photos
}

#[test]
fn every_filter_has_one_finite_verdict_for_every_odd_photo() {
    let photos = odd_photos();
    for stage in STAGES {
        let verdicts = photos.judge(stage.name, defaults());
        assert_eq!(verdicts.len(), photos.rows.len(), "{}", stage.name);
        for verdict in verdicts.values() {
            let numbers = [verdict.score, verdict.threshold];
            assert!(
                numbers.iter().flatten().all(|number| number.is_finite()),
                "{}: {verdict:?}",
                stage.name
            );
            assert_eq!(verdict.file, format!("{}.file", verdict.id));
            if !verdict.keeps() {
                assert!(!verdict.reason.is_empty(), "{}: {verdict:?}", stage.name);
                assert!(
                    verdict.verdict == stage.name || verdict.verdict == "decode",
                    "{verdict:?}"
                );
            }
        }
    }
}

#[test]
fn bytes_that_are_no_photo_are_a_verdict_with_the_reason() {
    let photos = odd_photos();
    for stage in pixel_filters() {
        let verdicts = photos.judge(stage, defaults());
        assert_eq!(verdicts["html"].verdict, "decode", "{stage}");
        assert!(
            verdicts["html"].reason.contains("3c68746d6c"),
            "{stage}: {}",
            verdicts["html"].reason
        );
        assert_eq!(verdicts["no-bytes"].verdict, "decode", "{stage}");
    }
}

#[test]
fn a_set_of_no_photos_has_no_verdicts() {
    for stage in STAGES {
        let decided = Photos::default().decide(&*bind(stage.name, defaults()), &[]);
        assert_eq!(decided, [], "{}", stage.name);
    }
}

/// One decode serves all filters: any of them fills the tables of all, and each table is the filter's own.
#[test]
fn a_filter_that_measures_pixels_fills_the_tables_of_all_from_one_decode() {
    let photos = odd_photos();
    let image = |row: &Row| row.blobs["image"];
    let alone: Vec<Vec<Vec<u8>>> = pixel_filters()
        .iter()
        .map(|name| photos.measures(&*bind(name, defaults())))
        .collect();
    for name in pixel_filters() {
        let stage = bind(name, defaults());
        let measure = measure_of(&*stage);
        assert_eq!(measure.table().unwrap().name, name);
        assert_eq!(measure.together(), tables());
        for (at, row) in photos.rows.iter().enumerate() {
            let before = photos.harness.reads(&image(row));
            let together = measure.measure(&photos.harness.ctx(), row, &tables()).unwrap();
            assert_eq!(
                photos.harness.reads(&image(row)),
                before + 1,
                "{name} of {}",
                row.id
            );
            let expected: Vec<_> = alone.iter().map(|measures| measures[at].clone()).collect();
            assert_eq!(together, expected, "{name} of {}", row.id);
        }
    }
    for name in ["size", "shape"] {
        let stage = bind(name, defaults());
        assert_eq!(measure_of(&*stage).table(), None);
        assert!(
            measure_of(&*stage).together().is_empty(),
            "{name} needs the facts alone"
        );
    }
}

#[test]
fn a_decision_looks_at_other_photos_only_where_its_rule_does() {
    for (name, params, passes) in [
        ("size", defaults(), &[][..]),
        ("shape", defaults(), &["sizes"]),
        ("shape", json!({"min_share": 0.0}), &[]),
        ("grayscale", defaults(), &["colors"]),
        ("grayscale", json!({"keep": "color"}), &[]),
        ("histogram", defaults(), &["shares", "distances"]),
        ("histogram", json!({"rule": "paper"}), &["sums"]),
        ("blur", defaults(), &["ratios"]),
        ("blur", json!({"rule": "laplacian"}), &[]),
    ] {
        let stage = bind(name, params.clone());
        let Work::Map(map) = stage.work() else {
            panic!("{name} is a map");
        };
        let found = map.comparison().map(|comparison| comparison.passes());
        assert_eq!(found.unwrap_or_default(), passes, "{name} {params}");
    }
}

/// What makes a decision without a comparison right: each photo alone has the verdict that it has among the others.
#[test]
fn a_decision_on_one_photo_is_that_among_others_where_photos_are_not_compared() {
    let photos = mixed();
    for (name, params) in [
        ("size", defaults()),
        (
            "shape",
            json!({"min_share": 0.0, "common_share": 0.5, "min_set": 2}),
        ),
        ("grayscale", json!({"keep": "color"})),
        ("blur", json!({"rule": "laplacian"})),
    ] {
        let stage = bind(name, params);
        let measures = photos.measures(&*stage);
        let items: Vec<_> = photos
            .rows
            .iter()
            .zip(&measures)
            .map(|(row, measure)| item(0, row, measure))
            .collect();
        let alone: Vec<_> = items
            .iter()
            .flat_map(|item| photos.decide(&*stage, &[*item]))
            .collect();
        assert_eq!(alone, photos.decide(&*stage, &items), "{name}");
    }
}

/// Threads may measure in any order and at the same time.
#[test]
fn measures_are_the_same_from_any_thread() {
    let photos = odd_photos();
    let stage = bind("blur", defaults());
    let alone = photos.measures(&*stage);
    let together: Vec<Vec<Vec<u8>>> = std::thread::scope(|scope| {
        let threads: Vec<_> = (0..4)
            .map(|_| scope.spawn(|| photos.measures(&*bind("blur", defaults()))))
            .collect();
        threads.into_iter().map(|thread| thread.join().unwrap()).collect()
    });
    assert!(together.iter().all(|measures| *measures == alone));
}

#[test]
fn every_filter_can_be_overruled_by_id_or_file_and_says_so() {
    let photos = mixed();
    for stage in STAGES {
        let by_hand = json!({"by_hand": {"keep": ["half-black", "smeared.file"], "reject": ["place-5"]}});
        let usual = photos.judge(stage.name, defaults());
        let verdicts = photos.judge(stage.name, by_hand);
        for kept in ["half-black", "smeared"] {
            assert!(verdicts[kept].keeps(), "{}: {:?}", stage.name, verdicts[kept]);
            assert!(
                verdicts[kept].reason.starts_with("kept by hand"),
                "{:?}",
                verdicts[kept]
            );
            assert_eq!(verdicts[kept].score, usual[kept].score, "{}", stage.name);
        }
        let gone = &verdicts["place-5"];
        assert_eq!(gone.verdict, stage.name);
        assert!(gone.reason.starts_with("rejected by hand"), "{gone:?}");
    }
}

#[test]
fn a_row_without_image_stops_the_filters_that_measure_pixels() {
    let mut photos = Photos::default();
    photos.add("bare", b"x");
    photos.rows[0].blobs.clear();
    for stage in pixel_filters() {
        let stage = bind(stage, defaults());
        let error = measure_of(&*stage)
            .measure(&photos.harness.ctx(), &photos.rows[0], &tables())
            .unwrap_err();
        assert_eq!(error.to_string(), "photo `bare` has no blob `image`");
    }
}

#[test]
fn a_measure_that_was_damaged_is_an_error_that_names_the_photo() {
    let mut photos = Photos::default();
    photos.add("place", &png(&ground(0)));
    for stage in STAGES {
        let bound = bind(stage.name, defaults());
        for damaged in [&b"{"[..], b"\x01\xff", b"\x07"] {
            let items = [item(0, &photos.rows[0], damaged)];
            let error = photos.try_decide(&*bound, &items).unwrap_err();
            assert!(error.to_string().contains("`place`"), "{}: {error}", stage.name);
        }
    }
}

#[test]
fn thresholds_are_in_the_params_but_not_in_what_a_measure_depends_on() {
    let changed = [
        ("size", json!({"min_bytes": 7})),
        ("shape", json!({"min_width": 7})),
        ("duplicate", json!({"rule": "phash", "max_bits": 7})),
        ("grayscale", json!({"keep": "all"})),
        ("histogram", json!({"rule": "paper", "max_bins": 0.7})),
        ("blur", json!({"rule": "laplacian", "tau": 7.0})),
    ];
    for (name, params) in changed {
        let (usual, other) = (bind(name, defaults()), bind(name, params));
        assert_ne!(usual.params(), other.params(), "{name}");
        assert_eq!(measure_of(&*usual).table(), measure_of(&*other).table(), "{name}");
    }
}

#[test]
fn unknown_and_impossible_parameters_are_refused_by_name() {
    for stage in STAGES {
        let error = (stage.bind)(json!({"min_bytess": 1})).map(|_| ()).unwrap_err();
        assert!(error.message.contains("min_bytess"), "{}: {error}", stage.name);
    }
    for (name, params, path) in [
        ("size", json!({"min_bits_per_pixel": -1.0}), "min_bits_per_pixel"),
        ("shape", json!({"min_share": 1.5}), "min_share"),
        ("duplicate", json!({"candidate_bits": 65}), "candidate_bits"),
        ("grayscale", json!({"min_share": 2.0}), "min_share"),
        ("histogram", json!({"max_flat": -0.1}), "max_flat"),
        ("blur", json!({"floor_ratio": 20.0}), "floor_ratio"),
    ] {
        let error = (crate::common::stage(name).bind)(params).map(|_| ()).unwrap_err();
        assert_eq!(error.path, path, "{name}: {error}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(16))]

    #[test]
    fn verdicts_do_not_depend_on_the_order_of_the_photos(order in Just((0..12).collect::<Vec<usize>>()).prop_shuffle()) {
        thread_local!(static SET: (Photos, Vec<Vec<Vec<u8>>>) = {
            let photos = mixed();
            let measures = STAGES.iter().map(|stage| photos.measures(&*bind(stage.name, defaults()))).collect();
            (photos, measures)
        });
        SET.with(|(photos, measures)| {
            for (stage, measures) in STAGES.iter().zip(measures) {
                let bound = bind(stage.name, defaults());
                let ask = |order: &[usize]| {
                    let items: Vec<_> = order.iter().map(|at| item(0, &photos.rows[*at], &measures[*at])).collect();
                    by_id(photos.decide(&*bound, &items))
                };
                let sorted: Vec<usize> = (0..photos.rows.len()).collect();
                prop_assert_eq!(ask(&sorted), ask(&order), "{}", stage.name);
            }
            Ok(())
        })?;
    }
}
