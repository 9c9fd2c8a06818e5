//! Which photos count as the same view, and which of them stays.

mod versions;

use crate::common::{
    Photos, bind, by_id, defaults, dynamic, ground, item, jpeg, measure_of, narrow, pixel_filters, png,
    recoloured, with_orientation,
};
use image::imageops::{self, FilterType};
use marf_scene::{Image, Srgb};
use marf_stage::{StageError, Work};
use serde_json::json;

/// Judges sols one after the other. Returns the verdicts and the bytes each sol added. The photos are all in the
/// store of the first.
fn fold(
    sols: &[&Photos],
) -> (
    Vec<std::collections::BTreeMap<String, marf_stage::Verdict>>,
    Vec<Vec<u8>>,
) {
    let stage = bind("duplicate", defaults());
    let Work::Fold(duplicate) = stage.work() else {
        panic!("duplicate is a fold");
    };
    let harness = &sols[0].harness;
    let (mut state, mut verdicts, mut states) = (duplicate.begin(), Vec::new(), Vec::<Vec<u8>>::new());
    for (sol, photos) in (1..).zip(sols) {
        let measures = photos.measures(&*stage);
        for digest in measures
            .iter()
            .flat_map(|measure| measure_of(&*stage).blobs(measure))
        {
            harness.put(&photos.harness.get(&digest).unwrap());
        }
        let items: Vec<_> = photos
            .rows
            .iter()
            .zip(&measures)
            .map(|(row, measure)| item(sol, row, measure))
            .collect();
        let (added, judged) = state.fold(&harness.ctx(), &items).unwrap();
        let mut resumed = duplicate.begin();
        for added in &states {
            resumed.replay(&harness.ctx(), added).unwrap();
        }
        let again = resumed.fold(&harness.ctx(), &items).unwrap();
        assert_eq!(
            (&added, &judged),
            (&again.0, &again.1),
            "a state that was replayed is the same"
        );
        for digest in state.blobs(&added) {
            assert!(
                harness.get(&digest).is_some(),
                "what was added names a blob that is not stored"
            );
        }
        verdicts.push(by_id(judged));
        states.push(added);
    }
    (verdicts, states)
}

fn pair(first: &[u8], second: &[u8]) -> (marf_stage::Verdict, marf_stage::Verdict) {
    let mut photos = Photos::default();
    photos.add("a", first).add("b", second);
    let verdicts = photos.judge("duplicate", defaults());
    (verdicts["a"].clone(), verdicts["b"].clone())
}

#[test]
fn copies_of_other_format_size_and_light_are_found_and_the_original_stays() {
    let original = ground(1);
    let resized = dynamic(&original).resize_exact(256, 192, FilterType::Lanczos3);
    let darker = recoloured(&original, |pixel| {
        pixel.map(|value| (f64::from(value) * 0.8) as u8)
    });
    for (name, copy) in [
        ("the same bytes", png(&original)),
        ("JPEG of quality 50", jpeg(&dynamic(&original), 50)),
        ("four fifths of the size", jpeg(&resized, 92)),
        ("darker", png(&darker)),
    ] {
        let (a, b) = pair(&png(&original), &copy);
        assert!(a.keeps(), "{name}: {a:?}");
        assert_eq!(
            (b.verdict.as_str(), b.twin.as_deref()),
            ("duplicate", Some("a")),
            "{name}: {b:?}"
        );
        assert!(b.score >= b.threshold, "{name}: {b:?}");
    }
}

#[test]
fn copies_through_a_narrow_filter_go_even_if_they_come_first() {
    let original = ground(2);
    for (band, tint) in [(0, [1.0, 0.55, 0.35]), (2, [0.45, 0.6, 1.0])] {
        let (narrow, broad) = pair(&png(&narrow(&original, band, tint)), &png(&original));
        assert!(broad.keeps(), "band {band}: {broad:?}");
        assert_eq!(narrow.twin.as_deref(), Some("b"), "band {band}: {narrow:?}");
    }
}

