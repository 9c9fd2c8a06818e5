//! What the tests share.
#![allow(dead_code, reason = "each test file uses its part")]

use std::path::{Path, PathBuf};

use marf_extract::Extract;
use marf_scene::PhotoFacts;
use marf_stage::harness::Harness;
use marf_stage::{ArchiveContext, Listing, ParamError, Source, Stage, StageError, Verdict, Work, define};

/// Everything an archive brought.
pub struct Brought {
    pub listing: Listing,
    pub rows: Vec<(u32, marf_cache::manifest::Row)>,
    pub verdicts: Vec<Verdict>,
    pub harness: Harness,
}

impl Brought {
    pub fn facts(&self, id: &str) -> PhotoFacts {
        let row = self.rows.iter().find(|(_, row)| row.id == id);
        let row = row.unwrap_or_else(|| panic!("no row `{id}` among {:?}", self.ids()));
        PhotoFacts::from_json(&row.1.facts).unwrap()
    }

    pub fn ids(&self) -> Vec<&str> {
        self.rows.iter().map(|(_, row)| row.id.as_str()).collect()
    }

    pub fn verdict(&self, file: &str) -> &Verdict {
        let verdict = self.verdicts.iter().find(|verdict| verdict.file == file);
        verdict.unwrap_or_else(|| panic!("no verdict of `{file}` among {:#?}", self.verdicts))
    }
}

pub fn stage(archive: serde_json::Value) -> Result<Box<dyn Stage>, ParamError> {
    stage_in(archive, ArchiveContext::default())
}

pub fn stage_in(archive: serde_json::Value, context: ArchiveContext) -> Result<Box<dyn Stage>, ParamError> {
    (define::<Extract>().bind_archive)(serde_json::json!({ "archive": archive }), context)
}

pub fn source(stage: &dyn Stage) -> &dyn Source {
    match stage.work() {
        Work::Source(source) => source,
        _ => panic!("extract is a source"),
    }
}

pub fn bring(archive: serde_json::Value) -> Result<Brought, StageError> {
    let harness = Harness::default();
    let stage = stage(archive).unwrap();
    let source = source(stage.as_ref());
    let listing = source.list(&harness.ctx())?;
    let (mut rows, mut verdicts) = (Vec::new(), Vec::new());
    for shard in &listing.shards {
        let fetched = source.fetch(&harness.ctx(), shard.shard)?;
        rows.extend(fetched.rows.into_iter().map(|row| (shard.shard, row)));
        verdicts.extend(fetched.verdicts);
    }
    Ok(Brought {
        listing,
        rows,
        verdicts,
        harness,
    })
}

pub fn folder(path: &Path) -> serde_json::Value {
    serde_json::json!({"kind": "folder", "path": path})
}

/// The folder of real data, where it is there.
pub fn real(name: &str) -> Option<PathBuf> {
    let root = std::env::var_os("MARF_SHARED_DATA").map_or_else(
        || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data"),
        PathBuf::from,
    );
    let path = root.join(name);
    if !path.is_dir() {
        println!("skipped: {name} needs ../shared/data");
        return None;
    }
    Some(path)
}
