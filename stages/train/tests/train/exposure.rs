//! Exposures and vignetting that matched points say: when they are on, what training starts from, and how held-out photos are judged.

use marf_cache::Digest;
use marf_field::Gain;
use marf_scene::{Falloff, Image, Photo, PhotoTone, Scene, ToneDifference, Tones, encode_png};
use marf_stage::{Outputs, harness::Harness};
use marf_train::Train;
use serde_json::{Value, json};

use crate::common::{inputs, json, put_scene, run, scene, small, stage};

/// Photos of the tiny scene.
const PHOTOS: u32 = 12;

/// Gain and offset of a photo.
fn planted(index: usize) -> [f64; 2] {
    [[1.0, 0.0], [0.5, 0.2], [0.8, 0.0], [0.6, 0.35]][index % 4]
}

/// The tiny scene with exposures planted in its photos, and what matched points say of them.
fn exposed(harness: &Harness, difference: ToneDifference) -> Scene {
    let mut scene = scene(harness, PHOTOS);
    let mut photos = Vec::new();
    for (index, frame) in scene.frames.iter_mut().enumerate() {
        let [gain, offset] = planted(index);
        let plain = Photo::decode(&harness.get(&frame.image).unwrap()).unwrap().image;
        let shown = |channel: u8| (gain.mul_add(f64::from(channel), 255.0 * offset) + 0.5) as u8;
        let image = Image::from_fn(plain.width, plain.height, |column, row| {
            plain.at(column, row).map(shown)
        });
        frame.image = harness.put(&encode_png(&image).unwrap());
        photos.push(PhotoTone {
            id: frame.id.clone(),
            log_gain: [gain.ln(); 3],
            offset: [offset; 3],
        });
    }
    if !difference.is_real() {
        photos.clear();
    }
    scene.tones = Some(Tones {
        difference,
        photos,
        vignetting: Vec::new(),
    });
    scene
}

const UNEQUAL: ToneDifference = ToneDifference {
    points: 1240,
    spread: 0.34,
    noise: 0.05,
};

fn trained(harness: &Harness, scene: Digest, steps: u64, more: &Value) -> Outputs {
    let mut field = small();
    let both = field.as_object_mut().unwrap();
    both.extend(more.as_object().unwrap().clone());
    let train: Train = stage(json!({"steps": steps, "field": field}));
    run(&train, &harness.ctx(), &inputs(&[("scene", scene)])).unwrap()
}

#[test]
fn photos_that_differ_get_exposures_of_their_own_without_a_key() {
    let harness = Harness::default();
    let scene = put_scene(&harness, &exposed(&harness, UNEQUAL));
    let [with, without] = [json!({}), json!({"gain": "off"})].map(|keys| {
        let outputs = trained(&harness, scene, 600, &keys);
        json(&harness, &outputs, "metrics")
    });
    assert_eq!(with["config"]["gain"], json!(Gain::PerPhotoAndOffset));
    assert_eq!(without["config"]["gain"], json!(Gain::Off));
    assert_eq!(with["tones"], json!(UNEQUAL));
    // The loss at the end, and the share of held-out photos of which the field lets no photo see anything: fog hides it.
    let loss = |metrics: &Value| metrics["loss"].as_f64().unwrap();
    let uncovered = |metrics: &Value| {
        let views = metrics["views"].as_array().unwrap().iter();
        let shares = views.map(|view| view["nearest"]["uncovered_share"].as_f64().unwrap());
        shares.sum::<f64>()
    };
    assert!(
        loss(&with) < 0.9 * loss(&without),
        "{} {}",
        with["loss"],
        without["loss"]
    );
    assert!(
        uncovered(&with) < 0.5 * uncovered(&without),
        "{} {}",
        with["views"],
        without["views"]
    );
    let view = &with["views"][0];
    assert!(
        view["psnr_affine"].as_f64() > view["psnr"].as_f64(),
        "the exposure of a held-out photo counts in one and not in the other: {view}"
    );
    assert!(with["psnr_affine"].is_number() && without.get("psnr_affine").is_none());
}

/// The same weights with the key `off`, without evidence, and with evidence that photos are equal.
#[test]
fn photos_that_do_not_differ_are_trained_as_without_exposures() {
    let harness = Harness::default();
    let equal = ToneDifference {
        spread: 0.06,
        ..UNEQUAL
    };
    let silent = Scene {
        tones: None,
        ..exposed(&harness, equal)
    };
    let [equal, silent, unequal] = [exposed(&harness, equal), silent, exposed(&harness, UNEQUAL)]
        .map(|scene| put_scene(&harness, &scene));
    let weights = |scene: Digest, keys: Value| trained(&harness, scene, 48, &keys)["weights"];
    let off = weights(unequal, json!({"gain": "off"}));
    assert_eq!(weights(equal, json!({})), off);
    assert_eq!(weights(silent, json!({})), off);
    assert_ne!(weights(unequal, json!({})), off);
}

