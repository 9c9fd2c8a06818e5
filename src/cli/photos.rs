use std::path::PathBuf;

use clap::Args;
use marf_run::photos::{PhotoLine, UnreadFile};
use marf_run::{Context, Error};
use marf_scene::{CameraPrior, PhotoFacts};

use super::options::{NodeArgs, RecordArgs};
use super::output::print_json;
use crate::terminal::{print_line, print_lines};

/// Arguments of `photos`.
#[derive(Debug, Clone, Args)]
pub struct PhotosArgs {
    /// Folder with photos [default: the newest run of the pipeline]
    dir: Option<PathBuf>,
    /// Node whose photos are listed
    #[arg(long, default_value = "extract")]
    node: String,
    /// Print the table as CSV instead of Markdown. Files without a photo have their reason in `not_read`
    #[arg(long, conflicts_with = "json")]
    csv: bool,
    #[command(flatten)]
    record: RecordArgs,
    #[command(flatten)]
    nodes: NodeArgs,
}

/// `marf photos [DIR]`: lists the photos of a folder or of the pipeline's newest run, and the files that were not read.
pub fn photos(args: PhotosArgs, context: Context) -> Result<(), Error> {
    let context = args.nodes.context(args.record.store.context(context));
    let table = marf_run::photos::photos(&context, args.dir.as_deref(), &args.node)?;
    if args.record.json {
        return print_json(&table);
    }
    if args.csv {
        print_lines(table.csv()?.lines());
        return Ok(());
    }
    print_line(
        "| product | format | pixels | camera of the label | frame | site, drive, pose | sol | notes |",
    );
    print_line("|---|---|---|---|---|---|---|---|");
    table.photos.iter().for_each(|line| print_line(&row(line)));
    if !table.not_read.is_empty() {
        print_lines(["", "| file without a photo | why |", "|---|---|"]);
        for UnreadFile { file, reason } in &table.not_read {
            print_line(&cells(&[file.clone(), reason.clone()]));
        }
    }
    Ok(())
}

/// Returns a row of a table.
fn cells(cells: &[String]) -> String {
    let cells: Vec<String> = cells.iter().map(|cell| cell.replace('|', "\\|")).collect();
    format!("| {} |", cells.join(" | "))
}

fn row(line: &PhotoLine) -> String {
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
        known(frame(facts)),
        known(place(facts)),
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

fn frame(facts: &PhotoFacts) -> Option<String> {
    let (frame, pose) = match (&facts.prior, &facts.place) {
        (Some(prior), _) => (&prior.frame, prior.site_from_frame),
        (None, Some(place)) => (&place.frame, place.site_from_frame),
        (None, None) => return None,
    };
    Some(match pose {
        Some(_) => frame.clone(),
        None => format!("{frame}, not placed in a site"),
    })
}

/// The first three numbers of the rover's motion counter.
fn place(facts: &PhotoFacts) -> Option<String> {
    let numbers: Vec<String> = facts
        .motion_counter()
        .iter()
        .take(3)
        .map(i64::to_string)
        .collect();
    (!numbers.is_empty()).then(|| numbers.join(", "))
}
