use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use marf_cache::Digest;
use marf_field::{Field, Gain};
use marf_scene::{Image, Srgb, TrainedPhotos, metrics};
use marf_schema::{
    output::{HELDOUT, PHOTO},
    scores::{Apart, PhotoScores, Scores},
    train::OnTraining,
};
use marf_stage::{Ctx, Outputs, StageError};
use serde::{Deserialize, Serialize};

use crate::{
    TrainError,
    checkpoint::Journal,
    depth_views::depth_view,
    error::field_failed,
    io::put_png,
    photos::{PhotoReader, ScaledPhoto},
    split::{NamedFrame, spread_order},
    view::render_view,
};

/// Which photos of those held out are judged.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct JudgedPhotos {
    /// Most photos to judge. `None` means all.
    pub most: Option<usize>,
    /// As many as are judged by then, but [`JudgedPhotos::LEAST`] at least.
    pub until: Option<Instant>,
}

impl JudgedPhotos {
    /// All of them.
    pub const ALL: Self = Self {
        most: None,
        until: None,
    };
    /// Photos that are judged whatever time it takes.
    pub const LEAST: usize = 4;

    /// Returns their indices among `count`. Any number of the first ones is spread over all.
    fn order(self, count: usize) -> Vec<usize> {
        match self {
            Self::ALL => (0..count).collect(),
            Self { most, .. } => {
                let mut order = spread_order(count);
                order.truncate(most.unwrap_or(count));
                order
            }
        }
    }

    /// Returns whether the photos judged so far are enough, where another may take `longest`.
    fn is_enough(self, judged: usize, longest: Duration) -> bool {
        let is_over = |until| Instant::now() + longest > until;
        judged >= Self::LEAST && self.until.is_some_and(is_over)
    }
}

/// A photo that was compared, as a journal keeps it.
#[derive(Serialize, Deserialize)]
struct PhotoJudgement {
    scores: PhotoScores,
    /// Render and photo, by the names of the outputs.
    pictures: BTreeMap<String, Digest>,
}

/// Compares a field with photos, one at a time. Photos that an unfinished run has compared are not rendered again.
pub(crate) struct Judge<'a> {
    ctx: &'a Ctx<'a>,
    field: &'a Field,
    photos: &'a PhotoReader<'a>,
    journal: Journal<'a>,
}

impl<'a> Judge<'a> {
    /// Returns the judge of a field. `of` identifies the node and its field.
    pub fn new(ctx: &'a Ctx<'a>, of: Digest, field: &'a Field, photos: &'a PhotoReader<'a>) -> Self {
        Self {
            ctx,
            field,
            photos,
            journal: Journal::new(ctx, "judging", of),
        }
    }

