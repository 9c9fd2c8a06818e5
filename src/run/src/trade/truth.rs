//! Known cameras, by which those of a calibration are judged.

use std::path::Path;

use marf_cache::file::{FileKind, Links, read};
use marf_calibrate::import::read_transforms;
use marf_scene::{Alignment, Pose, Scene};

use crate::error::Error;

/// Known cameras by the names of their photos.
#[derive(Debug, Default)]
pub struct Truth(Vec<(String, Pose)>);

/// Medians over the cameras found, after the similarity that brings them nearest to the known ones.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PoseError {
    /// Distance of centres, in the unit of the known cameras.
    pub position: f64,
    /// Angle between attitudes.
    pub angle_deg: f64,
}

impl Truth {
    /// Reads a transforms.json.
    ///
    /// # Errors
    /// A file that cannot be read or is none.
    pub fn read(file: &Path) -> Result<Self, Error> {
        let told =
            |error: &dyn std::fmt::Display| Error::usage(format!("--truth {}: {error}", file.display()));
        let bytes = read(file, FileKind::Document, Links::Followed).map_err(|error| told(&error))?;
        // The names in it are relative to its folder, wherever that is.
        let name = file.file_name().unwrap_or_default().to_string_lossy();
        let transforms = read_transforms(&name, &bytes).map_err(|error| told(&error))?;
        let views = transforms.views.into_iter();
        Ok(Self(
            views
                .map(|view| (stem(&view.file).to_owned(), view.cam_from_world))
                .collect(),
        ))
    }

    /// Returns the error of the cameras of a scene against the known ones. None if fewer than three of its photos have a known camera, or
    /// their centres are on one line.
    pub fn error_of(&self, scene: &Scene) -> Option<PoseError> {
        let known = |file: &str| {
            self.0
                .iter()
                .find(|(known, _)| known == stem(file))
                .map(|(_, pose)| *pose)
        };
        let pairs = scene
            .frames
            .iter()
            .filter_map(|frame| Some((frame.cam_from_world, known(&frame.file)?)));
        let pairs: Vec<(Pose, Pose)> = pairs.collect();
        let alignment = Alignment::fit(&pairs)?;
        let (distances, angles): (Vec<f64>, Vec<f64>) = pairs
            .iter()
            .map(|pair| alignment.difference(&pair.0, &pair.1))
            .unzip();
        Some(PoseError {
            position: median(distances),
            angle_deg: median(angles).to_degrees(),
        })
    }
}

/// Returns the name of a file without its folders and ending: a calibration may have resampled a photo to another format.
fn stem(file: &str) -> &str {
    let name = file.rsplit('/').next().unwrap_or(file);
    name.rsplit_once('.').map_or(name, |(stem, _)| stem)
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

#[cfg(test)]
mod tests {
    use super::*;
    use marf_cache::Digest;
    use marf_scene::{Camera, Frame};
    use nalgebra::Vector3;

    fn pose(index: usize) -> Pose {
        let index = index as f64;
        let eye = Vector3::new(index.cos() * 3.0, index.sin() * 2.0, 0.3 * index);
        Pose::looking_at(eye, Vector3::new(9.0, 1.0, index), Vector3::new(0.0, 0.1, 1.0))
    }

    fn scene(count: usize) -> Scene {
        let frame = |index: usize| Frame {
            id: format!("p{index}"),
            file: format!("sol 1/p{index}.jpg"),
            image: Digest::from_content(&[]),
            mask: None,
            camera: Camera::pinhole(4, 4, 4.0),
            cam_from_world: pose(index),
            held_out: false,
            error_px: None,
        };
        Scene {
            frames: (0..count).map(frame).collect(),
            ..Scene::default()
        }
    }

    #[test]
    fn photos_are_matched_by_name_and_the_medians_are_those_of_the_cameras() {
        let mut truth = Truth((0..9).map(|index| (format!("p{index}"), pose(index))).collect());
        let error = truth.error_of(&scene(7)).unwrap();
        assert!(error.position < 1e-12 && error.angle_deg < 1e-9, "{error:?}");
        // One camera off by a metre moves no median.
        truth.0[2].1.translation.x += 1.0;
        let error = truth.error_of(&scene(7)).unwrap();
        assert!(error.position > 0.0 && error.position < 0.5, "{error:?}");
        assert_eq!(truth.error_of(&scene(2)), None);
        assert_eq!(Truth::default().error_of(&scene(7)), None);
    }

    #[test]
    fn folders_and_endings_do_not_matter() {
        assert_eq!(stem("images/a.b.png"), "a.b");
        assert_eq!((stem("a"), stem("")), ("a", ""));
    }
}
