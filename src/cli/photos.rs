use std::path::Path;

use marf_cache::Digest;
use marf_engine::sets;
use marf_engine::{Cancel, RunRecord};
use marf_scene::{CameraPrior, Photo, PhotoFacts};
use marf_stage::{PHOTOS, VERDICTS, Verdict};
use serde::Serialize;

use super::args::Global;
use super::error::CliError;
use super::folder;
use super::output::print_json;
use super::run::{execute, options};
use super::session::Session;
use crate::terminal::print_line;

/// One photo, as the table shows it.
#[derive(Debug, Serialize)]
struct Line {
    product: String,
    image: Option<Digest>,
    /// Of the file, by its bytes.
    format: &'static str,
    #[serde(flatten)]
    facts: PhotoFacts,
}

/// What `--json` prints.
#[derive(Debug, Serialize)]
struct Table {
    photos: Vec<Line>,
    /// Files that gave no photo.
    not_read: Vec<NotRead>,
}

/// A file that gave no photo.
#[derive(Debug, Serialize)]
struct NotRead {
    file: String,
    reason: String,
}

/// `marf photos [DIR]`: what was read of every photo, from a folder or from the pipeline's last run, and which files were not.
pub fn photos(global: &Global, dir: Option<&Path>, node: &str, cancel: &Cancel) -> Result<(), CliError> {
    let (session, record) = match dir {
        Some(dir) => {
            let session = Session::implicit(&folder::photos("photos", dir), global, cancel)?;
            let (record, ended) = execute(&session, &options(global, &session.name), global, cancel)?;
            ended?;
            (session, record)
        }
        None => {
            let session = Session::open(global, cancel)?;
            let last = session.last()?;
            let record = last.ok_or_else(|| CliError::failed("no run of this pipeline yet".to_owned()))?;
            (session, record)
        }
    };
    let table = Table {
        photos: lines(&session, &record, node)?,
        not_read: not_read(&session, &record, node)?,
    };
    if global.json {
        return print_json(&table);
    }
    print_line(
        "| product | format | pixels | camera of the label | frame | site, drive, pose | sol | notes |",
    );
    print_line("|---|---|---|---|---|---|---|---|");
    table.photos.iter().for_each(|line| print_line(&row(line)));
    if !table.not_read.is_empty() {
        print_line("\n| file without a photo | why |\n|---|---|");
        for NotRead { file, reason } in &table.not_read {
            print_line(&cells(&[file.clone(), reason.clone()]));
        }
    }
    Ok(())
}

/// Returns the files that a source has met and took no photo from; none of a filter, whose verdicts are on photos.
fn not_read(session: &Session, record: &RunRecord, node: &str) -> Result<Vec<NotRead>, CliError> {
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
        .map(|Verdict { file, reason, .. }| NotRead { file, reason })
        .collect())
}

/// Returns the format of a photo's file: what its bytes are, whatever it is called. Raw pixels are kept beside the photo made of them.
///
/// # Errors
/// A photo that the store has lost.
fn format(session: &Session, image: Option<&Digest>, has_raw: bool) -> Result<&'static str, CliError> {
    match image {
        Some(_) if has_raw => Ok("IMG"),
        Some(image) => Ok(Photo::format(&session.store.get(image)?).unwrap_or("-")),
        None => Ok("-"),
    }
}

/// Returns a row of a table.
fn cells(cells: &[String]) -> String {
    let cells: Vec<String> = cells.iter().map(|cell| cell.replace('|', "\\|")).collect();
    format!("| {} |", cells.join(" | "))
}

fn lines(session: &Session, record: &RunRecord, node: &str) -> Result<Vec<Line>, CliError> {
    let found = record.nodes.iter().find(|one| one.name == node);
    let output = found.and_then(|node| node.outputs.get(PHOTOS)).ok_or_else(|| {
        let nodes: Vec<&str> = record.nodes.iter().map(|node| node.name.as_str()).collect();
        CliError::usage(format!(
            "node `{node}` gave no photos in the last run; its nodes: {}",
            nodes.join(", ")
        ))
    })?;
    let rows = sets::rows(&output.digest, |digest| {
        Ok::<_, CliError>(session.store.get(digest)?)
    })?;
    let mut lines = Vec::new();
    for row in rows {
        let facts = PhotoFacts::from_json(&row.facts)
            .map_err(|error| CliError::failed(format!("photos of `{node}`: {error}")))?;
        let image = row.blobs.get("image").copied();
        lines.push(Line {
            facts,
            format: format(session, image.as_ref(), row.blobs.contains_key("raw"))?,
            image,
            product: row.id,
        });
    }
    Ok(lines)
}

fn row(line: &Line) -> String {
    let facts = &line.facts;
    let prior = facts.prior.as_ref();
    let known = |text: Option<String>| text.unwrap_or_else(|| "-".to_owned());
    cells(&[
        line.product.clone(),
        line.format.to_owned(),
        format!("{} x {} x {}", facts.width, facts.height, facts.bands),
        known(
            prior
                .map(camera)
                .or_else(|| facts.focal_px.map(|focal| format!("EXIF {focal:.1} px"))),
        ),
        known(prior.map(frame)),
        known(prior.and_then(place)),
        known(facts.sol.map(|sol| sol.to_string())),
        facts.notes.join("; "),
    ])
}

/// Model, focal length and principal point, pixels.
fn camera(prior: &CameraPrior) -> String {
    let kind = match (prior.model.o, prior.model.e) {
        (_, Some(_)) => "CAHVORE",
        (Some(_), None) => "CAHVOR",
        _ => "CAHV",
    };
    match prior.model.intrinsics() {
        Ok(k) => format!("{kind} {:.1} px at ({:.0}, {:.0})", k.hs, k.hc, k.vc),
        Err(error) => format!("{kind}: {error}"),
    }
}

fn frame(prior: &CameraPrior) -> String {
    match prior.site_from_frame {
        Some(_) => prior.frame.clone(),
        None => format!("{}, not placed in a site", prior.frame),
    }
}

/// The first three numbers of the rover's motion counter.
fn place(prior: &CameraPrior) -> Option<String> {
    let numbers: Vec<String> = prior.motion_counter.iter().take(3).map(i64::to_string).collect();
    (!numbers.is_empty()).then(|| numbers.join(", "))
}
