//! The calibration from the models.

use std::collections::BTreeMap;

use marf_scene::{Camera, Point, Pose, SiteFrame};
use marf_schema::calibrate::CalibrateParams;
use marf_sfm::align::Similarity;
use marf_sfm::bundle::LensModel;
use marf_sfm::mapper::{MapperInput, Model, pose_uncertainties};
use marf_sfm::metric::{LabelAgreement, RejectedLabel};
use marf_sfm::view_graph::components;
use marf_stage::{Ctx, StageError};
use nalgebra::Vector3;
use rayon::prelude::*;

use super::earlier::EarlierScene;
use super::error::failed;
use super::photo_features::PhotoFeatures;
use super::reasons::{Cause, cause};
use super::reconstruction::Reconstruction;
use crate::calibration::{Calibration, PhotoStatistics, PlacedPhoto, up_of};
use crate::export::{Observation, TrackPoint};
use crate::labels::median;
use crate::photos::{as_png, reduced, reduction};
use crate::up::FoundUp;

/// Returns the calibration of the largest model and of those in the same metric frame.
pub(super) fn assemble(
    ctx: &Ctx<'_>,
    reconstruction: &Reconstruction<'_>,
    earlier: Option<&EarlierScene>,
    params: &CalibrateParams,
) -> Result<Calibration, StageError> {
    let metric = reconstruction.metric.first().is_some_and(Option::is_some);
    let same_frame = |index: &usize| *index == 0 || (metric && reconstruction.metric[*index].is_some());
    let chosen: Vec<usize> = (0..reconstruction.models.len()).filter(same_frame).collect();
    let world = world_from_model(reconstruction, metric, earlier);
    let mut placed = Vec::new();
    let mut points = Vec::new();
    for &index in &chosen {
        let model = moved(&reconstruction.models[index], &world);
        let agreement = reconstruction.metric[index].as_ref();
        let rejected = agreement.map_or(&[][..], |one| &one.rejected);
        placed.extend(frames(ctx, reconstruction, &model, rejected, params)?);
        points.extend(tracks(
            reconstruction.features,
            reconstruction.input,
            &model,
            params.longest_side_px,
        ));
    }
    let causes = causes(reconstruction, &chosen);
    let worst = most_common(&causes);
    let sparse_points: Vec<Point> = points.iter().map(sparse).collect();
    Ok(Calibration {
        unplaced: causes
            .into_iter()
            .map(|(photo, cause)| (photo, cause.to_string()))
            .collect(),
        up: match earlier {
            Some(earlier) => earlier.scene.up.map(FoundUp::extended),
            None if metric => Some(FoundUp::labels()),
            None => up_of(&placed, &sparse_points),
        },
        points: sparse_points,
        tracks: points,
        metres_per_unit: match earlier {
            Some(earlier) => earlier.scene.metres_per_unit,
            None => metric.then_some(1.0),
        },
        site: match earlier {
            Some(earlier) => earlier.scene.site,
            None => reconstruction.site.filter(|_| metric).map(|site| SiteFrame {
                site,
                origin_m: (-world.translation).into(),
            }),
        },
        placed,
        stereo_pairs: agreements(reconstruction)
            .flat_map(|one| one.stereo_pairs.clone())
            .collect(),
        method: method(reconstruction, metric, earlier),
        components: Some(component_count(reconstruction)),
        statistics: (0..reconstruction.features.len())
            .map(|photo| feature_counts(reconstruction, photo))
            .collect(),
        cause: worst
            .as_ref()
            .map(|(count, cause)| format!("{count} photos: {}{}", cause.kind(), cause.place())),
        hint: worst
            .map_or("add photos, or lower `min_registered`", |(_, cause)| cause.hint())
            .to_owned(),
        ..Calibration::default()
    })
}

/// Returns what the photos say of the labels of each model in metres.
fn agreements<'a>(reconstruction: &Reconstruction<'a>) -> impl Iterator<Item = &'a LabelAgreement> {
    reconstruction.metric.iter().flatten()
}

/// Returns the transform to the world of the scene.
///
/// - With labels: the site, with its origin at the median camera, in metres.
/// - Extended: the earlier world.
/// - Otherwise: the origin is the mean of the cameras, the unit their root mean square distance from it.
fn world_from_model(
    reconstruction: &Reconstruction<'_>,
    metric: bool,
    earlier: Option<&EarlierScene>,
) -> Similarity {
    let Some(model) = reconstruction.models.first().filter(|_| earlier.is_none()) else {
        return Similarity::identity();
    };
    let centres: Vec<Vector3<f64>> = model.poses.iter().flatten().map(|pose| pose.centre()).collect();
    if metric {
        let median = median(&centres);
        return Similarity {
            translation: -median,
            ..Similarity::identity()
        };
    }
    let count = centres.len().max(1) as f64;
    let mean = centres.iter().sum::<Vector3<f64>>() / count;
    let spread = centres
        .iter()
        .map(|centre| (centre - mean).norm_squared())
        .sum::<f64>()
        / count;
    let scale = 1.0 / spread.sqrt().max(f64::MIN_POSITIVE);
    Similarity {
        scale,
        translation: -scale * mean,
        ..Similarity::identity()
    }
}

