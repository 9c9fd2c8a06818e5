use std::{collections::BTreeMap, sync::OnceLock};

use marf_scene::{Cahvor, Photo};

use super::{lens::Lens, math::V3, *};

mod change;
mod labels;

/// The usual photos, small enough for a test.
fn small() -> Demo {
    Demo::new(DemoOptions {
        width_px: 160,
        height_px: 120,
        seed: 1,
    })
    .unwrap()
}

fn never() -> bool {
    false
}

/// The files of sol 1 of [`small`], by name.
fn sol_1() -> &'static BTreeMap<String, Vec<u8>> {
    static FILES: OnceLock<BTreeMap<String, Vec<u8>>> = OnceLock::new();
    FILES.get_or_init(|| {
        let files = small().files(1, &|_, _| (), &never).unwrap();
        files.into_iter().map(|file| (file.name, file.bytes)).collect()
    })
}

fn lens(model: &Cahvor) -> Lens {
    Lens {
        c: model.c.into(),
        a: model.a.into(),
        h: model.h.into(),
        v: model.v.into(),
        o: model.o.unwrap().into(),
        r: model.r.unwrap(),
    }
}

/// Sol 101 is the first of the second site. It has another landscape, another site in names and labels, and a
/// frame of its own. In it the rover is as near to the outcrop as on sol 1.
#[test]
fn each_hundred_sols_are_of_another_site() {
    let demo = small();
    let (first, second) = (demo.ground_truth(1).unwrap(), demo.ground_truth(101).unwrap());
    assert!(
        first.photos.iter().all(|photo| photo.file.contains("_N001")),
        "{}",
        first.photos[0].file
    );
    assert!(
        second.photos.iter().all(|photo| photo.file.contains("_N002")),
        "{}",
        second.photos[0].file
    );
    assert_ne!(first.photos[0].site_from_rover, second.photos[0].site_from_rover);
    let places = |truth: &Truth| truth.photos[0].site_from_rover.translation;
    assert!((places(&first) - places(&second)).norm() < 15.0);
    let ranges = |sol: u32, truth: &Truth| demo.ranges(sol, &truth.photos[0].file).unwrap().range_m;
    assert_ne!(ranges(1, &first), ranges(101, &second));
    assert_ne!(demo.fingerprint(1), demo.fingerprint(101));
    assert_eq!(
        (plan::site(1), plan::site(100), plan::site(101), plan::site(999)),
        (1, 1, 2, 10)
    );
}

#[test]
fn the_same_bytes_with_one_thread_and_with_four() {
    let options = DemoOptions {
        width_px: 64,
        height_px: 48,
        seed: 3,
    };
    let draw = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        let demo = Demo::new(options.clone()).unwrap();
        pool.install(|| demo.files(2, &|_, _| (), &never).unwrap())
    };
    let (one, four) = (draw(1), draw(4));
    assert_eq!(one.len(), four.len());
    for (a, b) in one.iter().zip(&four) {
        assert!(a == b, "{} differs", a.name);
    }
}

/// Digest changed: raise `DEMO_VERSION`, then note the new pair here.
#[test]
fn the_version_is_raised_when_the_demo_draws_otherwise() {
    let options = DemoOptions {
        width_px: 64,
        height_px: 48,
        seed: 1,
    };
    let files = Demo::new(options).unwrap().files(1, &|_, _| (), &never).unwrap();
    let all: Vec<(String, Digest)> = files
        .into_iter()
        .map(|file| (file.name, Digest::from_content(&file.bytes)))
        .collect();
    let digest = digest_of(&all).short();
    assert_eq!((DEMO_VERSION, digest.as_str()), (1, "95213f591cb0"));
}

