//! A made-up run for tests: a store in memory and nodes with one output of every kind.

use std::collections::BTreeMap;
use std::sync::Arc;

use marf_cache::Digest;
use marf_cache::manifest::{Leaf, LeafRef, Root, Row};
use marf_field::{Chosen, Config, Facts, Overrides, Sizes};
use marf_scene::{Camera, Frame, Image, PhotoFacts, Point, Pose, Scene, Unplaced, encode_png};
use marf_schema::scores::{PhotoScores, Scores};
use marf_schema::{bootstrap, calibrate, output, train, tune};
use marf_stage::{Document, PHOTOS, VERDICTS, Verdict};
use serde_json::json;

use super::input::{ChildView, NodeView, ReportInput, State};
use super::write;

/// A file name that would run a script if it reached the page as it is.
pub(super) const HOSTILE: &str = "<img src=x onerror=alert(1)>.jpg";
/// Names of the planted photos besides the hostile one.
const NAMES: [&str; 5] = ["a.jpg", "b.jpg", "c.jpg", "d.jpg", "e.jpg"];

/// A store in memory.
#[derive(Default)]
pub(super) struct Store {
    pub(super) blobs: BTreeMap<Digest, Arc<[u8]>>,
}

impl Store {
    pub(super) fn put(&mut self, bytes: &[u8]) -> Digest {
        let digest = Digest::of(bytes);
        self.blobs.insert(digest, bytes.into());
        digest
    }

    /// Stores a document; returns the name of its output with its digest.
    pub(super) fn document<D: Document>(&mut self, document: &D) -> (&'static str, Digest) {
        (D::OUTPUT, self.put(&document.encode().unwrap()))
    }

    pub(super) fn put_picture(&mut self, shade: u8) -> Digest {
        let image = Image::from_fn(24, 16, |x, y| [shade, (x * 10) as u8, (y * 15) as u8]);
        self.put(&encode_png(&image).unwrap())
    }

    pub(super) fn put_photos(&mut self, rows: Vec<Row>) -> Digest {
        let count = rows.len() as u32;
        let leaf = self.put(&Leaf::new(rows).unwrap().encode());
        let leaves = vec![LeafRef {
            shard: 1,
            leaf,
            rows: count,
        }];
        self.put(&Root { leaves }.encode())
    }

    pub(super) fn put_verdicts(&mut self, verdicts: &[Verdict]) -> Digest {
        let lines: Vec<String> = verdicts
            .iter()
            .map(|verdict| serde_json::to_string(verdict).unwrap())
            .collect();
        self.put(lines.join("\n").as_bytes())
    }

    /// Writes the report of these nodes.
    pub(super) fn report(&self, nodes: &[NodeView]) -> String {
        write(&ReportInput {
            pipeline: "made up".to_owned(),
            command: "marf run".to_owned(),
            started: "2026-01-02T03:04:05Z".to_owned(),
            program: "marf 0.1.0".to_owned(),
            nodes: nodes.to_vec(),
            read: &|digest| self.blobs.get(digest).cloned(),
            memos: &marf_stage::harness::Harness::default(),
        })
    }
}

/// A node without outputs that ran for a second.
pub(super) fn node(name: &str, upstream: &[&str]) -> NodeView {
    NodeView {
        name: name.to_owned(),
        stage: name.to_owned(),
        about: format!("does {name}"),
        upstream: upstream
            .iter()
            .map(|from| ("input".to_owned(), (*from).to_owned()))
            .collect(),
        state: State::Ran,
        reason: "no record of this key".to_owned(),
        seconds: Some(1.0),
        params: json!({"seed": 3}),
        outputs: BTreeMap::new(),
        children: Vec::new(),
    }
}

/// A node with outputs.
pub(super) fn giving<const N: usize>(mut node: NodeView, outputs: [(&str, Digest); N]) -> NodeView {
    node.outputs
        .extend(outputs.map(|(name, digest)| (name.to_owned(), digest)));
    node
}

pub(super) fn verdict(id: &str, kind: &str) -> Verdict {
    Verdict {
        id: id.to_owned(),
        file: id.to_owned(),
        verdict: kind.to_owned(),
        score: Some(12.5),
        threshold: Some(20.0),
        twin: None,
        reason: String::new(),
    }
}

pub(super) fn row(store: &mut Store, id: &str, shade: u8) -> Row {
    let facts = PhotoFacts {
        file: id.to_owned(),
        ..PhotoFacts::default()
    };
    Row {
        id: id.to_owned(),
        blobs: BTreeMap::from([("image".to_owned(), store.put_picture(shade))]),
        facts: facts.to_json(),
    }
}

