//! A run of one filter without an engine.
#![allow(dead_code, reason = "each test binary uses its own part")]
#![allow(
    clippy::unwrap_used,
    reason = "helpers of tests: a fixture that is wrong should stop the test"
)]

use std::collections::BTreeMap;

use image::ImageFormat;
use marf_cache::manifest::Row;
use marf_filter::STAGES;
use marf_scene::{Image, Photo, PhotoFacts};
use marf_stage::{
    Measure, Measured, Stage, StageDef, StageError, Verdict, Work,
    harness::{Harness, decide},
};
use serde_json::{Value, json};

pub use pictures::*;

mod pictures;

/// A set of photos under test.
#[derive(Default)]
pub struct Photos {
    pub harness: Harness,
    pub rows: Vec<Row>,
}

impl Photos {
    /// Adds a photo with the facts an archive would give.
    pub fn add(&mut self, id: &str, bytes: &[u8]) -> &mut Self {
        self.add_with(id, bytes, |_| {})
    }

    /// Adds a photo with the facts an archive would give, changed by `change`.
    pub fn add_with(&mut self, id: &str, bytes: &[u8], change: impl FnOnce(&mut PhotoFacts)) -> &mut Self {
        let decoded = Photo::decode(bytes).ok();
        let (width, height) = decoded
            .as_ref()
            .map_or((0, 0), |photo| (photo.image.width, photo.image.height));
        let mut facts = PhotoFacts {
            file: format!("{id}.file"),
            size_bytes: bytes.len() as u64,
            width,
            height,
            bands: decoded.map_or(0, |photo| photo.bands),
            ..PhotoFacts::default()
        };
        change(&mut facts);
        let blobs = BTreeMap::from([("image".to_owned(), self.harness.put(bytes))]);
        self.rows.push(Row {
            id: id.to_owned(),
            blobs,
            facts: facts.to_json(),
        });
        self
    }

    /// Returns the measures of all photos for the table of a filter. Empty ones without a table.
    pub fn measures(&self, stage: &dyn Stage) -> Vec<Vec<u8>> {
        let measure = measure_of(stage);
        let Some(table) = measure.table() else {
            return vec![Vec::new(); self.rows.len()];
        };
        let measured = |row| measure.measure(&self.harness.ctx(), row, &[table]).unwrap();
        self.rows.iter().flat_map(measured).collect()
    }

    /// Runs one filter over all photos as one sol, and returns the verdicts by photo.
    pub fn judge(&self, name: &str, params: Value) -> BTreeMap<String, Verdict> {
        let stage = bind(name, params);
        let measures = self.measures(&*stage);
        let items: Vec<_> = (0..self.rows.len())
            .map(|at| item(0, &self.rows[at], &measures[at]))
            .collect();
        by_id(self.decide(&*stage, &items))
    }
}

impl Photos {
    /// Returns the verdicts of a filter on one sol, or its error.
    pub fn try_decide(&self, stage: &dyn Stage, items: &[Measured<'_>]) -> Result<Vec<Verdict>, StageError> {
        match stage.work() {
            Work::Map(map) => Ok(decide(map, &[items.to_vec()])?.concat()),
            Work::Fold(fold) => Ok(fold.begin().fold(&self.harness.ctx(), items)?.1),
            _ => panic!("a filter is a map or a fold"),
        }
    }

    /// Returns the verdicts of a filter on one sol.
    pub fn decide(&self, stage: &dyn Stage, items: &[Measured<'_>]) -> Vec<Verdict> {
        self.try_decide(stage, items).unwrap()
    }
}

/// Returns a photo with its measure.
pub fn item<'a>(shard: u32, row: &'a Row, measure: &'a [u8]) -> Measured<'a> {
    Measured { shard, row, measure }
}

/// Returns the verdicts by photo.
pub fn by_id(verdicts: Vec<Verdict>) -> BTreeMap<String, Verdict> {
    verdicts
        .into_iter()
        .map(|verdict| (verdict.id.clone(), verdict))
        .collect()
}

/// Returns the row of a filter in the table.
pub fn stage(name: &str) -> &'static StageDef {
    STAGES.iter().find(|stage| stage.name == name).unwrap()
}

/// Returns the names of the filters that measure pixels.
pub fn pixel_filters() -> Vec<&'static str> {
    let names = STAGES.iter().map(|stage| stage.name);
    names
        .filter(|name| measure_of(&*bind(name, defaults())).table().is_some())
        .collect()
}

/// Returns a filter with these parameters.
pub fn bind(name: &str, params: Value) -> Box<dyn Stage> {
    (stage(name).bind)(params).unwrap()
}

/// Returns the measuring half of a filter.
pub fn measure_of(stage: &dyn Stage) -> &dyn Measure {
    match stage.work() {
        Work::Map(map) => map,
        Work::Fold(fold) => fold,
        _ => panic!("a filter is a map or a fold"),
    }
}

/// Returns six places, each once, and flawed photos and copies.
pub fn mixed() -> Photos {
    let lost = ground(12);
    let mut photos = Photos::default();
    for seed in 0..6 {
        photos.add(&format!("place-{seed}"), &png(&ground(seed)));
    }
    photos
        .add("copy-of-1", &jpeg(&dynamic(&ground(1)), 80))
        .add("red-of-2", &png(&narrow(&ground(2), 0, [1.0, 0.55, 0.35])))
        .add("smeared", &png(&smeared(&ground(10), 15)))
        .add(
            "gray",
            &encoded(&dynamic(&ground(11)).to_luma8().into(), ImageFormat::Png),
        )
        .add(
            "half-black",
            &png(&Image::from_fn(320, 240, |x, y| {
                if y < 80 { lost.at(x, y) } else { [0; 3] }
            })),
        )
        .add("cut", &jpeg(&dynamic(&ground(13)), 90)[..9000]);
    photos
}

/// Returns no parameters: those of the filter are used.
pub fn defaults() -> Value {
    json!({})
}
