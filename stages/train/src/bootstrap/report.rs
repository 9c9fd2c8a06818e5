use marf_schema::bootstrap::{Coverage, HeldOut, Member, Metrics, Mode, PhotoReport, ViewReport};
use marf_stage::{Ctx, StageError};

use super::{
    calibration::{PixelErrors, calibrate, coverage, mean, nll},
    maps::Maps,
    sparsification::{Norm, Sparsification, hundredths, sparsify, spearman},
};

/// A viewpoint's maps with the error against its photo, if there is one.
#[derive(Debug)]
pub(crate) struct ViewMaps {
    pub name: String,
    pub maps: Maps,
    pub truth: Option<GroundTruth>,
}

/// The error of the mean render against a photo that was held out.
#[derive(Debug)]
pub(crate) struct GroundTruth {
    /// |mean gray - gray of the photo|, a value a pixel.
    pub error: Vec<f32>,
    /// PSNR of the mean render, dB.
    pub psnr: f64,
}

/// Shares of a normal distribution within 1, 2 and 3 standard deviations.
const NOMINAL: Coverage = Coverage {
    sd1: 0.682_689,
    sd2: 0.954_500,
    sd3: 0.997_300,
};

/// Returns the metrics of a bootstrap.
///
/// # Errors
/// A request to stop.
pub(crate) fn report(
    ctx: &Ctx<'_>,
    b: u32,
    mode: Mode,
    members: Vec<Member>,
    views: &[ViewMaps],
) -> Result<Metrics, StageError> {
    let all = |map: fn(&Maps) -> &[f32]| mean(views.iter().flat_map(|view| map(&view.maps)).copied());
    let channel = |channel: usize| {
        let pixels = views.iter().flat_map(|view| &view.maps.rgb_std);
        mean(pixels.map(|rgb| rgb[channel]))
    };
    let (depth_std, unseen_share) = depth(views.iter().flat_map(|view| &view.maps.depth_std));
    let reports = views.iter().map(|view| {
        ctx.check()?;
        Ok(view_report(view))
    });
    let reports = reports.collect::<Result<Vec<ViewReport>, StageError>>()?;
    Ok(Metrics {
        b,
        mode,
        std: all(|maps| &maps.std),
        std_paper: all(|maps| &maps.std_paper),
        std_rgb: [0, 1, 2].map(channel),
        opacity_term: all(|maps| &maps.opacity_term),
        total_sd: all(|maps| &maps.total),
        depth_std,
        unseen_share,
        heldout: held_out(views, &reports, &members),
        members,
        views: reports,
    })
}

/// Returns the figures of one viewpoint.
fn view_report(view: &ViewMaps) -> ViewReport {
    let maps = &view.maps;
    let (depth_std, unseen_share) = depth(maps.depth_std.iter());
    ViewReport {
        name: view.name.clone(),
        std: mean(maps.std.iter().copied()),
        std_paper: mean(maps.std_paper.iter().copied()),
        opacity_term: mean(maps.opacity_term.iter().copied()),
        total_sd: mean(maps.total.iter().copied()),
        depth_std,
        unseen_share,
        photo: view.truth.as_ref().map(|truth| photo_report(maps, truth)),
    }
}

/// Returns how well the spread ranks the errors against a photo.
fn photo_report(maps: &Maps, truth: &GroundTruth) -> PhotoReport {
    let removed = hundredths();
    let by = |map: &[f32], norm| -> Sparsification { sparsify(map, &truth.error, &removed, norm) };
    let (mae, rmse) = (by(&maps.std, Norm::Mae), by(&maps.std, Norm::Rmse));
    PhotoReport {
        psnr: truth.psnr,
        ause_mae: mae.ause,
        ause_mae_random: mae.ause_random,
        ause_rmse: rmse.ause,
        ause_rmse_random: rmse.ause_random,
        ause_mae_total: by(&maps.total, Norm::Mae).ause,
        spearman: spearman(&maps.std, &truth.error),
    }
}