/// A sample drawn with replacement gives a photo and its copies the same start, so that it trains.
#[test]
fn copies_of_a_photo_start_from_its_exposure() {
    let harness = Harness::default();
    let scene = put_scene(&harness, &exposed(&harness, UNEQUAL));
    let train: Train = stage(json!({"steps": 200, "resample": 3, "field": small()}));
    let outputs = run(&train, &harness.ctx(), &inputs(&[("scene", scene)])).unwrap();
    let metrics = json(&harness, &outputs, "metrics");
    assert_eq!(metrics["config"]["gain"], json!(Gain::PerPhotoAndOffset));
    assert!(metrics["loss"].as_f64().unwrap() < 0.02, "{}", metrics["loss"]);
}

/// The tiny scene with corners that are 40 % darker than the middle, and what matched points say of that.
fn vignetted(harness: &Harness, sigma: f64) -> Scene {
    let mut scene = scene(harness, PHOTOS);
    let camera = scene.frames[0].camera;
    let falloff = Falloff {
        camera,
        factors: [-0.4 / camera.corner_radius2(), 0.0, 0.0],
        darkening: 0.4,
        sigma,
        pairs: 1240,
        spread: 0.09,
        noise: 0.04,
    };
    for frame in &mut scene.frames {
        let plain = Photo::decode(&harness.get(&frame.image).unwrap()).unwrap().image;
        let image = Image::from_fn(plain.width, plain.height, |column, row| {
            let pixel = nalgebra::Vector2::new(f64::from(column) + 0.5, f64::from(row) + 0.5);
            let v = falloff.at(camera.radius2(&pixel));
            plain
                .at(column, row)
                .map(|tone| (v * f64::from(tone) + 0.5) as u8)
        });
        frame.image = harness.put(&encode_png(&image).unwrap());
    }
    scene.tones = Some(Tones {
        difference: ToneDifference {
            spread: 0.06,
            ..UNEQUAL
        },
        photos: Vec::new(),
        vignetting: vec![falloff],
    });
    scene
}

#[test]
fn vignetting_is_taken_from_photos_and_given_to_renders_that_are_judged() {
    let harness = Harness::default();
    let sure = vignetted(&harness, 0.01);
    let scene = put_scene(&harness, &sure);
    let [with, without] = [json!({}), json!({"vignetting": "off"})].map(|keys| {
        let outputs = trained(&harness, scene, 600, &keys);
        (json(&harness, &outputs, "metrics"), outputs)
    });
    assert_eq!(with.0["config"]["vignetting"], "per_camera");
    assert_eq!(without.0["config"].get("vignetting"), None);
    assert_eq!(with.0["vignetting"], json!(sure.tones.unwrap().vignetting));
    let [with_db, without_db] = [&with.0, &without.0].map(|metrics| metrics["psnr"].as_f64().unwrap());
    // A render that did not get it back would be brighter than the photo by up to two thirds.
    assert!(with_db > without_db - 0.5, "{with_db} {without_db}");
    // The picture of a held-out photo is without it, as the render next to it.
    let brightness = |outputs: &Outputs| {
        let (_, photo) = outputs
            .iter()
            .find(|(name, _)| name.starts_with("photo/"))
            .unwrap();
        let image = Photo::decode(&harness.get(photo).unwrap()).unwrap().image;
        image
            .pixels
            .as_flattened()
            .iter()
            .map(|tone| u64::from(*tone))
            .sum::<u64>()
    };
    assert!(brightness(&with.1) > brightness(&without.1));
}

/// The same bytes with the key `off` as with a falloff that is not sure.
#[test]
fn an_unsure_falloff_changes_nothing() {
    let harness = Harness::default();
    let scene = put_scene(&harness, &vignetted(&harness, 0.2));
    let auto = trained(&harness, scene, 48, &json!({}));
    assert_eq!(auto, trained(&harness, scene, 48, &json!({"vignetting": "off"})));
    assert_ne!(
        auto["weights"],
        trained(
            &harness,
            put_scene(&harness, &vignetted(&harness, 0.01)),
            48,
            &json!({})
        )["weights"]
    );
}