/// Returns the model in the world of the scene.
fn moved(model: &Model, world: &Similarity) -> Model {
    let mut model = model.clone();
    model.transform(world);
    model
}

/// Returns the photos of a model.
fn frames(
    ctx: &Ctx<'_>,
    reconstruction: &Reconstruction<'_>,
    model: &Model,
    rejected: &[RejectedLabel],
    params: &CalibrateParams,
) -> Result<Vec<PlacedPhoto>, StageError> {
    let photos: Vec<usize> = model.photos().collect();
    let uncertainties = pose_uncertainties(reconstruction.input, model).map_err(failed)?;
    let uncertainties = uncertainties.unwrap_or_default();
    let frames = photos.into_par_iter().enumerate().map(|(rank, photo)| {
        let rejected = rejected.iter().find(|one| one.photo == photo);
        let label_note = reconstruction.features[photo].row.note.as_deref();
        let mut placed = frame(ctx, reconstruction, model, photo, params)?;
        placed.statistics.note = note(label_note, rejected);
        placed.statistics.uncertainty = uncertainties.get(rank).copied();
        Ok(placed)
    });
    frames.collect()
}

/// Returns a photo of a model at the size that the field is trained on, without uncertainty and note.
fn frame(
    ctx: &Ctx<'_>,
    reconstruction: &Reconstruction<'_>,
    model: &Model,
    photo: usize,
    params: &CalibrateParams,
) -> Result<PlacedPhoto, StageError> {
    let row = &reconstruction.features[photo].row;
    let factor = reduction(row.width, row.height, params.longest_side_px);
    let file = row
        .file
        .as_ref()
        .unwrap_or(&reconstruction.items[photo].facts.file);
    let (image, file) = match factor {
        1 => (row.image, file.clone()),
        _ => {
            let size_px = [row.width, row.height];
            (reduced(ctx, file, &row.image, size_px, factor)?, as_png(file))
        }
    };
    let errors: Vec<f64> = model
        .active_in(reconstruction.input, photo)
        .filter_map(|observation| {
            model.error_px(
                reconstruction.input,
                &reconstruction.input.tracks.observations[observation],
            )
        })
        .collect();
    let mean = errors.iter().sum::<f64>() / errors.len().max(1) as f64;
    Ok(PlacedPhoto {
        item: photo,
        file,
        image,
        mask: None,
        camera: full_size(reconstruction, model, photo).box_reduced(factor),
        cam_from_world: model.poses[photo].unwrap_or_else(Pose::identity),
        held_out: None,
        statistics: PhotoStatistics {
            inliers: Some(errors.len() as u32),
            error_px: Some(mean * f64::from(row.factor) / f64::from(factor)),
            error_working_px: Some(mean),
            ..feature_counts(reconstruction, photo)
        },
    })
}

/// Returns the numbers of features and matches of a photo.
fn feature_counts(reconstruction: &Reconstruction<'_>, photo: usize) -> PhotoStatistics {
    PhotoStatistics {
        features: Some(reconstruction.features[photo].features.keypoints.len() as u32),
        matches: Some(reconstruction.input.tracks.in_photo(photo).count() as u32),
        ..PhotoStatistics::default()
    }
}

/// Returns the remark on the label of a photo.
fn note(label: Option<&str>, rejected: Option<&RejectedLabel>) -> Option<String> {
    let rejected = rejected.map(|one| {
        let angle_deg = one.angle_rad.to_degrees();
        format!(
            "label outvoted by the photos: {:.2} m and {angle_deg:.2} degrees off",
            one.distance_m
        )
    });
    rejected.or_else(|| label.map(str::to_owned))
}

/// Returns the camera of the model for the full-size photo.
fn full_size(reconstruction: &Reconstruction<'_>, model: &Model, photo: usize) -> Camera {
    let row = &reconstruction.features[photo].row;
    let camera = &model.cameras[reconstruction.input.views[photo].camera];
    camera.unreduced(row.factor, [row.width, row.height])
}

