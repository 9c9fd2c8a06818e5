use marf_numeric::lower_median;
use marf_schema::bootstrap::{
    Coverage, HeldOut, Member, Metrics, Mode, PhotoReport, SparsificationCurves, ViewReport,
};

use super::{
    intervals::{DEPTH_FLOORS, Errors, GRAY_FLOORS, calibrate},
    normality::mean,
    study::{HeldOutStudy, ViewStudy},
};

/// Shares of a normal distribution within 1, 2 and 3 standard deviations.
const NOMINAL: Coverage = Coverage {
    sd1: 0.682_689,
    sd2: 0.954_500,
    sd3: 0.997_300,
};

/// Returns the metrics of a bootstrap: means over all pixels of all viewpoints.
pub(crate) fn report(mode: Mode, members: Vec<Member>, views: &[ViewStudy]) -> Metrics {
    let pixels: Vec<f64> = views.iter().map(|view| view.pixels).collect();
    let all = |value: &dyn Fn(&ViewStudy) -> f64| weighted(views.iter().map(value), &pixels);
    let depth_pixels: Vec<f64> = views.iter().map(|view| view.depth_pixels).collect();
    let depth_std = weighted(
        views.iter().map(|view| view.report.depth_std.unwrap_or(0.0)),
        &depth_pixels,
    );
    Metrics {
        b: members.len() as u32,
        mode,
        std: all(&|view| view.report.std),
        std_paper: all(&|view| view.report.std_paper),
        std_rgb: [0, 1, 2].map(|channel| all(&|view| view.rgb_std[channel])),
        unseen_term: all(&|view| view.report.unseen_term),
        total_sd: all(&|view| view.report.total_sd),
        depth_std: (depth_pixels.iter().sum::<f64>() > 0.0).then_some(depth_std),
        unseen_share: all(&|view| view.report.unseen_share),
        sky_share: all(&|view| view.report.sky_share),
        heldout: held_out(views, &members),
        out_of_bag: None,
        members,
        views: views
            .iter()
            .map(|view| view.report.clone())
            .collect::<Vec<ViewReport>>(),
    }
}

/// Returns the mean of values with weights, 0 where all weights are.
fn weighted(values: impl Iterator<Item = f64>, weights: &[f64]) -> f64 {
    let sum: f64 = values.zip(weights).map(|(value, weight)| value * weight).sum();
    sum / weights.iter().sum::<f64>().max(1.0)
}

/// Returns the figures over all held-out photos, or `None` without any.
fn held_out(views: &[ViewStudy], members: &[Member]) -> Option<HeldOut> {
    let photos: Vec<&PhotoReport> = views
        .iter()
        .filter_map(|view| view.report.photo.as_ref())
        .collect();
    let studies: Vec<(&HeldOutStudy, f64)> = views
        .iter()
        .filter_map(|view| Some((view.held_out.as_ref()?, view.pixels)))
        .collect();
    if photos.is_empty() {
        return None;
    }
    let mean_of = |value: fn(&PhotoReport) -> f64| mean(photos.iter().map(|photo| value(photo)));
    let pixels: Vec<f64> = studies.iter().map(|(_, pixels)| *pixels).collect();
    let over_pixels =
        |value: fn(&HeldOutStudy) -> f64| weighted(studies.iter().map(|(study, _)| value(study)), &pixels);
    let errors = |of_study: fn(&HeldOutStudy) -> &Errors| -> Vec<Errors> {
        studies.iter().map(|(study, _)| of_study(study).clone()).collect()
    };
    let spearman = lower_median(photos.iter().map(|photo| photo.spearman));
    Some(HeldOut {
        mean: PhotoReport {
            psnr: mean_of(|photo| photo.psnr),
            ause_mae: mean_of(|photo| photo.ause_mae),
            ause_mae_random: mean_of(|photo| photo.ause_mae_random),
            ause_rmse: mean_of(|photo| photo.ause_rmse),
            ause_rmse_random: mean_of(|photo| photo.ause_rmse_random),
            ause_mae_total: mean_of(|photo| photo.ause_mae_total),
            spearman: spearman.unwrap_or(0.0),
        },
        sparsification: mean_curves(&studies),
        psnr_members_mean: mean(members.iter().map(|member| member.psnr)),
        coverage: Coverage {
            sd1: over_pixels(|study| study.coverage.sd1),
            sd2: over_pixels(|study| study.coverage.sd2),
            sd3: over_pixels(|study| study.coverage.sd3),
        },
        coverage_nominal: NOMINAL,
        nll: (over_pixels(|study| study.nll) * 1e6).round() / 1e6,
        calibration: calibrate(&errors(|study| &study.gray), &GRAY_FLOORS),
        depth_calibration: calibrate(&errors(|study| &study.depth), &DEPTH_FLOORS),
    })
}

