use marf_cache::Digest;
use marf_scene::{Camera, Frame, Pose};
use nalgebra::{Vector2, Vector3};

use super::model::{lens, quaternion};
use super::*;
use crate::export::Observation;
use crate::export::TrackPoint;
use crate::import::{Cameras, Model, read_colmap_binary, read_colmap_text};

/// Four cameras on a ring, one of each lens, and a fifth that shares the first one's.
fn scene() -> Scene {
    let plain = Camera::pinhole(1440, 1920, 1453.0);
    let cameras = [
        plain,
        Camera { k1: 0.09, ..plain },
        Camera {
            k1: 0.09,
            k2: -0.13,
            ..plain
        },
        Camera {
            fy_px: 1454.0,
            k1: 0.09,
            k2: -0.13,
            p1: 0.001,
            p2: -7e-5,
            ..plain
        },
        plain,
    ];
    let frame = |(index, camera): (usize, Camera)| {
        let angle = index as f64;
        let eye = Vector3::new(4.0 * angle.cos(), 4.0 * angle.sin(), 1.0 - angle);
        Frame {
            id: format!("photo-{index}"),
            file: format!("images/{index}.jpg"),
            image: Digest::from_content(&[index as u8]),
            camera,
            cam_from_world: Pose::looking_at(eye, Vector3::zeros(), -Vector3::z()),
            held_out: false,
            mask: None,
            error_px: None,
        }
    };
    Scene {
        frames: cameras.into_iter().enumerate().map(frame).collect(),
        ..Scene::default()
    }
}

/// Points of a small cube, each seen in every frame, `off_px` to the right of where it is.
fn tracks(scene: &Scene, off_px: f64) -> Tracks {
    let position = |index: u32| {
        let (x, y, z) = (index % 4, index / 4 % 4, index / 16);
        [x, y, z].map(|step| f64::from(step) * 0.4 - 0.6)
    };
    let observation = |position: [f64; 3], frame: usize| {
        let at = &scene.frames[frame];
        let pixel = at
            .camera
            .project(&at.cam_from_world.point(&Vector3::from(position)))
            .unwrap();
        Observation {
            frame: frame as u32,
            pixel: (pixel + Vector2::new(off_px, 0.0)).into(),
            tone: None,
        }
    };
    let point = |index: u32| TrackPoint {
        position: position(index),
        color: [index as u8, 10, 255],
        error_px: off_px,
        observations: (0..scene.frames.len())
            .map(|frame| observation(position(index), frame))
            .collect(),
    };
    Tracks {
        points: (0..64).map(point).collect(),
    }
}