/// Returns the points with their observations, which name photos by index. Their pixels are those of photos reduced to `longest_side_px`.
pub(super) fn tracks(
    features: &[PhotoFeatures],
    input: &MapperInput<'_>,
    model: &Model,
    longest_side_px: Option<u32>,
) -> Vec<TrackPoint> {
    let scale = |photo: u32| {
        let row = &features[photo as usize].row;
        f64::from(row.factor) / f64::from(reduction(row.width, row.height, longest_side_px))
    };
    let points = model.points.iter().enumerate();
    points
        .filter_map(|(track, point)| {
            let position = (*point)?;
            let active = input
                .tracks
                .range(track)
                .filter(|&observation| model.active[observation]);
            let seen: Vec<_> = active
                .map(|observation| input.tracks.observations[observation])
                .collect();
            let errors = seen.iter().filter_map(|observation| {
                Some(model.error_px(input, observation)? * scale(observation.photo))
            });
            let error_px = errors.sum::<f64>() / seen.len().max(1) as f64;
            let colors = seen
                .iter()
                .map(|observation| features[observation.photo as usize].colors[observation.feature as usize]);
            let colors: Vec<[u8; 3]> = colors.collect();
            let observations = seen.iter().zip(&colors).map(|(observation, color)| Observation {
                frame: observation.photo,
                pixel: (observation.pixel * scale(observation.photo)).into(),
                tone: Some(*color),
            });
            Some(TrackPoint {
                position: position.into(),
                error_px,
                observations: observations.collect(),
                color: mean_color(colors),
            })
        })
        .collect()
}

/// Returns the mean colour, rounded.
fn mean_color(colors: Vec<[u8; 3]>) -> [u8; 3] {
    let count = colors.len().max(1) as u32;
    [0, 1, 2].map(|channel| {
        let sum: u32 = colors.iter().map(|color| u32::from(color[channel])).sum();
        ((sum + count / 2) / count) as u8
    })
}

/// Returns a point without its observations.
pub(crate) fn sparse(point: &TrackPoint) -> Point {
    Point {
        position: point.position,
        color: Some(point.color),
        views: point.observations.len() as u32,
    }
}

/// Returns the number of connected components of two and more photos.
fn component_count(reconstruction: &Reconstruction<'_>) -> usize {
    let component = components(reconstruction.features.len(), reconstruction.input.links);
    let mut sizes: BTreeMap<usize, usize> = BTreeMap::new();
    component
        .into_iter()
        .for_each(|rank| *sizes.entry(rank).or_default() += 1);
    sizes.values().filter(|size| **size > 1).count()
}

/// Returns the photos outside the chosen models, with the reason.
fn causes(reconstruction: &Reconstruction<'_>, chosen: &[usize]) -> Vec<(usize, Cause)> {
    let component = components(reconstruction.features.len(), reconstruction.input.links);
    let placed = |photo: usize| {
        chosen
            .iter()
            .any(|&index| reconstruction.models[index].poses[photo].is_some())
    };
    let left = (0..reconstruction.features.len()).filter(|&photo| !placed(photo));
    left.map(|photo| (photo, cause(reconstruction, &component, photo)))
        .collect()
}

/// Returns the most common kind of cause, with its number of photos.
fn most_common(causes: &[(usize, Cause)]) -> Option<(usize, Cause)> {
    let mut counts: BTreeMap<&str, (usize, &Cause)> = BTreeMap::new();
    for (_, cause) in causes {
        counts.entry(cause.kind()).or_insert((0, cause)).0 += 1;
    }
    let most = counts.into_values().max_by_key(|(count, _)| *count);
    most.map(|(count, cause)| (count, cause.clone()))
}

/// Returns the number of photos of the model with a label.
fn labelled(reconstruction: &Reconstruction<'_>, model: &Model) -> usize {
    model
        .photos()
        .filter(|&photo| reconstruction.features[photo].row.label.is_some())
        .count()
}

/// Returns a sentence on the method, for people and for the record.
fn method(reconstruction: &Reconstruction<'_>, metric: bool, earlier: Option<&EarlierScene>) -> String {
    let Some(model) = reconstruction.models.first() else {
        return "sfm".to_owned();
    };
    let rejected: usize = agreements(reconstruction).map(|one| one.rejected.len()).sum();
    let scale = match (earlier, metric) {
        (Some(_), _) => "added to the earlier scene".to_owned(),
        (None, true) => format!("in metres by the labels, {rejected} of them outvoted"),
        (None, false) => match labelled(reconstruction, model) {
            0 => "without scale: no labels".to_owned(),
            count => format!("without scale: of {count} labels no half agrees with the photos"),
        },
    };
    format!("sfm: {} lens, {scale}", lens_name(model.lens))
}

fn lens_name(lens: LensModel) -> &'static str {
    match lens {
        LensModel::Pinhole => "pinhole",
        LensModel::SimpleRadial => "simple radial",
        LensModel::Radial => "radial",
        LensModel::OpenCv => "radial and tangential",
    }
}
