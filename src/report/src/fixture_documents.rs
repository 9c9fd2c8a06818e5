//! Made-up documents of stages for tests.

use super::fixture::HOSTILE;
use super::trade;
use marf_field::{Choice, Config, Facts, Overrides, Sizes};
use marf_scene::ToneDifference;
use marf_schema::scores::Scores;
use marf_schema::{bootstrap, calibrate, train, tune};

/// Metrics of a calibration with one photo in its list.
pub(super) fn calibration(method: &str, registered: usize, error_px: f64) -> calibrate::Metrics {
    let photo = calibrate::PhotoMetrics {
        id: "a.jpg".to_owned(),
        file: "a.jpg".to_owned(),
        registered: true,
        held_out: false,
        features: Some(900),
        matches: Some(812),
        inliers: Some(640),
        error_px: Some(error_px),
        angle_sigma_deg: None,
        centre_sigma: None,
        note: None,
        reason: String::new(),
    };
    calibrate::Metrics {
        method: method.to_owned(),
        totals: calibrate::Totals {
            photos: registered + 1,
            registered,
            held_out: 1,
            unplaced: 1,
            missing: 0,
            points: 1,
            components: None,
            error_px: Some(error_px),
            error_working_px: None,
        },
        photos: vec![photo],
        missing: Vec::new(),
        up: Some(calibrate::Up {
            source: calibrate::UpSource::Ground,
            sigma_deg: Some(1.25),
        }),
        tie: Some(calibrate::Tie {
            site: 3,
            photos: registered,
            median_m: 0.012,
            largest_m: 0.04,
        }),
        stereo_pairs: Vec::new(),
    }
}

/// A trial of eight levels.
pub(super) fn trial(number: u32, rank: u32, psnr: f64) -> tune::Trial {
    tune::Trial {
        trial: number,
        rank,
        steps: 400,
        judged_px: None,
        psnr,
        psnr_paper: Some(psnr - 1.0),
        ssim: Some(0.7),
        params: Overrides([("levels".to_owned(), 8.into())].into()),
    }
}

/// Metrics of a training of 4,000 steps.
pub(super) fn training(scores: Scores) -> train::Metrics {
    train::Metrics {
        target: None,
        schedule: None,
        scores,
        on_training: Some(train::OnTraining {
            photos: 1,
            psnr: 26.125,
            psnr_paper: None,
            ssim: None,
        }),
        steps: 4000,
        rays: 2_048_000,
        samples: 51_234_567,
        loss: 0.0031,
        scale: 4,
        thinned: None,
        tones: Some(ToneDifference {
            points: 1240,
            spread: 0.34,
            noise: 0.05,
        }),
        vignetting: Vec::new(),
        warm_start: None,
        seed: 7,
        holdout: train::Holdout::Test,
        fold: None,
        judged_scale: None,
        train_photos: 70,
        held_out_photos: 10,
        drawn: None,
        fit: train::Fit::Scene,
        gpu: None,
        config: Config::default(),
        field: facts(),
    }
}

/// Facts of a field with one part that was tried.
pub(super) fn facts() -> Facts {
    fn chosen<T>(value: T, reason: &str) -> Choice<T> {
        let reason = reason.to_owned();
        Choice { value, reason }
    }
    Facts {
        origin: [0.0; 3],
        half_side: 3.5,
        box_reason: "80 % of the points".to_owned(),
        near: 0.9,
        far: 30.0,
        steps_per_ray: 90,
        halvings: 1,
        levels: Vec::new(),
        sizes: Sizes {
            near: chosen(0.25, "half of <that>"),
            far: chosen(8.5, "the farthest point"),
            finest: chosen(512, "two pixels"),
            levels: chosen(8, "by 1.9 a level"),
            surface_cells: chosen(12_345, "points in cells"),
            detail: chosen(0.75, "patches of the photos"),
            log2_table: chosen(17, "cells of the surface"),
            halvings: chosen(3, "two pixels"),
            distortion: chosen([0.0, 0.1], "many photos"),
            depth_steps: chosen(200, "half of them"),
            table_decay: chosen(1e-6, "ten photos"),
        },
        parameters: 1_000_000,
        seen_share: 0.5,
        occupied_share: 0.1,
        steps: 4000,
        transparent_photos: 0,
    }
}

