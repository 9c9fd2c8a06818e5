use marf_scene::Pose;
use nalgebra::{Matrix3, Vector3};

use super::super::distortion::{Distortion, Rational};
use super::super::lens::Focal;
use super::super::pose_matrix::rotation;
use super::*;

const UNIT: &str = "[[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]";

fn frames(frames: &str) -> Result<Vec<View>, ImportError> {
    read_transforms(
        "sub/transforms.json",
        format!(r#"{{"fl_x": 100, "w": 40.0, "h": 30, {frames}}}"#).as_bytes(),
    )
    .map(|read| read.views)
}

fn message(text: &str) -> String {
    frames(text).unwrap_err().to_string()
}

#[test]
fn a_camera_looks_along_minus_z_with_y_up() {
    // At (1, 2, 3), turned by nothing: OpenGL looks along -z of the world, up is +y.
    let moved = "[[1,0,0,1],[0,1,0,2],[0,0,1,3],[0,0,0,1]]";
    let views = frames(&format!(
        r#""frames": [{{"file_path": "./a.jpg", "transform_matrix": {moved}}}]"#
    ))
    .unwrap();
    let pose: Pose = views[0].cam_from_world;
    assert_eq!(pose.centre(), Vector3::new(1.0, 2.0, 3.0));
    assert_eq!(
        pose.point(&Vector3::new(1.0, 2.0, -4.0)),
        Vector3::new(0.0, 0.0, 7.0)
    );
    assert_eq!(pose.direction(&Vector3::y()), Vector3::new(0.0, -1.0, 0.0));
    assert_eq!(
        (views[0].file.as_str(), views[0].place.as_str()),
        ("sub/a.jpg", "/frames/0")
    );
}

#[test]
fn a_frames_own_lens_counts_more_than_the_one_at_the_top() {
    let text = format!(
        r#""k1": 0.5, "frames": [{{"file_path": "a", "fl_x": 7, "cx": 3.5, "transform_matrix": {UNIT}}},
        {{"file_path": "../b", "transform_matrix": {UNIT}}}]"#
    );
    let views = frames(&text).unwrap();
    assert_eq!(views[0].lens.focal, Focal::Px(7.0, 7.0));
    assert_eq!(
        (views[0].lens.cx_px, views[0].lens.distortion),
        (Some(3.5), Distortion::Brown([0.5, 0.0, 0.0, 0.0]))
    );
    assert_eq!(views[1].lens.focal, Focal::Px(100.0, 100.0));
    assert_eq!(
        (views[1].lens.size, views[1].file.as_str()),
        (Some((40, 30)), "b")
    );
}

#[test]
fn a_uniform_scale_is_divided_out_and_rounded_digits_are_mended() {
    let scaled = Matrix3::new(0.0, -2.0, 0.0, 2.0, 0.0, 0.0, 0.0, 0.0, 2.0);
    let expected = Matrix3::new(0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0);
    assert_eq!(rotation(&scaled), Ok(expected));
    let rounded = Matrix3::new(0.707, -0.707, 0.0, 0.707, 0.707, 0.0, 0.0, 0.0, 1.0);
    let mended = rotation(&rounded).unwrap();
    let defect = (mended.transpose() * mended - Matrix3::identity()).abs().max();
    assert!(defect < 1e-14, "{defect}");
    for (bad, word) in [
        (Matrix3::zeros(), "singular"),
        (-Matrix3::identity(), "mirrored"),
        (
            Matrix3::new(1.0, 0.1, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0),
            "not a rotation",
        ),
        (
            Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, 2.0)),
            "not a rotation",
        ),
        (Matrix3::repeat(f64::MAX), "singular"),
    ] {
        let error = rotation(&bad).unwrap_err();
        assert!(error.contains(word), "{error}");
    }
}

