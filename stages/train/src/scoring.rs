use marf_field::{Field, render_in_bands};
use marf_scene::{Image, Srgb, metrics};
use marf_schema::{
    output::{HELDOUT, PHOTO},
    scores::{PhotoScores, Scores},
};
use marf_stage::{Ctx, Outputs, StageError};

use crate::{
    TrainError,
    error::field_failed,
    io::put_png,
    photos::{PhotoReader, ScaledPhoto},
    split::NamedFrame,
};

/// Renders the view of every photo, compares it with the photo and stores both pictures; one photo at a time is in
/// memory.
pub(crate) fn score_views(
    ctx: &Ctx<'_>,
    field: &Field,
    photos: &PhotoReader<'_>,
    frames: &[NamedFrame<'_>],
    outputs: &mut Outputs,
) -> Result<Scores, StageError> {
    let mut views = Vec::with_capacity(frames.len());
    for named in frames {
        let photo = &photos.read(named.frame)?;
        let render = render(ctx, field, named, photo)?;
        views.push(compare(named, &render, &photo.image)?);
        let name = &named.name;
        put_png(ctx, outputs, format!("{HELDOUT}{name}.png"), &render)?;
        put_png(ctx, outputs, format!("{PHOTO}{name}.png"), &photo.image)?;
    }
    Ok(means(views))
}

/// Returns the mean PSNR over photos, dB; nothing is stored.
pub(crate) fn mean_psnr(
    ctx: &Ctx<'_>,
    field: &Field,
    probes: &[(NamedFrame<'_>, ScaledPhoto)],
) -> Result<f64, StageError> {
    let mut sum = 0.0;
    for (named, photo) in probes {
        let render = render(ctx, field, named, photo)?;
        sum += compare(named, &render, &photo.image)?.psnr;
    }
    Ok(sum / probes.len().max(1) as f64)
}

/// Renders the view of a photo.
fn render(
    ctx: &Ctx<'_>,
    field: &Field,
    named: &NamedFrame<'_>,
    photo: &ScaledPhoto,
) -> Result<Image<Srgb>, StageError> {
    let pose = &named.frame.cam_from_world;
    let render = render_in_bands(field, &photo.camera, pose, || ctx.check(), field_failed)?;
    Ok(render.to_image())
}

/// Returns the scores of a render against its photo.
fn compare(
    named: &NamedFrame<'_>,
    render: &Image<Srgb>,
    photo: &Image<Srgb>,
) -> Result<PhotoScores, TrainError> {
    let psnr = metrics::psnr(render, photo).map_err(|cause| TrainError::Metric {
        id: named.frame.id.clone(),
        cause,
    })?;
    Ok(PhotoScores {
        id: named.frame.id.clone(),
        file: named.frame.file.clone(),
        name: named.name.clone(),
        psnr,
        // The sizes agree, or the line above had stopped: what is left is a black or a tiny photo.
        psnr_paper: metrics::psnr_paper(render, photo).ok(),
        ssim: metrics::ssim(render, photo).ok(),
    })
}

/// Returns the means over photos, with each photo's own scores.
fn means(views: Vec<PhotoScores>) -> Scores {
    let mean = |value: fn(&PhotoScores) -> Option<f64>| {
        let values: Vec<f64> = views.iter().filter_map(value).collect();
        (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
    };
    Scores {
        psnr: mean(|view| Some(view.psnr)).unwrap_or_default(),
        psnr_paper: mean(|view| view.psnr_paper),
        ssim: mean(|view| view.ssim),
        views,
    }
}
