use serde::{Deserialize, Serialize};

use crate::{
    Calibration, Intervals, Maps, Mode, Norm, Sparsification, calibrate, coverage, nll,
    sparsification::hundredths, sparsify, spearman,
};

/// Output `metrics` of `bootstrap`. Spreads are of sRGB in [0, 1], means over all pixels of all viewpoints.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// Members.
    pub b: u32,
    /// What differs between them.
    pub mode: Mode,
    /// Mean sample standard deviation of gray, divisor B - 1.
    pub std: f64,
    /// The paper's figure: mean standard deviation of gray, divisor B.
    pub std_paper: f64,
    /// Mean sample standard deviation of each channel.
    pub rgb_std: [f64; 3],
    /// Mean opacity term.
    pub opacity_term: f64,
    /// Mean total standard deviation.
    pub total: f64,
    /// Mean sample standard deviation of the depth where it is seen, world units.
    pub depth_std: Option<f64>,
    /// Share of pixels where the mean opacity is at most 0.5.
    pub unseen_share: f64,
    /// The members, in order.
    pub members: Vec<Member>,
    /// What the photos held out say; none where the viewpoints are not photos.
    pub heldout: Option<HeldOut>,
    /// Every viewpoint.
    pub views: Vec<ViewReport>,
}

/// A member, from its own metrics.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Member {
    /// Its seed.
    pub seed: u64,
    /// Factor by which its photos were shrunk.
    pub scale: u32,
    /// Mean PSNR on the photos held out, dB.
    pub psnr: f64,
    /// Mean SSIM on them.
    pub ssim: Option<f64>,
}

/// One viewpoint.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ViewReport {
    /// Name of its maps.
    pub name: String,
    /// Mean sample standard deviation of gray.
    pub std: f64,
    /// The same with divisor B.
    pub std_paper: f64,
    /// Mean opacity term.
    pub opacity_term: f64,
    /// Mean total standard deviation.
    pub total: f64,
    /// Mean standard deviation of the depth where it is seen, world units.
    pub depth_std: Option<f64>,
    /// Share of pixels unseen.
    pub unseen_share: f64,
    /// How well the spread ranks the errors; only where there is a photo.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub photo: Option<PhotoReport>,
}

/// A viewpoint compared with its photo. Errors are |mean gray - gray of the photo|.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PhotoReport {
    /// PSNR of the mean render, dB.
    pub psnr: f64,
    /// Area under the sparsification error by the standard deviation, mean absolute error.
    pub ause_mae: f64,
    /// Of a random order.
    pub ause_mae_random: f64,
    /// Root mean squared error.
    pub ause_rmse: f64,
    /// Of a random order.
    pub ause_rmse_random: f64,
    /// By the total standard deviation, mean absolute error.
    pub ause_mae_total: f64,
    /// Rank correlation of standard deviation and error.
    pub spearman: f64,
}

/// What the photos held out say about the spread.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct HeldOut {
    /// Means of [`PhotoReport`] over photos, `spearman` as the median.
    #[serde(flatten)]
    pub mean: PhotoReport,
    /// Mean of the members' own PSNR, dB: what averaging gains is the difference.
    pub psnr_members: f64,
    /// Share of pixels whose error is at most 1, 2, 3 standard deviations.
    pub coverage: [f64; 3],
    /// What these would be, were the errors normal with that spread.
    pub coverage_nominal: [f64; 3],
    /// Mean negative log-likelihood of the errors, nats, to six decimals.
    pub nll: f64,
    /// Fitted on half of the photos and tested on the other; none with fewer than four.
    pub calibration: Option<Calibration>,
}

/// A viewpoint's maps with the error against its photo, if there is one.
#[derive(Debug)]
pub(crate) struct View {
    pub name: String,
    pub maps: Maps,
    pub truth: Option<Truth>,
}

/// What is known where a photo was held out.
#[derive(Debug)]
pub(crate) struct Truth {
    /// |mean gray - gray of the photo|, a value a pixel.
    pub error: Vec<f32>,
    /// PSNR of the mean render, dB.
    pub psnr: f64,
}

/// Shares of a normal distribution within 1, 2 and 3 standard deviations.
const NOMINAL: [f64; 3] = [0.682_689, 0.954_500, 0.997_300];

