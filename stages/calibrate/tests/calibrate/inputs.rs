//! Photos, cameras and masks as people have them, one test for each kind of fault that was found.

use std::path::Path;

use marf_scene::{Cahvor, CameraPrior, Image, Photo, PhotoFacts, Srgb, encode_png};
use serde_json::{Value, json};

use crate::common::{Input, Output, shared};

const UNIT: &str = "[[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]";

/// Different everywhere, and not its own mirror image.
fn picture() -> Image<Srgb> {
    Image::from_fn(64, 48, |x, y| {
        [x * 4, y * 5, (x * y) % 256].map(|value| value as u8)
    })
}

/// Returns a PNG with an EXIF orientation.
fn tagged(png: &[u8], orientation: u8) -> Vec<u8> {
    let tiff = [
        &b"II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0"[..],
        &[orientation, 0, 0, 0, 0, 0, 0, 0],
    ]
    .concat();
    let body = [&b"eXIf"[..], &tiff].concat();
    // Signature and IHDR are 33 bytes.
    let (head, rest) = png.split_at(33);
    let length = (tiff.len() as u32).to_be_bytes();
    [head, &length, &body, &crc32(&body).to_be_bytes(), rest].concat()
}

fn crc32(bytes: &[u8]) -> u32 {
    let step = |crc: u32, byte: &u8| {
        (0..8).fold(crc ^ u32::from(*byte), |crc, _| {
            (crc >> 1) ^ (0xedb8_8320 * (crc & 1))
        })
    };
    !bytes.iter().fold(!0, step)
}

fn model(names: &[&str], camera: &str) -> [String; 2] {
    let images = (1..)
        .zip(names)
        .map(|(id, name)| format!("{id} 1 0 0 0 0 0 0 1 {name}\n\n"));
    [format!("1 {camera}\n"), images.collect()]
}

fn with_model(input: &mut Input, [cameras, images]: &[String; 2]) {
    input.companion("sparse/0/cameras.txt", cameras.as_bytes());
    input.companion("sparse/0/images.txt", images.as_bytes());
}

fn import(input: &Input) -> Output {
    input
        .run(&json!({"method": "import", "find_points": false}))
        .unwrap()
}

fn decoded(input: &Input, digest: &marf_cache::Digest) -> Photo {
    Photo::decode(&input.harness.get(digest).unwrap()).unwrap()
}

#[test]
fn imported_cameras_and_masks_are_for_the_stored_pixels_in_every_orientation() {
    let png = encode_png(&picture()).unwrap();
    let mask = Image::<Srgb>::from_fn(64, 48, |x, y| if x < 10 && y < 30 { [0; 3] } else { [255; 3] });
    let run = |bytes: &[u8]| {
        let mut input = Input::default();
        for name in ["a.png", "b.png"] {
            input.decoded(name, bytes);
        }
        input.companion("masks/a.png", &encode_png(&mask).unwrap());
        with_model(
            &mut input,
            &model(
                &["a.png", "b.png"],
                "OPENCV 64 48 60 61 30 25 -0.1 0.01 0.001 0.002",
            ),
        );
        let output = import(&input);
        (input, output)
    };
    let (_, plain) = run(&png);
    for orientation in 1..=8 {
        let (input, output) = run(&tagged(&png, orientation));
        assert_eq!(output.metrics.totals.registered, 2, "{orientation}");
        for (frame, expected) in output.scene.frames.iter().zip(&plain.scene.frames) {
            assert_eq!(frame.camera, expected.camera, "{orientation}");
            assert_eq!(frame.cam_from_world, expected.cam_from_world, "{orientation}");
            let photo = decoded(&input, &frame.image);
            assert_eq!(photo.image, picture(), "{orientation}");
            assert!(
                orientation == 1 || photo.notes.is_empty(),
                "{orientation}: {:?}",
                photo.notes
            );
        }
        let found = output.scene.frames[0].mask.unwrap();
        assert_eq!(decoded(&input, &found).image, mask, "{orientation}");
        assert!(output.scene.frames[1].mask.is_none());
    }
}

#[test]
fn a_scene_holds_photos_that_open_as_their_cameras_have_them_in_every_orientation() {
    let png = encode_png(&picture()).unwrap();
    for orientation in 1..=8 {
        let bytes = tagged(&png, orientation);
        let upright = Photo::decode(&bytes).unwrap();
        let (width, height) = (upright.image.width, upright.image.height);
        let mut input = Input::default();
        for index in 0..2 {
            let model = Cahvor {
                c: [f64::from(index), 0.0, 0.0],
                a: [0.0, 0.0, 1.0],
                h: [60.0, 0.0, f64::from(width) / 2.0],
                v: [0.0, 60.0, f64::from(height) / 2.0],
                o: None,
                r: None,
                e: None,
            };
            let facts = PhotoFacts {
                file: format!("{index}.png"),
                width,
                height,
                notes: upright.notes.clone(),
                prior: Some(CameraPrior {
                    model,
                    frame: "SITE_FRAME".to_owned(),
                    site_from_frame: None,
                    motion_counter: vec![1],
                }),
                ..PhotoFacts::default()
            };
            input.photo(&format!("{index}"), &bytes, facts);
        }
        let output = input.run(&json!({"method": "labels"})).unwrap();
        for frame in &output.scene.frames {
            let photo = decoded(&input, &frame.image);
            assert!(
                orientation == 1 || photo.notes.is_empty(),
                "{orientation}: {:?}",
                photo.notes
            );
            assert_eq!(photo.image, upright.image, "{orientation}");
            assert_eq!((frame.camera.width, frame.camera.height), (width, height));
        }
    }
}