/// Returns the means of curves over photos.
fn mean_curves(studies: &[(&HeldOutStudy, f64)]) -> SparsificationCurves {
    let removed = studies
        .first()
        .map_or(Vec::new(), |(study, _)| study.curves.removed.clone());
    let mean_of = |curve: fn(&SparsificationCurves) -> &Vec<f64>| {
        let at = |index: usize| mean(studies.iter().map(|(study, _)| curve(&study.curves)[index]));
        (0..removed.len()).map(at).collect()
    };
    SparsificationCurves {
        by_std: mean_of(|curves| &curves.by_std),
        by_total: mean_of(|curves| &curves.by_total),
        best: mean_of(|curves| &curves.best),
        removed,
    }
}

#[cfg(test)]
mod tests {
    use super::super::maps::tests::{example, maps_of};
    use super::super::study::{Truth, study};
    use super::*;
    use marf_scene::{Camera, Image, Pose, path::Viewpoint};

    fn member(seed: u64) -> Member {
        Member {
            seed,
            scale: 1,
            psnr: 20.0 + seed as f64,
            ssim: None,
        }
    }

    fn place() -> Viewpoint {
        Viewpoint {
            name: "0001".into(),
            camera: Camera::pinhole(4, 1, 4.0),
            cam_from_world: Pose::identity(),
        }
    }

    #[test]
    fn a_report_without_photos_has_spreads_and_nothing_more() {
        let view = study(&place(), &maps_of(&example()), None, &[]).unwrap();
        let report = report(Mode::Seeds, vec![member(0), member(1)], &[view]);
        assert_eq!(report.heldout, None);
        assert!(
            (report.std_paper - 0.027_311).abs() < 6e-7,
            "{}",
            report.std_paper
        );
        assert_eq!(report.unseen_share, 0.25);
        let sum: f64 = report.std_rgb.iter().sum();
        assert!((sum / 3.0 - report.std).abs() < 1e-6, "gray colours");
    }

    #[test]
    fn larger_views_weigh_more_and_those_without_depth_nothing() {
        let mut views: Vec<ViewStudy> = (0..2)
            .map(|_| study(&place(), &maps_of(&example()), None, &[]).unwrap())
            .collect();
        (views[1].pixels, views[1].report.std) = (12.0, 1.0);
        (views[1].depth_pixels, views[1].report.depth_std) = (0.0, None);
        let one = views[0].report.clone();
        let report = report(Mode::Seeds, vec![], &views);
        assert!((report.std - (one.std + 3.0) / 4.0).abs() < 1e-12);
        assert_eq!(report.depth_std, one.depth_std);
    }

    #[test]
    fn photos_give_order_and_coverage() {
        let photo = Image {
            width: 4,
            height: 1,
            pixels: vec![[128; 3], [77; 3], [184; 3], [153; 3]],
        };
        let view = |number: usize| {
            let truth = Truth {
                photo: &photo,
                hidden: &[],
                place: number,
            };
            study(&place(), &maps_of(&example()), Some(&truth), &[]).unwrap()
        };
        let views: Vec<ViewStudy> = (0..4).map(view).collect();
        let found = report(Mode::Seeds, vec![member(0), member(2)], &views)
            .heldout
            .unwrap();
        assert!((found.mean.spearman - 0.4).abs() < 1e-12);
        let Coverage { sd1, sd2, sd3 } = found.coverage;
        assert_eq!([sd1, sd2, sd3], [0.25, 0.5, 0.75]);
        assert_eq!(found.psnr_members_mean, 21.0);
        let curves = &found.sparsification;
        assert_eq!((curves.removed.len(), curves.removed[19]), (20, 0.95));
        // All photos are the same: their mean is each of them. Without three of four pixels the least error is left.
        let close = |found: f64, expected: f64| (found - expected).abs() < 2e-3;
        assert!(
            close(curves.best[0], 0.0925) && close(curves.by_std[0], 0.0925),
            "{curves:?}"
        );
        assert!(close(curves.best[15], 0.0), "{curves:?}");
        assert!(
            curves
                .best
                .iter()
                .zip(&curves.by_std)
                .all(|(best, by)| best <= by)
        );
        assert_eq!(
            (found.calibration, found.depth_calibration),
            (None, None),
            "twelve errors"
        );
    }
}
