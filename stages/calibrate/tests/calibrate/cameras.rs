//! The folder for other programs: all files that transforms.json names are there, without a lens if requested.

use std::collections::BTreeMap;

use crate::common::Input;
use marf_cache::Digest;
use marf_calibrate::import::{Model, read_colmap_text, read_transforms};
use marf_calibrate::{ExportCameras, Observation, TrackPoint, Tracks, write_colmap};
use marf_scene::{Image, Photo, Scene, Srgb, encode_png};
use marf_schema::output::{CAMERAS, SCENE, SPARSE, SPARSE_IMAGES, SPARSE_POINTS};
use marf_stage::{Define, Inputs, Outputs, PHOTOS, Set, StageError, define};
use serde_json::{Value, json};

/// What both photos see.
const POINT: [f64; 3] = [0.15, 0.08, 4.0];

/// Two photos of a lens, side by side, imported from a model of COLMAP with a point that both see.
fn calibrated() -> (Input, Outputs) {
    let mut input = Input::default();
    for name in ["a.png", "b.jpg"] {
        let image: Image<Srgb> = Image::from_fn(64, 48, |x, y| [(x * 4) as u8, (y * 5) as u8, 90]);
        input.plain(name, &encode_png(&image).unwrap());
    }
    input.companion(
        "sparse/0/cameras.txt",
        b"1 OPENCV 64 48 60 60 32 24 -0.2 0.05 0.001 0\n",
    );
    input.companion(
        "sparse/0/images.txt",
        b"1 1 0 0 0 0 0 0 1 a.png\n\n2 1 0 0 0 -0.5 0 0 1 b.jpg\n\n",
    );
    input.companion("sparse/0/points3D.txt", b"1 0.15 0.08 4 9 8 7 0.5\n");
    let stage = marf_calibrate::Calibrate::new(serde_json::from_value(json!({"method": "import"})).unwrap());
    let mut outputs = input.outputs_of(&stage.unwrap());
    // An import keeps no observations: here both photos see a point half a pixel to the right of where it is.
    let scene = Scene::decode(&input.harness.get(&outputs[SCENE]).unwrap()).unwrap();
    let observation = |frame: u32| {
        let at = &scene.frames[frame as usize];
        let pixel = at
            .camera
            .project(&at.cam_from_world.point(&POINT.into()))
            .unwrap();
        let pixel = [pixel.x + 0.5, pixel.y];
        Observation {
            frame,
            pixel,
            tone: None,
        }
    };
    let point = TrackPoint {
        position: POINT,
        color: [9, 8, 7],
        error_px: 0.5,
        observations: vec![observation(0), observation(1)],
    };
    for (name, bytes) in write_colmap(&scene, &Tracks { points: vec![point] }) {
        outputs.insert(format!("{SPARSE}0/{name}"), input.harness.put(&bytes));
    }
    (input, outputs)
}

fn exported(input: &Input, scene: &Outputs, params: &Value) -> Result<Outputs, StageError> {
    let stage = ExportCameras::new(serde_json::from_value(params.clone()).unwrap()).unwrap();
    let names = [SCENE, SPARSE_IMAGES, SPARSE_POINTS];
    let mut inputs: BTreeMap<String, Digest> = names.map(|name| (name.to_owned(), scene[name])).into();
    if params.get("photos_at").is_some() {
        inputs.insert(PHOTOS.to_owned(), input.photo_set());
    }
    stage.run(&input.harness.ctx(), &Inputs(inputs))
}

fn text(input: &Input, outputs: &Outputs, name: &str) -> String {
    let bytes = input.harness.get(&outputs[&format!("{CAMERAS}{name}")]).unwrap();
    String::from_utf8(bytes.to_vec()).unwrap()
}

