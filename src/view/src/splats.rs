//! Splats for the browser: made in the background, and packed.

use std::sync::{Arc, OnceLock};

use marf_scene::Scene;
use marf_scene::path::focus_point;
use marf_surface::splats::{Splat, file};
use nalgebra::Vector3;

use crate::source::{FieldSource, Source};
use crate::splat_progress::{SplatProgress, SplatStep};

/// Bytes of a packed splat.
const PACKED_BYTES: usize = 24;
/// Standard deviation of a point of the calibration, as a share of the distance between the first photo and what the photos look at.
const POINT_SHARE: f64 = 1e-3;

/// Splats that are being made.
#[derive(Debug, Default)]
pub struct SplatJob {
    progress: Arc<SplatProgress>,
    result: OnceLock<Result<Arc<[u8]>, String>>,
}

/// State of a [`SplatJob`].
pub enum SplatState {
    /// Being made.
    Running(SplatStep),
    /// Made and packed.
    Done(Arc<[u8]>),
    /// There are none, with the sentence why.
    Failed(String),
}

impl SplatJob {
    /// Begins to make the splats of a field, on a thread of its own.
    ///
    /// # Errors
    /// A thread that cannot be started.
    pub fn begin(source: Arc<dyn Source>, field: FieldSource) -> Result<Arc<Self>, String> {
        let job = Arc::new(Self::default());
        let begun = Arc::clone(&job);
        let work = move || {
            let _ = begun.result.set(packed(source.as_ref(), &field, &begun.progress));
        };
        let thread = std::thread::Builder::new().name("splats".to_owned());
        thread.spawn(work).map_err(|error| error.to_string())?;
        Ok(job)
    }

    /// Returns how far it is, or its result.
    pub fn state(&self) -> SplatState {
        match self.result.get() {
            None => SplatState::Running(self.progress.step()),
            Some(Ok(bytes)) => SplatState::Done(Arc::clone(bytes)),
            Some(Err(message)) => SplatState::Failed(message.clone()),
        }
    }

    /// Returns whether it has ended without splats.
    pub fn has_failed(&self) -> bool {
        matches!(self.result.get(), Some(Err(_)))
    }
}

/// Makes the splats of a field, in the world of its scene.
fn packed(
    source: &dyn Source,
    field: &FieldSource,
    progress: &Arc<SplatProgress>,
) -> Result<Arc<[u8]>, String> {
    let scene = source
        .object(&field.scene)
        .ok_or("the store has lost the scene of the field")?;
    let scene = Scene::decode(&scene).map_err(|error| error.to_string())?;
    let mut splats = file::read(&source.splats(field, progress)?)?;
    // The file is in metres where the scene has a scale.
    let unit = scene.metres_per_unit.unwrap_or(1.0);
    for splat in &mut splats {
        splat.position /= unit;
        splat.sigma /= unit;
    }
    Ok(pack(&splats).into())
}

/// Returns the points of the calibration as small splats.
pub fn splats_of_points(scene: &Scene) -> Vec<Splat> {
    let eye = scene.frames.first().map(|frame| frame.cam_from_world.centre());
    let distance = eye.map_or(1.0, |eye| (focus_point(scene) - eye).norm());
    let splats = scene.points.iter().map(|point| Splat {
        position: Vector3::from(point.position),
        normal: Vector3::z(),
        sigma: POINT_SHARE * distance,
        color: point
            .color
            .unwrap_or([200; 3])
            .map(|channel| f32::from(channel) / 255.0),
        opacity: 0.99,
    });
    splats.collect()
}

/// Packs splats as the page reads them, little-endian: of all x, y, z and standard deviation as f32, then of all the normal (octahedral,
/// Meyer et al. 2010, 2 x i16 of 1/32767) and red, green, blue, opacity (4 x u8 of 1/255).
pub fn pack(splats: &[Splat]) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(PACKED_BYTES * splats.len());
    for splat in splats {
        let [x, y, z]: [f64; 3] = splat.position.into();
        for number in [x, y, z, splat.sigma] {
            bytes.extend((number as f32).to_le_bytes());
        }
    }
    for splat in splats {
        for number in octahedral(&splat.normal) {
            bytes.extend(((number * 32767.0).round() as i16).to_le_bytes());
        }
        let [red, green, blue] = splat.color;
        bytes.extend([red, green, blue, splat.opacity].map(|value| (255.0 * value).round() as u8));
    }
    bytes
}

/// Returns the place of a unit vector on an octahedron that is unfolded to a square, in [-1, 1].
fn octahedral(normal: &Vector3<f64>) -> [f64; 2] {
    let on = normal / normal.lp_norm(1).max(f64::MIN_POSITIVE);
    if on.z >= 0.0 {
        return [on.x, on.y];
    }
    [
        (1.0 - on.y.abs()).copysign(on.x),
        (1.0 - on.x.abs()).copysign(on.y),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_packed_splat_has_its_numbers_where_the_page_reads_them() {
        let splat = |normal| Splat {
            position: Vector3::new(1.0, -2.0, 0.5),
            normal,
            sigma: 0.25,
            color: [0.0, 0.2, 1.0],
            opacity: 0.6,
        };
        let bytes = pack(&[splat(Vector3::x()), splat(-Vector3::z())]);
        assert_eq!(bytes.len(), 2 * PACKED_BYTES);
        let number = |at: usize| f32::from_le_bytes(bytes[4 * at..4 * at + 4].try_into().unwrap());
        assert_eq!([4, 5, 6, 7].map(number), [1.0, -2.0, 0.5, 0.25]);
        assert_eq!(bytes[32..40], [0xff, 0x7f, 0, 0, 0, 51, 255, 153]);
        assert_eq!(
            bytes[40..44],
            [0x01, 0x80, 0x01, 0x80],
            "down is a corner of the square"
        );
    }

    #[test]
    fn every_direction_has_its_own_place() {
        for (normal, wanted) in [
            ([0.0, 0.0, 1.0], [0.0, 0.0]),
            ([0.0, -1.0, 0.0], [0.0, -1.0]),
            ([0.6, 0.0, 0.8], [0.6 / 1.4, 0.0]),
            ([0.6, 0.0, -0.8], [1.0, 1.0 - 0.6 / 1.4]),
        ] {
            let found = octahedral(&Vector3::from(normal));
            for (found, wanted) in found.into_iter().zip(wanted) {
                assert!((found - wanted).abs() < 1e-12, "{normal:?}: {found}");
            }
        }
    }
}
