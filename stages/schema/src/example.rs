//! Outputs with invented numbers, for tests of code that reads outputs.

use marf_field::{Choice, Config, Facts, Sizes};

use crate::{
    scores::{PhotoScores, Scores},
    train::{self, Fit, Holdout},
};

/// Returns metrics of a training with seed 0 on two photos. One of them is held out.
pub fn train_metrics() -> train::Metrics {
    train::Metrics {
        scores: scores(),
        on_training: None,
        target: None,
        steps: 400,
        schedule: None,
        rays: 409_600,
        samples: 8_192_000,
        loss: 0.0031,
        scale: 1,
        thinned: None,
        tones: None,
        vignetting: Vec::new(),
        warm_start: None,
        seed: 0,
        holdout: Holdout::Test,
        fold: None,
        judged_scale: None,
        train_photos: 1,
        held_out_photos: 1,
        drawn: None,
        fit: Fit::Scene,
        gpu: None,
        config: Config::default(),
        field: facts(&Config::default()),
    }
}

/// Returns the scores of one photo, `0001.png`.
pub fn scores() -> Scores {
    let photo = PhotoScores {
        id: "0001".to_owned(),
        file: "0001.png".to_owned(),
        name: "0001".to_owned(),
        psnr: 20.0,
        psnr_affine: None,
        psnr_paper: Some(19.0),
        ssim: Some(0.75),
        nearest: None,
    };
    Scores {
        psnr: photo.psnr,
        psnr_affine: None,
        psnr_paper: photo.psnr_paper,
        ssim: photo.ssim,
        apart: None,
        views: vec![photo],
    }
}

fn facts(config: &Config) -> Facts {
    Facts {
        origin: [0.0; 3],
        half_side: 1.0,
        box_reason: "invented".to_owned(),
        near: 0.1,
        far: 8.0,
        steps_per_ray: 256,
        halvings: 0,
        levels: Vec::new(),
        sizes: Sizes {
            near: chosen(0.1),
            far: chosen(8.0),
            finest: chosen(1024),
            levels: chosen(config.levels.unwrap_or(8)),
            surface_cells: chosen(100_000),
            detail: chosen(1.0),
            log2_table: chosen(config.log2_table.unwrap_or(15)),
            halvings: chosen(0),
            distortion: chosen([0.0; 2]),
            depth_steps: chosen(200),
            table_decay: chosen(0.0),
        },
        parameters: 1_000_000,
        seen_share: 0.5,
        occupied_share: 0.25,
        steps: 400,
        transparent_photos: 0,
    }
}

fn chosen<T>(value: T) -> Choice<T> {
    Choice {
        value,
        reason: "invented".to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bootstrap::{self, Mode};
    use marf_stage::Document;

    /// Returns metrics of two members without held-out photos.
    fn bootstrap_metrics() -> bootstrap::Metrics {
        let view = bootstrap::ViewReport {
            name: "0001".to_owned(),
            std: 0.02,
            std_paper: 0.014,
            unseen_term: 0.01,
            total_sd: 0.03,
            depth_std: Some(0.5),
            unseen_share: 0.1,
            sky_share: 0.2,
            place: None,
            photo: None,
        };
        let member = |seed| bootstrap::Member {
            seed,
            scale: 1,
            psnr: 20.0,
            ssim: None,
        };
        bootstrap::Metrics {
            b: 2,
            mode: Mode::Seeds,
            std: view.std,
            std_paper: view.std_paper,
            std_rgb: [view.std; 3],
            unseen_term: view.unseen_term,
            total_sd: view.total_sd,
            depth_std: view.depth_std,
            unseen_share: view.unseen_share,
            sky_share: view.sky_share,
            members: vec![member(0), member(1)],
            out_of_bag: None,
            heldout: None,
            views: vec![view],
        }
    }

    #[test]
    fn examples_survive_their_bytes() {
        let train = train_metrics();
        let bytes = train.encode().unwrap();
        assert!(bytes.starts_with(br#"{"psnr":20.0,"psnr_paper":19.0,"ssim":0.75,"views":[{"#));
        assert_eq!(train::Metrics::decode(&bytes).unwrap(), train);
        let bootstrap = bootstrap_metrics();
        let bytes = bootstrap.encode().unwrap();
        assert_eq!(bootstrap::Metrics::decode(&bytes).unwrap(), bootstrap);
    }
}
