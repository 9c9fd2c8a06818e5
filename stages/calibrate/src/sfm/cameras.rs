//! Cameras that photos share, and what is known of each before the reconstruction.

use marf_scene::Camera;
use marf_schema::calibrate::{CalibrateParams, Intrinsics};
use marf_sfm::view_graph::{SharedCamera, View};
use marf_sfm_features::two_view::FocalKnown;

use super::photo_features::PhotoFeatures;
use crate::photos::InputPhoto;

/// Standard deviation of the focal lengths of labels and of EXIF, as a fraction. A tenth of a percent is our choice: the
/// demo's labels are exact, and photos that disagree outweigh it. EXIF has whole millimetres.
const LABEL_SIGMA: f64 = 0.001;
const EXIF_SIGMA: f64 = 0.1;
/// Focal length if nothing is known: COLMAP's guess, as a fraction of the longer side.
const GUESS: f64 = 1.2;
/// Cameras of labels are the same if they differ by no more than this.
const SAME_SHARE: f64 = 2e-4;
const SAME_PX: f64 = 0.05;

/// Returns the cameras of the photos at working size, and each photo with the index of its camera.
pub(super) fn group(
    items: &[InputPhoto],
    features: &[PhotoFeatures],
    params: &CalibrateParams,
) -> (Vec<SharedCamera>, Vec<View>) {
    let mut cameras: Vec<(String, SharedCamera)> = Vec::new();
    let mut views = Vec::with_capacity(features.len());
    for (photo, one) in features.iter().enumerate() {
        let facts = &items[photo].facts;
        let name = match params.intrinsics {
            Intrinsics::Camera => {
                format!("{:?} {:?} {}", facts.instrument, facts.device, one.row.factor)
            }
            Intrinsics::Photo => photo.to_string(),
        };
        let start = initial_camera(&items[photo], one);
        let known = cameras
            .iter()
            .position(|(other, shared)| *other == name && same(&shared.camera, &start.camera));
        let camera = known.unwrap_or_else(|| {
            cameras.push((name, start));
            cameras.len() - 1
        });
        views.push(View {
            camera,
            pixels: one.pixels(),
        });
    }
    (cameras.into_iter().map(|(_, shared)| shared).collect(), views)
}

/// Returns whether two cameras are the same.
fn same(a: &Camera, b: &Camera) -> bool {
    (a.width, a.height) == (b.width, b.height)
        && (a.fx_px / b.fx_px - 1.0).abs() < SAME_SHARE
        && (a.fy_px / b.fy_px - 1.0).abs() < SAME_SHARE
        && (a.cx_px - b.cx_px).abs() < SAME_PX
        && (a.cy_px - b.cy_px).abs() < SAME_PX
}

/// Returns the known part of a photo's camera, at working size.
fn initial_camera(item: &InputPhoto, one: &PhotoFeatures) -> SharedCamera {
    let row = &one.row;
    let (width, height) = (row.width, row.height);
    let (camera, focal, focal_sigma_share) = match (row.label, item.facts.focal_px) {
        (Some((camera, _)), _) => (camera, FocalKnown::Known, Some(LABEL_SIGMA)),
        (None, Some(focal_px)) => (
            Camera::pinhole(width, height, focal_px),
            FocalKnown::Known,
            Some(EXIF_SIGMA),
        ),
        (None, None) => (
            Camera::pinhole(width, height, GUESS * f64::from(width.max(height))),
            FocalKnown::Guessed,
            None,
        ),
    };
    SharedCamera {
        camera: camera.box_reduced(row.factor),
        focal,
        focal_sigma_share,
    }
}
