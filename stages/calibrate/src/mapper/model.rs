use marf_scene::{Camera, Pose};
use nalgebra::Vector3;
use rayon::prelude::*;

use super::Task;
use super::tracks::TrackSight;
use crate::bundle::LensModel;
use crate::estimators::{Sight, ray_angle_rad, triangulate_robust};

/// Photos in one frame, with the points they see.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Model {
    /// By index of [`super::Task::cameras`].
    pub cameras: Vec<Camera>,
    /// Lens terms that stay free for cameras with photos enough.
    pub lens: LensModel,
    /// Whether principal points are free.
    pub principal_point: bool,
    /// `cam_from_world` by photo.
    pub poses: Vec<Option<Pose>>,
    /// By track.
    pub points: Vec<Option<Vector3<f64>>>,
    /// By sight: whether it takes part.
    pub active: Vec<bool>,
    /// The photo the model began with; its pose is held.
    pub anchor: usize,
}

/// What a step says of one track: its point, and which of its sights take part.
type TrackState = (Option<Vector3<f64>>, Vec<bool>);

impl Model {
    pub(crate) fn empty(task: &Task<'_>, anchor: usize) -> Self {
        Self {
            cameras: task.cameras.iter().map(|shared| shared.camera).collect(),
            lens: task.options.lens.while_growing(),
            principal_point: false,
            poses: vec![None; task.views.len()],
            points: vec![None; task.tracks.len()],
            active: vec![false; task.tracks.sights.len()],
            anchor,
        }
    }

    /// Takes the lens terms of the cameras as they are, and leaves free those that are there.
    pub(crate) fn keep_lens(&mut self) {
        let used = |camera: &Camera| match camera {
            camera if camera.p1 != 0.0 || camera.p2 != 0.0 => LensModel::OpenCv,
            camera if camera.k2 != 0.0 => LensModel::Radial,
            camera if camera.k1 != 0.0 => LensModel::SimpleRadial,
            _ => LensModel::Pinhole,
        };
        self.lens = self.cameras.iter().map(used).max().unwrap_or(LensModel::Pinhole);
    }

    /// Indices of the placed photos.
    pub(crate) fn photos(&self) -> impl Iterator<Item = usize> + '_ {
        let placed = self.poses.iter().enumerate();
        placed.filter_map(|(photo, pose)| pose.is_some().then_some(photo))
    }

    /// Distance from the pixel to where the point appears; `None` where it cannot appear.
    pub(crate) fn error_px(&self, task: &Task<'_>, sight: &TrackSight) -> Option<f64> {
        let point = self.points[sight.track as usize]?;
        self.error_of(task, sight, &point)
    }

    fn error_of(&self, task: &Task<'_>, sight: &TrackSight, point: &Vector3<f64>) -> Option<f64> {
        let photo = sight.photo as usize;
        let in_camera = self.poses[photo]?.point(point);
        let pixel = self.cameras[task.views[photo].camera].project(&in_camera)?;
        Some((pixel - sight.pixel).norm())
    }

    /// Triangulates tracks without a point, and takes back sights that fit the point of their track.
    pub(crate) fn complete(&mut self, task: &Task<'_>, tracks: Vec<usize>) {
        self.update(tracks, |model, track| model.completed(task, track), task);
    }

    /// Drops sights that err by more than the options allow, then points without two sights or without parallax.
    pub(crate) fn filter(&mut self, task: &Task<'_>, tracks: Vec<usize>) {
        self.update(tracks, |model, track| model.filtered(task, track), task);
    }

    pub(crate) fn active_count(&self) -> usize {
        self.active.iter().filter(|active| **active).count()
    }

    /// Indices of the sights of a photo that take part.
    pub(crate) fn active_in<'a>(
        &'a self,
        task: &'a Task<'_>,
        photo: usize,
    ) -> impl Iterator<Item = usize> + 'a {
        task.tracks.in_photo(photo).filter(|&sight| self.active[sight])
    }

    /// Takes a photo out, with all its sights.
    pub(crate) fn remove(&mut self, task: &Task<'_>, photo: usize) {
        self.poses[photo] = None;
        for sight in task.tracks.in_photo(photo) {
            self.active[sight] = false;
        }
    }

    fn update(
        &mut self,
        tracks: Vec<usize>,
        step: impl Fn(&Self, usize) -> TrackState + Sync,
        task: &Task<'_>,
    ) {
        let states: Vec<TrackState> = tracks.par_iter().map(|&track| step(self, track)).collect();
        for (track, (point, active)) in tracks.into_iter().zip(states) {
            self.points[track] = point;
            self.active[task.tracks.range(track)].copy_from_slice(&active);
        }
    }

    fn state(&self, task: &Task<'_>, track: usize) -> TrackState {
        (self.points[track], self.active[task.tracks.range(track)].to_vec())
    }

    fn completed(&self, task: &Task<'_>, track: usize) -> TrackState {
        let Some(point) = self.points[track] else {
            return self.triangulated(task, track);
        };
        let range = task.tracks.range(track);
        let fits = |sight: usize| {
            let error = self.error_of(task, &task.tracks.sights[sight], &point);
            self.active[sight] || error.is_some_and(|error| error <= task.options.max_error_px)
        };
        (Some(point), range.map(fits).collect())
    }

    fn triangulated(&self, task: &Task<'_>, track: usize) -> TrackState {
        let range = task.tracks.range(track);
        let (mut placed, mut sights, mut errors) = (Vec::new(), Vec::new(), Vec::new());
        for sight in range.clone() {
            let seen = &task.tracks.sights[sight];
            let photo = seen.photo as usize;
            let camera = &self.cameras[task.views[photo].camera];
            let (Some(pose), Some(ray)) = (self.poses[photo], camera.unproject(&seen.pixel)) else {
                continue;
            };
            placed.push(sight - range.start);
            errors.push(task.options.max_error_px / camera.fx_px);
            sights.push(Sight {
                cam_from_world: pose,
                plane: ray.xy(),
            });
        }
        let mut active = vec![false; range.len()];
        let found = triangulate_robust(&sights, &errors, task.options.min_angle_rad);
        for &inlier in found.iter().flat_map(|found| &found.inliers) {
            active[placed[inlier]] = true;
        }
        (found.map(|found| found.point), active)
    }

    fn filtered(&self, task: &Task<'_>, track: usize) -> TrackState {
        let Some(point) = self.points[track] else {
            return self.state(task, track);
        };
        let range = task.tracks.range(track);
        let fits = |sight: usize| {
            let error = self.error_of(task, &task.tracks.sights[sight], &point);
            self.active[sight] && error.is_some_and(|error| error <= task.options.max_error_px)
        };
        let active: Vec<bool> = range.clone().map(fits).collect();
        let centres: Vec<Vector3<f64>> = range
            .zip(&active)
            .filter(|(_, active)| **active)
            .filter_map(|(sight, _)| self.poses[task.tracks.sights[sight].photo as usize])
            .map(|pose| pose.centre())
            .collect();
        if wide(&centres, &point, task.options.min_angle_rad) {
            (Some(point), active)
        } else {
            (None, vec![false; active.len()])
        }
    }
}

/// Tells whether two of the centres see the point under at least that angle.
fn wide(centres: &[Vector3<f64>], point: &Vector3<f64>, min_angle_rad: f64) -> bool {
    centres.iter().enumerate().any(|(index, first)| {
        let others = &centres[index + 1..];
        others
            .iter()
            .any(|second| ray_angle_rad(first, second, point) >= min_angle_rad)
    })
}
