//! Sparse points with their observations.

use marf_scene::{Camera, Falloff, Point, Scene, Tones};
use marf_sfm::{
    tones::{PointTone, find_tones},
    vignetting::find_vignetting,
};
use nalgebra::{Vector2, Vector3};

/// Sparse points with their observations. Every number is finite.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Tracks {
    /// The points.
    pub points: Vec<TrackPoint>,
}

/// A sparse point and its observations.
#[derive(Debug, Clone, PartialEq)]
pub struct TrackPoint {
    /// Position in the world.
    pub position: [f64; 3],
    /// sRGB.
    pub color: [u8; 3],
    /// Mean reprojection error, pixels.
    pub error_px: f64,
    /// Where it was observed.
    pub observations: Vec<Observation>,
}

/// A feature that observes a point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Observation {
    /// Index of the frame in the scene.
    pub frame: u32,
    /// Position in that frame's image, pixels.
    pub pixel: [f64; 2],
    /// sRGB there, if the method has read it.
    pub tone: Option<[u8; 3]>,
}

impl Tracks {
    /// Returns the tracks of points without known observations. Points without a colour are grey.
    pub fn without_observations(points: &[Point]) -> Self {
        let point = |point: &Point| TrackPoint {
            position: point.position,
            color: point.color.unwrap_or([128; 3]),
            error_px: 0.0,
            observations: Vec::new(),
        };
        Self {
            points: points.iter().map(point).collect(),
        }
    }

    /// Returns what the tones of the points say of the exposures of the scene's photos, and of the vignetting of their cameras.
    pub(crate) fn tones(&self, scene: &Scene) -> Option<Tones> {
        let ids: Vec<&str> = scene.frames.iter().map(|frame| frame.id.as_str()).collect();
        let cameras: Vec<Camera> = scene.frames.iter().map(|frame| frame.camera).collect();
        let tone = |seen: &Observation| {
            let photo = seen.frame as usize;
            let radius2 = cameras.get(photo)?.radius2(&seen.pixel.into());
            PointTone::unclipped(photo, radius2, seen.tone?)
        };
        let tones = self
            .points
            .iter()
            .map(|point| point.observations.iter().filter_map(tone));
        let mut tones: Vec<Vec<PointTone>> = tones.map(Iterator::collect).collect();
        let vignetting = find_vignetting(&cameras, &tones);
        for seen in tones.iter_mut().flatten() {
            if let Some(real) = Falloff::real_one(&vignetting, &cameras[seen.photo]) {
                seen.tone = seen.tone.map(|tone| tone / real.at(seen.radius2));
            }
        }
        Some(Tones {
            vignetting,
            ..find_tones(&ids, &tones)?
        })
    }

    /// Sets the error of each point to the mean distance of its observations from its projections, pixels. 0 without observations.
    pub fn measure(&mut self, scene: &Scene) {
        for point in &mut self.points {
            let position = Vector3::from(point.position);
            let distance = |observation: &Observation| {
                let frame = scene.frames.get(observation.frame as usize)?;
                let pixel = frame.camera.project(&frame.cam_from_world.point(&position))?;
                Some((pixel - Vector2::from(observation.pixel)).norm())
            };
            let distances: Vec<f64> = point.observations.iter().filter_map(distance).collect();
            let mean = distances.iter().sum::<f64>() / distances.len() as f64;
            point.error_px = if mean.is_finite() { mean } else { 0.0 };
        }
    }
}