#[test]
fn lists_of_names_decide_what_is_measured() {
    let frame = |name: &str| format!(r#"{{"file_path": "{name}", "transform_matrix": {UNIT}}}"#);
    let all = ["a", "b", "c", "d"].map(frame).join(",");
    let roles = |lists: &str| -> Vec<Role> {
        frames(&format!(r#"{lists} "frames": [{all}]"#))
            .unwrap()
            .iter()
            .map(|view| view.role)
            .collect()
    };
    use Role::{HeldOut, Open, Train, Unlisted};
    assert_eq!(roles(""), [Open; 4]);
    let lists = r#""train_filenames": ["a", "b"], "val_filenames": ["./c"], "test_filenames": ["b"],"#;
    assert_eq!(roles(lists), [Train, HeldOut, HeldOut, Unlisted]);
    assert_eq!(
        roles(r#""train_filenames": ["a"],"#),
        [Train, HeldOut, HeldOut, HeldOut]
    );
    assert_eq!(
        roles(r#""test_filenames": ["a"],"#),
        [HeldOut, Train, Train, Train]
    );
    assert_eq!(roles(r#""test_filenames": [],"#), [Open; 4]);
}

#[test]
fn every_wrong_field_is_named_by_its_pointer() {
    let frame = |more: &str| format!(r#""frames": [{{"file_path": "a.jpg", {more}}}]"#);
    let cases = [
        (
            frame(r#""transform_matrix": [[1,0,0,0],[0,1,0,0]]"#),
            "/frames/0/transform_matrix: 2 rows",
        ),
        (
            frame(r#""transform_matrix": [[1,0,0],[],[],[]]"#),
            "/frames/0/transform_matrix/0: 3 numbers",
        ),
        (
            frame(r#""transform_matrix": [[1,0,0,"x"],[],[],[]]"#),
            "/frames/0/transform_matrix/0/3: \"x\" is not",
        ),
        (
            frame(r#""fl_x": 0"#),
            "/frames/0/fl_x: 0 is not a positive focal length",
        ),
        (frame(r#""fl_x": -5"#), "/frames/0/fl_x: -5 is not"),
        (frame(r#""w": 4.5"#), "/frames/0/w: 4.5 is not a size"),
        (
            frame(r#""camera_model": "EQUIRECTANGULAR""#),
            "/frames/0/camera_model: the lens `EQUIRECTANGULAR` is not read",
        ),
        (
            frame(r#""k3": NaN"#),
            "/frames/0/k3: \"NaN\" is not a finite number",
        ),
        (
            frame(r#""is_fisheye": 1"#),
            "/frames/0/is_fisheye: neither true nor false",
        ),
        (frame(r#""x": 1"#), "/frames/0: `transform_matrix` is missing"),
        (r#""frames": []"#.to_owned(), "`frames` is empty"),
        (r#""frames": {}"#.to_owned(), "/frames: not a list"),
        (
            r#""train_filenames": [3], "frames": [{}]"#.to_owned(),
            "/train_filenames/0: not a text",
        ),
    ];
    for (text, part) in cases {
        let error = frames(&text)
            .err()
            .map(|error| error.to_string())
            .unwrap_or_default();
        assert!(error.starts_with("`sub/transforms.json`"), "{text}: {error}");
        assert!(error.contains(part), "{text}: {error}");
    }
    assert!(message(r#""frames": [{"file_path": "a", "transform_matrix": 1e999}]"#).contains("not JSON"));
}

#[test]
fn a_frames_own_angle_counts_more_than_the_focal_length_at_the_top() {
    let frame = |own: &str| format!(r#""frames": [{{"file_path": "a", {own} "transform_matrix": {UNIT}}}]"#);
    let focal = |own: &str| frames(&frame(own)).unwrap()[0].lens.focal;
    assert_eq!(focal(r#""camera_angle_x": 0.5,"#), Focal::Angle(0.5, None));
    assert_eq!(focal(r#""camera_angle_x": 0.5, "fl_x": 7,"#), Focal::Px(7.0, 7.0));
    assert_eq!(focal(r#""fl_y": 7,"#), Focal::Px(100.0, 7.0));
    assert_eq!(focal(""), Focal::Px(100.0, 100.0));
}

#[test]
fn every_lens_is_read_by_its_own_equations() {
    let lens = |terms: &str| {
        let text = format!(r#"{terms} "frames": [{{"file_path": "a", "transform_matrix": {UNIT}}}]"#);
        frames(&text).unwrap()[0].lens.distortion
    };
    let rational = |fourth: f64, denominator: [f64; 3]| {
        Distortion::Rational(Rational {
            numerator: [0.1, 0.0, 0.3, fourth],
            denominator,
            tangential: [0.0, 0.01],
        })
    };
    let terms = r#""k1": 0.1, "k3": 0.3, "p2": 0.01,"#;
    assert_eq!(lens(terms), rational(0.0, [0.0; 3]));
    assert_eq!(lens(&format!(r#"{terms} "k4": 0.4,"#)), rational(0.4, [0.0; 3]));
    let full = format!(r#"{terms} "k4": 0.4, "camera_model": "FULL_OPENCV","#);
    assert_eq!(lens(&full), rational(0.0, [0.4, 0.0, 0.0]));
    assert_eq!(
        lens(&format!(r#"{terms} "k6": 0.6,"#)),
        rational(0.0, [0.0, 0.0, 0.6])
    );
    let zero = r#""k1": 0.1, "k3": 0, "k4": 0.0, "k5": 0, "k6": 0, "camera_model": "FULL_OPENCV","#;
    assert_eq!(lens(zero), Distortion::Brown([0.1, 0.0, 0.0, 0.0]));
    for fisheye in [r#""is_fisheye": true,"#, r#""camera_model": "OPENCV_FISHEYE","#] {
        let terms = format!(r#""k1": 0.1, "k4": 0.4, {fisheye}"#);
        assert_eq!(lens(&terms), Distortion::Fisheye([0.1, 0.0, 0.0, 0.4]));
    }
}

#[test]
fn what_is_clear_in_a_file_is_used_and_the_rest_is_named() {
    let short = "[[1,0,0,0],[0,1,0,0],[0,0,1,0]]";
    let json = format!(
        r#"{{"fl_x": 100, "scale": NaN, "note": "NaN \" Infinity", "aabb": [-Infinity, Infinity], "frames": [
        {{"file_path": "NaN.jpg", "transform_matrix": {UNIT}}},
        {{"file_path": "b.jpg", "transform_matrix": {short}}},
        {{"file_path": "c.jpg", "transform_matrix": [[NaN,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]}},
        {{"transform_matrix": {UNIT}}}]}}"#
    );
    let bytes = ["\u{feff}".as_bytes(), json.as_bytes()].concat();
    let read = read_transforms("transforms.json", &bytes).unwrap();
    let files: Vec<&str> = read.views.iter().map(|view| view.file.as_str()).collect();
    assert_eq!(files, ["NaN.jpg", "b.jpg"]);
    assert_eq!(read.views[0].cam_from_world, read.views[1].cam_from_world);
    let rejected: Vec<(&str, &str)> = read
        .rejected
        .iter()
        .map(|one| (one.file.as_str(), one.reason.as_str()))
        .collect();
    let reason = "/frames/2/transform_matrix/0/0 \"NaN\" is not a finite number";
    assert_eq!(
        rejected,
        [
            ("c.jpg", reason),
            ("/frames/3", "/frames/3 `file_path` is missing")
        ]
    );
}

#[test]
fn paths_from_elsewhere_and_masks_are_named_by_their_tail() {
    let json = format!(
        r#""frames": [{{"file_path": "C:\\scan\\a.jpg", "mask_path": "../../masks/a.png", "transform_matrix": {UNIT}}}]"#
    );
    let view = frames(&json).unwrap().remove(0);
    assert_eq!(
        (view.file.as_str(), view.mask.as_deref()),
        ("/C:/scan/a.jpg", Some("/masks/a.png"))
    );
}