#[test]
fn the_fingerprints_stay_what_they_were() {
    let changed = small().with_change(2).unwrap();
    let fingerprints = [
        small().fingerprint(1),
        small().fingerprint(101),
        changed.fingerprint(2),
    ];
    let short = fingerprints.map(|fingerprint| fingerprint.unwrap().short());
    assert_eq!(short, ["ee7a3639e17b", "a2736e0d6c86", "acc46f514ecb"]);
}

#[test]
fn the_fingerprint_knows_sol_and_every_option() {
    let base = DemoOptions::default();
    let others = [
        base.clone(),
        DemoOptions {
            width_px: 320,
            ..base.clone()
        },
        DemoOptions {
            height_px: 320,
            ..base.clone()
        },
        DemoOptions { seed: 2, ..base },
    ];
    let mut prints: Vec<Digest> = others
        .into_iter()
        .map(|options| Demo::new(options).unwrap().fingerprint(1).unwrap())
        .collect();
    prints.push(small().fingerprint(2).unwrap());
    prints.sort();
    prints.dedup();
    assert_eq!(prints.len(), 5);
}

#[test]
fn what_cannot_be_drawn_is_refused() {
    for (width_px, height_px) in [(0, 480), (640, 15), (4097, 480)] {
        let options = DemoOptions {
            width_px,
            height_px,
            seed: 1,
        };
        let error = Demo::new(options).err().unwrap().to_string();
        assert!(error.contains(&format!("{width_px} x {height_px}")), "{error}");
    }
    for sol in [0, 1000] {
        assert_eq!(small().fingerprint(sol), Err(DemoError::Sol { sol }));
        assert_eq!(
            small().files(sol, &|_, _| (), &never),
            Err(DemoError::Sol { sol })
        );
    }
    let file = || "ZL0.png".to_owned();
    assert_eq!(
        small().ranges(1, "ZL0.png"),
        Err(DemoError::File { file: file(), sol: 1 })
    );
}

#[test]
fn a_wish_to_stop_is_heard() {
    assert_eq!(small().files(1, &|_, _| (), &|| true), Err(DemoError::Cancelled));
}

#[test]
fn progress_counts_every_file_once() {
    let last = AtomicU64::new(0);
    let demo = Demo::new(DemoOptions {
        width_px: 16,
        height_px: 16,
        seed: 1,
    })
    .unwrap();
    let files = demo.files(
        1,
        &|done, _| {
            last.fetch_max(done, Ordering::Relaxed);
        },
        &never,
    );
    assert_eq!(last.into_inner() * 2, files.unwrap().len() as u64);
}

#[test]
fn every_image_has_its_label_and_decodes_unless_it_is_the_truncated_one() {
    let truth = small().ground_truth(1).unwrap();
    let truncated: Vec<&Flaw> = truth
        .flaws
        .iter()
        .filter(|flaw| flaw.kind == FlawKind::Truncated)
        .collect();
    assert_eq!(truncated.len(), 1);
    for (name, bytes) in sol_1().iter().filter(|(name, _)| !name.ends_with(".xml")) {
        assert!(sol_1().contains_key(&format!("{}.xml", &name[..54])), "{name}");
        assert_eq!(
            Photo::decode(bytes).is_err(),
            *name == truncated[0].file,
            "{name}"
        );
    }
    assert_eq!(truth.photos.len(), 20);
    assert_eq!(sol_1().len(), 2 * (truth.photos.len() + truth.flaws.len()));
}

/// Returns the filters, one of them expected to reject a flaw, the likeliest first. `decode` means extraction itself.
fn expected(kind: FlawKind) -> &'static [&'static str] {
    match kind {
        FlawKind::Thumbnail => &["shape", "size"],
        FlawKind::MonoCopy => &["duplicate", "grayscale"],
        FlawKind::Mono | FlawKind::EqualBands => &["grayscale"],
        FlawKind::NarrowBand(_) | FlawKind::ExactCopy | FlawKind::Reencoded => &["duplicate"],
        FlawKind::Defocus | FlawKind::Motion => &["blur"],
        FlawKind::Noise => &["histogram", "blur"],
        FlawKind::ColourBlocks | FlawKind::Deck => &["histogram"],
        FlawKind::Truncated => &["decode"],
        FlawKind::Dark => &["size"],
    }
}

