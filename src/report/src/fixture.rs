//! A made-up run for tests: a store in memory and nodes with one output of every kind.

use std::collections::BTreeMap;
use std::convert::Infallible;
use std::sync::{Arc, LazyLock};

use marf_cache::manifest::{Leaf, LeafRef, Root, Row};
use marf_cache::{Digest, Output};
use marf_engine::{Edge, NodeRun, NodeState, RUN_FORMAT, RunRecord};
use marf_field::Overrides;
use marf_model::{Run, RunNode};
use marf_scene::{Camera, Frame, Image, Nearest, PhotoFacts, Point, Pose, Scene, Unplaced, encode_png};
use marf_schema::scores::{PhotoScores, Scores};
use marf_schema::{output, train, tune};
use marf_stage::{Document, PHOTOS, VERDICTS, Verdict};
use serde_json::{Value, json};

use super::fixture_documents::{calibration, spread, training, trial};
use super::report::{ChangedNode, Changes, Report};
use super::write;

/// A file name that would run a script if it reached the page as it is.
pub(super) const HOSTILE: &str = "<img src=x onerror=alert(1)>.jpg";
/// Names of the planted photos besides the hostile one.
const NAMES: [&str; 5] = ["a.jpg", "b.jpg", "c.jpg", "d.jpg", "e.jpg"];

/// A store in memory.
#[derive(Default)]
pub(super) struct Store {
    pub(super) blobs: BTreeMap<Digest, Arc<[u8]>>,
    /// Parameters by node. Other nodes get a seed.
    pub(super) params: BTreeMap<String, Value>,
}

/// A store on disk without objects.
static EMPTY: LazyLock<(tempfile::TempDir, marf_cache::Store)> = LazyLock::new(|| {
    let dir = tempfile::tempdir().unwrap();
    let store = marf_cache::Store::open(dir.path().join("store")).unwrap();
    (dir, store)
});

/// Returns a run without nodes.
fn record() -> RunRecord {
    let record = json!({
        "format": RUN_FORMAT, "id": "a", "source": {"kind": "pipeline", "file": "p.toml"}, "pipeline": "made up",
        "command": "marf run", "program": "marf 0.1.0", "started_unix_s": 0, "seconds": 1.0, "outcome": "done",
        "digest": Digest::from_content(b""), "threads": 1, "nodes": [], "latest": {},
    });
    serde_json::from_value(record).unwrap()
}

/// Returns a run of these nodes.
pub(super) fn run(nodes: &[RunNode]) -> Run<'static> {
    let mut run = Run::new(&EMPTY.1, record()).unwrap();
    run.nodes = nodes.to_vec();
    run
}

impl Store {
    pub(super) fn put(&mut self, bytes: &[u8]) -> Digest {
        let digest = Digest::from_content(bytes);
        self.blobs.insert(digest, bytes.into());
        digest
    }

    /// Stores a document and returns the name of its output with its digest.
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
    pub(super) fn report(&self, nodes: &[RunNode]) -> String {
        self.with_report(nodes, write)
    }

    /// Does something with the report of these nodes.
    pub(super) fn with_report<T>(&self, nodes: &[RunNode], make: impl FnOnce(&Report<'_>) -> T) -> T {
        self.with_report_of(&run(nodes), make)
    }

    /// Does something with the report of a run.
    pub(super) fn with_report_of<T>(&self, run: &Run<'_>, make: impl FnOnce(&Report<'_>) -> T) -> T {
        let mut params = self.params.clone();
        for node in &run.nodes {
            params
                .entry(node.run.name.clone())
                .or_insert_with(|| json!({"seed": 3}));
        }
        make(&Report {
            run,
            started: "2026-01-02T03:04:05Z".to_owned(),
            scene: None,
            nodes: run.nodes.iter().filter(|node| !node.is_child()).collect(),
            scenes: Vec::new(),
            params: &params,
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
pub(super) fn node(name: &str, upstream: &[&str]) -> RunNode {
    let edge = |from: &&str| Edge {
        key: "input".to_owned(),
        upstream: (*from).to_owned(),
        part: None,
    };
    RunNode {
        run: NodeRun {
            name: name.to_owned(),
            stage: name.to_owned(),
            parent: None,
            edges: upstream.iter().map(edge).collect(),
            inputs: BTreeMap::new(),
            key: None,
            state: NodeState::Finished,
            reason: "no record of this key".to_owned(),
            cause: None,
            hint: None,
            seconds: 1.0,
            started_unix_s: None,
            outputs: BTreeMap::new(),
            counts: BTreeMap::new(),
        },
        of_run: None,
        worked_s: Some(1.0),
        action: None,
        record: None,
    }
}

/// A child node of another one.
pub(super) fn child(parent: &RunNode, name: &str, state: NodeState, worked_s: Option<f64>) -> RunNode {
    let mut child = node(name, &[]);
    child.run.parent = Some(parent.run.name.clone());
    (child.run.state, child.worked_s) = (state, worked_s);
    child
}

/// A node with outputs.
pub(super) fn giving<const N: usize>(mut node: RunNode, outputs: [(&str, Digest); N]) -> RunNode {
    let output = |digest| Output { digest, bytes: 1 };
    let outputs = outputs.map(|(name, digest)| (name.to_owned(), output(digest)));
    node.run.outputs.extend(outputs);
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
pub(super) fn full() -> (Store, Vec<RunNode>) {
    let mut store = Store::default();
    let mut nodes = photo_nodes(&mut store);
    nodes.extend(field_nodes(&mut store));
    (store, nodes)
}

fn photo_nodes(store: &mut Store) -> Vec<RunNode> {
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

fn field_nodes(store: &mut Store) -> Vec<RunNode> {
    let scene = store.put(&scene().encode().unwrap());
    let placed = store.document(&calibration(HOSTILE, 4, 0.4));
    let mut calibrate = giving(
        node("calibrate", &["duplicate"]),
        [(output::SCENE, scene), placed],
    );
    calibrate.run.state = NodeState::Reused;
    let tune = node("tune", &["calibrate"]);
    let trial_node = child(&tune, HOSTILE, NodeState::Finished, None);
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
    last.run.state = NodeState::Skipped;
    (last.run.reason, last.worked_s) = (format!("{HOSTILE} failed"), None);
    vec![
        calibrate,
        tune,
        trial_node,
        train(store, scene),
        bootstrap(store),
        render,
        film,
        last,
    ]
}

fn train(store: &mut Store, scene: Digest) -> RunNode {
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

fn bootstrap(store: &mut Store) -> RunNode {
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