/// A pipeline in which every section has something to show and every text of the outside is hostile.
pub(super) fn full() -> (Store, Vec<NodeView>) {
    let mut store = Store::default();
    let mut nodes = photo_nodes(&mut store);
    nodes.extend(field_nodes(&mut store));
    (store, nodes)
}

fn photo_nodes(store: &mut Store) -> Vec<NodeView> {
    let all: Vec<&str> = NAMES.into_iter().chain([HOSTILE]).collect();
    let rows: Vec<Row> = all
        .iter()
        .zip(10..)
        .map(|(id, shade)| row(store, id, shade))
        .collect();
    let kept: Vec<Row> = rows
        .iter()
        .filter(|row| !["a.jpg", HOSTILE].contains(&row.id.as_str()))
        .cloned()
        .collect();
    let mut seen: Vec<Verdict> = all.iter().map(|id| verdict(id, "keep")).collect();
    seen.push(Verdict {
        reason: format!("{HOSTILE} ends early"),
        ..verdict("broken<b>.jpg", "decode")
    });
    let mut judged: Vec<Verdict> = NAMES[1..].iter().map(|id| verdict(id, "keep")).collect();
    judged.push(Verdict {
        reason: format!("same view as {HOSTILE}"),
        twin: Some(HOSTILE.to_owned()),
        ..verdict("a.jpg", "duplicate")
    });
    judged.push(Verdict {
        reason: "<script>alert(2)</script>".to_owned(),
        ..verdict(HOSTILE, "<b>blur</b>")
    });
    let extract = [
        (PHOTOS, store.put_photos(rows)),
        (VERDICTS, store.put_verdicts(&seen)),
    ];
    let filter = [
        (PHOTOS, store.put_photos(kept)),
        (VERDICTS, store.put_verdicts(&judged)),
    ];
    vec![
        giving(node("extract", &[]), extract),
        giving(node("duplicate", &["extract"]), filter),
    ]
}

fn field_nodes(store: &mut Store) -> Vec<NodeView> {
    let scene = store.put(&scene().encode().unwrap());
    let placed = store.document(&calibration(HOSTILE, 4, 0.4));
    let mut calibrate = giving(
        node("calibrate", &["duplicate"]),
        [(output::SCENE, scene), placed],
    );
    calibrate.state = State::Reused;
    let mut tune = node("tune", &["calibrate"]);
    tune.children = vec![ChildView {
        name: HOSTILE.to_owned(),
        state: State::Ran,
        seconds: None,
    }];
    let mut second = trial(1, 1, 21.0);
    second.params = Overrides([("levels".to_owned(), HOSTILE.into())].into());
    let scatter = tune::Scatter {
        psnr: [20.0, 20.2],
        difference_db: 0.2,
        best_minus_default_db: 1.0,
    };
    let best = tune::BestParams {
        field: second.params.clone(),
    };
    let outputs = [
        store.document(&tune::Trials(vec![trial(0, 2, 20.0), second])),
        store.document(&scatter),
        store.document(&best),
    ];
    let tune = giving(tune, outputs);
    let video = store.put(b"GIF89a-made-up");
    let render = giving(
        node("render", &["train"]),
        [(output::VIDEO, video), ("frames/0001.png", video)],
    );
    let mut last = node("skipped<i>", &["render"]);
    (last.state, last.reason, last.seconds) = (State::Skipped, format!("{HOSTILE} failed"), None);
    vec![
        calibrate,
        tune,
        train(store, scene),
        bootstrap(store),
        render,
        last,
    ]
}

fn train(store: &mut Store, scene: Digest) -> NodeView {
    let metrics = training(Scores {
        psnr: 24.567,
        psnr_paper: Some(23.0),
        ssim: Some(0.81),
        views: vec![PhotoScores {
            id: HOSTILE.to_owned(),
            file: HOSTILE.to_owned(),
            name: "v1".to_owned(),
            psnr: 24.0,
            psnr_paper: None,
            ssim: Some(0.8),
        }],
    });
    let point = |step: u64, loss: f64, psnr: f64| train::CurvePoint {
        step,
        rays: step / 2,
        samples: step * 5,
        loss,
        psnr,
    };
    let curve = train::Curve(vec![point(10, 0.1, 12.0), point(20, 0.01, 20.0)]);
    let outputs = [
        (output::SCENE, scene),
        store.document(&metrics),
        store.document(&curve),
        ("heldout/v1.png", store.put_picture(90)),
        ("photo/v1.png", store.put_picture(100)),
    ];
    giving(node("train", &["calibrate", "tune"]), outputs)
}