#[test]
fn the_archives_word_on_the_filter_decides_which_one_stays() {
    let mut photos = Photos::default();
    photos
        .add_with("a", &png(&ground(3)), |facts| facts.filter = Some("5".to_owned()))
        .add_with("b", &png(&ground(3)), |facts| facts.filter = Some("0".to_owned()));
    let verdicts = photos.judge("duplicate", defaults());
    assert_eq!(verdicts["a"].twin.as_deref(), Some("b"), "{:?}", verdicts["a"]);
}

#[test]
fn a_copy_turned_by_exif_is_found() {
    let original = dynamic(&ground(4));
    let turned = with_orientation(&jpeg(&imageops::rotate270(&original.to_rgb8()).into(), 92), 6);
    let (_, copy) = pair(&png(&ground(4)), &turned);
    assert_eq!(copy.verdict, "duplicate", "{copy:?}");
    let (_, untagged) = pair(
        &png(&ground(4)),
        &jpeg(&imageops::rotate270(&original.to_rgb8()).into(), 92),
    );
    assert!(untagged.keeps(), "{untagged:?}");
}

#[test]
fn other_places_and_neighbours_stay() {
    let (a, b) = pair(&png(&ground(5)), &png(&ground(6)));
    assert!(a.keeps() && b.keeps(), "{a:?} {b:?}");
    let place = ground(7);
    let moved = |by: u32| Image::from_fn(240, 180, |x, y| place.at(x + by, y));
    let (a, b) = pair(&png(&moved(0)), &png(&moved(24)));
    assert!(a.keeps() && b.keeps(), "a tenth of the width on: {a:?} {b:?}");
}

fn blend(step: u32, steps: u32) -> Image<Srgb> {
    let (from, to) = (ground(20), ground(21));
    Image::from_fn(320, 240, |x, y| {
        let mix = |band: usize| {
            let (from, to) = (u32::from(from.at(x, y)[band]), u32::from(to.at(x, y)[band]));
            ((from * (steps - step) + to * step) / steps) as u8
        };
        [mix(0), mix(1), mix(2)]
    })
}

#[test]
fn a_chain_of_neighbours_is_thinned_but_not_lost() {
    let mut photos = Photos::default();
    for step in 0..=16 {
        photos.add(&format!("{step:02}"), &png(&blend(step, 16)));
    }
    for params in [defaults(), json!({"rule": "phash"})] {
        let verdicts = photos.judge("duplicate", params.clone());
        let kept = verdicts.values().filter(|verdict| verdict.keeps()).count();
        assert!((2..17).contains(&kept), "{params}: {kept} kept");
        for verdict in verdicts.values().filter(|verdict| !verdict.keeps()) {
            let twin = &verdicts[verdict.twin.as_ref().unwrap()];
            assert!(
                twin.keeps(),
                "{params}: {} gave way to {}, which went too",
                verdict.id,
                twin.id
            );
        }
    }
}

#[test]
fn a_photo_of_a_later_sol_gives_way_to_one_of_an_earlier_sol() {
    let (mut first, mut second, mut third) = (Photos::default(), Photos::default(), Photos::default());
    first.add("z", &jpeg(&dynamic(&ground(30)), 60));
    second.add("a", &png(&ground(30))).add("new", &png(&ground(31)));
    third.add("b", &png(&ground(30))).add("c", &png(&ground(31)));
    let (verdicts, states) = fold(&[&first, &second, &third]);
    assert!(verdicts[0]["z"].keeps());
    assert_eq!(verdicts[1]["a"].twin.as_deref(), Some("z"));
    assert!(verdicts[1]["new"].keeps());
    assert_eq!(verdicts[2]["b"].twin.as_deref(), Some("z"));
    assert_eq!(verdicts[2]["c"].twin.as_deref(), Some("new"));
    assert_eq!(
        states[2],
        [0],
        "a sol that keeps nothing adds a list of no photos"
    );
}

#[test]
fn a_state_cut_short_is_refused() {
    let mut photos = Photos::default();
    photos.add("a", &png(&ground(40)));
    let (_, states) = fold(&[&photos]);
    let stage = bind("duplicate", defaults());
    let Work::Fold(duplicate) = stage.work() else {
        panic!("duplicate is a fold");
    };
    let cut = &states[0][..states[0].len() - 1];
    let error = duplicate.begin().replay(&photos.harness.ctx(), cut).unwrap_err();
    assert_eq!(error.to_string(), "photos kept of a sol cannot be read");
}

