use std::path::Path;

use marf_cache::Digest;
use marf_engine::sets;
use marf_engine::{Cancel, RunRecord};
use marf_scene::{CameraPrior, PhotoFacts};
use marf_stage::PHOTOS;
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
    #[serde(flatten)]
    facts: PhotoFacts,
}

/// `marf photos [DIR]`: what was read of every photo, from a folder or from the pipeline's last run.
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
    let lines = lines(&session, &record, node)?;
    if global.json {
        return print_json(&lines);
    }
    print_line(
        "| product | format | pixels | camera of the label | frame | site, drive, pose | sol | notes |",
    );
    print_line("|---|---|---|---|---|---|---|---|");
    lines.iter().for_each(|line| print_line(&row(line)));
    Ok(())
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
        lines.push(Line {
            facts,
            image: row.blobs.get("image").copied(),
            product: row.id,
        });
    }
    Ok(lines)
}

fn row(line: &Line) -> String {
    let facts = &line.facts;
    let prior = facts.prior.as_ref();
    let known = |text: Option<String>| text.unwrap_or_else(|| "-".to_owned());
    let format = Path::new(&facts.file)
        .extension()
        .unwrap_or_default()
        .to_string_lossy()
        .to_uppercase();
    let cells = [
        line.product.clone(),
        format,
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
    ];
    format!("| {} |", cells.map(|cell| cell.replace('|', "\\|")).join(" | "))
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