#[test]
fn every_kind_of_flaw_is_planted_and_is_what_it_says() {
    let truth = small().ground_truth(1).unwrap();
    let expected: std::collections::BTreeSet<&str> = truth
        .flaws
        .iter()
        .flat_map(|flaw| expected(flaw.kind))
        .copied()
        .collect();
    let filters = [
        "blur",
        "decode",
        "duplicate",
        "grayscale",
        "histogram",
        "shape",
        "size",
    ];
    assert_eq!(expected.into_iter().collect::<Vec<_>>(), filters);
    for flaw in truth.flaws.iter().filter(|flaw| flaw.kind != FlawKind::Truncated) {
        let photo = Photo::decode(&sol_1()[&flaw.file]).unwrap();
        let gray = photo.image.pixels.iter().all(|[r, g, b]| r == g && g == b);
        let mono = matches!(flaw.kind, FlawKind::Mono | FlawKind::MonoCopy);
        assert_eq!(photo.bands == 1, mono, "{flaw:?}");
        assert_eq!(gray, mono || flaw.kind == FlawKind::EqualBands, "{flaw:?}");
        let thumbnail = flaw.kind == FlawKind::Thumbnail;
        assert_eq!(photo.image.width == 40, thumbnail, "{flaw:?}");
        if flaw.kind == FlawKind::ExactCopy {
            assert_eq!(sol_1()[&flaw.file], sol_1()[flaw.twin.as_ref().unwrap()]);
        }
    }
}

/// Points seen in the left eye, carried by the true range into the right one, have the same colour there
/// unless something hides them.
#[test]
fn truth_carries_points_from_eye_to_eye_and_from_stop_to_stop() {
    let demo = small();
    let truth = demo.ground_truth(1).unwrap();
    for (a, b) in [(0, 1), (0, 8)] {
        let (from, to) = (&truth.photos[a], &truth.photos[b]);
        let (ranges, other) = (
            demo.ranges(1, &from.file).unwrap(),
            demo.ranges(1, &to.file).unwrap(),
        );
        let decode = |file: &str| Photo::decode(&sol_1()[file]).unwrap().image;
        let (left, right) = (decode(&from.file), decode(&to.file));
        let (one, two) = (lens(&from.site_model), lens(&to.site_model));
        let (mut seen, mut alike) = (0, 0);
        for (x, y) in (60..118).flat_map(|y| (4..156).map(move |x| (x, y))) {
            let range = f64::from(ranges.range_m[(y * 160 + x) as usize]);
            let point = one.c + one.ray(f64::from(x), f64::from(y)) * range;
            let Some((u, v)) = two.project(point) else {
                continue;
            };
            if !(1.0..158.0).contains(&u) || !(1.0..118.0).contains(&v) {
                continue;
            }
            let at = ((v + 0.5) as usize) * 160 + (u + 0.5) as usize;
            let depth = (point - two.c).norm();
            if (f64::from(other.range_m[at]) - depth).abs() > 0.01 * depth {
                continue; // Hidden, or on an edge.
            }
            seen += 1;
            alike += usize::from(distance(left.at(x, y), bilinear(&right, u, v)) < 24.0);
        }
        let share = f64::from(alike as u32) / f64::from(seen as u32);
        assert!(seen > 1500, "{seen} points between photos {a} and {b}");
        assert!(share > 0.9, "photos {a} and {b}: {share} of {seen} points alike");
    }
}

fn bilinear(image: &Image<Srgb>, x: f64, y: f64) -> [f64; 3] {
    let (i, j) = (x as u32, y as u32);
    let (u, v) = (x - f64::from(i), y - f64::from(j));
    std::array::from_fn(|k| {
        let at = |di, dj| f64::from(image.at(i + di, j + dj)[k]);
        (at(0, 0) * (1.0 - u) + at(1, 0) * u) * (1.0 - v) + (at(0, 1) * (1.0 - u) + at(1, 1) * u) * v
    })
}

