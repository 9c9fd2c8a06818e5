//! Distances of pixels, for a field to learn from.

use marf_scene::Scene;
use marf_stage::{Ctx, StageError};
use nalgebra::Vector2;

use crate::disparities::Class;
use crate::matching::Matching;
use crate::merge::PhotoDepth;
use crate::raster::Raster;

/// How finely photos are matched for a training.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TargetDetail {
    /// Few photos, each of which counts: 480 pixels a side, three pairs a photo, at most 32,768 distances of each.
    Fine,
    /// Many photos: 240 pixels, one pair, 8,192 distances. It takes a fifteenth of the time (`benches/field.md`).
    Coarse,
}

impl TargetDetail {
    /// Longest side of the pictures that are matched, pixels.
    const fn side_px(self) -> u32 {
        match self {
            Self::Fine => 480,
            Self::Coarse => 240,
        }
    }

    /// Most pairs of a photo.
    const fn neighbours(self) -> u32 {
        match self {
            Self::Fine => 3,
            Self::Coarse => 1,
        }
    }

    /// Most distances of a photo: from every second, third, ... column and row.
    const fn most(self) -> usize {
        match self {
            Self::Fine => 1 << 15,
            Self::Coarse => 1 << 13,
        }
    }
}

/// How far away what a pixel shows is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DistanceSample {
    /// Place in the photo as shares of its width and height.
    pub at: [f32; 2],
    /// Distance from the camera, units of the world. Infinite for sky.
    pub distance: f32,
    /// One standard deviation of it, 0 for sky.
    pub sigma: f32,
}

/// Returns distances of pixels of each photo of a scene, in their order, from pairs of these photos alone.
///
/// They are spread over the photo. There is none next to edges. Sky is infinitely far away. Without a pair that shows depth the list is
/// empty.
///
/// # Errors
/// A photo that cannot be read, or the wish to stop.
pub fn distances(
    ctx: &Ctx<'_>,
    scene: &Scene,
    detail: TargetDetail,
) -> Result<Vec<Vec<DistanceSample>>, StageError> {
    let mut matching = Matching::new(ctx, scene, detail.side_px(), detail.neighbours())?;
    let photos = 0..scene.frames.len();
    photos
        .map(|photo| Ok(spread(&matching.depth_of(photo)?, detail.most())))
        .collect()
}

/// Pixels around sky that are not certain to show sky alone.
const SKYLINE_PX: usize = 2;

/// Returns distances of pixels on a lattice.
fn spread(depth: &PhotoDepth, most: usize) -> Vec<DistanceSample> {
    let (width, height) = (depth.camera.width as usize, depth.camera.height as usize);
    let stride = (1..).find(|stride| width.div_ceil(*stride) * height.div_ceil(*stride) <= most);
    let stride = stride.unwrap_or(1);
    let rows = (stride / 2..height).step_by(stride);
    let pixels = rows.flat_map(|row| {
        (stride / 2..width)
            .step_by(stride)
            .map(move |column| [column, row])
    });
    let sky = Raster {
        width,
        height,
        values: depth.class.iter().map(|class| *class == Class::Sky).collect(),
    };
    let sky = sky.eroded(SKYLINE_PX, SKYLINE_PX);
    let found = pixels.filter_map(|[column, row]| {
        let index = row * width + column;
        let at = Vector2::new(column as f64 + 0.5, row as f64 + 0.5);
        let shares = [at.x / width as f64, at.y / height as f64].map(|share| share as f32);
        if sky.values[index] {
            return Some(DistanceSample {
                at: shares,
                distance: f32::INFINITY,
                sigma: 0.0,
            });
        }
        if !matches!(depth.class[index], Class::Pair | Class::Confirmed) {
            return None;
        }
        let inverse = f64::from(depth.inverse[index]);
        let distance = depth.camera.unproject(&at)?.norm() / inverse;
        Some(DistanceSample {
            at: shares,
            distance: distance as f32,
            sigma: (distance * f64::from(depth.sigma[index]) / inverse) as f32,
        })
    });
    found.collect()
}