/// Photos of the same names in several folders, each with the factor by which it is smaller.
fn in_folders(folders: &[(&str, u32)]) -> Input {
    let mut input = Input::default();
    for (folder, factor) in folders {
        let png = encode_png(&picture().box_reduced(*factor)).unwrap();
        for name in ["1.png", "2.png", "3.png"] {
            input.plain(&format!("{folder}{name}"), &png);
        }
    }
    input
}

#[test]
fn of_folders_with_the_same_names_the_one_that_fits_the_cameras_is_used() {
    let names = ["1.png", "2.png", "3.png"];
    let scales = [("images/", 1), ("images_2/", 2), ("images_4/", 4)];
    for (folders, camera, chosen) in [
        (&scales[..], "PINHOLE 64 48 60 60 32 24", "images/"),
        (&scales, "PINHOLE 32 24 30 30 16 12", "images_2/"),
        (&scales, "PINHOLE 640 480 600 600 320 240", "images/"),
        (
            &[("images/", 1), ("input/", 1)],
            "PINHOLE 64 48 60 60 32 24",
            "images/",
        ),
    ] {
        let mut input = in_folders(folders);
        with_model(&mut input, &model(&names, camera));
        let output = import(&input);
        let files: Vec<&str> = output
            .scene
            .frames
            .iter()
            .map(|frame| frame.file.as_str())
            .collect();
        assert_eq!(files, names.map(|name| format!("{chosen}{name}")), "{camera}");
        assert!(
            output.metrics.method.contains(&format!("photos of `{chosen}`")),
            "{}",
            output.metrics.method
        );
        let reason = &output.scene.unplaced[0].reason;
        assert_eq!(
            reason,
            &format!("the photo of the same name in `{chosen}` is used")
        );
    }
    // The folder that the model names goes before all.
    let mut input = in_folders(&scales);
    with_model(
        &mut input,
        &model(&["images_4/1.png", "images_4/2.png"], "PINHOLE 64 48 60 60 32 24"),
    );
    assert_eq!(import(&input).scene.frames[1].file, "images_4/2.png");
    // Nothing distinguishes these.
    let mut input = in_folders(&[("left/", 1), ("right/", 1)]);
    with_model(&mut input, &model(&names, "PINHOLE 64 48 60 60 32 24"));
    let complaint = input.complaint(&json!({"method": "import"}));
    assert!(complaint.starts_with("0 of 6 photos were placed"), "{complaint}");
}