fn distance(a: [u8; 3], b: [f64; 3]) -> f64 {
    (0..3).map(|k| (f64::from(a[k]) - b[k]).abs()).fold(0.0, f64::max)
}

/// Every photo shows rocks a few metres away, from positions metres apart.
#[test]
fn sols_look_at_the_same_rocks_from_different_places() {
    let demo = small();
    let centres: Vec<V3> = (1..=3)
        .flat_map(|sol| demo.ground_truth(sol).unwrap().photos)
        .map(|photo| photo.site_model.c.into())
        .collect();
    let widest = centres
        .iter()
        .flat_map(|a| centres.iter().map(|b| (*a - *b).norm()))
        .fold(0.0, f64::max);
    assert!((5.0..14.0).contains(&widest), "{widest} m apart");
    assert!(((centres[0] - centres[1]).norm() - tour::BASELINE_M).abs() < 1e-9);
    for photo in demo.ground_truth(2).unwrap().photos {
        let ranges = demo.ranges(2, &photo.file).unwrap().range_m;
        let ground = ranges.iter().filter(|range| range.is_finite()).count() as f64 / ranges.len() as f64;
        assert!(
            (0.6..=1.0).contains(&ground),
            "{}: {ground} of the photo is ground",
            photo.file
        );
        let middle = f64::from(ranges[60 * 160 + 80]);
        assert!((2.0..60.0).contains(&middle), "{}: {middle} m", photo.file);
    }
}

/// The pinhole of the truth is the lens without its radial terms.
#[test]
fn the_pinhole_sees_what_the_lens_sees_at_its_axis() {
    for photo in small().ground_truth(1).unwrap().photos {
        let lens = lens(&photo.site_model);
        let point = lens.c + lens.o * 6.0;
        let (x, y) = lens.project(point).unwrap();
        let in_camera = photo.cam_from_site.point(&point);
        let pixel = photo.pinhole.project(&in_camera).unwrap();
        assert!(
            (pixel.x - x - 0.5).abs() < 1e-9 && (pixel.y - y - 0.5).abs() < 1e-9,
            "{pixel} {x} {y}"
        );
        assert!(photo.cam_from_site.is_valid() && photo.pinhole.is_valid());
    }
}

/// Near the optical axis, where the lens bends nothing, a picture of the ideal pinhole is the photo.
#[test]
fn a_picture_shows_what_the_photo_shows_at_its_axis() {
    let demo = small();
    let photo = &demo.ground_truth(1).unwrap().photos[0];
    let shown = demo.picture(1, &photo.cam_from_site, &photo.pinhole).unwrap();
    let taken = Photo::decode(&sol_1()[&photo.file]).unwrap().image;
    let apart = |columns: std::ops::Range<u32>, rows: std::ops::Range<u32>| {
        let pixels = columns.flat_map(|x| rows.clone().map(move |y| (x, y)));
        let apart: Vec<f64> = pixels
            .map(|(x, y)| distance(taken.at(x, y), shown.at(x, y).map(f64::from)))
            .collect();
        apart.iter().sum::<f64>() / apart.len() as f64
    };
    assert!(
        apart(70..95, 48..72) < 1.0,
        "{} levels at the axis",
        apart(70..95, 48..72)
    );
    assert!(
        apart(0..25, 96..120) > 2.0,
        "{} levels in a corner, where the lens bends",
        apart(0..25, 96..120)
    );
    let camera = Camera {
        width: 4097,
        ..photo.pinhole
    };
    assert!(matches!(
        demo.picture(1, &photo.cam_from_site, &camera),
        Err(DemoError::Size { width_px: 4097, .. })
    ));
}
