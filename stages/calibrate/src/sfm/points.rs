//! Points of photos whose cameras are known.

use marf_cache::{Digest, digest_of};
use marf_scene::Camera;
use marf_schema::calibrate::CalibrateParams;
use marf_sfm::mapper::{MapOptions, MapperInput, Model, Tracks, triangulate};
use marf_sfm::view_graph::{KnownView, Link, PosedCamera, SharedCamera, View, relate_known};
use marf_sfm_features::two_view::{FocalKnown, RelativePose};
use marf_stage::{Ctx, Inputs, StageError};

use super::assemble::tracks;
use super::capture_order::capture_order;
use super::compare::{choose, names};
use super::error::failed;
use super::pair_memos::{PairFunction, map_pairs};
use super::photo_features::{PhotoFeatures, photo_features};
use crate::calibration::{PhotoStatistics, PlacedPhoto};
use crate::export::TrackPoint;
use crate::photos::InputPhoto;

/// Raised when matches of photos with known cameras may change.
const VERSION: u32 = 1;

/// What photos with known cameras show.
pub(crate) struct KnownPoints {
    /// Points with their observations. Frames are indices into the photos.
    pub tracks: Vec<TrackPoint>,
    /// Of each photo: its features, and how far points are from where it shows them.
    pub statistics: Vec<PhotoStatistics>,
}

/// Triangulates the points that photos with known cameras show, from matches that agree with the cameras. The cameras stay as they are.
///
/// `photos` and `placed` describe the same photos, one by one.
///
/// # Errors
/// A photo that cannot be decoded, a mask that does not fit, a request to stop.
pub(crate) fn points_of_known(
    ctx: &Ctx<'_>,
    inputs: &Inputs,
    photos: &[InputPhoto],
    placed: &[&PlacedPhoto],
    params: &CalibrateParams,
) -> Result<KnownPoints, StageError> {
    let candidates: Vec<_> = photos.iter().map(|_| None).collect();
    let features = photo_features(ctx, inputs, photos, &candidates, params)?;
    let known = placed.iter().zip(&features).map(|(one, features)| PosedCamera {
        camera: features.row.at_working_size(&one.camera),
        cam_from_world: one.cam_from_world,
    });
    let known: Vec<PosedCamera> = known.collect();
    let pairs = choose(ctx, &features, &capture_order(photos), params)?;
    let work = KnownPairs {
        features: &features,
        known: &known,
    };
    let relative_poses = map_pairs(ctx, &names(&features), &pairs, &work)?;
    let links = pairs.into_iter().zip(relative_poses);
    let links: Vec<Link> = links
        .map(|(photos, relative_pose)| Link {
            photos,
            relative_pose,
        })
        .collect();
    let (cameras, views) = own_cameras(&features, &known);
    let input = MapperInput {
        views: &views,
        cameras: &cameras,
        links: &links,
        tracks: Tracks::build(&views, &links),
        options: MapOptions::automatic(&cameras, params.seed),
        stop: &|| ctx.cancel.is_set(),
        registered: &|_| (),
    };
    let known: Vec<Option<PosedCamera>> = known.into_iter().map(Some).collect();
    let model = triangulate(&input, &known).map_err(failed)?;
    Ok(KnownPoints {
        tracks: model.as_ref().map_or_else(Vec::new, |model| {
            tracks(&features, &input, model, params.longest_side_px)
        }),
        statistics: (0..features.len())
            .map(|photo| {
                let camera = &placed[photo].camera;
                statistics(&features[photo], &input, model.as_ref(), photo, camera)
            })
            .collect(),
    })
}

/// Returns a camera for each photo.
fn own_cameras(features: &[PhotoFeatures], known: &[PosedCamera]) -> (Vec<SharedCamera>, Vec<View>) {
    let shared = |known: &PosedCamera| SharedCamera {
        camera: known.camera,
        focal: FocalKnown::Known,
        focal_sigma_share: None,
    };
    let view = |photo: usize| View {
        camera: photo,
        pixels: features[photo].pixels(),
    };
    (
        known.iter().map(shared).collect(),
        (0..features.len()).map(view).collect(),
    )
}

/// Returns the statistics of a photo: the numbers of its features, matches and points, and the mean distance of these from where it shows
/// them.
fn statistics(
    features: &PhotoFeatures,
    input: &MapperInput<'_>,
    model: Option<&Model>,
    photo: usize,
    camera: &Camera,
) -> PhotoStatistics {
    let errors = model.into_iter().flat_map(|model| {
        let seen = model.active_in(input, photo);
        seen.filter_map(|index| model.error_px(input, &input.tracks.observations[index]))
    });
    let errors: Vec<f64> = errors.collect();
    let mean = (!errors.is_empty()).then(|| errors.iter().sum::<f64>() / errors.len() as f64);
    PhotoStatistics {
        features: Some(features.features.keypoints.len() as u32),
        matches: Some(input.tracks.in_photo(photo).count() as u32),
        inliers: Some(errors.len() as u32),
        error_px: mean.map(|mean| {
            mean * f64::from(features.row.factor) * f64::from(camera.width) / f64::from(features.row.width)
        }),
        error_working_px: mean,
        ..PhotoStatistics::default()
    }
}

/// Matching of photos whose cameras are known.
struct KnownPairs<'a> {
    features: &'a [PhotoFeatures],
    known: &'a [PosedCamera],
}

impl PairFunction for KnownPairs<'_> {
    type Output = RelativePose;
    const NOTE: &'static str = "pairs compared";

    fn table(&self) -> Digest {
        digest_of(&("calibrate known pairs", VERSION))
    }

    fn key(&self, photos: [usize; 2]) -> Digest {
        let parts = photos.map(|photo| {
            let known = &self.known[photo];
            (
                self.features[photo].row.found,
                (known.cam_from_world, known.camera),
            )
        });
        Digest::from_content(&serde_json::to_vec(&parts).unwrap_or_default())
    }

    fn compute(&self, photos: [usize; 2], _key: &Digest) -> RelativePose {
        let view = |photo: usize| KnownView {
            features: &self.features[photo].features,
            cam_from_world: &self.known[photo].cam_from_world,
            camera: &self.known[photo].camera,
        };
        relate_known(photos.map(view))
    }
}