/// Returns the figures over all held-out photos; `None` where there are none.
fn held_out(views: &[ViewMaps], reports: &[ViewReport], members: &[Member]) -> Option<HeldOut> {
    let photos: Vec<&PhotoReport> = reports.iter().filter_map(|view| view.photo.as_ref()).collect();
    let errors: Vec<PixelErrors<'_>> = views
        .iter()
        .filter_map(|view| {
            let error = &view.truth.as_ref()?.error;
            Some(PixelErrors {
                std: &view.maps.std,
                error,
            })
        })
        .collect();
    if photos.is_empty() {
        return None;
    }
    let mean_of = |value: fn(&PhotoReport) -> f64| mean(photos.iter().map(|photo| value(photo)));
    let mut ranks: Vec<f64> = photos.iter().map(|photo| photo.spearman).collect();
    ranks.sort_unstable_by(f64::total_cmp);
    Some(HeldOut {
        mean: PhotoReport {
            psnr: mean_of(|photo| photo.psnr),
            ause_mae: mean_of(|photo| photo.ause_mae),
            ause_mae_random: mean_of(|photo| photo.ause_mae_random),
            ause_rmse: mean_of(|photo| photo.ause_rmse),
            ause_rmse_random: mean_of(|photo| photo.ause_rmse_random),
            ause_mae_total: mean_of(|photo| photo.ause_mae_total),
            spearman: ranks[(ranks.len() - 1) / 2],
        },
        psnr_members_mean: mean(members.iter().map(|member| member.psnr)),
        coverage: Coverage {
            sd1: coverage(&errors, 1.0),
            sd2: coverage(&errors, 2.0),
            sd3: coverage(&errors, 3.0),
        },
        coverage_nominal: NOMINAL,
        nll: (nll(&errors, 1.0) * 1e6).round() / 1e6,
        calibration: calibrate(&errors),
    })
}

/// Returns the mean over the pixels that have a depth, and the share of those that have none.
fn depth<'a>(map: impl Iterator<Item = &'a f32> + Clone) -> (Option<f64>, f64) {
    let count = map.clone().count();
    let seen: Vec<f32> = map.copied().filter(|std| *std >= 0.0).collect();
    let unseen = (count - seen.len()) as f64 / count.max(1) as f64;
    ((!seen.is_empty()).then(|| mean(seen.iter().copied())), unseen)
}

#[cfg(test)]
mod tests {
    use super::super::maps::tests::{example, maps_of};
    use super::*;

    fn member(seed: u64) -> Member {
        Member {
            seed,
            scale: 1,
            psnr: 20.0 + seed as f64,
            ssim: None,
        }
    }

    fn report_of(mode: Mode, members: Vec<Member>, views: &[ViewMaps]) -> Metrics {
        let harness = marf_stage::harness::Harness::default();
        report(&harness.ctx(), 4, mode, members, views).unwrap()
    }

    #[test]
    fn a_report_without_photos_has_spreads_and_nothing_more() {
        let view = ViewMaps {
            name: "0001".into(),
            maps: maps_of(&example()),
            truth: None,
        };
        let report = report_of(Mode::Seeds, vec![member(0), member(1)], &[view]);
        assert_eq!(report.heldout, None);
        assert!(
            (report.std_paper - 0.027_311).abs() < 6e-7,
            "{}",
            report.std_paper
        );
        assert_eq!(report.unseen_share, 0.25);
        assert!((report.std / report.std_paper - (4.0_f64 / 3.0).sqrt()).abs() < 1e-6);
    }

    #[test]
    fn photos_give_order_coverage_and_calibration() {
        let view = |index: usize| {
            let truth = GroundTruth {
                error: vec![0.0, 0.10, 0.08, 0.19],
                psnr: 21.5,
            };
            ViewMaps {
                name: format!("{index}"),
                maps: maps_of(&example()),
                truth: Some(truth),
            }
        };
        let views: Vec<ViewMaps> = (0..4).map(view).collect();
        let found = report_of(Mode::Seeds, vec![member(0), member(2)], &views)
            .heldout
            .unwrap();
        assert!((found.mean.spearman - 0.4).abs() < 1e-12);
        let Coverage { sd1, sd2, sd3 } = found.coverage;
        assert_eq!([sd1, sd2, sd3], [0.25, 0.5, 0.75]);
        assert_eq!(found.psnr_members_mean, 21.0);
        assert!(
            found.mean.ause_mae_total < found.mean.ause_mae,
            "the opacity term puts p4 last"
        );
        let calibration = found.calibration.unwrap();
        assert!((calibration.t - 4.9562).abs() < 1e-4, "{calibration:?}");
        let three = report_of(Mode::Seeds, vec![], &views[..3]).heldout.unwrap();
        assert_eq!(three.calibration, None);
    }
}
