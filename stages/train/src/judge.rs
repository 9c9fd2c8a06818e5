use std::collections::BTreeMap;

use marf_field::{Field, render_in_bands};
use marf_scene::{Image, Srgb, encode_png, metrics};
use marf_stage::{Ctx, Outputs, StageError};
use serde::{Deserialize, Serialize};

use crate::{
    TrainError,
    error::field_failed,
    split::{Named, Reduced, reduced},
};

/// How well one photo is reproduced.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Scores {
    /// Id of the photo.
    pub id: String,
    /// Its file.
    pub file: String,
    /// Name of its pictures (`heldout/<name>.png`, `photo/<name>.png`).
    pub name: String,
    /// Peak signal-to-noise ratio, peak 1, dB; 100 at most, which equal pictures have.
    pub psnr: f64,
    /// The paper's definition, peak = largest value of the photo, dB; none for a black photo.
    pub psnr_paper: Option<f64>,
    /// Structural similarity, at most 1; none for a photo smaller than its window of 11 pixels.
    pub ssim: Option<f64>,
}

/// Means over photos, and each photo's own.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Metrics {
    /// Mean of [`Scores::psnr`], dB.
    pub psnr: f64,
    /// Mean of [`Scores::psnr_paper`] over the photos that have one, dB.
    pub psnr_paper: Option<f64>,
    /// Mean of [`Scores::ssim`] over the photos that have one.
    pub ssim: Option<f64>,
    /// Every photo.
    pub views: Vec<Scores>,
}

/// Renders every photo's view, compares, and stores both pictures; one photo at a time is in memory.
pub(crate) fn judge(
    ctx: &Ctx<'_>,
    field: &Field,
    frames: &[Named<'_>],
    scale: u32,
    outputs: &mut Outputs,
) -> Result<Metrics, StageError> {
    let mut views = Vec::with_capacity(frames.len());
    for named in frames {
        let photo = &reduced(ctx, named.frame, scale)?;
        let render = render(ctx, field, named, photo)?;
        views.push(scores(named, &render, &photo.image)?);
        let name = &named.name;
        outputs.insert(format!("heldout/{name}.png"), put_png(ctx, &render)?);
        outputs.insert(format!("photo/{name}.png"), put_png(ctx, &photo.image)?);
    }
    Ok(means(views))
}

/// Returns the mean PSNR over photos, dB, without storing anything.
pub(crate) fn mean_psnr(
    ctx: &Ctx<'_>,
    field: &Field,
    probes: &[(Named<'_>, Reduced)],
) -> Result<f64, StageError> {
    let mut sum = 0.0;
    for (named, photo) in probes {
        let render = render(ctx, field, named, photo)?;
        sum += scores(named, &render, &photo.image)?.psnr;
    }
    Ok(sum / probes.len().max(1) as f64)
}

pub(crate) fn put_png(ctx: &Ctx<'_>, image: &Image<Srgb>) -> Result<marf_cache::Digest, StageError> {
    let png = encode_png(image).map_err(|error| StageError::new(error.to_string()))?;
    ctx.put(&png)
}

pub(crate) fn put_json(ctx: &Ctx<'_>, value: &impl Serialize) -> Result<marf_cache::Digest, StageError> {
    let json = serde_json::to_vec(value).map_err(|error| StageError::new(error.to_string()))?;
    ctx.put(&json)
}

fn render(
    ctx: &Ctx<'_>,
    field: &Field,
    named: &Named<'_>,
    photo: &Reduced,
) -> Result<Image<Srgb>, StageError> {
    let pose = &named.frame.cam_from_world;
    let render = render_in_bands(field, &photo.camera, pose, || ctx.check(), field_failed)?;
    Ok(render.to_image())
}

fn scores(named: &Named<'_>, render: &Image<Srgb>, photo: &Image<Srgb>) -> Result<Scores, TrainError> {
    let psnr = metrics::psnr(render, photo).map_err(|cause| TrainError::Metric {
        id: named.frame.id.clone(),
        cause,
    })?;
    Ok(Scores {
        id: named.frame.id.clone(),
        file: named.frame.file.clone(),
        name: named.name.clone(),
        psnr,
        // The sizes agree, or the line above had stopped: what is left is a black or a tiny photo.
        psnr_paper: metrics::psnr_paper(render, photo).ok(),
        ssim: metrics::ssim(render, photo).ok(),
    })
}

fn means(views: Vec<Scores>) -> Metrics {
    let mean = |value: fn(&Scores) -> Option<f64>| {
        let values: Vec<f64> = views.iter().filter_map(value).collect();
        (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
    };
    Metrics {
        psnr: mean(|view| Some(view.psnr)).unwrap_or_default(),
        psnr_paper: mean(|view| view.psnr_paper),
        ssim: mean(|view| view.ssim),
        views,
    }
}

/// Reads a JSON output of an upstream node.
pub(crate) fn get_json<T: serde::de::DeserializeOwned>(
    ctx: &Ctx<'_>,
    name: &str,
    digest: &marf_cache::Digest,
) -> Result<T, StageError> {
    let bytes = ctx.get(digest)?;
    serde_json::from_slice(&bytes).map_err(|error| StageError::new(format!("input `{name}`: {error}")))
}

/// Collects named outputs.
pub(crate) fn outputs<const N: usize>(named: [(&str, marf_cache::Digest); N]) -> Outputs {
    let owned = named.map(|(name, digest)| (name.to_owned(), digest));
    BTreeMap::from(owned)
}
