//! Archives over the network, against a server that plays one: the built-in Mars in the folders of Mars 2020.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "a test that cannot go on should stop"
)]

mod bundle;
mod check;
#[path = "../common/mod.rs"]
mod common;
mod curiosity;
mod feed;
mod lock;
mod offline;
mod pds;
mod questions;
mod sentences;
mod trees;

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::{Arc, LazyLock, Mutex};

use common::{real, source, stage_in};
use marf_demo::{Demo, DemoFile, DemoOptions};
use marf_loopback::{Reply, Server};
use marf_stage::harness::Harness;
use marf_stage::{Access, ArchiveContext, Listing, Stage, StageError, Verdict};
use serde_json::{Value, json};

const BROWSE: &str = "/img/data/mars2020/mars2020_mastcamz_ops_raw/browse/sol";
const DATA: &str = "/img/data/mars2020/mars2020_mastcamz_ops_raw/data/sol";
const BELOW: &str = "ids/edr/zcam";

/// Puts the built-in Mars of these sols into the archive and returns the names of its pictures.
fn mount(server: &Server, sols: impl IntoIterator<Item = u32>) -> BTreeSet<String> {
    let mut names = BTreeSet::new();
    for sol in sols {
        for file in drawn(sol).iter().cloned() {
            let name = file.name.rsplit('/').next().unwrap().to_owned();
            match name.rsplit_once('.').unwrap() {
                (_, "xml") => server.file(&format!("{DATA}/{sol:05}/{BELOW}/{name}"), file.bytes),
                (stem, _) if stem.len() == 54 => {
                    // The archive's browse pictures are PNG. A name decides nothing about the bytes.
                    let name = format!("{stem}.png");
                    server.file(&format!("{BROWSE}/{sol:05}/{BELOW}/{name}"), file.bytes);
                    names.insert(name);
                }
                _ => {}
            }
        }
    }
    names
}

type Sols = BTreeMap<u32, Arc<[DemoFile]>>;

/// The files of a sol, drawn once for all tests.
fn drawn(sol: u32) -> Arc<[DemoFile]> {
    static DRAWN: LazyLock<(Demo, Mutex<Sols>)> = LazyLock::new(|| {
        let options = DemoOptions {
            width_px: 24,
            height_px: 18,
            seed: 1,
        };
        (Demo::new(options).unwrap(), Mutex::default())
    });
    let mut drawn = DRAWN.1.lock().unwrap();
    let draw = || DRAWN.0.files(sol, &|_, _| {}, &|| false).unwrap().into();
    Arc::clone(drawn.entry(sol).or_insert_with(draw))
}

/// One pipeline's folder: lock, scratch and store.
struct Place {
    dir: tempfile::TempDir,
    harness: Harness,
}

impl Place {
    fn new() -> Self {
        let dir = tempfile::tempdir().unwrap();
        let mut harness = Harness::default();
        harness.scratch = dir.path().join("scratch");
        Self { dir, harness }
    }

    fn archive(&self, server: &Server, sols: &str) -> Archive {
        let table = json!({
            "kind": "pds", "mission": "perseverance", "instrument": "mastcam-z", "sols": sols,
            "base": [server.url("/img/data")],
            "network": {"delay_ms": 0, "retry_ms": 1, "stall_s": 1},
        });
        self.named("jezero", table)
    }

    fn feed(&self, server: &Server, sols: &str) -> Archive {
        let table = json!({
            "kind": "feed", "mission": "perseverance", "instrument": "navcam", "sols": sols,
            "base": [server.origin()],
            "network": {"delay_ms": 0, "retry_ms": 1, "stall_s": 1},
        });
        self.named("raws", table)
    }

    fn named(&self, name: &str, table: Value) -> Archive {
        let context = ArchiveContext {
            name: name.to_owned(),
            folder: self.dir.path().to_owned(),
            lock: Some(self.dir.path().join("marf.lock")),
            access: Access::Online,
            ..ArchiveContext::default()
        };
        Archive { table, context }
    }

    fn list(&self, archive: &Archive) -> Result<Listing, StageError> {
        let stage = archive.stage();
        source(stage.as_ref()).list(&self.harness.ctx())
    }

    fn bring(&self, archive: &Archive) -> Result<Brought, StageError> {
        let stage = archive.stage();
        let source = source(stage.as_ref());
        let mut listing = source.list(&self.harness.ctx())?;
        let mut brought = Brought::default();
        for shard in &mut listing.shards {
            let fetched = source.fetch(&self.harness.ctx(), shard.shard)?;
            // What came is known now, and a result is kept under it.
            shard.fingerprint = fetched.fingerprint.unwrap_or(shard.fingerprint);
            brought.warnings.extend(fetched.warnings);
            let mut rows = fetched.rows;
            rows.sort_by(|a, b| a.id.cmp(&b.id));
            for row in rows {
                let blobs = row.blobs.iter().map(|(name, blob)| format!("{name} {blob}"));
                brought
                    .rows
                    .insert(row.id.clone(), blobs.collect::<Vec<_>>().join(" "));
                brought.facts.insert(row.id, row.facts);
            }
            brought.verdicts.extend(fetched.verdicts);
        }
        // The note counts files to fetch, not files present.
        brought.listing = Listing {
            note: None,
            ..listing
        };
        Ok(brought)
    }

    /// The files of marf.lock by their paths in it.
    fn lock(&self) -> BTreeMap<String, String> {
        let root = self.dir.path().join("marf.lock");
        let mut files = BTreeMap::new();
        for folder in subfolders(&root).into_iter().chain([root.clone()]) {
            for path in std::fs::read_dir(folder)
                .into_iter()
                .flatten()
                .map(|entry| entry.unwrap().path())
            {
                if path.is_file() {
                    let name = path.strip_prefix(&root).unwrap().to_string_lossy().into_owned();
                    files.insert(name, std::fs::read_to_string(path).unwrap());
                }
            }
        }
        files
    }

