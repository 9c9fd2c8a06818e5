//! Photos as tests of the members that did not draw them.

use marf_cache::{Digest, digest_of};
use marf_field::Field;
use marf_scene::{Image, Srgb, metrics::psnr};
use marf_schema::{bootstrap::OutOfBag, train};
use marf_stage::StageError;
use serde::{Deserialize, Serialize};

use super::normality::mean;
use crate::{
    TrainError, checkpoint::Journal, error::field_failed, photos::PhotoReader, photos::ScaledPhoto,
    split::NamedFrame,
};

/// Longest side of the photos that are compared, pixels.
const SIDE_PX: u32 = 160;

/// PSNR of one photo, dB.
#[derive(Serialize, Deserialize)]
struct BagScores {
    out_of_bag: Option<f64>,
    in_bag: Option<f64>,
}

/// Compares every photo with the mean of the members that did not draw it, and with the mean of those that did.
///
/// `None` if a member has not drawn photos. `identity` identifies the node and its fields.
pub(super) fn out_of_bag(
    identity: Digest,
    members: &[train::Metrics],
    fields: &[Field],
    photos: &PhotoReader<'_>,
    training: &[NamedFrame<'_>],
) -> Result<Option<OutOfBag>, StageError> {
    if members.iter().any(|member| member.drawn.is_none()) {
        return Ok(None);
    }
    let ctx = photos.ctx;
    let mut journal = Journal::new(ctx, "out of bag", digest_of(&(identity, "out of bag")));
    let mut compared = Vec::with_capacity(training.len());
    for (index, named) in training.iter().enumerate() {
        let note = format!("out of bag: {}", named.name);
        ctx.progress.at(index as u64, training.len() as u64, &note);
        compared.push(journal.piece_of(
            |_| true,
            || {
                let photo = photos.read(named.frame)?.without_falloff().thinned_to(SIDE_PX);
                let mean_of = |drew: bool| {
                    let chosen = members
                        .iter()
                        .zip(fields)
                        .filter(|(member, _)| member.has_drawn(&named.frame.id) == drew);
                    mean_psnr(named, &photo, chosen.map(|(_, field)| field))
                };
                Ok(BagScores {
                    out_of_bag: mean_of(false)?,
                    in_bag: mean_of(true)?,
                })
            },
        )?);
    }
    journal.end();
    Ok(summary(&compared))
}

/// Returns the means over photos that at least one member did not draw, or `None` without such a photo.
fn summary(compared: &[BagScores]) -> Option<OutOfBag> {
    let out: Vec<f64> = compared.iter().filter_map(|photo| photo.out_of_bag).collect();
    let both: Vec<f64> = compared
        .iter()
        .filter_map(|photo| photo.out_of_bag.and(photo.in_bag))
        .collect();
    (!out.is_empty()).then(|| OutOfBag {
        photos: out.len() as u64,
        psnr: mean(out.iter().copied()),
        psnr_in_bag: (!both.is_empty()).then(|| mean(both.iter().copied())),
    })
}

/// Returns the PSNR of the mean render of some members, dB, or `None` without members.
fn mean_psnr<'a>(
    named: &NamedFrame<'_>,
    photo: &ScaledPhoto,
    fields: impl Iterator<Item = &'a Field>,
) -> Result<Option<f64>, StageError> {
    let mut sum = vec![[0.0_f64; 3]; photo.image.pixels.len()];
    let mut count = 0_u32;
    for field in fields {
        let render = field
            .render(&photo.camera, &named.frame.cam_from_world)
            .map_err(field_failed)?;
        for (sum, rgb) in sum.iter_mut().zip(&render.rgb) {
            (0..3).for_each(|channel| sum[channel] += f64::from(rgb[channel]));
        }
        count += 1;
    }
    if count == 0 {
        return Ok(None);
    }
    let round = |sum: f64| ((sum / f64::from(count)).clamp(0.0, 1.0) * 255.0 + 0.5) as u8;
    let mean = Image::<Srgb> {
        width: photo.image.width,
        height: photo.image.height,
        pixels: sum.into_iter().map(|rgb| rgb.map(round)).collect(),
    };
    let found = psnr(&mean, &photo.image, &photo.hidden).map_err(|cause| TrainError::Metric {
        id: named.frame.id.clone(),
        cause,
    })?;
    Ok(Some(found))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_photos_that_some_member_did_not_draw_count() {
        let photo = |out_of_bag: Option<f64>, in_bag: Option<f64>| BagScores { out_of_bag, in_bag };
        let all = [
            photo(Some(20.0), Some(24.0)),
            photo(None, Some(30.0)),
            photo(Some(22.0), None),
        ];
        let found = summary(&all).unwrap();
        assert_eq!(
            (found.photos, found.psnr, found.psnr_in_bag),
            (2, 21.0, Some(24.0))
        );
        assert_eq!(summary(&all[1..2]), None);
    }
}
