use std::path::PathBuf;

use clap::Args;
use marf_progress::format::count;
use marf_report::{FACTORS, calls, percent};
use marf_run::filter::FilterCalls;
use marf_run::{Context, Error};

use super::options::FolderArgs;
use super::output::print_json;
use crate::terminal::{eprint_line, print_line};

/// Arguments of `filter`.
#[derive(Debug, Clone, Args)]
pub struct FilterArgs {
    /// Folder with photos
    pub dir: PathBuf,
    /// CSV to write: file, verdict, score, threshold, twin, reason. A page with the photos is written next to it as .html
    #[arg(long, value_name = "FILE", default_value = "verdicts.csv")]
    pub out: PathBuf,
    /// Keep this photo (product id or file name), even if a filter rejects it
    #[arg(long, value_name = "ID")]
    pub keep: Vec<String>,
    /// Reject this photo, even if all filters keep it
    #[arg(long, value_name = "ID")]
    pub reject: Vec<String>,
    #[command(flatten)]
    folder: FolderArgs,
}

/// Runs `marf filter DIR`: every filter with its defaults on the photos of a folder.
pub fn filter(args: FilterArgs, context: Context) -> Result<(), Error> {
    let context = args.folder.context(context);
    let result = marf_run::filter::filter(&context, &args.dir, &args.out, &args.keep, &args.reject)?;
    if args.folder.json {
        return print_json(&result.counts);
    }
    let all = count(result.counts.values().sum(), "file");
    for (name, number) in &result.counts {
        print_line(&format!("{name:<12} {number} of {all}"));
    }
    changed_by_thresholds(&result.filters)
        .iter()
        .for_each(|line| eprint_line(line));
    eprint_line(&format!(
        "wrote {} and {}",
        args.out.display(),
        result.page.display()
    ));
    Ok(())
}

/// Returns a table of how many verdicts of each filter would change at other thresholds.
fn changed_by_thresholds(filters: &[FilterCalls]) -> Vec<String> {
    let heads: Vec<String> = FACTORS
        .iter()
        .map(|factor| format!("{:>7}", percent(factor - 1.0)))
        .collect();
    let mut lines = vec![format!("{:<12} {}", "threshold", heads.concat())];
    for filter in filters {
        let calls = calls(&filter.verdicts);
        let flips = |factor: f64| calls.iter().filter(|call| call.flips_at(factor)).count();
        let cells: Vec<String> = FACTORS
            .iter()
            .map(|factor| format!("{:>7}", flips(*factor)))
            .collect();
        lines.push(format!(
            "{:<12} {} of {} verdicts change",
            filter.name,
            cells.concat(),
            calls.len()
        ));
    }
    lines
}