pub(crate) fn report(b: u32, mode: Mode, members: Vec<Member>, views: &[View]) -> Report {
    let all = |map: fn(&Maps) -> &[f32]| mean(views.iter().flat_map(|view| map(&view.maps)).copied());
    let channel = |channel: usize| {
        let pixels = views.iter().flat_map(|view| &view.maps.rgb_std);
        mean(pixels.map(|rgb| rgb[channel]))
    };
    let (depth_std, unseen_share) = depth(views.iter().flat_map(|view| &view.maps.depth_std));
    Report {
        b,
        mode,
        std: all(|maps| &maps.std),
        std_paper: all(|maps| &maps.std_paper),
        rgb_std: [0, 1, 2].map(channel),
        opacity_term: all(|maps| &maps.opacity_term),
        total: all(|maps| &maps.total),
        depth_std,
        unseen_share,
        heldout: held_out(views, &members),
        members,
        views: views.iter().map(view_report).collect(),
    }
}

fn view_report(view: &View) -> ViewReport {
    let maps = &view.maps;
    let (depth_std, unseen_share) = depth(maps.depth_std.iter());
    ViewReport {
        name: view.name.clone(),
        std: mean(maps.std.iter().copied()),
        std_paper: mean(maps.std_paper.iter().copied()),
        opacity_term: mean(maps.opacity_term.iter().copied()),
        total: mean(maps.total.iter().copied()),
        depth_std,
        unseen_share,
        photo: view.truth.as_ref().map(|truth| photo_report(maps, truth)),
    }
}

fn photo_report(maps: &Maps, truth: &Truth) -> PhotoReport {
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

fn held_out(views: &[View], members: &[Member]) -> Option<HeldOut> {
    let photos: Vec<PhotoReport> = views.iter().filter_map(|view| view_report(view).photo).collect();
    let intervals: Vec<Intervals<'_>> = views
        .iter()
        .filter_map(|view| {
            let error = &view.truth.as_ref()?.error;
            Some(Intervals {
                std: &view.maps.std,
                error,
            })
        })
        .collect();
    if photos.is_empty() {
        return None;
    }
    let mean_of = |value: fn(&PhotoReport) -> f64| mean(photos.iter().map(value));
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
        psnr_members: mean(members.iter().map(|member| member.psnr)),
        coverage: [1.0, 2.0, 3.0].map(|widths| coverage(&intervals, widths)),
        coverage_nominal: NOMINAL,
        nll: (nll(&intervals, 1.0) * 1e6).round() / 1e6,
        calibration: calibrate(&intervals),
    })
}

/// Mean over the pixels that have a depth, and the share of those that have none.
fn depth<'a>(map: impl Iterator<Item = &'a f32> + Clone) -> (Option<f64>, f64) {
    let count = map.clone().count();
    let seen: Vec<f32> = map.copied().filter(|std| *std >= 0.0).collect();
    let unseen = (count - seen.len()) as f64 / count.max(1) as f64;
    ((!seen.is_empty()).then(|| mean(seen.iter().copied())), unseen)
}

fn mean<T: Into<f64>>(values: impl Iterator<Item = T>) -> f64 {
    let (sum, count) = values.fold((0.0, 0_u64), |(sum, count), value| {
        (sum + value.into(), count + 1)
    });
    sum / count.max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{maps, maps::tests::example};

    fn member(seed: u64) -> Member {
        Member {
            seed,
            scale: 1,
            psnr: 20.0 + seed as f64,
            ssim: None,
        }
    }

    #[test]
    fn a_report_without_photos_has_spreads_and_nothing_more() {
        let view = View {
            name: "0001".into(),
            maps: maps(&example()),
            truth: None,
        };
        let report = report(4, Mode::Seeds, vec![member(0), member(1)], &[view]);
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
            let truth = Truth {
                error: vec![0.0, 0.10, 0.08, 0.19],
                psnr: 21.5,
            };
            View {
                name: format!("{index}"),
                maps: maps(&example()),
                truth: Some(truth),
            }
        };
        let views: Vec<View> = (0..4).map(view).collect();
        let found = report(4, Mode::Seeds, vec![member(0), member(2)], &views)
            .heldout
            .unwrap();
        assert!((found.mean.spearman - 0.4).abs() < 1e-12);
        assert_eq!(found.coverage, [0.25, 0.5, 0.75]);
        assert_eq!(found.psnr_members, 21.0);
        assert!(
            found.mean.ause_mae_total < found.mean.ause_mae,
            "the opacity term puts p4 last"
        );
        let calibration = found.calibration.unwrap();
        assert!((calibration.t - 4.9562).abs() < 1e-4, "{calibration:?}");
        let three = report(4, Mode::Seeds, vec![], &views[..3]).heldout.unwrap();
        assert_eq!(three.calibration, None);
    }
}
