use super::super::distortion::Rational;
use super::*;
use crate::import::lens::Focal;

const CAMERAS: &str =
    "# Camera list\n1 OPENCV 100 80 90 91 50 40 0.1 -0.1 0.001 0.002\n2 SIMPLE_RADIAL 100 80 90 50 40 0.1\n";
/// Two images, the second without features: its second line is empty.
const IMAGES: &str = "# Image list\n1 1 0 0 0 0 0 0 1 a.png\n50 40 7 10 10 -1 50.5 40 8\n2 0.5 0.5 0.5 0.5 1 2 3 2 sub/b c.png\n\n";
const POINTS: &str = "8 0 0 4 10 20 30 0.5 1 2\n7 0 0 2 255 0 1 0.25 1 0 2 4\n";

fn text() -> Model<'static> {
    Model {
        names: ["cameras.txt", "images.txt", "points3D.txt"],
        cameras: CAMERAS.as_bytes(),
        images: IMAGES.as_bytes(),
        points: Some(POINTS.as_bytes()),
    }
}

fn floats(numbers: &[f64]) -> Vec<u8> {
    numbers.iter().flat_map(|number| number.to_le_bytes()).collect()
}

/// The same model as the text, written by hand.
fn binary() -> [Vec<u8>; 3] {
    let camera = |id: u32, lens: u32, params: &[f64]| {
        let head = [id.to_le_bytes(), lens.to_le_bytes()].concat();
        [head, [100_u64, 80].map(u64::to_le_bytes).concat(), floats(params)].concat()
    };
    let cameras = [
        2_u64.to_le_bytes().to_vec(),
        camera(1, 4, &[90.0, 91.0, 50.0, 40.0, 0.1, -0.1, 0.001, 0.002]),
        camera(2, 2, &[90.0, 50.0, 40.0, 0.1]),
    ];
    let image = |id: u32, pose: &[f64], camera: u32, name: &str, features: &[(f64, f64, u64)]| {
        let mut bytes = [
            id.to_le_bytes().to_vec(),
            floats(pose),
            camera.to_le_bytes().to_vec(),
        ]
        .concat();
        bytes.extend(name.bytes().chain([0]));
        bytes.extend((features.len() as u64).to_le_bytes());
        for (x, y, point) in features {
            bytes.extend(floats(&[*x, *y]).into_iter().chain(point.to_le_bytes()));
        }
        bytes
    };
    let features = [(50.0, 40.0, 7), (10.0, 10.0, u64::MAX), (50.5, 40.0, 8)];
    let images = [
        2_u64.to_le_bytes().to_vec(),
        image(1, &[1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0], 1, "a.png", &features),
        image(2, &[0.5, 0.5, 0.5, 0.5, 1.0, 2.0, 3.0], 2, "sub/b c.png", &[]),
    ];
    let point = |id: u64, z: f64, color: [u8; 3], views: u64| {
        let mut bytes = [
            id.to_le_bytes().to_vec(),
            floats(&[0.0, 0.0, z]),
            color.to_vec(),
            floats(&[0.5]),
        ]
        .concat();
        bytes.extend(views.to_le_bytes());
        bytes.resize(bytes.len() + views as usize * 8, 0);
        bytes
    };
    let points = [
        2_u64.to_le_bytes().to_vec(),
        point(8, 4.0, [10, 20, 30], 1),
        point(7, 2.0, [255, 0, 1], 2),
    ];
    [cameras.concat(), images.concat(), points.concat()]
}

fn model(files: &[Vec<u8>; 3]) -> Model<'_> {
    Model {
        names: ["cameras.bin", "images.bin", "points3D.bin"],
        cameras: &files[0],
        images: &files[1],
        points: Some(&files[2]),
    }
}