fn read_back(files: &[(&'static str, Vec<u8>); 3]) -> Cameras {
    let model = Model {
        names: files.each_ref().map(|file| file.0),
        cameras: &files[0].1,
        images: &files[1].1,
        points: Some(&files[2].1),
    };
    read_colmap_binary(&model).unwrap()
}

#[test]
fn a_model_is_read_back_with_its_cameras_poses_sights_and_errors() {
    let scene = scene();
    let files = write_colmap(&scene, &tracks(&scene, 0.25));
    let cameras = read_back(&files);
    assert_eq!(cameras.views.len(), 5);
    for (view, frame) in cameras.views.iter().zip(&scene.frames) {
        assert_eq!(view.file, frame.file);
        assert_eq!(
            view.lens.camera(1440, 1920).unwrap(),
            frame.camera,
            "{}",
            frame.id
        );
        let (read, wrote) = (view.cam_from_world, frame.cam_from_world);
        let defect = (read.rotation - wrote.rotation).abs().max();
        assert!(defect < 1e-15 * 4.0, "{}: {defect:e}", frame.id);
        assert_eq!(read.translation, wrote.translation);
        assert_eq!((view.matches, view.inliers), (Some(64), Some(64)));
        let error_px = view.error_px.unwrap();
        assert!((error_px - 0.25).abs() < 1e-9, "{}: {error_px}", frame.id);
    }
    assert_eq!(cameras.points.len(), 64);
    assert_eq!(cameras.points[63].color, Some([63, 10, 255]));
    assert_eq!(
        (cameras.points[63].position[0], cameras.points[63].views),
        (3.0 * 0.4 - 0.6, 5)
    );
}

#[test]
fn the_text_says_what_the_binary_says() {
    let scene = scene();
    let tracks = tracks(&scene, 0.25);
    let text = write_colmap_text(&scene, &tracks);
    let model = Model {
        names: ["model"; 3],
        cameras: text[0].1.as_bytes(),
        images: text[1].1.as_bytes(),
        points: Some(text[2].1.as_bytes()),
    };
    let [read, expected] = [
        read_colmap_text(&model).unwrap(),
        read_back(&write_colmap(&scene, &tracks)),
    ];
    assert_eq!(read.points, expected.points);
    for (text, binary) in read.views.iter().zip(&expected.views) {
        assert_eq!((&text.file, text.lens), (&binary.file, binary.lens));
        assert_eq!(text.cam_from_world, binary.cam_from_world, "{}", text.file);
        assert_eq!((text.inliers, text.error_px), (binary.inliers, binary.error_px));
    }
    // Without observations an image has an empty line behind it.
    let bare = write_colmap_text(&scene, &Tracks::default());
    assert_eq!(bare[1].1.lines().filter(|line| line.is_empty()).count(), 5);
}

#[test]
fn each_camera_gets_the_smallest_lens_and_equal_ones_share_it() {
    let files = write_colmap(&scene(), &Tracks::default());
    let numbers: Vec<u32> = scene().frames.iter().map(|frame| lens(&frame.camera).0).collect();
    assert_eq!(numbers, [1, 2, 3, 4, 1]);
    // Four cameras of 4, 4, 5 and 8 parameters behind 24 bytes each.
    assert_eq!(files[0].1.len(), 8 + 4 * 24 + (4 + 4 + 5 + 8) * 8);
    // Two focal lengths do not fit SIMPLE_RADIAL or RADIAL.
    let uneven = Camera {
        fy_px: 1454.0,
        k1: 0.1,
        ..Camera::pinhole(8, 8, 1453.0)
    };
    assert_eq!(lens(&uneven).0, 4);
    assert!(read_back(&files).points.is_empty());
}

#[test]
fn a_sight_of_a_frame_that_is_not_there_is_left_out() {
    let scene = scene();
    let mut tracks = tracks(&scene, 0.0);
    tracks.points[0].observations.insert(
        1,
        Observation {
            frame: 5,
            pixel: [1.0, 2.0],
            tone: None,
        },
    );
    let cameras = read_back(&write_colmap(&scene, &tracks));
    assert_eq!(cameras.points[0].views, 5);
    assert!(cameras.views.iter().all(|view| view.error_px.unwrap() < 1e-9));
}

#[test]
fn a_quaternion_has_length_one_and_w_not_below_zero_for_every_turn() {
    let axes = [
        Vector3::x(),
        Vector3::y(),
        Vector3::z(),
        Vector3::new(1.0, -2.0, 0.5).normalize(),
    ];
    for axis in axes {
        for degrees in [
            -180.0_f64, -179.999, -120.0, -1e-7, 0.0, 90.0, 120.0, 179.999999, 180.0,
        ] {
            let turn = nalgebra::Rotation3::new(axis * degrees.to_radians());
            let [w, x, y, z] = quaternion(turn.matrix());
            let length = (w * w + x * x + y * y + z * z).sqrt();
            assert!(
                (length - 1.0).abs() < 1e-15 * 4.0 && w >= 0.0,
                "{axis} {degrees}: {w} {x} {y} {z}"
            );
            let back = nalgebra::UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(w, x, y, z));
            let defect = (back.to_rotation_matrix().matrix() - turn.matrix()).abs().max();
            assert!(defect < 1e-14, "{axis} {degrees}: {defect:e}");
        }
    }
}
