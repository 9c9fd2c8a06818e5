use marf_scene::Camera;

use super::pairs::Compared;
use super::prepare::Prepared;
use crate::mapper::{SharedCamera, View};
use crate::params::{CalibrateParams, Intrinsics};
use crate::photos::Item;
use crate::two_view::{FocalKnown, focal_from_pairs};

/// How far the focal lengths of labels and of EXIF are trusted, as a share. A tenth of a percent is our choice: the
/// demo's labels are exact in it, and photos that say otherwise outvote it. EXIF has whole millimetres.
const LABEL_SIGMA: f64 = 0.001;
const EXIF_SIGMA: f64 = 0.1;
/// Without any word on the focal length: COLMAP's guess, a share of the longer side.
const GUESS: f64 = 1.2;
/// Cameras of labels are one camera if they differ by no more than this.
const SAME_SHARE: f64 = 2e-4;
const SAME_PX: f64 = 0.05;

/// Groups the photos by camera; returns the cameras at working size and each photo's index.
pub(super) fn group(
    items: &[Item],
    prepared: &[Prepared],
    params: &CalibrateParams,
) -> (Vec<SharedCamera>, Vec<View>) {
    let mut cameras: Vec<(String, SharedCamera)> = Vec::new();
    let mut views = Vec::with_capacity(prepared.len());
    for (photo, one) in prepared.iter().enumerate() {
        let facts = &items[photo].facts;
        let name = match params.intrinsics {
            Intrinsics::Camera => {
                format!("{:?} {:?} {}", facts.instrument, facts.device, one.row.factor)
            }
            Intrinsics::Photo => photo.to_string(),
        };
        let start = start(&items[photo], one);
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

fn same(a: &Camera, b: &Camera) -> bool {
    (a.width, a.height) == (b.width, b.height)
        && (a.fx_px / b.fx_px - 1.0).abs() < SAME_SHARE
        && (a.fy_px / b.fy_px - 1.0).abs() < SAME_SHARE
        && (a.cx_px - b.cx_px).abs() < SAME_PX
        && (a.cy_px - b.cy_px).abs() < SAME_PX
}

/// What is known of a photo's camera, at working size.
fn start(item: &Item, one: &Prepared) -> SharedCamera {
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

/// Replaces guessed focal lengths by what the pairs of one camera's photos say; where they say nothing, by what
/// the others are found to have, relative to the longer side: mostly it is one camera, held upright or reduced.
pub(super) fn refine_guesses(cameras: &mut [SharedCamera], views: &[View], compared: &[Compared]) {
    let mut open = Vec::new();
    let mut found = Vec::new();
    for (index, shared) in cameras.iter_mut().enumerate() {
        if shared.focal == FocalKnown::Known {
            continue;
        }
        let own = compared
            .iter()
            .filter(|one| one.photos.iter().all(|&photo| views[photo].camera == index));
        let pairs: Vec<_> = own
            .filter_map(|one| Some((one.verified.fundamental?, one.verified.inliers.len())))
            .collect();
        let side = longer_side(&shared.camera);
        match focal_from_pairs(&pairs, &shared.camera) {
            Some(focal_px) => {
                (shared.camera.fx_px, shared.camera.fy_px) = (focal_px, focal_px);
                found.push(focal_px / side);
            }
            None => open.push(index),
        }
    }
    found.sort_by(f64::total_cmp);
    let Some(share) = found.get(found.len() / 2) else {
        return;
    };
    for index in open {
        let camera = &mut cameras[index].camera;
        let focal_px = share * longer_side(camera);
        (camera.fx_px, camera.fy_px) = (focal_px, focal_px);
    }
}

fn longer_side(camera: &Camera) -> f64 {
    f64::from(camera.width.max(camera.height))
}