#[test]
fn the_papers_rule_asks_the_hash_alone() {
    let mut photos = Photos::default();
    photos
        .add("a", &png(&ground(50)))
        .add("b", &jpeg(&dynamic(&ground(50)), 70))
        .add("c", &png(&ground(51)));
    let verdicts = photos.judge("duplicate", json!({"rule": "phash"}));
    assert_eq!(
        verdicts.values().filter(|verdict| verdict.keeps()).count(),
        2,
        "{verdicts:?}"
    );
    assert_eq!(verdicts["b"].twin.as_deref(), Some("a"));
    assert!(verdicts["b"].score.unwrap() < 5.0, "{:?}", verdicts["b"]);
    let strict = photos.judge("duplicate", json!({"rule": "phash", "max_bits": 0}));
    assert!(
        strict.values().all(marf_stage::Verdict::keeps),
        "less than 0 bits apart is impossible"
    );
}

/// The images that are compared are a blob of their own, which the measure names.
#[test]
fn a_measure_stays_below_a_kilobyte() {
    let mut photos = Photos::default();
    photos.add("a", &png(&ground(60)));
    for name in pixel_filters() {
        let stage = bind(name, defaults());
        let bytes = &photos.measures(&*stage)[0];
        assert!(bytes.len() < 1000, "{name}: {} bytes", bytes.len());
        let blobs = measure_of(&*stage).blobs(bytes);
        assert_eq!(blobs.len(), usize::from(name == "duplicate"), "{name}");
        assert!(blobs.iter().all(|digest| photos.harness.get(digest).is_some()));
        assert!(measure_of(&*stage).blobs(b"\0cut").is_empty());
        // The text of a reason may read like a descriptor.
        let reason = [&[0], &bytes[1..]].concat();
        assert!(measure_of(&*stage).blobs(&reason).is_empty());
    }
}

/// The error names the digest of lost planes, so that the photo is measured again.
#[test]
fn lost_planes_are_named() {
    let mut photos = Photos::default();
    photos
        .add("a", &png(&ground(61)))
        .add("b", &jpeg(&dynamic(&ground(61)), 80));
    let stage = bind("duplicate", defaults());
    let measures = photos.measures(&*stage);
    let lost = measure_of(&*stage).blobs(&measures[1])[0];
    photos.harness.forget(&lost);
    let items: Vec<_> = photos
        .rows
        .iter()
        .zip(&measures)
        .map(|(row, measure)| item(0, row, measure))
        .collect();
    let error = photos.try_decide(&*stage, &items).unwrap_err();
    let StageError::Blob(error) = error else {
        panic!("{error}");
    };
    assert_eq!(error.lost, Some(lost));
}

/// Of different places no planes are read, since no hash is near.
#[test]
fn only_the_planes_of_candidates_are_read() {
    let mut photos = Photos::default();
    for seed in 200..206 {
        photos.add(&format!("place-{seed}"), &png(&ground(seed)));
    }
    photos.add("copy", &jpeg(&dynamic(&ground(203)), 70));
    let stage = bind("duplicate", json!({"candidate_bits": 6}));
    let measures = photos.measures(&*stage);
    let items: Vec<_> = photos
        .rows
        .iter()
        .zip(&measures)
        .map(|(row, measure)| item(0, row, measure))
        .collect();
    let verdicts = by_id(photos.decide(&*stage, &items));
    assert_eq!(verdicts.values().filter(|verdict| !verdict.keeps()).count(), 1);
    for (row, measure) in photos.rows.iter().zip(&measures) {
        let reads = photos.harness.reads(&measure_of(&*stage).blobs(measure)[0]);
        assert_eq!(
            reads,
            u64::from(["place-203", "copy"].contains(&row.id.as_str())),
            "{}",
            row.id
        );
    }
}

