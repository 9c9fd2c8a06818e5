use std::collections::BTreeMap;

use marf_cache::Digest;
use marf_scene::{Camera, Photo, Point};
use marf_stage::{Ctx, StageError};
use nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;

use super::components;
use super::earlier::Earlier;
use super::reasons::{Cause, cause};
use super::{Outvoted, Solved};
use crate::estimators::Similarity;
use crate::export::{Sight, TrackPoint};
use crate::import::mean_up;
use crate::mapper::{Model, deviations};
use crate::params::CalibrateParams;
use crate::photos::{Calibrated, Found, Placed, as_png, reduction};

/// Turns models into a scene: the largest one, and those that stand in the same site.
pub(super) fn answer(
    ctx: &Ctx<'_>,
    solved: &Solved<'_>,
    earlier: Option<&Earlier>,
    params: &CalibrateParams,
) -> Result<Calibrated, StageError> {
    let metric = solved.metric.first().is_some_and(Option::is_some);
    let together = |index: &usize| *index == 0 || (metric && solved.metric[*index].is_some());
    let chosen: Vec<usize> = (0..solved.models.len()).filter(together).collect();
    let world = world(solved, metric, earlier);
    let mut placed = Vec::new();
    let mut points = Vec::new();
    for &index in &chosen {
        let model = moved(&solved.models[index], &world);
        let outvoted = solved.metric[index].as_deref().unwrap_or_default();
        placed.extend(frames(ctx, solved, &model, outvoted, params)?);
        points.extend(tracks(solved, &model));
    }
    let causes = causes(solved, &chosen);
    let worst = commonest(&causes);
    Ok(Calibrated {
        unplaced: causes
            .into_iter()
            .map(|(photo, cause)| (photo, cause.to_string()))
            .collect(),
        missing: Vec::new(),
        points: points.iter().map(sparse).collect(),
        tracks: points,
        up: match earlier {
            Some(earlier) => earlier.scene.up,
            None if metric => Some([0.0, 0.0, -1.0]),
            None => mean_up(&placed),
        },
        metres_per_unit: match earlier {
            Some(earlier) => earlier.scene.metres_per_unit,
            None => metric.then_some(1.0),
        },
        placed,
        method: method(solved, metric, earlier),
        components: Some(groups(solved)),
        seen: (0..solved.prepared.len())
            .map(|photo| seen(solved, photo))
            .collect(),
        cause: worst
            .as_ref()
            .map(|(count, cause)| format!("{count} photos: {}{}", cause.kind(), cause.place())),
        hint: worst.map_or_else(String::new, |(_, cause)| cause.hint().to_owned()),
    })
}