#[test]
fn the_text_form_is_read_to_the_last_number() {
    let cameras = read_colmap_text(&text()).unwrap();
    let [a, b] = cameras.views.as_slice() else {
        panic!("{} views", cameras.views.len());
    };
    assert_eq!(
        (a.file.as_str(), a.matches, a.inliers),
        ("a.png", Some(3), Some(2))
    );
    // On the axis both points project to (50, 40): distances 0 and 0.5.
    assert_eq!(a.error_px, Some(0.25));
    assert_eq!(a.lens.distortion, Distortion::Brown([0.1, -0.1, 0.001, 0.002]));
    assert_eq!(
        (b.file.as_str(), b.matches, b.error_px),
        ("sub/b c.png", Some(0), None)
    );
    assert_eq!(b.lens.focal, Focal::Px(90.0, 90.0));
    // (w, x, y, z) = 1/2 each turns x to y, y to z, z to x.
    assert_eq!(b.cam_from_world.direction(&Vector3::x()), Vector3::y());
    assert_eq!(b.cam_from_world.translation, Vector3::new(1.0, 2.0, 3.0));
    assert_eq!(cameras.points[0].position, [0.0, 0.0, 2.0]);
    assert_eq!(
        (cameras.points[0].views, cameras.points[1].color),
        (2, Some([10, 20, 30]))
    );
}

#[test]
fn the_binary_form_says_the_same_as_the_text() {
    let from_binary = read_colmap_binary(&model(&binary())).unwrap();
    let mut from_text = read_colmap_text(&text()).unwrap();
    for (text, binary) in from_text.views.iter_mut().zip(&from_binary.views) {
        text.place.clone_from(&binary.place);
    }
    assert_eq!(from_text, from_binary);
}

#[test]
fn a_binary_file_cut_anywhere_is_refused() {
    let whole = binary();
    for (index, name) in ["cameras.bin", "images.bin", "points3D.bin"]
        .into_iter()
        .enumerate()
    {
        for cut in 0..whole[index].len() {
            let mut files = whole.clone();
            files[index].truncate(cut);
            let error = read_colmap_binary(&model(&files)).unwrap_err().to_string();
            assert!(
                error.starts_with(&format!("`{name}`")),
                "{name} cut at {cut}: {error}"
            );
            let is_last = cut + 1 == whole[index].len();
            assert!(
                !is_last
                    || error.ends_with("the file ends 1 bytes early")
                    || error.ends_with("bytes are left"),
                "{name}: {error}"
            );
        }
        let mut files = whole.clone();
        files[index].push(0);
        let error = read_colmap_binary(&model(&files)).unwrap_err().to_string();
        assert!(error.contains("1 bytes after the last record"), "{error}");
    }
}

#[test]
fn an_announced_length_takes_no_memory() {
    let mut files = binary();
    for index in 0..3 {
        files[index][..8].copy_from_slice(&u64::MAX.to_le_bytes());
        let error = read_colmap_binary(&model(&files)).unwrap_err().to_string();
        assert!(error.contains("18446744073709551615 records"), "{error}");
        files = binary();
    }
}

#[test]
fn another_lens_is_refused_by_name() {
    let with = |cameras: &'static str| {
        let cameras = cameras.as_bytes();
        read_colmap_text(&Model { cameras, ..text() })
            .unwrap_err()
            .to_string()
    };
    let error = with("1 THIN_PRISM_FISHEYE 100 80 1 1 1 1 0 0 0 0 0 0 0 0");
    assert!(
        error.starts_with("`cameras.txt` line 1: the lens `THIN_PRISM_FISHEYE` is not read"),
        "{error}"
    );
    assert!(error.contains("colmap image_undistorter"), "{error}");
    let error = with("1 OPENCV 100 80 1 1 1 1");
    assert!(error.contains("OPENCV has 8 parameters, 4 are given"), "{error}");
    for (bad, part) in [
        ("1 PINHOLE 100 80 NaN 1 1 1", "parameter NaN"),
        ("1 PINHOLE 100 80 0 1 1 1", "0 and 1 are not focal lengths"),
        ("1 PINHOLE 4294967295 80 1 1 1 1", "a size beyond 1 to 100000"),
        ("1 PINHOLE 100", "the line ends before the height"),
        ("1 PINHOLE 100 x 1 1 1 1", "`x` is not the height"),
    ] {
        let error = with(bad);
        assert!(error.contains(part), "{error}");
    }
    let mut files = binary();
    files[0][12] = 7;
    let error = read_colmap_binary(&model(&files)).unwrap_err().to_string();
    assert!(
        error.contains("camera record 0: the lens `FOV` is not read"),
        "{error}"
    );
    files[0][12] = 99;
    let error = read_colmap_binary(&model(&files)).unwrap_err().to_string();
    assert!(error.contains("lens number 99 is unknown"), "{error}");
}

