//! A set of photos in memory, and the stage run on it.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use marf_cache::{Digest, manifest::Row};
use marf_calibrate::{Calibrate, SplitByPlace};
use marf_scene::{Cahvor, CameraPrior, Photo, PhotoFacts, Scene};
use marf_schema::{
    calibrate::Metrics,
    output::{POINTS, SCENE, TRANSFORMS},
    scenes::Scenes,
};
use marf_stage::{
    COMPANIONS, Cancel, Ctx, Document, Inputs, Outputs, PHOTOS, Stage, StageDef, StageError, Work, define,
    harness::Harness,
};

/// Photos, companions and a store.
#[derive(Clone, Default)]
pub struct Input {
    pub harness: Harness,
    rows: Vec<(u32, Row)>,
    companions: BTreeMap<String, Digest>,
}

/// What came out.
#[derive(Debug)]
pub struct Output {
    pub scene: Scene,
    pub scene_digest: Digest,
    pub metrics: Metrics,
    pub transforms: String,
    /// cameras.bin, images.bin and points3D.bin.
    pub model: [Vec<u8>; 3],
    pub points: Vec<u8>,
}

impl Input {
    pub fn photo(&mut self, id: &str, bytes: &[u8], facts: PhotoFacts) {
        let blobs = BTreeMap::from([("image".to_owned(), self.harness.put(bytes))]);
        let row = Row {
            id: id.to_owned(),
            blobs,
            facts: facts.to_json(),
        };
        self.rows.push((facts.sol.unwrap_or(0), row));
    }

    /// A photo as it decodes, with its notes.
    pub fn decoded(&mut self, file: &str, bytes: &[u8]) {
        let photo = Photo::decode(bytes).unwrap();
        let facts = PhotoFacts {
            file: file.to_owned(),
            width: photo.image.width,
            height: photo.image.height,
            notes: photo.notes,
            ..PhotoFacts::default()
        };
        self.photo(file, bytes, facts);
    }

    /// Makes a photo one that was developed from another file.
    pub fn developed(&mut self, id: &str) {
        let raw = self.harness.put(b"raw numbers");
        let row = self.rows.iter_mut().find(|(_, row)| row.id == id);
        row.unwrap().1.blobs.insert("raw".to_owned(), raw);
    }

    /// A photo without a label.
    pub fn plain(&mut self, file: &str, bytes: &[u8]) {
        let (width, height) = Photo::size_px(bytes).unwrap();
        let facts = PhotoFacts {
            file: file.to_owned(),
            width,
            height,
            ..PhotoFacts::default()
        };
        self.photo(file, bytes, facts);
    }

    /// Turns the label's camera of a photo about the site's vertical, and returns the photo's id.
    pub fn turn_label(&mut self, index: usize, degrees: f64) -> String {
        let (sin, cos) = degrees.to_radians().sin_cos();
        let turn = nalgebra::Matrix3::new(cos, -sin, 0.0, sin, cos, 0.0, 0.0, 0.0, 1.0);
        self.relabel(index, |prior| {
            let pose = prior.site_from_frame.as_mut().unwrap();
            // About the rover's own place, so that the camera turns and moves.
            pose.rotation = turn * pose.rotation;
        });
        self.rows[index].1.id.clone()
    }

    /// Changes the label's camera of a photo and returns the one it had.
    pub fn relabel(&mut self, index: usize, change: impl FnOnce(&mut CameraPrior)) -> CameraPrior {
        let row = &mut self.rows[index].1;
        let mut facts = PhotoFacts::from_json(&row.facts).unwrap();
        let before = facts.prior.clone().unwrap();
        change(facts.prior.as_mut().unwrap());
        row.facts = facts.to_json();
        before
    }

    /// Returns the index of a photo.
    pub fn index_of(&self, id: &str) -> usize {
        self.rows.iter().position(|(_, row)| row.id == id).unwrap()
    }

    /// Gives every photo a label with the place of the rover, and no more than a pinhole of its camera.
    pub fn stand_still(&mut self, place: &[i64]) {
        for (index, (_, row)) in (0..).zip(&mut self.rows) {
            let mut facts = PhotoFacts::from_json(&row.facts).unwrap();
            let focal_px = f64::from(facts.width);
            facts.prior = Some(CameraPrior {
                model: Cahvor {
                    c: [0.0; 3],
                    a: [0.0, 0.0, 1.0],
                    h: [focal_px, 0.0, focal_px / 2.0],
                    v: [0.0, focal_px, f64::from(facts.height) / 2.0],
                    o: None,
                    r: None,
                    e: None,
                },
                frame: "ROVER_NAV_FRAME".to_owned(),
                site_from_frame: None,
                // Behind site, drive and pose: how the mast turned.
                motion_counter: place.iter().copied().chain([index]).collect(),
            });
            row.facts = facts.to_json();
        }
    }

    pub fn companion(&mut self, name: &str, bytes: &[u8]) {
        let digest = self.harness.put(bytes);
        self.companions.insert(name.to_owned(), digest);
    }

    /// Loses every photo, as if the archive were gone.
    pub fn forget_photos(&self) {
        for (_, row) in &self.rows {
            self.harness.forget(&row.blobs["image"]);
        }
    }

    /// Keeps the first photos only, and returns the others.
    pub fn split_off(&mut self, count: usize) -> Vec<(u32, Row)> {
        self.rows.split_off(count)
    }