#[test]
fn photos_are_named_where_they_lie_and_those_elsewhere_beside_the_file() {
    let (input, scene) = calibrated();
    let beside = exported(&input, &scene, &json!({})).unwrap();
    let read = read_transforms(
        "transforms.json",
        text(&input, &beside, "transforms.json").as_bytes(),
    )
    .unwrap();
    for (view, photo) in read.views.iter().zip(input.photos()) {
        assert_eq!(beside[&format!("{CAMERAS}{}", view.file)], photo, "{}", view.file);
    }
    let there = exported(&input, &scene, &json!({"photos_at": "../photos"})).unwrap();
    assert!(text(&input, &there, "transforms.json").contains("\"file_path\": \"../photos/a.png\""));
    assert!(!there.keys().any(|name| name.ends_with("a.png")), "{there:?}");
    // Resampled photos are not there, so they are written.
    let params = json!({"photos_at": "../photos", "undistort": true});
    let straight = exported(&input, &scene, &params).unwrap();
    assert!(text(&input, &straight, "transforms.json").contains("\"file_path\": \"b.png\""));
    assert!(straight.contains_key("cameras/b.png"), "{straight:?}");
}

#[test]
fn without_distortion_a_point_is_seen_where_the_pinhole_shows_it() {
    let (input, scene) = calibrated();
    let straight = exported(&input, &scene, &json!({"undistort": true})).unwrap();
    let files = ["cameras", "images", "points3D"]
        .map(|name| text(&input, &straight, &format!("sparse/0/{name}.txt")));
    let read = read_colmap_text(&Model {
        names: ["cameras", "images", "points3D"],
        cameras: files[0].as_bytes(),
        images: files[1].as_bytes(),
        points: Some(files[2].as_bytes()),
    });
    let read = read.unwrap();
    for view in &read.views {
        let (width, height) = view.lens.size.unwrap();
        let camera = view.lens.camera(width, height).unwrap();
        assert_eq!([camera.k1, camera.k2, camera.p1, camera.p2], [0.0; 4]);
        let photo = Photo::decode(
            &input
                .harness
                .get(&straight[&format!("{CAMERAS}{}", view.file)])
                .unwrap(),
        );
        let photo = photo.unwrap().image;
        assert_eq!((photo.width, photo.height), (width, height), "{}", view.file);
        // A barrel: what was bent inwards is stretched, so that the picture has more whole pixels at the same scale: less than
        // one above and below.
        assert!(width > 64 && height >= 48, "{width} x {height}");
        // The observation moves with the picture: it is still about half a pixel off.
        let error_px = view.error_px.unwrap();
        assert!((0.45..0.6).contains(&error_px), "{}: {error_px}", view.file);
    }
    let error_px: f64 = files[2]
        .lines()
        .last()
        .unwrap()
        .split(' ')
        .nth(7)
        .unwrap()
        .parse()
        .unwrap();
    assert!((0.45..0.6).contains(&error_px), "{error_px}");
}

#[test]
fn masks_are_written_and_named_as_colmap_and_nerfstudio_read_them() {
    let (mut input, _) = calibrated();
    let mask: Image<Srgb> = Image::from_fn(64, 48, |column, _| if column < 20 { [0; 3] } else { [255; 3] });
    input.companion("masks/a.png", &encode_png(&mask).unwrap());
    let stage = marf_calibrate::Calibrate::new(serde_json::from_value(json!({"method": "import"})).unwrap());
    let scene = input.outputs_of(&stage.unwrap());
    let decoded = |outputs: &Outputs, name: &str| {
        Photo::decode(&input.harness.get(&outputs[name]).unwrap())
            .unwrap()
            .image
    };
    let plain = exported(&input, &scene, &json!({})).unwrap();
    assert_eq!(decoded(&plain, "cameras/masks/a.png.png"), mask);
    let json: Value = serde_json::from_str(&text(&input, &plain, "transforms.json")).unwrap();
    assert_eq!(json["frames"][0]["mask_path"], "masks/a.png.png");
    assert_eq!(json["frames"][1]["mask_path"], Value::Null);
    let straight = exported(&input, &scene, &json!({"undistort": true})).unwrap();
    let (photo, mask) = (
        decoded(&straight, "cameras/a.png"),
        decoded(&straight, "cameras/masks/a.png.png"),
    );
    assert_eq!((mask.width, mask.height), (photo.width, photo.height));
    assert!(mask.at(2, 20) == [0; 3] && mask.at(mask.width - 2, 20) == [255; 3]);
}

