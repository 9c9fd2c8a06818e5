//! `marf compare`: maps what changed on the ground between two times.

use std::path::PathBuf;

use clap::Args;
use marf_field::Quality;
use marf_progress::format::count;
use marf_run::compare::{CompareRequest, REPORT};
use marf_run::{Context, Diagnostic, Error};
use marf_schema::changes::{Change, ChangesParams, ChangesReport};
use marf_stage::Sols;

use super::options::{ResultArgs, word};
use super::output::print_json;
use crate::terminal::print_line;

/// Most patches that are listed in the terminal.
const MOST_LISTED: usize = 20;

/// Arguments of `compare`.
#[derive(Debug, Clone, Args)]
#[command(after_help = AFTER_HELP)]
pub struct CompareArgs {
    /// Scene, if the pipeline splits photos by place
    #[arg(value_name = "SCENE")]
    pub scene: Option<String>,
    /// Sols of the earlier photos, then those of the later photos: `--sols 1..=2 --sols 8..=9`
    #[arg(long, value_name = "SOLS", required = true, value_parser = Sols::parse)]
    pub sols: Vec<Sols>,
    /// Folder to write
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Number of the run [default: the newest one that has the scene]
    #[arg(long, value_name = "NUMBER")]
    pub run: Option<u64>,
    /// Quality of the trainings: `draft`, `standard` or `best`
    #[arg(long, value_name = "QUALITY", default_value = "draft", value_parser = word::<Quality>)]
    pub quality: Quality,
    /// Optimiser steps of a training [default: by quality]
    #[arg(long, value_name = "STEPS")]
    pub steps: Option<u64>,
    /// Number of trainings for each time, at least 2, whose differences measure the noise
    #[arg(short = 'b', long = "members", value_name = "COUNT", default_value_t = ChangesParams::default().b)]
    pub members: u32,
    /// Width of a cell of the map, metres [default: as fine as the photos allow]
    #[arg(long, value_name = "METRES")]
    pub cell: Option<f64>,
    #[command(flatten)]
    results: ResultArgs,
}

const AFTER_HELP: &str = "\
Fields are trained on the photos of each time, with the cameras of the run. DIR receives map.png (changes over gray ground), before.png \
and after.png (orthophotos), height.png (change of height) and height-interval.png (16-bit PNG, the scale in their text chunks), a world \
file for each, and changes.json with every patch. Ground that is only brighter or darker is undecided, because shadows look the same. The \
noise is estimated from nine tenths of the ground, which are assumed to be unchanged.";

/// `marf compare`: compares the two times, unless the store has the result, and writes it.
pub fn compare(args: CompareArgs, context: Context) -> Result<(), Error> {
    let [before, after] = args.sols.as_slice() else {
        let diagnostic = Diagnostic::new(format!(
            "--sols: {} times are given, two are compared",
            args.sols.len()
        ));
        return Err(Error::Usage(diagnostic.hint("`--sols 1..=2 --sols 8..=9`")));
    };
    let request = CompareRequest {
        scene: args.scene,
        out: args.out,
        run: args.run,
        params: ChangesParams {
            before: before.clone(),
            after: after.clone(),
            b: args.members,
            quality: args.quality,
            steps: args.steps,
            cell: args.cell,
            ..ChangesParams::default()
        },
    };
    let result = marf_run::compare::compare(&args.results.context(context), &request)?;
    if args.results.json {
        return print_json(&result);
    }
    text(&result.changes).iter().for_each(|line| print_line(line));
    print_line(&format!(
        "wrote {} to {}",
        count(result.files.len(), "file"),
        request.out.display()
    ));
    Ok(())
}

/// Returns the changes as lines of text.
fn text(report: &ChangesReport) -> Vec<String> {
    let time = |time: &marf_schema::changes::Time| {
        format!(
            "{}, {:.1} dB, {:.1} m²",
            count(time.photos, "photo"),
            time.psnr,
            time.area_m2
        )
    };
    let changed = report.patches.iter();
    let changed = changed.filter(|patch| patch.change != Change::Undecided).count();
    let mut lines = vec![
        format!("before   {}", time(&report.before)),
        format!("after    {}", time(&report.after)),
        format!(
            "compared {:.2} m² in cells of {:.3} m. Where nothing changed, 90 % of the heights differ by less than {:.3} m",
            report.compared_m2, report.cell_m, report.height.interval
        ),
        format!(
            "changed  {:.3} m² in {}, undecided {:.3} m²",
            report.changed_m2,
            match changed {
                1 => "1 patch".to_owned(),
                changed => format!("{changed} patches"),
            },
            report.undecided_m2
        ),
    ];
    for patch in report.patches.iter().take(MOST_LISTED) {
        let word = patch.change.word();
        lines.push(format!(
            "  {word:<14} {:.3} m² ({:.3} to {:.3}) at {:.2} m right, {:.2} m up, {:+.3} m ± {:.3}, light x {:.2}",
            patch.area_m2,
            patch.area_interval_m2[0],
            patch.area_interval_m2[1],
            patch.middle_m[0],
            patch.middle_m[1],
            patch.height_m[0],
            patch.height_m[1],
            patch.brightness
        ));
    }
    let more = report.patches.len().saturating_sub(MOST_LISTED);
    lines.extend((more > 0).then(|| format!("  and {more} smaller ones in {REPORT}")));
    lines
}