#[test]
fn the_one_kept_by_hand_stays_and_the_better_one_goes() {
    let mut photos = Photos::default();
    photos
        .add("sharp", &png(&ground(75)))
        .add("poor", &jpeg(&dynamic(&ground(75)), 80));
    assert!(photos.judge("duplicate", defaults())["sharp"].keeps());
    let by_hand = |keep: &[&str]| json!({"by_hand": {"keep": keep}});
    let verdicts = photos.judge("duplicate", by_hand(&["poor"]));
    assert!(verdicts["poor"].keeps() && verdicts["poor"].reason.starts_with("kept by hand"));
    assert_eq!(verdicts["sharp"].twin.as_deref(), Some("poor"));
    let verdicts = photos.judge("duplicate", by_hand(&["poor", "sharp.file"]));
    assert!(verdicts.values().all(marf_stage::Verdict::keeps), "{verdicts:?}");
}

/// 15,000 photos of three sols, where every tenth repeats an earlier place. They are enough that hashes are looked up
/// in tables and for many photos at once. The results equal those of comparing each photo with all kept ones.
#[test]
fn among_many_photos_the_same_are_found_as_by_comparing_all() {
    const SOLS: usize = 3;
    const PHOTOS: usize = 15_000;
    let mixed = |seed: usize| {
        let z = (seed as u64 ^ 0x9e37_79b9_7f4a_7c15).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        (z ^ (z >> 29)).wrapping_mul(0x94d0_49bb_1331_11eb) ^ (z >> 32)
    };
    // A photo of the same place has the same planes, and a hash some bits away: often too many.
    let place = |at: usize| {
        if at % 10 == 9 {
            (mixed(at) as usize % at) / 10 * 10
        } else {
            at
        }
    };
    let hash = |at: usize| {
        let flips = if place(at) == at { 0 } else { mixed(7 * at) % 20 };
        (0..flips).fold(mixed(place(at)), |hash, flip| {
            hash ^ (1 << ((flip * 3 + mixed(at)) % 64))
        })
    };
    let mut photos = Photos::default();
    let mut measures = Vec::new();
    for at in 0..PHOTOS {
        photos.rows.push(marf_cache::manifest::Row {
            id: format!("{at:05}"),
            blobs: Default::default(),
            facts: json!({"file": "", "width": 640, "height": 480}),
        });
        let planes: Vec<u8> = (0..4096)
            .map(|cell| mixed(4096 * place(at) + cell) as u8)
            .collect();
        // As a measure is kept: its first byte, size, sharpness, colour, hashes, digest of the planes.
        let planes = photos.harness.put(&planes);
        let descriptor = (
            [640_u32, 480],
            (PHOTOS - at) as f64,
            0.1,
            vec![hash(at)],
            planes.as_bytes(),
        );
        measures.push([vec![1], postcard::to_allocvec(&descriptor).unwrap()].concat());
    }
    let stage = bind("duplicate", defaults());
    let Work::Fold(duplicate) = stage.work() else {
        panic!("duplicate is a fold");
    };
    let (mut state, mut kept) = (duplicate.begin(), Vec::<usize>::new());
    let mut found_gone = 0;
    for sol in 0..SOLS {
        let of_sol = sol * PHOTOS / SOLS..(sol + 1) * PHOTOS / SOLS;
        let items: Vec<_> = of_sol
            .clone()
            .map(|at| item(sol as u32, &photos.rows[at], &measures[at]))
            .collect();
        let (_, verdicts) = state.fold(&photos.harness.ctx(), &items).unwrap();
        for (at, verdict) in of_sol.zip(verdicts) {
            // The photos are sharpest first, hence in the order of their ids.
            let near = |other: &&usize| (hash(at) ^ hash(**other)).count_ones() <= 14;
            let twin = kept.iter().filter(near).find(|other| place(**other) == place(at));
            let expected = twin.map(|twin| format!("{twin:05}"));
            assert_eq!(verdict.twin, expected, "{verdict:?}");
            match expected {
                None => kept.push(at),
                Some(_) => found_gone += 1,
            }
        }
    }
    assert!((500..1400).contains(&found_gone), "{found_gone}");
    assert!(kept.len() > 13_000, "{}", kept.len());
}