    /// Renders the views of the chosen photos, compares each with its photo and stores both pictures. `trained` are the photos that the
    /// field was trained on.
    pub fn held_out(
        &mut self,
        frames: &[NamedFrame<'_>],
        photos: JudgedPhotos,
        trained: &TrainedPhotos<'_>,
        outputs: &mut Outputs,
    ) -> Result<Scores, StageError> {
        let mut views = BTreeMap::new();
        let mut longest = Duration::ZERO;
        for index in photos.order(frames.len()) {
            if photos.is_enough(views.len(), longest) {
                break;
            }
            let (named, began) = (&frames[index], Instant::now());
            self.at(views.len(), frames.len(), named);
            let judged = self.judged(|judge| {
                let view = depth_view(judge.field, judge.photos, named.frame)?;
                let mut judged = judge.stored(named)?;
                judged.scores.nearest = trained.nearest(named.frame.into(), &view);
                Ok(judged)
            })?;
            outputs.extend(judged.pictures);
            views.insert(index, judged.scores);
            longest = longest.max(began.elapsed());
        }
        Ok(means(views.into_values().collect()))
    }

    /// Compares the field with photos that it was trained on. Stores no picture.
    pub fn on_training(&mut self, frames: &[NamedFrame<'_>]) -> Result<OnTraining, StageError> {
        let mut views = Vec::with_capacity(frames.len());
        for (index, named) in frames.iter().enumerate() {
            self.at(index, frames.len(), named);
            let judged = self.judged(|judge| {
                Ok(PhotoJudgement {
                    scores: compare_view(judge.field, named, &judge.photos.read(named.frame)?)?,
                    pictures: BTreeMap::new(),
                })
            })?;
            views.push(judged.scores);
        }
        let Scores {
            psnr,
            psnr_paper,
            ssim,
            views,
            ..
        } = means(views);
        Ok(OnTraining {
            photos: views.len() as u64,
            psnr,
            psnr_paper,
            ssim,
        })
    }

    fn at(&self, index: usize, count: usize, named: &NamedFrame<'_>) {
        let note = format!("judging {}", named.name);
        self.ctx.progress.at(index as u64, count as u64, &note);
    }

    /// Returns how a photo was judged before, or judges it.
    fn judged(
        &mut self,
        judge: impl FnOnce(&PhotoJudge<'_>) -> Result<PhotoJudgement, StageError>,
    ) -> Result<PhotoJudgement, StageError> {
        let judging = PhotoJudge {
            ctx: self.ctx,
            field: self.field,
            photos: self.photos,
        };
        self.journal.piece(
            |bytes| known(judging.ctx, bytes),
            || {
                let judged = judge(&judging)?;
                let bytes = serde_json::to_vec(&judged);
                Ok((judged, bytes.map_err(|error| StageError::new(error.to_string()))?))
            },
        )
    }
}

/// Reads a photo that was compared, if its pictures are still stored.
fn known(ctx: &Ctx<'_>, bytes: &[u8]) -> Option<PhotoJudgement> {
    let judged: PhotoJudgement = serde_json::from_slice(bytes).ok()?;
    let stored = judged.pictures.values().all(|digest| ctx.blobs.contains(digest));
    stored.then_some(judged)
}

/// What a photo is judged with.
struct PhotoJudge<'a> {
    ctx: &'a Ctx<'a>,
    field: &'a Field,
    photos: &'a PhotoReader<'a>,
}

impl PhotoJudge<'_> {
    /// Compares one photo with the render of its view, and stores both pictures without vignetting.
    fn stored(&self, named: &NamedFrame<'_>) -> Result<PhotoJudgement, StageError> {
        let photo = self.photos.read(named.frame)?;
        let pose = &named.frame.cam_from_world;
        let render = render_view(self.ctx, self.field, &photo.camera, pose)?.to_image();
        let mut scores = compare(named, &render, &photo)?;
        if self.field.config().gain != Gain::Off {
            scores.psnr_affine =
                metrics::psnr_affine(&photo.with_falloff(&render), &photo.image, &photo.hidden).ok();
        }
        let (name, mut pictures) = (&named.name, BTreeMap::new());
        put_png(self.ctx, &mut pictures, format!("{HELDOUT}{name}.png"), &render)?;
        let image = &photo.without_falloff().image;
        put_png(self.ctx, &mut pictures, format!("{PHOTO}{name}.png"), image)?;
        Ok(PhotoJudgement { scores, pictures })
    }
}

/// Returns the mean PSNR over small photos, dB. Stores nothing.
pub(crate) fn mean_psnr(
    ctx: &Ctx<'_>,
    field: &Field,
    probes: &[(NamedFrame<'_>, ScaledPhoto)],
) -> Result<f64, StageError> {
    let mut sum = 0.0;
    for (named, photo) in probes {
        ctx.check()?;
        sum += compare_view(field, named, photo)?.psnr;
    }
    Ok(sum / probes.len().max(1) as f64)
}

/// Renders the view of a photo and compares both.
fn compare_view(
    field: &Field,
    named: &NamedFrame<'_>,
    photo: &ScaledPhoto,
) -> Result<PhotoScores, StageError> {
    let render = field.render(&photo.camera, &named.frame.cam_from_world);
    let picture = render.map_err(field_failed)?.to_image();
    Ok(compare(named, &picture, photo)?)
}

/// Returns the scores of a render, as the photo's camera shows it, against its photo, without what its mask hides.
fn compare(
    named: &NamedFrame<'_>,
    render: &Image<Srgb>,
    photo: &ScaledPhoto,
) -> Result<PhotoScores, TrainError> {
    let render = &*photo.with_falloff(render);
    let (photo, hidden) = (&photo.image, photo.hidden.as_slice());
    let psnr = metrics::psnr(render, photo, hidden).map_err(|cause| TrainError::Metric {
        id: named.frame.id.clone(),
        cause,
    })?;
    Ok(PhotoScores {
        id: named.frame.id.clone(),
        file: named.frame.file.clone(),
        name: named.name.clone(),
        psnr,
        psnr_affine: None,
        // The sizes agree, or the line above had stopped. This fails only for a black or a tiny photo, or a mask with small holes.
        psnr_paper: metrics::psnr_paper(render, photo, hidden).ok(),
        ssim: metrics::ssim(render, photo, hidden).ok(),
        nearest: None,
    })
}

/// Returns the means over photos, with each photo's own scores.
pub(crate) fn means(views: Vec<PhotoScores>) -> Scores {
    let mean = |value: fn(&PhotoScores) -> Option<f64>| {
        let values: Vec<f64> = views.iter().filter_map(value).collect();
        (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
    };
    Scores {
        psnr: mean(|view| Some(view.psnr)).unwrap_or_default(),
        psnr_affine: mean(|view| view.psnr_affine),
        psnr_paper: mean(|view| view.psnr_paper),
        ssim: mean(|view| view.ssim),
        apart: apart(&views),
        views,
    }
}

/// Returns the means of photos that extrapolate and of those that do not, or `None` if no photo extrapolates.
fn apart(views: &[PhotoScores]) -> Option<Apart> {
    let extrapolates =
        |view: &&PhotoScores| view.nearest.as_ref().is_some_and(|nearest| nearest.extrapolates);
    let (far, others): (Vec<_>, Vec<_>) = views.iter().partition(extrapolates);
    let mean = |views: &[&PhotoScores]| {
        let sum: f64 = views.iter().map(|view| view.psnr).sum();
        (!views.is_empty()).then(|| sum / views.len() as f64)
    };
    Some(Apart {
        extrapolated: far.len() as u64,
        psnr_extrapolated: mean(&far)?,
        psnr_others: mean(&others),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use marf_scene::Nearest;
    use marf_schema::example;

    #[test]
    fn a_time_that_is_over_lets_a_few_photos_be_judged_and_a_number_the_first_of_an_order() {
        let most = JudgedPhotos {
            most: Some(3),
            ..JudgedPhotos::ALL
        };
        assert_eq!(most.order(8), [0, 4, 2]);
        assert_eq!(
            (most.order(2), JudgedPhotos::ALL.order(3)),
            (vec![0, 1], vec![0, 1, 2])
        );
        assert!(!most.is_enough(99, Duration::MAX / 4));
        let hour = Duration::from_secs(3600);
        let until = JudgedPhotos {
            until: Some(Instant::now() + hour),
            ..JudgedPhotos::ALL
        };
        assert!(!until.is_enough(4, hour / 2));
        assert!(until.is_enough(4, hour));
        assert!(!until.is_enough(3, hour));
    }

    #[test]
    fn photos_that_extrapolate_have_a_mean_of_their_own() {
        let view = |psnr: f64, extrapolates: bool| PhotoScores {
            psnr,
            nearest: Some(Nearest {
                id: "0".to_owned(),
                distance: 1.0,
                distance_m: None,
                angle_deg: 0.0,
                uncovered_share: 0.0,
                extrapolates,
            }),
            ..example::scores().views.remove(0)
        };
        assert_eq!(means(vec![view(20.0, false)]).apart, None);
        let apart = means(vec![view(20.0, false), view(10.0, true), view(12.0, true)]).apart;
        let apart = apart.unwrap();
        assert_eq!((apart.extrapolated, apart.psnr_extrapolated), (2, 11.0));
        assert_eq!(apart.psnr_others, Some(20.0));
        assert_eq!(means(vec![view(9.0, true)]).apart.unwrap().psnr_others, None);
    }
}