    /// Takes the lock of another place.
    fn take_lock(&self, files: &BTreeMap<String, String>) {
        for (name, text) in files {
            let path = self.dir.path().join("marf.lock").join(name);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, text).unwrap();
        }
    }

    fn lock_says(&self, part: &str) -> bool {
        self.lock().values().any(|text| text.contains(part))
    }

    /// Asserts that the folder holds nothing but the scratch and the files of marf.lock.
    fn holds_only_lock(&self) {
        for entry in std::fs::read_dir(self.dir.path()).unwrap() {
            let name = entry.unwrap().file_name();
            assert!(name == "scratch" || name == "marf.lock", "{name:?}");
        }
        for path in self.lock().keys() {
            let name = path.rsplit('/').next().unwrap();
            let known = ["README", "archive.toml"].contains(&name);
            assert!(
                known || (name.starts_with("sol-") && name.ends_with(".toml")),
                "{path}"
            );
        }
    }
}

fn subfolders(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).into_iter().flatten();
    entries
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.is_dir())
        .collect()
}

/// An `[archive.*]` table and the context from its pipeline.
#[derive(Clone)]
struct Archive {
    table: Value,
    context: ArchiveContext,
}

impl Archive {
    fn stage(&self) -> Box<dyn Stage> {
        stage_in(self.table.clone(), self.context.clone()).unwrap()
    }
}

#[derive(Default)]
struct Brought {
    listing: Listing,
    /// Digests of the blobs by id.
    rows: BTreeMap<String, String>,
    facts: BTreeMap<String, Value>,
    verdicts: Vec<Verdict>,
    warnings: Vec<String>,
}

impl Brought {
    fn reason(&self, file: &str) -> &str {
        let verdict = self
            .verdicts
            .iter()
            .find(|verdict| verdict.file.starts_with(file));
        &verdict.unwrap_or_else(|| panic!("no verdict of {file}")).reason
    }

    fn kept(&self) -> BTreeSet<String> {
        let kept = self.verdicts.iter().filter(|verdict| verdict.keeps());
        kept.map(|verdict| verdict.file.clone()).collect()
    }
}

fn with(mut archive: Archive, pointer: &str, value: Value) -> Archive {
    let (parent, key) = pointer.rsplit_once('/').unwrap();
    archive.table.pointer_mut(parent).unwrap()[key] = value;
    archive
}

fn access(archive: &Archive, access: Access) -> Archive {
    let mut archive = archive.clone();
    archive.context.access = access;
    archive
}

fn pictures(server: &Server) -> usize {
    server
        .requests()
        .iter()
        .filter(|request| request.path().ends_with(".png"))
        .count()
}

/// A small PNG of its own.
fn image_bytes(seed: u8) -> Vec<u8> {
    let picture = image::RgbImage::from_fn(16, 12, |x, y| image::Rgb([x as u8 * seed, y as u8 * 9, seed]));
    let mut bytes = std::io::Cursor::new(Vec::new());
    picture.write_to(&mut bytes, image::ImageFormat::Png).unwrap();
    bytes.into_inner()
}

/// Plays the raw-image feed of Mars 2020 from records, with paging.
fn play(server: &Server, records: Vec<Value>) {
    server.feed("/rss/api/", move |_, query| {
        let value = |key: &str| {
            let pairs = query.split('&').filter_map(|pair| pair.split_once('='));
            pairs
                .filter(|(name, _)| *name == key)
                .map(|(_, value)| value.to_owned())
                .next()
        };
        let sol = |record: &Value| record["sol"].as_u64().unwrap();
        if value("latest").is_some() {
            let latest = records.iter().map(sol).max();
            return Some(
                json!({"latest_sol": latest, "type": "mars2020"})
                    .to_string()
                    .into_bytes(),
            );
        }
        let bound = |key: &str| value(key)?.split(':').next()?.parse::<u64>().ok();
        let (first, last) = (bound("condition_2")?, bound("condition_3")?);
        let (page, per_page): (usize, usize) = (value("page")?.parse().ok()?, value("num")?.parse().ok()?);
        let found: Vec<&Value> = records
            .iter()
            .filter(|record| (first..=last).contains(&sol(record)))
            .collect();
        let images: Vec<&&Value> = found.iter().skip(page * per_page).take(per_page).collect();
        Some(
            json!({"images": images, "total_results": found.len(), "page": page})
                .to_string()
                .into_bytes(),
        )
    });
}

fn served(server: &Server) -> usize {
    server
        .requests()
        .iter()
        .filter(|request| request.path().starts_with("/mars2020-raw-images/"))
        .count()
}

/// One PDS3 product of Curiosity: an attached label of 8 x 8 samples.
fn img() -> Vec<u8> {
    let label = "PDS_VERSION_ID = PDS3\r\nRECORD_TYPE = FIXED_LENGTH\r\nRECORD_BYTES = 512\r\n^IMAGE = 2\r\nOBJECT = IMAGE\r\n \
                 LINES = 8\r\n LINE_SAMPLES = 8\r\n SAMPLE_BITS = 8\r\n SAMPLE_TYPE = UNSIGNED_INTEGER\r\n BANDS = 1\r\n\
                 END_OBJECT = IMAGE\r\nEND\r\n";
    let mut bytes = label.as_bytes().to_vec();
    bytes.resize(512, b' ');
    bytes.extend((0..64).map(|value| value * 3));
    bytes
}
