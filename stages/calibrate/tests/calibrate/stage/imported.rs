//! Cameras from a transforms.json.

use serde_json::json;

use super::*;

const UNIT: &str = "[[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]";

pub(super) fn transforms(frames: &[&str]) -> String {
    let frames: Vec<String> = frames
        .iter()
        .map(|file| format!(r#"{{"file_path": "{file}", "transform_matrix": {UNIT}}}"#))
        .collect();
    format!(
        r#"{{"fl_x": 60, "w": 64, "h": 48, "frames": [{}]}}"#,
        frames.join(",")
    )
}

pub(super) fn imported(photos: &[&str], json: &str) -> Input {
    let mut input = Input::default();
    for (index, photo) in photos.iter().enumerate() {
        input.plain(photo, &picture(index as u32));
    }
    input.companion("transforms.json", json.as_bytes());
    input
}

#[test]
fn frames_and_photos_that_do_not_meet_are_listed_on_both_sides() {
    let input = imported(
        &["a.png", "b.png", "z.png"],
        &transforms(&["b", "./a.png", "gone.png"]),
    );
    let output = input.run(&json!({"method": "import"})).unwrap();
    assert_eq!(output.metrics.totals.registered, 2);
    assert_eq!(output.metrics.missing[0].file, "gone.png");
    assert_eq!(output.scene.unplaced[0].id, "z.png");
    // The first of the sorted names is held out.
    assert!(output.scene.frames[0].held_out && !output.scene.frames[1].held_out);
}

#[test]
fn the_points_that_transforms_name_are_read_and_no_others() {
    let ply: &[u8] = b"ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\n\
        property float z\nend_header\n1 2 3\n4 5 6\n";
    let json = transforms(&["a", "b"]);
    let named = json.replace("{\"fl_x\"", "{\"ply_file_path\": \"./points.ply\", \"fl_x\"");
    let run = |json: &str, points: Option<&[u8]>| {
        let mut input = imported(&["a.png", "b.png"], json);
        if let Some(points) = points {
            input.companion("points.ply", points);
        }
        input
    };
    let import = json!({"method": "import"});
    let output = run(&named, Some(ply)).run(&import).unwrap();
    let positions: Vec<_> = output.scene.points.iter().map(|point| point.position).collect();
    assert_eq!(positions, [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]);
    assert!(
        output.transforms.contains("\"ply_file_path\": \"points.ply\""),
        "{}",
        output.transforms
    );
    assert!(
        run(&json, Some(ply))
            .run(&import)
            .unwrap()
            .scene
            .points
            .is_empty()
    );
    let complaint = run(&named, None).complaint(&import);
    assert!(
        complaint.starts_with("`transforms.json` /ply_file_path: `points.ply` is not among the files"),
        "{complaint}"
    );
    assert!(
        complaint.contains(
            "put the points there, or take `ply_file_path` out of transforms.json to go without them"
        ),
        "{complaint}"
    );
    let complaint = run(&named, Some(&ply[..ply.len() - 6])).complaint(&import);
    assert!(complaint.starts_with("`points.ply`: 2 vertices"), "{complaint}");
}

#[test]
fn the_parts_of_a_split_set_read_the_points_they_share_once() {
    let part = |photo: &str| {
        transforms(&[photo]).replace("{\"fl_x\"", "{\"ply_file_path\": \"points.ply\", \"fl_x\"")
    };
    let mut input = Input::default();
    input.plain("a.png", &picture(1));
    input.plain("b.png", &picture(2));
    input.companion("transforms_train.json", part("a").as_bytes());
    input.companion("transforms_test.json", part("b").as_bytes());
    input.companion(
        "points.ply",
        b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\n\
        property float z\nend_header\n1 2 3\n",
    );
    let output = input.run(&json!({"method": "import"})).unwrap();
    assert_eq!(output.scene.points.len(), 1);
}

/// `auto` imports where there is something to import, and looks at the photos where there is not.
#[test]
fn auto_takes_the_cameras_beside_the_photos_or_finds_them() {
    let with = imported(&["a.png", "b.png"], &transforms(&["a", "b"]));
    let [auto, import] = ["auto", "import"].map(|method| with.run(&json!({ "method": method })).unwrap());
    assert_eq!(auto.transforms, import.transforms);
    assert!(auto.metrics.method.starts_with("import of transforms.json"));
    let mut without = Input::default();
    without.plain("a.png", &picture(1));
    let complaints = ["auto", "sfm"].map(|method| without.complaint(&json!({ "method": method })));
    assert!(complaints[0].contains("too few features"), "{}", complaints[0]);
    assert_eq!(complaints[0], complaints[1]);
}

#[test]
fn cameras_for_none_of_the_photos_are_an_error() {
    let complaint = imported(&["a.png"], &transforms(&["b.png"])).complaint(&json!({"method": "import"}));
    assert!(complaint.starts_with("0 of 1 photos were placed"), "{complaint}");
    assert!(
        complaint.contains("transforms.json has no camera for it"),
        "{complaint}"
    );
}

#[test]
fn a_repeated_frame_is_used_once_and_two_cameras_of_one_photo_are_not() {
    let json = transforms(&["a", "b", "c", "a.png"]);
    let photos = ["a.png", "b.png", "c.png"];
    let import = json!({"method": "import"});
    let output = imported(&photos, &json).run(&import).unwrap();
    assert_eq!(output.metrics.totals.registered, 3);
    assert_eq!(output.metrics.missing[0].reason, "/frames/3 repeats /frames/0");
    let other = json.replacen("[[1,0,0,0]", "[[1,0,0,5]", 1);
    let output = imported(&photos, &other).run(&import).unwrap();
    assert_eq!(output.metrics.totals.registered, 2);
    let reason = &output.scene.unplaced[0].reason;
    assert_eq!(
        reason,
        "transforms.json has two different cameras for it, at /frames/0 and at /frames/3"
    );
}

#[test]
fn a_camera_of_another_shape_is_an_error_with_both_sizes() {
    let json = transforms(&["a", "b"]).replace("\"h\": 48", "\"h\": 64");
    let complaint = imported(&["a.png", "b.png"], &json).complaint(&json!({"method": "import"}));
    assert!(
        complaint.contains("the camera is for 64 x 64 pixels, the photo has 64 x 48"),
        "{complaint}"
    );
}