#[test]
fn a_bad_image_is_named_by_its_line() {
    let with = |images: &'static str| {
        let images = images.as_bytes();
        read_colmap_text(&Model { images, ..text() })
            .unwrap_err()
            .to_string()
    };
    for (bad, part) in [
        ("1 0 0 0 0 0 0 0 1 a.png\n\n", "line 1: a quaternion of length 0"),
        ("1 NaN 0 0 0 0 0 0 1 a.png\n\n", "line 1: a pose with [NaN"),
        ("1 1 0 0 0 0 0 inf 1 a.png\n\n", "inf"),
        ("1 1 0 0 0 0 0 0 9 a.png\n\n", "camera 9 is not in cameras.txt"),
        ("1 1 0 0 0 0 0 0 1 ./..\n\n", "`./..` names no file"),
        ("1 1 0 0 0 0 0 0 1\n\n", "the line ends before the name"),
        (
            "1 1 0 0 0 0 0 0 1 a.png\n50 40\n",
            "line 2: the line ends before a feature's point",
        ),
        ("# nothing\n", "holds no image"),
    ] {
        let error = with(bad);
        assert!(error.contains(part), "{bad}: {error}");
    }
}

#[test]
fn names_keep_their_blanks_and_may_come_from_elsewhere() {
    let images = "\u{feff}# made on Windows\r\n1 1 0 0 0 0 0 0 1 sol 7  left.png \r\n\r\n\
        2 1 0 0 0 0 0 0 1 C:\\scan\\b.png\r\n\r\n3 1 0 0 0 0 0 0 1 ../../c.png\r\n\r\n";
    let read = read_colmap_text(&Model {
        images: images.as_bytes(),
        ..text()
    });
    let files: Vec<String> = read.unwrap().views.into_iter().map(|view| view.file).collect();
    assert_eq!(files, ["sol 7  left.png", "/C:/scan/b.png", "/c.png"]);
}

#[test]
fn every_lens_is_read_with_its_parameters_in_colmaps_order() {
    let lens = |line: &str| {
        let cameras = line.as_bytes();
        let read = read_colmap_text(&Model {
            cameras,
            images: b"1 1 0 0 0 0 0 0 1 a.png\n\n",
            points: None,
            ..text()
        });
        read.unwrap().views[0].lens.distortion
    };
    let full = Rational {
        numerator: [0.1, 0.2, 0.5, 0.0],
        denominator: [0.6, 0.7, 0.8],
        tangential: [0.3, 0.4],
    };
    assert_eq!(
        lens("1 FULL_OPENCV 100 80 60 60 50 40 .1 .2 .3 .4 .5 .6 .7 .8"),
        Distortion::Rational(full)
    );
    // Without further terms it is OPENCV.
    assert_eq!(
        lens("1 FULL_OPENCV 100 80 60 60 50 40 .1 .2 .3 .4 0 0 0 0"),
        Distortion::Brown([0.1, 0.2, 0.3, 0.4])
    );
    assert_eq!(
        lens("1 OPENCV_FISHEYE 100 80 60 60 50 40 .1 .2 .3 .4"),
        Distortion::Fisheye([0.1, 0.2, 0.3, 0.4])
    );
    assert_eq!(
        lens("1 RADIAL_FISHEYE 100 80 60 50 40 .1 .2"),
        Distortion::Fisheye([0.1, 0.2, 0.0, 0.0])
    );
    assert_eq!(
        lens("1 SIMPLE_RADIAL_FISHEYE 100 80 60 50 40 .1"),
        Distortion::Fisheye([0.1, 0.0, 0.0, 0.0])
    );
}

#[test]
fn a_point_that_is_nowhere_is_named_in_either_form() {
    let mut files = binary();
    // The z of the first point, behind the count, the number, x and y.
    files[2][32..40].copy_from_slice(&f64::NAN.to_le_bytes());
    let error = read_colmap_binary(&model(&files)).unwrap_err().to_string();
    assert!(error.ends_with("a point at [0.0, 0.0, NaN]"), "{error}");
    let points = POINTS.replacen("8 0 0 4", "8 0 inf 4", 1);
    let model = Model {
        points: Some(points.as_bytes()),
        ..text()
    };
    let error = read_colmap_text(&model).unwrap_err().to_string();
    assert!(error.ends_with("a point at [0.0, inf, 4.0]"), "{error}");
}
