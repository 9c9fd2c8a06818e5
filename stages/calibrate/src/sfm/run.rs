//! The steps from photos to a calibration.

use marf_schema::calibrate::{CalibrateParams, LensParam, PrincipalPoint};
use marf_sfm::bundle::LensModel;
use marf_sfm::mapper::{
    Intruders, LensChoice, MapOptions, MapperInput, Model, PrincipalPointChoice, Tracks, extend, map,
    remove_intruders,
};
use marf_sfm::metric::{LabelAgreement, align_to_labels};
use marf_sfm::rigs::LabelPose;
use marf_sfm::view_graph::{SharedCamera, refine_focal_lengths};
use marf_stage::{Ctx, Inputs, StageError};

use super::capture_order::capture_order;
use super::compare::{Comparison, choose};
use super::error::failed;
use super::fixed_masks::FixedMasks;
use super::links::PairLinks;
use super::photo_features::{PhotoFeatures, photo_features};
use super::reconstruction::Reconstruction;
use super::{assemble, cameras, earlier};
use crate::calibration::Calibration;
use crate::labels;
use crate::photos::InputPhoto;

/// Returns the cameras of the photos by structure from motion.
pub(crate) fn run(
    ctx: &Ctx<'_>,
    inputs: &Inputs,
    items: &[InputPhoto],
    params: &CalibrateParams,
) -> Result<Calibration, StageError> {
    let candidates = labels::of_one_site(items, params.site);
    let features = photo_features(ctx, inputs, items, &candidates, params)?;
    let (mut shared, views) = cameras::group(items, &features, params);
    let pairs = choose(ctx, &features, &capture_order(items), params)?;
    let comparison = Comparison {
        features: &features,
        views: &views,
        cameras: &shared,
        params,
    };
    let compared = comparison.run(ctx, &pairs)?;
    refine_focal_lengths(&mut shared, &views, &compared);
    let links = PairLinks {
        features: &features,
        views: &views,
        cameras: &shared,
        compared: &compared,
        params,
    };
    let links = links.run(ctx)?;
    let total = features.len() as u64;
    let input = MapperInput {
        views: &views,
        cameras: &shared,
        links: &links,
        tracks: Tracks::build(&views, &links),
        options: options(params, &shared),
        stop: &|| ctx.cancel.is_set(),
        registered: &|count| ctx.progress.at(count as u64, total, "photos placed"),
    };
    let earlier = earlier::load(ctx, inputs, items, &features)?;
    let mut models = match &earlier {
        Some(earlier) => extend(&input, &earlier.known)
            .map_err(failed)?
            .into_iter()
            .collect(),
        None => map(&input).map_err(failed)?,
    };
    let intruders = models.iter_mut().map(|model| remove_intruders(&input, model));
    let intruders: Vec<Intruders> = intruders.collect();
    let metric = match &earlier {
        Some(_) => vec![None; models.len()],
        None => align_all(&input, &mut models, &label_poses(items, &features))?,
    };
    let reconstruction = Reconstruction {
        items,
        features: &features,
        compared: &compared,
        input: &input,
        models: &models,
        intruders: &intruders,
        metric: &metric,
        site: candidates.iter().flatten().find_map(|candidate| candidate.site),
    };
    let mut calibration = assemble::assemble(ctx, &reconstruction, earlier.as_ref(), params)?;
    let masks = FixedMasks {
        ctx,
        inputs,
        reconstruction: &reconstruction,
        candidates: &candidates,
    };
    masks.hide(&mut calibration)?;
    Ok(calibration)
}

/// Aligns each model with the labels of its photos, where enough of them agree.
fn align_all(
    input: &MapperInput<'_>,
    models: &mut [Model],
    labels: &[Option<LabelPose>],
) -> Result<Vec<Option<LabelAgreement>>, StageError> {
    let aligned = models
        .iter_mut()
        .map(|model| align_to_labels(input, model, labels));
    aligned.collect::<Result<_, _>>().map_err(failed)
}

/// Returns the options of the mapper: the automatic ones, or what the parameters ask for.
fn options(params: &CalibrateParams, cameras: &[SharedCamera]) -> MapOptions {
    let automatic = MapOptions::automatic(cameras, params.seed);
    MapOptions {
        lens: match params.lens {
            LensParam::Auto => automatic.lens,
            LensParam::Pinhole => LensChoice::Fixed(LensModel::Pinhole),
            LensParam::SimpleRadial => LensChoice::Fixed(LensModel::SimpleRadial),
            LensParam::Radial => LensChoice::Fixed(LensModel::Radial),
            LensParam::Opencv => LensChoice::Fixed(LensModel::OpenCv),
        },
        principal_point: match params.principal_point {
            PrincipalPoint::Centre => PrincipalPointChoice::Fixed,
            PrincipalPoint::Free => PrincipalPointChoice::Free,
            PrincipalPoint::Auto => automatic.principal_point,
        },
        ..automatic
    }
}

/// Returns the pose of each photo from its label, if it has one of the chosen site.
fn label_poses(items: &[InputPhoto], features: &[PhotoFeatures]) -> Vec<Option<LabelPose>> {
    let labels = items.iter().zip(features).map(|(item, one)| {
        let (_, cam_from_site) = one.row.label?;
        Some(LabelPose {
            cam_from_site,
            motion_counter: item.facts.prior.as_ref()?.motion_counter.clone(),
            instrument: item.facts.instrument.clone().unwrap_or_default(),
        })
    });
    labels.collect()
}