#[test]
fn a_mask_that_a_file_names_is_used_and_a_lost_one_is_reported() {
    let mask = Image::<Srgb>::from_fn(64, 48, |x, _| if x < 32 { [0; 3] } else { [255; 3] });
    let frame = |name: &str, mask: &str| {
        format!(r#"{{"file_path": "{name}", "mask_path": "{mask}", "transform_matrix": {UNIT}}}"#)
    };
    let frames = [
        frame("a.png", "hide/all.png"),
        frame("b.png", "/x/hide/all.png"),
        frame("c.png", "gone.png"),
    ];
    let mut input = Input::default();
    for name in ["a.png", "b.png", "c.png"] {
        input.plain(name, &encode_png(&picture()).unwrap());
    }
    input.companion("hide/all.png", &encode_png(&mask).unwrap());
    let json = format!(r#"{{"fl_x": 60, "frames": [{}]}}"#, frames.join(","));
    input.companion("transforms.json", json.as_bytes());
    let output = import(&input);
    let found: Vec<_> = output.scene.frames.iter().map(|frame| frame.mask).collect();
    assert_eq!(decoded(&input, &found[0].unwrap()).image, mask);
    assert_eq!((found[1], found[2]), (found[0], None));
    assert_eq!(
        output.metrics.missing[0].reason,
        "the mask of c.png is not among the files next to the photos"
    );
}

#[test]
fn a_lens_beyond_brown_is_resampled_to_a_pinhole_with_its_mask() {
    let mask = Image::<Srgb>::from_fn(64, 48, |x, _| if x < 20 { [0; 3] } else { [255; 3] });
    for camera in [
        "FULL_OPENCV 64 48 60 60 32 24 -0.2 0.05 0.001 0 0.01 0.02 0 0",
        "OPENCV_FISHEYE 64 48 40 40 32 24 0.01 0 0 0",
    ] {
        let mut input = Input::default();
        for name in ["a.jpg", "b.jpg"] {
            input.plain(name, &encode_png(&picture()).unwrap());
        }
        input.companion("masks/a.png", &encode_png(&mask).unwrap());
        with_model(&mut input, &model(&["a.jpg", "b.jpg"], camera));
        let output = import(&input);
        let frame = &output.scene.frames[0];
        let own = frame.camera;
        assert_eq!([own.k1, own.k2, own.p1, own.p2], [0.0; 4]);
        assert!(frame.file == "a.png" && own.width > 64, "{frame:?}");
        for picture in [frame.image, frame.mask.unwrap()] {
            let picture = decoded(&input, &picture).image;
            assert_eq!(
                (picture.width, picture.height),
                (own.width, own.height),
                "{camera}"
            );
        }
    }
    let mut input = in_folders(&[("", 1)]);
    with_model(&mut input, &model(&["1.png"], "FOV 64 48 60 60 32 24 0.9"));
    let complaint = input.complaint(&json!({"method": "import"}));
    assert!(
        complaint.contains("`FOV` is not read") && complaint.contains("image_undistorter"),
        "{complaint}"
    );
}

/// Masks of other programs have 1, 254 or grey where the photo counts.
#[test]
fn a_mask_hides_its_black_pixels_whatever_the_others_are() {
    let mask_of = |open: u8| {
        let mask = Image::<Srgb>::from_fn(64, 48, |x, _| if x < 20 { [0; 3] } else { [open; 3] });
        let mut input = Input::default();
        for name in ["a.jpg", "b.jpg"] {
            input.plain(name, &encode_png(&picture()).unwrap());
        }
        input.companion("masks/a.png", &encode_png(&mask).unwrap());
        let camera = "OPENCV_FISHEYE 64 48 40 40 32 24 0.01 0 0 0";
        with_model(&mut input, &model(&["a.jpg", "b.jpg"], camera));
        let frame = &import(&input).scene.frames[0];
        decoded(&input, &frame.mask.unwrap()).image
    };
    let white = mask_of(255);
    let hidden = white.pixels.iter().filter(|pixel| **pixel == [0; 3]).count();
    assert!(
        hidden > 0 && 2 * hidden < white.pixels.len(),
        "{hidden} of {}",
        white.pixels.len()
    );
    for open in [254, 120, 1] {
        assert!(mask_of(open) == white, "{open} hides more than black");
    }
}

/// Reads a folder of `input-faults` as `extract` does: pictures below `masks` and files of cameras are companions.
fn faulty(root: &Path) -> Input {
    let mut input = Input::default();
    let mut folders = vec![String::new()];
    let mut files = Vec::new();
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(root.join(&folder)).unwrap() {
            let entry = entry.unwrap();
            let name = format!("{folder}{}", entry.file_name().to_string_lossy());
            if entry.path().is_dir() {
                folders.push(format!("{name}/"));
            } else {
                files.push(name);
            }
        }
    }
    files.sort();
    for name in files {
        let bytes = std::fs::read(root.join(&name)).unwrap();
        if name.ends_with(".jpg") && !name.starts_with("masks/") {
            input.decoded(&name, &bytes);
        } else {
            input.companion(&name, &bytes);
        }
    }
    input
}

#[test]
fn the_faulty_inputs_are_placed() {
    let Some(data) = shared("the_faulty_inputs_are_placed") else {
        return;
    };
    let data = data.join("input-faults");
    if !data.is_dir() {
        println!("skipped: the_faulty_inputs_are_placed needs ../shared/data/input-faults");
        return;
    }
    for (folder, placed, masks, camera) in [
        ("exif3-colmap", 8, 0, 240),
        ("exif6-colmap", 8, 0, 320),
        ("mip360-layout", 4, 0, 120),
        ("mask-path", 8, 8, 240),
        ("mask-jpg", 8, 8, 240),
        ("ns-colmap-layout", 8, 0, 0),
        ("abs-paths", 4, 0, 120),
        ("k3", 4, 0, 0),
        ("full-opencv-zero", 4, 0, 120),
        ("nfc-nfd", 4, 0, 0),
    ] {
        let output = import(&faulty(&data.join(folder)));
        let frames = &output.scene.frames;
        assert_eq!(
            frames.len(),
            placed,
            "{folder}: {:?} {:?}",
            output.metrics.missing,
            output.scene.unplaced
        );
        assert_eq!(
            frames.iter().filter(|frame| frame.mask.is_some()).count(),
            masks,
            "{folder}"
        );
        let width = frames[0].camera.width;
        assert!(camera == 0 || width == camera, "{folder}: {width}");
        let json: Value = serde_json::from_str(&output.transforms).unwrap();
        assert_eq!(json["frames"].as_array().map(Vec::len), Some(placed), "{folder}");
    }
}
