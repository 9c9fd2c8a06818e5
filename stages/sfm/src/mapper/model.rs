//! A model: registered photos and triangulated points.

use marf_scene::{Camera, Pose};
use marf_sfm_features::estimators::{Ray, ray_angle_rad, triangulate_robust};
use nalgebra::Vector3;
use rayon::prelude::*;

use super::input::MapperInput;
use super::tracks::Observation;
use crate::align::Similarity;
use crate::bundle::LensModel;
use crate::view_graph::PosedCamera;

/// Registered photos in one coordinate frame, with the points they observe.
#[derive(Debug, Clone, PartialEq)]
pub struct Model {
    /// By index of [`MapperInput::cameras`].
    pub cameras: Vec<Camera>,
    /// Distortion model that is free for cameras with enough photos.
    pub lens: LensModel,
    /// Whether principal points are free.
    pub principal_point: bool,
    /// `cam_from_world` of each photo, if registered.
    pub poses: Vec<Option<Pose>>,
    /// Position of each track, if triangulated.
    pub points: Vec<Option<Vector3<f64>>>,
    /// Whether each observation is used.
    pub active: Vec<bool>,
    /// The first photo of the model, whose pose fixes the gauge.
    pub anchor: usize,
}

/// Tracks between two questions whether to stop.
const TRACKS_AT_ONCE: usize = 1024;

/// State of one track: its point, and which of its observations are used.
type TrackState = (Option<Vector3<f64>>, Vec<bool>);

impl Model {
    /// Returns a model without photos.
    pub(crate) fn empty(input: &MapperInput<'_>, anchor: usize) -> Self {
        Self {
            cameras: input.cameras.iter().map(|shared| shared.camera).collect(),
            lens: input.options.lens.while_growing(),
            principal_point: false,
            poses: vec![None; input.views.len()],
            points: vec![None; input.tracks.len()],
            active: vec![false; input.tracks.observations.len()],
            anchor,
        }
    }

    /// Returns the model of the photos whose pose and working-size camera are known, with the tracks that fit. `None`
    /// without any such photo.
    pub(super) fn known(input: &MapperInput<'_>, known: &[Option<PosedCamera>]) -> Option<Self> {
        let anchor = known.iter().position(Option::is_some)?;
        let mut model = Self::empty(input, anchor);
        for (photo, known) in known.iter().enumerate() {
            if let Some(known) = known {
                model.poses[photo] = Some(known.cam_from_world);
                model.cameras[input.views[photo].camera] = known.camera;
            }
        }
        model.set_lens_from_cameras();
        model.complete(input, input.tracks.all());
        Some(model)
    }

    /// Sets the distortion model to the smallest that holds the coefficients of all cameras.
    pub(crate) fn set_lens_from_cameras(&mut self) {
        let used = |camera: &Camera| match camera {
            camera if camera.p1 != 0.0 || camera.p2 != 0.0 => LensModel::OpenCv,
            camera if camera.k2 != 0.0 => LensModel::Radial,
            camera if camera.k1 != 0.0 => LensModel::SimpleRadial,
            _ => LensModel::Pinhole,
        };
        self.lens = self.cameras.iter().map(used).max().unwrap_or(LensModel::Pinhole);
    }