/// Metrics of a bootstrap of five members at these viewpoints.
pub(super) fn spread(names: Vec<String>) -> bootstrap::Metrics {
    let photo = bootstrap::PhotoReport {
        psnr: 25.8,
        ause_mae: 0.29,
        ause_mae_random: 0.65,
        ause_rmse: 0.3,
        ause_rmse_random: 0.7,
        ause_mae_total: 0.31,
        spearman: 0.51,
    };
    let coverage = |sd1: f64, sd2: f64, sd3: f64| bootstrap::Coverage { sd1, sd2, sd3 };
    let view = |name: String| bootstrap::ViewReport {
        name,
        std: 0.0213,
        std_paper: 0.019,
        unseen_term: 0.004,
        total_sd: 0.031,
        depth_std: None,
        unseen_share: 0.012,
        sky_share: 0.2,
        place: Some(0),
        photo: Some(photo.clone()),
    };
    let member = |seed: u64| bootstrap::Member {
        seed,
        scale: 4,
        psnr: 25.0,
        ssim: Some(0.77),
    };
    bootstrap::Metrics {
        b: 5,
        mode: bootstrap::Mode::Seeds,
        std: 0.0213,
        std_paper: 0.019,
        std_rgb: [0.02; 3],
        unseen_term: 0.004,
        total_sd: 0.031,
        depth_std: None,
        unseen_share: 0.012,
        sky_share: 0.2,
        members: (0..5).map(member).collect(),
        out_of_bag: None,
        heldout: Some(bootstrap::HeldOut {
            mean: photo.clone(),
            sparsification: bootstrap::SparsificationCurves {
                removed: vec![0.0, 0.5, 0.95],
                by_std: vec![0.02, 0.012, 0.004],
                by_total: vec![0.02, 0.013, 0.005],
                best: vec![0.02, 0.006, 0.0],
            },
            psnr_members_mean: 25.0,
            coverage: coverage(0.55, 0.81, 0.9),
            coverage_nominal: coverage(0.68, 0.95, 0.997),
            nll: 0.5,
            calibration: Some(intervals(2.0 / 255.0)),
            depth_calibration: Some(intervals(0.004)),
        }),
        views: names.into_iter().map(view).collect(),
    }
}

fn intervals(floor: f64) -> bootstrap::Calibration {
    bootstrap::Calibration {
        floor,
        t: 1.4,
        factor90: 2.6,
        ece: 0.02,
        ece_range: [0.01, 0.04],
        inside: (1..20).map(|share| f64::from(share) * 0.049).collect(),
        coverage90: 18.0 * 0.049,
        coverage90_range: [0.86, 0.93],
        median_error: 2.5 * floor,
        median_half90: 8.0 * floor,
        places: 5,
        views: 10,
        errors: 12_345,
        unseen_share: 0.012,
        note: "only 5 places were held out: a new one may be unlike them".to_owned(),
    }
}

/// A trade of three settings. One of them could not be trained.
pub(super) fn trade() -> trade::Trade {
    let run = |psnr, seconds| trade::PointRun {
        seed: 0,
        judged_by: None,
        judged_scale: 4,
        psnr,
        ssim: Some(0.7),
        seconds,
        calibrate_s: 1.0,
        train_s: seconds - 3.0,
        placed: 9,
        error_px: None,
        steps: 400,
        parameters: 100_000,
        bytes: 400_000,
        peak_mb: 300,
    };
    let point = |sets: &[&str], runs: &[trade::PointRun], fault: Option<&str>| trade::Point {
        sets: sets.iter().map(|set| (*set).to_owned()).collect(),
        runs: runs.to_vec(),
        fault: fault.map(str::to_owned),
    };
    let interval = |mean| trade::Interval {
        mean,
        half: Some(0.1),
    };
    trade::Trade {
        pipeline: "made up".to_owned(),
        machine: "a processor, 2 cores".to_owned(),
        program: "marf 0.1.0".to_owned(),
        points: vec![
            point(&[], &[run(24.0, 20.0)], None),
            point(&["train.scale=2"], &[run(23.1, 9.0)], None),
            point(&["train.scale=99"], &[], Some(HOSTILE)),
        ],
        effects: vec![trade::Effect {
            point: 1,
            gain_db: interval(-0.9),
            time: interval(0.45),
        }],
        front: vec![1, 0],
    }
}