    pub fn add(&mut self, rows: Vec<(u32, Row)>) {
        self.rows.extend(rows);
    }

    pub fn run(&self, params: &serde_json::Value) -> Result<Output, StageError> {
        self.run_after(params, None)
    }

    /// Runs with an earlier scene of the same node.
    pub fn run_after(
        &self,
        params: &serde_json::Value,
        earlier: Option<Digest>,
    ) -> Result<Output, StageError> {
        const STAGE: StageDef = define::<Calibrate>();
        let stage = (STAGE.bind)(params.clone()).map_err(|error| StageError::new(error.to_string()))?;
        self.run_stage(stage.as_ref(), earlier)
    }

    /// Returns the outputs of a run that is stopped at the given check.
    pub fn run_until(&self, params: &serde_json::Value, checks: u64) -> Result<Outputs, StageError> {
        const STAGE: StageDef = define::<Calibrate>();
        let stage = (STAGE.bind)(params.clone()).map_err(|error| StageError::new(error.to_string()))?;
        let cancel = Cancel::after(checks);
        let ctx = Ctx {
            cancel: &cancel,
            ..self.harness.ctx()
        };
        self.outputs(stage.as_ref(), &ctx, None)
    }

    /// Returns the set of the photos, as a stage reads it.
    pub fn photo_set(&self) -> Digest {
        self.harness.put_set(&self.rows)
    }

    /// Returns the digest of each photo.
    pub fn photos(&self) -> Vec<Digest> {
        self.rows.iter().map(|(_, row)| row.blobs["image"]).collect()
    }

    fn run_stage(&self, stage: &dyn Stage, earlier: Option<Digest>) -> Result<Output, StageError> {
        let outputs = self.outputs(stage, &self.harness.ctx(), earlier)?;
        let get = |name: &str| self.harness.get(&outputs[name]).unwrap();
        Ok(Output {
            scene: Scene::decode(&get(SCENE)).unwrap(),
            scene_digest: outputs[SCENE],
            metrics: serde_json::from_slice(&get(Metrics::OUTPUT)).unwrap(),
            transforms: String::from_utf8(get(TRANSFORMS).to_vec()).unwrap(),
            model: ["cameras", "images", "points3D"]
                .map(|name| get(&format!("sparse/0/{name}.bin")).to_vec()),
            points: get(POINTS).to_vec(),
        })
    }

    /// Runs another stage on the set.
    pub fn outputs_of(&self, stage: &dyn Stage) -> Outputs {
        self.try_outputs_of(stage).unwrap()
    }

    /// As [`Input::outputs_of`], where it may fail.
    pub fn try_outputs_of(&self, stage: &dyn Stage) -> Result<Outputs, StageError> {
        self.outputs(stage, &self.harness.ctx(), None)
    }

    /// Splits the photos by place.
    pub fn split(&self, params: &serde_json::Value) -> Result<(Outputs, Scenes), StageError> {
        const STAGE: StageDef = define::<SplitByPlace>();
        let stage = (STAGE.bind)(params.clone()).map_err(|error| StageError::new(error.to_string()))?;
        let outputs = self.try_outputs_of(stage.as_ref())?;
        let scenes = Scenes::decode(&self.harness.get(&outputs[Scenes::OUTPUT]).unwrap()).unwrap();
        Ok((outputs, scenes))
    }

    fn outputs(
        &self,
        stage: &dyn Stage,
        ctx: &Ctx<'_>,
        earlier: Option<Digest>,
    ) -> Result<Outputs, StageError> {
        let companions = self.harness.put(&serde_json::to_vec(&self.companions).unwrap());
        let mut inputs = Inputs(BTreeMap::from([
            (PHOTOS.to_owned(), self.harness.put_set(&self.rows)),
            (COMPANIONS.to_owned(), companions),
        ]));
        inputs
            .0
            .extend(earlier.map(|scene| (marf_stage::EARLIER.to_owned(), scene)));
        let Work::Set(set) = stage.work() else {
            panic!("calibrate needs all its inputs at once");
        };
        set.run(ctx, &inputs)
    }

    /// The message, cause and hint of a run that must fail.
    pub fn complaint(&self, params: &serde_json::Value) -> String {
        match self.run(params).unwrap_err() {
            StageError::Failed { message, cause, hint } => {
                format!(
                    "{message}\n{}\n{}",
                    cause.unwrap_or_default(),
                    hint.unwrap_or_default()
                )
            }
            other => other.to_string(),
        }
    }
}

/// The folder of real photos, or `None` with a line that says so.
pub fn shared(test: &str) -> Option<PathBuf> {
    let beside = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/data");
    let data = std::env::var("MARF_SHARED_DATA").unwrap_or_else(|_| beside.to_owned());
    let data = PathBuf::from(data);
    if !data.is_dir() {
        println!("skipped: {test} needs ../shared/data");
        return None;
    }
    Some(data)
}

/// All files of a folder below `root`, as plain photos named relative to `root`.
pub fn folder(input: &mut Input, root: &Path, below: &str) {
    let mut names: Vec<String> = std::fs::read_dir(root.join(below))
        .unwrap()
        .map(|entry| format!("{below}/{}", entry.unwrap().file_name().to_string_lossy()))
        .collect();
    names.sort();
    for name in names {
        input.plain(&name, &std::fs::read(root.join(&name)).unwrap());
    }
}