    /// Returns the indices of the registered photos.
    pub fn photos(&self) -> impl Iterator<Item = usize> + '_ {
        let placed = self.poses.iter().enumerate();
        placed.filter_map(|(photo, pose)| pose.is_some().then_some(photo))
    }

    /// Returns the reprojection error of an observation. `None` if its point has no projection.
    pub fn error_px(&self, input: &MapperInput<'_>, observation: &Observation) -> Option<f64> {
        let point = self.points[observation.track as usize]?;
        self.error_of(input, observation, &point)
    }

    /// Returns the reprojection error of an observation for a given point.
    fn error_of(
        &self,
        input: &MapperInput<'_>,
        observation: &Observation,
        point: &Vector3<f64>,
    ) -> Option<f64> {
        let photo = observation.photo as usize;
        let in_camera = self.poses[photo]?.point(point);
        let pixel = self.cameras[input.views[photo].camera].project(&in_camera)?;
        Some((pixel - observation.pixel).norm())
    }

    /// Triangulates tracks without a point, and adds observations that fit the point of their track.
    pub(crate) fn complete(&mut self, input: &MapperInput<'_>, tracks: Vec<usize>) {
        self.update(tracks, |model, track| model.completed(input, track), input);
    }

    /// Removes observations whose reprojection error is too large, then points without two observations or without parallax.
    pub(crate) fn filter(&mut self, input: &MapperInput<'_>, tracks: Vec<usize>) {
        self.update(tracks, |model, track| model.filtered(input, track), input);
    }

    /// Returns the number of observations that are used.
    pub(crate) fn active_count(&self) -> usize {
        self.active.iter().filter(|active| **active).count()
    }

    /// Returns the indices of the used observations of a photo.
    pub fn active_in<'a>(
        &'a self,
        input: &'a MapperInput<'_>,
        photo: usize,
    ) -> impl Iterator<Item = usize> + 'a {
        input
            .tracks
            .in_photo(photo)
            .filter(|&observation| self.active[observation])
    }

    /// Removes a photo with all its observations.
    pub(crate) fn remove(&mut self, input: &MapperInput<'_>, photo: usize) {
        self.poses[photo] = None;
        for observation in input.tracks.in_photo(photo) {
            self.active[observation] = false;
        }
    }

    /// Fixes the gauge by the first photo if the anchor was removed.
    pub(super) fn move_anchor(&mut self) {
        if self.poses[self.anchor].is_none() {
            let first = self.photos().next();
            self.anchor = first.unwrap_or(self.anchor);
        }
    }

    /// Applies a similarity to all poses and points.
    pub fn transform(&mut self, similarity: &Similarity) {
        for pose in self.poses.iter_mut().flatten() {
            *pose = similarity.pose(pose);
        }
        for point in self.points.iter_mut().flatten() {
            *point = similarity.point(point);
        }
    }

    /// Computes the state of every track in parallel, then applies them in order.
    fn update(
        &mut self,
        tracks: Vec<usize>,
        step: impl Fn(&Self, usize) -> TrackState + Sync,
        input: &MapperInput<'_>,
    ) {
        let states: Vec<TrackState> = tracks
            .par_chunks(TRACKS_AT_ONCE)
            // A model that is stopped in the middle is thrown away.
            .filter(|_| !(input.stop)())
            .flat_map_iter(|tracks| tracks.iter().map(|&track| step(self, track)))
            .collect();
        if states.len() < tracks.len() {
            return;
        }
        for (track, (point, active)) in tracks.into_iter().zip(states) {
            self.points[track] = point;
            self.active[input.tracks.range(track)].copy_from_slice(&active);
        }
    }

    /// Returns the state of a track as it is.
    fn state(&self, input: &MapperInput<'_>, track: usize) -> TrackState {
        (
            self.points[track],
            self.active[input.tracks.range(track)].to_vec(),
        )
    }

    /// Returns a track triangulated, or with the observations that fit its point.
    fn completed(&self, input: &MapperInput<'_>, track: usize) -> TrackState {
        let Some(point) = self.points[track] else {
            return self.triangulated(input, track);
        };
        let range = input.tracks.range(track);
        let fits = |observation: usize| {
            let error = self.error_of(input, &input.tracks.observations[observation], &point);
            self.active[observation] || error.is_some_and(|error| error <= input.options.max_error_px)
        };
        (Some(point), range.map(fits).collect())
    }

    /// Returns a track triangulated from all its registered photos.
    fn triangulated(&self, input: &MapperInput<'_>, track: usize) -> TrackState {
        let range = input.tracks.range(track);
        let (mut indices, mut rays, mut errors) = (Vec::new(), Vec::new(), Vec::new());
        for observation in range.clone() {
            let one = &input.tracks.observations[observation];
            let photo = one.photo as usize;
            let camera = &self.cameras[input.views[photo].camera];
            let (Some(pose), Some(ray)) = (self.poses[photo], camera.unproject(&one.pixel)) else {
                continue;
            };
            indices.push(observation - range.start);
            errors.push(input.options.max_error_px / camera.fx_px);
            rays.push(Ray {
                cam_from_world: pose,
                plane: ray.xy(),
            });
        }
        let mut active = vec![false; range.len()];
        let found = triangulate_robust(&rays, &errors, input.options.min_angle_rad);
        for &inlier in found.iter().flat_map(|found| &found.inliers) {
            active[indices[inlier]] = true;
        }
        (found.map(|found| found.point), active)
    }

    /// Returns a track without observations whose error is too large, and without its point if too few are left.
    fn filtered(&self, input: &MapperInput<'_>, track: usize) -> TrackState {
        let Some(point) = self.points[track] else {
            return self.state(input, track);
        };
        let range = input.tracks.range(track);
        let fits = |observation: usize| {
            let error = self.error_of(input, &input.tracks.observations[observation], &point);
            self.active[observation] && error.is_some_and(|error| error <= input.options.max_error_px)
        };
        let active: Vec<bool> = range.clone().map(fits).collect();
        let centres: Vec<Vector3<f64>> = range
            .zip(&active)
            .filter(|(_, active)| **active)
            .filter_map(|(observation, _)| self.poses[input.tracks.observations[observation].photo as usize])
            .map(|pose| pose.centre())
            .collect();
        if wide(&centres, &point, input.options.min_angle_rad) {
            (Some(point), active)
        } else {
            (None, vec![false; active.len()])
        }
    }
}

/// Whether two of the centres have at least that triangulation angle.
fn wide(centres: &[Vector3<f64>], point: &Vector3<f64>, min_angle_rad: f64) -> bool {
    centres.iter().enumerate().any(|(index, first)| {
        let others = &centres[index + 1..];
        others
            .iter()
            .any(|second| ray_angle_rad(first, second, point) >= min_angle_rad)
    })
}