/// The scene's world: with labels the site with its origin at the median camera, in metres; extended, the
/// earlier one; otherwise the cameras' mean as origin and their mean square distance from it as unit.
fn world(solved: &Solved<'_>, metric: bool, earlier: Option<&Earlier>) -> Similarity {
    let unmoved = Similarity {
        scale: 1.0,
        rotation: Matrix3::identity(),
        translation: Vector3::zeros(),
    };
    let Some(model) = solved.models.first().filter(|_| earlier.is_none()) else {
        return unmoved;
    };
    let centres: Vec<Vector3<f64>> = model.poses.iter().flatten().map(|pose| pose.centre()).collect();
    if metric {
        let median = crate::labels::median(&centres);
        return Similarity {
            translation: -median,
            ..unmoved
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
        ..unmoved
    }
}

fn moved(model: &Model, world: &Similarity) -> Model {
    let mut model = model.clone();
    crate::metric::transform(&mut model, world);
    model
}

fn frames(
    ctx: &Ctx<'_>,
    solved: &Solved<'_>,
    model: &Model,
    outvoted: &[Outvoted],
    params: &CalibrateParams,
) -> Result<Vec<Placed>, StageError> {
    let photos: Vec<usize> = model.photos().collect();
    let deviations = deviations(solved.task, model).unwrap_or_default();
    let frames = photos.into_par_iter().enumerate().map(|(rank, photo)| {
        let outvoted = outvoted.iter().find(|one| one.photo == photo);
        let mut placed = frame(ctx, solved, model, photo, outvoted, params)?;
        placed.found.deviation = deviations.get(rank).copied();
        Ok(placed)
    });
    frames.collect()
}

fn frame(
    ctx: &Ctx<'_>,
    solved: &Solved<'_>,
    model: &Model,
    photo: usize,
    outvoted: Option<&Outvoted>,
    params: &CalibrateParams,
) -> Result<Placed, StageError> {
    let row = &solved.prepared[photo].row;
    let factor = reduction(row.width, row.height, params.longest_side_px);
    let file = row.file.as_ref().unwrap_or(&solved.items[photo].facts.file);
    let (image, file) = match factor {
        1 => (row.image, file.clone()),
        _ => (reduced(ctx, &row.image, file, factor)?, as_png(file)),
    };
    let errors: Vec<f64> = model
        .active_in(solved.task, photo)
        .filter_map(|sight| model.error_px(solved.task, &solved.task.tracks.sights[sight]))
        .collect();
    let mean = errors.iter().sum::<f64>() / errors.len().max(1) as f64;
    Ok(Placed {
        item: photo,
        file,
        image,
        camera: full_size(solved, model, photo).box_reduced(factor),
        cam_from_world: model.poses[photo].unwrap_or_else(marf_scene::Pose::identity),
        held_out: None,
        found: Found {
            inliers: Some(errors.len() as u32),
            error_px: Some(mean * f64::from(row.factor) / f64::from(factor)),
            error_working_px: Some(mean),
            deviation: None,
            note: note(row.note.as_deref(), outvoted),
            ..seen(solved, photo)
        },
    })
}

/// What was found in a photo before any was placed.
fn seen(solved: &Solved<'_>, photo: usize) -> Found {
    Found {
        features: Some(solved.prepared[photo].features.keypoints.len() as u32),
        matches: Some(solved.task.tracks.in_photo(photo).count() as u32),
        ..Found::default()
    }
}

/// What the label said and why it does not count.
fn note(label: Option<&str>, outvoted: Option<&Outvoted>) -> Option<String> {
    let outvoted = outvoted.map(|one| {
        let angle_deg = one.angle_rad.to_degrees();
        format!(
            "label outvoted by the photos: {:.2} m and {angle_deg:.2} degrees off",
            one.distance_m
        )
    });
    outvoted.or_else(|| label.map(str::to_owned))
}

fn reduced(ctx: &Ctx<'_>, image: &Digest, file: &str, factor: u32) -> Result<Digest, StageError> {
    let complain = |error: &dyn std::fmt::Display| StageError::new(format!("photo `{file}`: {error}"));
    let photo = Photo::decode_validated(&ctx.get(image)?).map_err(|error| complain(&error))?;
    let bytes = marf_scene::encode_png(&photo.image.box_reduced(factor)).map_err(|error| complain(&error))?;
    ctx.put(&bytes)
}

/// The model's camera for the whole photo.
fn full_size(solved: &Solved<'_>, model: &Model, photo: usize) -> Camera {
    let row = &solved.prepared[photo].row;
    let camera = &model.cameras[solved.task.views[photo].camera];
    let factor = f64::from(row.factor);
    Camera {
        width: row.width,
        height: row.height,
        fx_px: camera.fx_px * factor,
        fy_px: camera.fy_px * factor,
        cx_px: camera.cx_px * factor,
        cy_px: camera.cy_px * factor,
        ..*camera
    }
}

/// Points with their sights, which name photos by their index in the input set.
fn tracks(solved: &Solved<'_>, model: &Model) -> Vec<TrackPoint> {
    let task = solved.task;
    let points = model.points.iter().enumerate();
    points
        .filter_map(|(track, point)| {
            let position = (*point)?;
            let active = task.tracks.range(track).filter(|&sight| model.active[sight]);
            let seen: Vec<_> = active.map(|sight| task.tracks.sights[sight]).collect();
            let factor = |photo: u32| f64::from(solved.prepared[photo as usize].row.factor);
            let errors = seen
                .iter()
                .filter_map(|sight| Some(model.error_px(task, sight)? * factor(sight.photo)));
            let error_px = errors.sum::<f64>() / seen.len().max(1) as f64;
            let sights = seen.iter().map(|sight| Sight {
                frame: sight.photo,
                pixel: (sight.pixel * factor(sight.photo)).into(),
            });
            let colors = seen
                .iter()
                .map(|sight| solved.prepared[sight.photo as usize].colors[sight.feature as usize]);
            Some(TrackPoint {
                position: position.into(),
                color: mean_color(colors.collect()),
                error_px,
                sights: sights.collect(),
            })
        })
        .collect()
}

fn mean_color(colors: Vec<[u8; 3]>) -> [u8; 3] {
    let count = colors.len().max(1) as u32;
    [0, 1, 2].map(|channel| {
        let sum: u32 = colors.iter().map(|color| u32::from(color[channel])).sum();
        ((sum + count / 2) / count) as u8
    })
}

fn sparse(point: &TrackPoint) -> Point {
    Point {
        position: point.position,
        color: Some(point.color),
        views: point.sights.len() as u32,
    }
}

/// Groups of two and more photos that nothing links.
fn groups(solved: &Solved<'_>) -> usize {
    let component = components(solved.prepared.len(), solved.task.links);
    let mut sizes: BTreeMap<usize, usize> = BTreeMap::new();
    component
        .into_iter()
        .for_each(|rank| *sizes.entry(rank).or_default() += 1);
    sizes.values().filter(|size| **size > 1).count()
}

/// Why each photo that is in none of the chosen models is not.
fn causes(solved: &Solved<'_>, chosen: &[usize]) -> Vec<(usize, Cause)> {
    let component = components(solved.prepared.len(), solved.task.links);
    let placed = |photo: usize| {
        chosen
            .iter()
            .any(|&index| solved.models[index].poses[photo].is_some())
    };
    let left = (0..solved.prepared.len()).filter(|&photo| !placed(photo));
    left.map(|photo| (photo, cause(solved, &component, photo)))
        .collect()
}

/// The kind of cause most photos have, with their number.
fn commonest(causes: &[(usize, Cause)]) -> Option<(usize, Cause)> {
    let mut counts: BTreeMap<&str, (usize, &Cause)> = BTreeMap::new();
    for (_, cause) in causes {
        counts.entry(cause.kind()).or_insert((0, cause)).0 += 1;
    }
    let most = counts.into_values().max_by_key(|(count, _)| *count);
    most.map(|(count, cause)| (count, cause.clone()))
}

/// Photos of the model whose label says where they were taken.
fn labelled(solved: &Solved<'_>, model: &Model) -> usize {
    model
        .photos()
        .filter(|&photo| solved.prepared[photo].row.label.is_some())
        .count()
}

/// What was done, for people and for the record.
fn method(solved: &Solved<'_>, metric: bool, earlier: Option<&Earlier>) -> String {
    let Some(model) = solved.models.first() else {
        return "sfm".to_owned();
    };
    let outvoted: usize = solved.metric.iter().flatten().map(Vec::len).sum();
    let scale = match (earlier, metric) {
        (Some(_), _) => "added to the earlier scene".to_owned(),
        (None, true) => format!("in metres by the labels, {outvoted} of them outvoted"),
        (None, false) => match labelled(solved, model) {
            0 => "without scale: no labels".to_owned(),
            count => format!("without scale: of {count} labels no half agrees with the photos"),
        },
    };
    format!("sfm: {} lens, {scale}", super::lens_name(model.lens))
}
