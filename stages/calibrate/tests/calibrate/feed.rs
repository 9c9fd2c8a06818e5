//! Real photos of a feed with the camera models of its records.

use std::ops::RangeInclusive;

use marf_scene::{Cahvor, CameraPrior, EntrancePupil, Image, Photo, PhotoFacts, Pose, Scene, Srgb};
use marf_schema::scenes::PhotoGroup;
use nalgebra::{Quaternion, UnitQuaternion, Vector2, Vector3};
use serde_json::{Value, json};

use crate::common::{Input, shared};

fn numbers(text: &str) -> Vec<f64> {
    let inner = text.trim_matches(['(', ')']);
    inner
        .split(',')
        .map(|number| number.trim().parse().unwrap())
        .collect()
}

fn three(text: &str) -> [f64; 3] {
    numbers(text).try_into().unwrap()
}

/// A feed record's camera, as `extract` would hand it over.
fn feed_facts(record: &Value, file: &str, size: (u32, u32)) -> PhotoFacts {
    let list = record["camera"]["camera_model_component_list"].as_str().unwrap();
    let parts: Vec<&str> = list.split(';').collect();
    let entrance = (parts.len() == 9).then(|| EntrancePupil {
        terms: three(parts[6]),
        linearity: match parts[7].parse::<f64>().unwrap() {
            1.0 => 1.0,
            2.0 => 0.0,
            _ => parts[8].parse().unwrap(),
        },
    });
    let model = Cahvor {
        c: three(parts[0]),
        a: three(parts[1]),
        h: three(parts[2]),
        v: three(parts[3]),
        o: parts.get(4).map(|part| three(part)),
        r: parts.get(5).map(|part| three(part)),
        e: entrance,
    };
    let q = numbers(record["attitude"].as_str().unwrap());
    let attitude = UnitQuaternion::from_quaternion(Quaternion::new(q[0], q[1], q[2], q[3]));
    let prior = CameraPrior {
        model,
        frame: "ROVER_NAV_FRAME".to_owned(),
        site_from_frame: Some(Pose {
            rotation: *attitude.to_rotation_matrix().matrix(),
            translation: three(record["extended"]["xyz"].as_str().unwrap()).into(),
        }),
        motion_counter: vec![record["site"].as_i64().unwrap()],
    };
    PhotoFacts {
        file: file.to_owned(),
        width: size.0,
        height: size.1,
        sol: record["sol"].as_u64().map(|sol| sol as u32),
        prior: Some(prior),
        ..PhotoFacts::default()
    }
}

