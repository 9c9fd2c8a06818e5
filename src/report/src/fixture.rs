//! A made-up run for tests: a store in memory and nodes with one output of every kind.

use std::collections::BTreeMap;
use std::convert::Infallible;
use std::sync::Arc;

use marf_cache::Digest;
use marf_cache::manifest::{Leaf, LeafRef, Root, Row};
use marf_field::Overrides;
use marf_scene::{Camera, Frame, Image, Nearest, PhotoFacts, Point, Pose, Scene, Unplaced, encode_png};
use marf_schema::scores::{PhotoScores, Scores};
use marf_schema::{output, train, tune};
use marf_stage::{Document, PHOTOS, VERDICTS, Verdict};
use serde_json::json;

use super::fixture_documents::{calibration, spread, training, trial};
use super::input::{ChangedNode, Changes, ChildView, NodeView, ReportInput, State};
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
        let digest = Digest::from_content(bytes);
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
        self.put_leaf(leaf, count)
    }

    /// Stores a set of one leaf.
    fn put_leaf(&mut self, leaf: Digest, rows: u32) -> Digest {
        let leaves = vec![LeafRef { shard: 1, leaf, rows }];
        let Ok(root) = Root { leaves }.write(|bytes| Ok::<_, Infallible>(self.put(bytes)));
        root
    }

    pub(super) fn put_verdicts(&mut self, verdicts: &[Verdict]) -> Digest {
        let lines: Vec<String> = verdicts
            .iter()
            .map(|verdict| serde_json::to_string(verdict).unwrap())
            .collect();
        let leaf = self.put(lines.join("\n").as_bytes());
        self.put_leaf(leaf, verdicts.len() as u32)
    }

    /// Writes the report of these nodes.
    pub(super) fn report(&self, nodes: &[NodeView]) -> String {
        self.with_input(nodes, write)
    }

    /// Does something with the input of a report of these nodes.
    pub(super) fn with_input<T>(&self, nodes: &[NodeView], make: impl FnOnce(&ReportInput<'_>) -> T) -> T {
        make(&ReportInput {
            pipeline: "made up".to_owned(),
            command: "marf run".to_owned(),
            started: "2026-01-02T03:04:05Z".to_owned(),
            program: "marf 0.1.0".to_owned(),
            nodes: nodes.to_vec(),
            whole: None,
            scenes: Vec::new(),
            changes: Some(Changes {
                since: 3,
                nodes: vec![
                    ChangedNode {
                        heading: "blur: 1 products out, 2 outputs differ".to_owned(),
                        lines: vec![format!("product out: {HOSTILE}")],
                    },
                    ChangedNode {
                        heading: "shape: the outputs are equal".to_owned(),
                        lines: Vec::new(),
                    },
                ],
            }),
            trade: Some(super::fixture_documents::trade()),
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
        relax: None,
        upstream: upstream
            .iter()
            .map(|from| ("input".to_owned(), (*from).to_owned()))
            .collect(),
        state: State::Ran,
        of_run: None,
        reason: "no record of this key".to_owned(),
        seconds: Some(1.0),
        training_s: None,
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
        best_psnr: None,
        difference_db: 0.2,
        best_minus_default_db: 1.0,
        chosen: 1,
        decision: "trial 01 is chosen".to_owned(),
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
    let video = store.put(b"\0\0\0\x18ftypisom-made-up");
    let render = giving(
        node("render", &["train"]),
        [("film", video), ("frames/0001.png", video)],
    );
    let film = giving(node("video", &["render"]), [(output::VIDEO, video)]);
    let mut last = node("skipped<i>", &["render"]);
    (last.state, last.reason, last.seconds) = (State::Skipped, format!("{HOSTILE} failed"), None);
    vec![
        calibrate,
        tune,
        train(store, scene),
        bootstrap(store),
        render,
        film,
        last,
    ]
}

fn train(store: &mut Store, scene: Digest) -> NodeView {
    let metrics = training(Scores {
        psnr: 24.567,
        psnr_paper: Some(23.0),
        ssim: Some(0.81),
        views: vec![PhotoScores {
            id: NAMES[3].to_owned(),
            file: HOSTILE.to_owned(),
            name: "v1".to_owned(),
            psnr: 24.0,
            psnr_paper: None,
            ssim: Some(0.8),
            nearest: Some(Nearest {
                id: NAMES[0].to_owned(),
                distance: 1.5,
                distance_m: Some(3.0),
                angle_deg: 90.0,
                uncovered_share: 0.25,
                extrapolates: false,
            }),
        }],
        apart: None,
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
        image: Digest::from_content(NAMES[index].as_bytes()),
        camera: Camera::pinhole(640, 480, 500.0),
        cam_from_world: pose(eye(index)),
        held_out: index == 3,
        mask: None,
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
        site: None,
        metres_per_unit: Some(2.0),
        method: "import <x>".to_owned(),
    }
}