#[test]
fn a_photo_without_distortion_is_as_transparent_as_before() {
    let (mut input, _) = calibrated();
    let image = Image::<Srgb>::from_fn(64, 48, |x, _| if x < 20 { [0; 3] } else { [40; 3] });
    let alpha = (0..64 * 48).map(|at| if at % 64 < 20 { 0 } else { 255 });
    let photo = Photo {
        alpha: alpha.collect(),
        ..Photo::from(image)
    };
    input.plain("c.png", &photo.to_png().unwrap());
    input.companion(
        "sparse/0/images.txt",
        b"1 1 0 0 0 0 0 0 1 a.png\n\n2 1 0 0 0 -0.5 0 0 1 b.jpg\n\n3 1 0 0 0 -1 0 0 1 c.png\n\n",
    );
    let stage = marf_calibrate::Calibrate::new(serde_json::from_value(json!({"method": "import"})).unwrap());
    let scene = input.outputs_of(&stage.unwrap());
    let straight = exported(&input, &scene, &json!({"undistort": true})).unwrap();
    let bytes = input.harness.get(&straight["cameras/c.png"]).unwrap();
    let photo = Photo::decode(&bytes).unwrap();
    assert_eq!(photo.alpha.len(), photo.image.pixels.len());
    let width = photo.image.width as usize;
    assert!(width > 64, "{width}");
    let row = &photo.alpha[20 * width..21 * width];
    assert_eq!((row[2], row[width - 3]), (0, 255));
}

#[test]
fn a_developed_photo_is_named_and_written_as_the_png_that_it_is() {
    let (mut input, _) = calibrated();
    let image: Image<Srgb> = Image::from_fn(64, 48, |x, y| [x as u8, y as u8, 7]);
    let png = encode_png(&image).unwrap();
    input.plain("c.IMG", &png);
    input.developed("c.IMG");
    input.companion(
        "sparse/0/images.txt",
        b"1 1 0 0 0 0 0 0 1 a.png\n\n2 1 0 0 0 -0.5 0 0 1 b.jpg\n\n3 1 0 0 0 -1 0 0 1 c.IMG\n\n",
    );
    let stage = marf_calibrate::Calibrate::new(serde_json::from_value(json!({"method": "import"})).unwrap());
    let scene = input.outputs_of(&stage.unwrap());
    // One photo has no file. So that the folder is complete, all photos are written.
    let outputs = exported(&input, &scene, &json!({"photos_at": "../photos"})).unwrap();
    assert!(text(&input, &outputs, "transforms.json").contains("\"file_path\": \"c.png\""));
    assert_eq!(
        input.harness.get(&outputs["cameras/c.png"]).unwrap().to_vec(),
        png
    );
    assert!(outputs.contains_key("cameras/a.png") && !outputs.contains_key("cameras/c.IMG"));
}

#[test]
fn where_photos_lie_is_not_guessed() {
    let (input, scene) = calibrated();
    let stage = ExportCameras::new(serde_json::from_value(json!({"photos_at": "x"})).unwrap()).unwrap();
    let names = [SCENE, SPARSE_IMAGES, SPARSE_POINTS];
    let inputs: BTreeMap<String, Digest> = names.map(|name| (name.to_owned(), scene[name])).into();
    let StageError::Failed { message, hint, .. } =
        stage.run(&input.harness.ctx(), &Inputs(inputs)).unwrap_err()
    else {
        panic!("another error");
    };
    assert!(
        message.contains("`photos_at` (x)") && hint.unwrap().contains("photos = "),
        "{message}"
    );
    let refused = ExportCameras::new(serde_json::from_value(json!({"photos_at": "/x"})).unwrap());
    assert!(refused.unwrap_err().to_string().contains("not a relative path"));
}

/// If this fails, `cameras` answers differently: raise its VERSION, then put the new pair here.
#[test]
fn the_answer_belongs_to_the_version() {
    let (input, scene) = calibrated();
    let outputs = exported(&input, &scene, &json!({"undistort": true})).unwrap();
    let all: Vec<String> = outputs
        .iter()
        .map(|(name, digest)| format!("{name} {digest}"))
        .collect();
    let found = (
        ExportCameras::VERSION,
        Digest::from_content(all.join("\n").as_bytes()).short(),
    );
    assert_eq!(found, (4, "e095b7f91022".to_owned()));
    assert_eq!(define::<ExportCameras>().version, ExportCameras::VERSION);
}