fn bootstrap(store: &mut Store) -> NodeView {
    let outputs = [
        store.document(&spread(vec!["v1".to_owned()])),
        ("maps/v1-mean.png", store.put_picture(1)),
        ("maps/v1-std.png", store.put_picture(2)),
        ("maps/v1-depth-std.png", store.put_picture(3)),
    ];
    giving(node("bootstrap", &["calibrate", "tune"]), outputs)
}

/// Metrics of a calibration with one photo in its list.
pub(super) fn calibration(method: &str, registered: usize, error_px: f64) -> calibrate::Metrics {
    let photo = calibrate::PhotoMetrics {
        id: NAMES[0].to_owned(),
        file: NAMES[0].to_owned(),
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
    }
}

/// A trial of eight levels.
pub(super) fn trial(number: u32, rank: u32, psnr: f64) -> tune::Trial {
    tune::Trial {
        trial: number,
        rank,
        psnr,
        psnr_paper: Some(psnr - 1.0),
        ssim: Some(0.7),
        params: Overrides([("levels".to_owned(), 8.into())].into()),
    }
}

/// Metrics of a training of 4,000 steps.
pub(super) fn training(scores: Scores) -> train::Metrics {
    train::Metrics {
        scores,
        steps: 4000,
        rays: 2_048_000,
        samples: 51_234_567,
        loss: 0.0031,
        scale: 4,
        thinned: None,
        seed: 7,
        holdout: train::Holdout::Test,
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
    fn chosen<T>(value: T, reason: &str) -> Chosen<T> {
        let reason = reason.to_owned();
        Chosen { value, reason }
    }
    let trial = marf_field::Trial {
        part: "gain".to_owned(),
        with_db: Some(20.02),
        without_db: Some(20.0),
        parameters: Some(100),
        steps: 500,
        decision: "left out: +0.02 dB".to_owned(),
    };
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
            log2_table: chosen(17, "cells of the surface"),
            halvings: chosen(3, "two pixels"),
        },
        trials: vec![trial],
        parameters: 1_000_000,
        seen_share: 0.5,
        occupied_share: 0.1,
        steps: 4000,
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
        opacity_term: 0.004,
        total_sd: 0.031,
        depth_std: None,
        unseen_share: 0.012,
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
        opacity_term: 0.004,
        total_sd: 0.031,
        depth_std: None,
        unseen_share: 0.012,
        members: (0..5).map(member).collect(),
        heldout: Some(bootstrap::HeldOut {
            mean: photo.clone(),
            psnr_members_mean: 25.0,
            coverage: coverage(0.55, 0.81, 0.9),
            coverage_nominal: coverage(0.68, 0.95, 0.997),
            nll: 0.5,
            calibration: None,
        }),
        views: names.into_iter().map(view).collect(),
    }
}

/// Four cameras on a circle that look at its centre, z up, 2 m a unit.
pub(super) fn scene() -> Scene {
    let eye = |index: usize| [(2.0, 0.0), (0.0, 2.0), (-2.0, 0.0), (0.0, -2.0)][index];
    let pose = |(x, y): (f64, f64)| {
        Pose::from([
            [-y / 2.0, x / 2.0, 0.0, 0.0],
            [0.0, 0.0, -1.0, 1.0],
            [-x / 2.0, -y / 2.0, 0.0, 2.0],
        ])
    };
    let frame = |index: usize| Frame {
        id: NAMES[index].to_owned(),
        file: if index == 0 {
            HOSTILE.to_owned()
        } else {
            NAMES[index].to_owned()
        },
        image: Digest::of(NAMES[index].as_bytes()),
        camera: Camera::pinhole(640, 480, 500.0),
        cam_from_world: pose(eye(index)),
        held_out: index == 3,
        error_px: Some(0.4),
    };
    Scene {
        frames: (0..4).map(frame).collect(),
        unplaced: vec![Unplaced {
            id: HOSTILE.to_owned(),
            reason: "shares <3> matches".to_owned(),
        }],
        points: vec![Point {
            position: [0.1, 0.2, 0.3],
            color: None,
            views: 2,
        }],
        up: Some([0.0, 0.0, 1.0]),
        metres_per_unit: Some(2.0),
        method: "import <x>".to_owned(),
    }
}