/// The Navcam photos of some sols of the feed, and their facts by id.
fn feed(sols: RangeInclusive<u32>) -> Option<(Input, Vec<(String, PhotoFacts)>)> {
    let folder = shared("feed")?.join("m2020_navcam_feed");
    let mut input = Input::default();
    let mut all = Vec::new();
    let mut names: Vec<_> = std::fs::read_dir(&folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .collect();
    names.sort();
    for record in names
        .iter()
        .filter(|path| path.extension().is_some_and(|ext| ext == "json"))
    {
        let image = ["png", "jpg"].map(|ext| record.with_extension(ext));
        let image = image.iter().find(|path| path.exists()).unwrap();
        let bytes = std::fs::read(image).unwrap();
        let record: Value = serde_json::from_slice(&std::fs::read(record).unwrap()).unwrap();
        let file = image.file_name().unwrap().to_string_lossy().into_owned();
        let facts = feed_facts(&record, &file, Photo::size_px(&bytes).unwrap());
        let id = record["imageid"].as_str().unwrap().to_owned();
        if !facts.sol.is_some_and(|sol| sols.contains(&sol)) {
            continue;
        }
        input.photo(&id, &bytes, facts.clone());
        all.push((id, facts));
    }
    Some((input, all))
}

/// One photo of each Navcam site at a time: the pinhole must see every point where the label's camera saw it.
#[test]
fn a_resampled_navcam_photo_sees_points_where_the_label_says() {
    let Some((input, all)) = feed(0..=u32::MAX) else {
        return;
    };
    let mut sites: Vec<i64> = all
        .iter()
        .map(|(_, facts)| facts.prior.as_ref().unwrap().motion_counter[0])
        .collect();
    sites.sort_unstable();
    sites.dedup();
    let mut placed = 0;
    for site in sites {
        let params = json!({"method": "labels", "site": site, "hold_every": 0, "min_registered": 1});
        let output = input.run(&params).unwrap();
        assert_eq!(output.scene.metres_per_unit, Some(1.0));
        for unplaced in &output.scene.unplaced {
            assert!(
                unplaced.reason.starts_with("of site "),
                "{}: {}",
                unplaced.id,
                unplaced.reason
            );
        }
        placed += output.scene.frames.len();
        check_points(&output.scene, &all);
    }
    assert_eq!(placed, all.len());
}

/// Largest disagreement allowed, pixels.
const TOLERANCE_PX: f64 = 0.01;
/// Labels before the recalibration move the pupil by millimetres: a pinhole is exact far away only.
const FAR_M: f64 = 1e5;

fn check_points(scene: &Scene, all: &[(String, PhotoFacts)]) {
    // The world's origin is the median of the centres, so any one frame gives its place in the site.
    let centre_in_site = |id: &str| {
        let facts = &all.iter().find(|(other, _)| other == id).unwrap().1;
        let prior = facts.prior.clone().unwrap();
        let in_site = prior
            .model
            .normalised()
            .unwrap()
            .transformed(&prior.site_from_frame.unwrap());
        (in_site, facts.clone())
    };
    let first = &scene.frames[0];
    let site_from_world = Vector3::from(centre_in_site(&first.id).0.c) - first.cam_from_world.centre();
    for frame in &scene.frames {
        let (model, facts) = centre_in_site(&frame.id);
        let (width, height) = (f64::from(facts.width), f64::from(facts.height));
        let moves = model
            .e
            .is_some_and(|e| e.terms.iter().any(|term| term.abs() > 1e-6));
        let mut seen = 0;
        for (x, y, range_m) in [
            (0.5, 0.5, 3.0),
            (0.1, 0.2, 8.0),
            (0.9, 0.15, 30.0),
            (0.2, 0.9, 1000.0),
            (0.85, 0.8, 5.0),
        ] {
            let pixel = Vector2::new(x * width, y * height);
            let ray = model.unproject(&pixel).unwrap();
            let range_m = if moves { FAR_M } else { range_m };
            let in_world = ray.origin + ray.direction * range_m - site_from_world;
            let Some(there) = frame.camera.project(&frame.cam_from_world.point(&in_world)) else {
                continue;
            };
            // Back through the resampling: where in the photo does that pixel of the pinhole come from?
            let sight = frame.camera.unproject(&there).unwrap();
            let source = model
                .project_direction(&frame.cam_from_world.inverse().direction(&sight))
                .unwrap();
            assert!(
                (source - pixel).norm() < TOLERANCE_PX,
                "{}: {pixel} became {source}",
                frame.id
            );
            seen += 1;
        }
        assert_eq!(seen, 5, "{}", frame.id);
    }
}

#[test]
fn the_site_with_most_photos_is_taken_and_the_others_say_why() {
    let Some((input, _)) = feed(0..=u32::MAX) else {
        return;
    };
    let output = input.run(&json!({"method": "labels"})).unwrap();
    let totals = &output.metrics.totals;
    assert_eq!(totals.photos, 36);
    assert!(
        totals.registered >= 3 && totals.unplaced == 36 - totals.registered,
        "{totals:?}"
    );
    let reason = &output.scene.unplaced[0].reason;
    assert!(
        reason.contains("of site") && reason.contains("builds it"),
        "{reason}"
    );
    let up = output.scene.up.unwrap();
    assert_eq!(up, [0.0, 0.0, -1.0]);
    // The Navcam is 2 m above the ground and looks down more than up.
    for frame in &output.scene.frames {
        let forward = frame.cam_from_world.rotation.row(2);
        assert!(forward[2] > -0.3, "{}: looks along {forward}", frame.id);
    }
}

/// A bright spot painted where the Mastcam-Z label says a point is, found again in the resampled photo.
#[test]
fn a_spot_is_found_where_the_pinhole_says() {
    let model = Cahvor {
        c: [0.940191, 0.513654, -1.93784],
        a: [0.471981, 0.457932, 0.753358],
        h: [-2730.29, 3844.39, 539.735],
        v: [-2387.08, -2055.26, 3486.98],
        o: Some([0.472534, 0.459092, 0.752305]),
        r: Some([-7.31905e-05, -0.471381, 0.732327]),
        e: None,
    };
    let ray = model.unproject(&Vector2::new(1400.25, 250.75)).unwrap();
    let point = ray.origin + ray.direction * 6.0;
    let spot = model.project(&point).unwrap();
    let bell = |x: u32, y: u32| {
        let distance = (f64::from(x) - spot.x).powi(2) + (f64::from(y) - spot.y).powi(2);
        [(220.0 * (-distance / 18.0).exp()).round() as u8; 3]
    };
    let photo = Image::from_fn(1648, 1200, bell);
    let facts = PhotoFacts {
        file: "spot.png".to_owned(),
        prior: Some(CameraPrior {
            model,
            frame: "SITE_FRAME".to_owned(),
            site_from_frame: None,
            motion_counter: vec![33, 2864, 12],
        }),
        ..PhotoFacts::default()
    };
    let mut input = Input::default();
    input.photo("spot", &marf_scene::encode_png(&photo).unwrap(), facts);
    let output = input
        .run(&json!({"method": "labels", "hold_every": 0, "min_registered": 1}))
        .unwrap();
    let frame = &output.scene.frames[0];
    assert!(frame.cam_from_world.centre().norm() < 1e-12);
    let image = Photo::decode(&input.harness.get(&frame.image).unwrap())
        .unwrap()
        .image;
    // The world's origin is the only camera's centre.
    let in_world = point - Vector3::new(0.940191, 0.513654, -1.93784);
    let expected = frame
        .camera
        .project(&frame.cam_from_world.point(&in_world))
        .unwrap();
    let found = middle(&image);
    // 8-bit rounding of a spot 3 px wide moves its mean by a few thousandths.
    assert!((found - expected).norm() < 0.01, "{found} {expected}");
    let kept = f64::from(image.width * image.height) / f64::from(1648 * 1200);
    assert!(kept > 0.97, "{} x {}", image.width, image.height);
}

/// Mean position of the light, the first pixel's centre at (0.5, 0.5).
fn middle(image: &Image<Srgb>) -> Vector2<f64> {
    let (mut sum, mut light) = (Vector2::zeros(), 0.0);
    for y in 0..image.height {
        for x in 0..image.width {
            let value = f64::from(image.at(x, y)[0]);
            sum += Vector2::new(f64::from(x) + 0.5, f64::from(y) + 0.5) * value;
            light += value;
        }
    }
    sum / light
}

/// 12 Navcam photos of four sites: pairs of both eyes, a pair ten sols apart, and some that show what no other does.
#[test]
fn photos_that_show_the_same_have_labels_of_one_site() {
    let Some((input, _)) = feed(340..=575) else { return };
    let groups = |by: &str| {
        let (_, found) = input.split(&json!({"by": by, "min_photos": 2})).unwrap();
        [found.scenes, found.skipped].concat()
    };
    let of_sites = groups("label");
    let shown: Vec<PhotoGroup> = groups("overlap")
        .into_iter()
        .filter(|group| group.photos.len() > 1)
        .collect();
    assert_eq!(shown.len(), 5, "{shown:?}");
    for group in shown {
        let is_within = |site: &&PhotoGroup| group.photos.iter().all(|photo| site.photos.contains(photo));
        assert_eq!(of_sites.iter().filter(is_within).count(), 1, "{group:?}");
    }
}
