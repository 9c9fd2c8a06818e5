//! What was read of every photo.

use std::path::{Path, PathBuf};

use marf_cache::Digest;
use marf_engine::{RunRecord, sets};
use marf_model::select;
use marf_scene::{Photo, PhotoFacts};
use marf_stage::{PHOTOS, VERDICTS, Verdict};
use serde::Serialize;

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

/// A file that gave no photo.
#[derive(Debug, Serialize)]
pub struct UnreadFile {
    /// Its name.
    pub file: String,
    /// Why.
    pub reason: String,
}

/// Photos of a folder, or of the last run of the pipeline.
#[derive(Debug, Clone)]
pub struct PhotosRequest {
    /// The folder; none for the last run of the pipeline.
    pub dir: Option<PathBuf>,
    /// The node whose photos are shown.
    pub node: String,
}

/// Returns what was read of every photo, and which files were not read.
///
/// # Errors
/// A folder that cannot be read, a pipeline that has not run, a node that gave no photos.
pub fn photos(context: &Context, request: &PhotosRequest) -> Result<PhotoTable, Error> {
    let node = &request.node;
    let (session, record) = match &request.dir {
        Some(dir) => of_folder(context, dir)?,
        None => {
            let session = Session::open(context)?;
            let has_photos = |run: &RunRecord| {
                let node = run.node(node).filter(|node| node.state.is_good());
                node.is_some_and(|node| node.outputs.contains_key(PHOTOS))
            };
            let warnings = context.warnings();
            let with_photos = select::newest_with(&session.store, &session.subject(), warnings, has_photos)?;
            let run = with_photos.map_or_else(|| session.last(), |run| Ok(Some(run)))?;
            let record = run.ok_or_else(|| Error::failed("no run of this pipeline yet".to_owned()))?;
            (session, record)
        }
    };
    Ok(PhotoTable {
        photos: lines(&session, &record, node)?,
        not_read: not_read(&session, &record, node)?,
    })
}

fn of_folder(context: &Context, dir: &Path) -> Result<(Session, RunRecord), Error> {
    let session = Session::implicit(context, &folder::photos("photos", dir), "photos", dir)?;
    let record = execute(&session, &options(&session))?.done()?;
    Ok((session, record))
}

/// Returns the files that a source has met and took no photo from; none of a filter, whose verdicts are on photos.
fn not_read(session: &Session, record: &RunRecord, node: &str) -> Result<Vec<UnreadFile>, Error> {
    let source = record
        .nodes
        .iter()
        .find(|one| one.name == node && one.edges.is_empty());
    let Some(verdicts) = source.and_then(|node| node.outputs.get(VERDICTS)) else {
        return Ok(Vec::new());
    };
    let verdicts = session.verdicts(&verdicts.digest)?.into_iter();
    let left_out = verdicts.filter(|verdict| !verdict.keeps());
    Ok(left_out
        .map(|Verdict { file, reason, .. }| UnreadFile { file, reason })
        .collect())
}

/// Returns the format of a photo's file: what its bytes are, whatever it is called. Raw pixels are kept beside the photo made of them.
///
/// # Errors
/// A photo that the store has lost.
fn format(session: &Session, image: Option<&Digest>, has_raw: bool) -> Result<&'static str, Error> {
    match image {
        Some(_) if has_raw => Ok("IMG"),
        Some(image) => Ok(Photo::format(&session.store.get(image)?).unwrap_or("-")),
        None => Ok("-"),
    }
}

fn lines(session: &Session, record: &RunRecord, node: &str) -> Result<Vec<PhotoLine>, Error> {
    let found = record.nodes.iter().find(|one| one.name == node);
    let output = found.and_then(|node| node.outputs.get(PHOTOS)).ok_or_else(|| {
        let nodes: Vec<&str> = record.nodes.iter().map(|node| node.name.as_str()).collect();
        Error::usage(format!(
            "node `{node}` gave no photos in the last run; its nodes: {}",
            nodes.join(", ")
        ))
    })?;
    let rows = sets::rows(&output.digest, |digest| {
        Ok::<_, Error>(session.store.get(digest)?)
    })?;
    let mut lines = Vec::new();
    for row in rows {
        let facts = PhotoFacts::from_json(&row.facts)
            .map_err(|error| Error::failed(format!("photos of `{node}`: {error}")))?;
        let image = row.blobs.get("image").copied();
        lines.push(PhotoLine {
            facts,
            format: format(session, image.as_ref(), row.blobs.contains_key("raw"))?,
            image,
            product: row.id,
        });
    }
    Ok(lines)
}
