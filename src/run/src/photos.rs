//! What was read of every photo.

use std::path::Path;

use marf_cache::{Digest, Store};
use marf_engine::{RunRecord, sets};
use marf_scene::{Photo, PhotoFacts};
use marf_stage::{PHOTOS, VERDICTS, Verdict};
use serde::Serialize;

use crate::choice::RunChoice;
use crate::context::Context;
use crate::error::Error;
use crate::execute::{execute, options};
use crate::folder;
use crate::session::Session;

/// One photo, as the table shows it.
#[derive(Debug, Serialize)]
pub struct PhotoLine {
    /// Its product id.
    pub product: String,
    /// The picture.
    pub image: Option<Digest>,
    /// Format of the file, by its bytes.
    pub format: &'static str,
    /// What was read.
    #[serde(flatten)]
    pub facts: PhotoFacts,
}

/// All photos of a node.
#[derive(Debug, Serialize)]
pub struct PhotoTable {
    /// The photos.
    pub photos: Vec<PhotoLine>,
    /// Files that gave no photo.
    pub not_read: Vec<UnreadFile>,
}

impl PhotoTable {
    /// Returns the table as CSV: a line for each photo, then one with the reason in `not_read` for each file without a photo.
    ///
    /// # Errors
    /// An error of the CSV writer.
    pub fn csv(&self) -> Result<String, Error> {
        let failed = |error: String| Error::failed(format!("photos: {error}"));
        let mut writer = csv::Writer::from_writer(Vec::new());
        let unread = self.not_read.iter().map(|file| {
            let mut line = CSV_COLUMNS.map(|_| String::new());
            line[1].clone_from(&file.file);
            line[CSV_COLUMNS.len() - 1].clone_from(&file.reason);
            line
        });
        let heads = CSV_COLUMNS.map(str::to_owned);
        let photos = self.photos.iter().map(PhotoLine::csv);
        for line in std::iter::once(heads).chain(photos).chain(unread) {
            writer
                .write_record(line)
                .map_err(|error| failed(error.to_string()))?;
        }
        let bytes = writer.into_inner().map_err(|error| failed(error.to_string()))?;
        String::from_utf8(bytes).map_err(|error| failed(error.to_string()))
    }
}

/// Columns of the table as CSV.
const CSV_COLUMNS: [&str; 13] = [
    "product",
    "file",
    "format",
    "width_px",
    "height_px",
    "bands",
    "sol",
    "instrument",
    "focal_px",
    "frame",
    "motion_counter",
    "notes",
    "not_read",
];

impl PhotoLine {
    fn csv(&self) -> [String; CSV_COLUMNS.len()] {
        let facts = &self.facts;
        let prior = facts.prior.as_ref();
        let focal_px = prior
            .and_then(|prior| prior.model.intrinsics().ok())
            .map(|k| k.hs);
        let counter = prior.map_or(&[][..], |prior| &prior.motion_counter).iter();
        let counter: Vec<String> = counter.map(i64::to_string).collect();
        let text = |value: Option<String>| value.unwrap_or_default();
        [
            self.product.clone(),
            facts.file.clone(),
            self.format.to_owned(),
            facts.width.to_string(),
            facts.height.to_string(),
            facts.bands.to_string(),
            text(facts.sol.map(|sol| sol.to_string())),
            text(facts.instrument.clone()),
            text(focal_px.or(facts.focal_px).map(|focal_px| focal_px.to_string())),
            text(prior.map(|prior| prior.frame.clone())),
            counter.join(" "),
            facts.notes.join("; "),
            String::new(),
        ]
    }
}

/// A file that gave no photo.
#[derive(Debug, Serialize)]
pub struct UnreadFile {
    /// Its name.
    pub file: String,
    /// Why.
    pub reason: String,
}

/// Returns the metadata of every photo that a node gave, and the files that were not read. The photos are those of a folder, or by default
/// of the newest run of the pipeline with such photos.
///
/// # Errors
/// A folder that cannot be read, a pipeline that has not run, a node that gave no photos.
pub fn photos(context: &Context, dir: Option<&Path>, node: &str) -> Result<PhotoTable, Error> {
    let (store, record) = match dir {
        Some(dir) => {
            let session = Session::implicit(context, &folder::photos("photos", dir), "photos", dir)?;
            let record = execute(&session, &options(&session))?.done();
            let record = record.map_err(folder::for_folder)?;
            (session.store, record)
        }
        None => {
            let store = context.existing_store()?;
            let has_photos = |run: &RunRecord| {
                let node = run.node(node).filter(|node| node.state.is_good());
                node.is_some_and(|node| node.outputs.contains_key(PHOTOS))
            };
            let choice = RunChoice::new(context, &store, None)?;
            let record = choice.newest_with(has_photos, |run| without_photos(run, node))?;
            (store, record)
        }
    };
    Ok(PhotoTable {
        photos: lines(&store, &record, node)?,
        not_read: not_read(&store, &record, node)?,
    })
}

/// Returns the files that a source has met and took no photo from. Empty for a filter, whose verdicts are on photos.
fn not_read(store: &Store, record: &RunRecord, node: &str) -> Result<Vec<UnreadFile>, Error> {
    let source = record.node(node).filter(|node| node.edges.is_empty());
    let Some(verdicts) = source.and_then(|node| node.outputs.get(VERDICTS)) else {
        return Ok(Vec::new());
    };
    let get = |digest: &Digest| Ok::<_, Error>(store.get(digest)?);
    let verdicts = sets::verdicts(&verdicts.digest, get)?.into_iter();
    let left_out = verdicts.filter(|verdict| !verdict.keeps());
    Ok(left_out
        .map(|Verdict { file, reason, .. }| UnreadFile { file, reason })
        .collect())
}

/// Returns the format of a photo's file, by its bytes and not by its name. Raw pixels are stored next to the photo made from them.
///
/// # Errors
/// A photo that the store has lost.
fn format(store: &Store, image: Option<&Digest>, has_raw: bool) -> Result<&'static str, Error> {
    match image {
        Some(_) if has_raw => Ok("IMG"),
        Some(image) => Ok(Photo::format(&store.get(image)?).unwrap_or("-")),
        None => Ok("-"),
    }
}

/// Returns the error of a run in which a node gave no photos.
fn without_photos(run: &RunRecord, node: &str) -> Error {
    let nodes: Vec<&str> = run.nodes.iter().map(|node| node.name.as_str()).collect();
    Error::usage(format!(
        "node `{node}` gave no photos in the last run. Its nodes are {}",
        nodes.join(", ")
    ))
}

/// Returns the photos of a node.
pub(crate) fn lines(store: &Store, record: &RunRecord, node: &str) -> Result<Vec<PhotoLine>, Error> {
    let photos = record.node(node).and_then(|node| node.outputs.get(PHOTOS));
    let photos = photos.ok_or_else(|| without_photos(record, node))?;
    let rows = sets::rows(&photos.digest, |digest| Ok::<_, Error>(store.get(digest)?))?;
    let mut lines = Vec::new();
    for row in rows {
        let facts = PhotoFacts::from_json(&row.facts)
            .map_err(|error| Error::failed(format!("photos of `{node}`: {error}")))?;
        let image = row.blobs.get("image").copied();
        lines.push(PhotoLine {
            facts,
            format: format(store, image.as_ref(), row.blobs.contains_key("raw"))?,
            image,
            product: row.id,
        });
    }
    Ok(lines)
}
