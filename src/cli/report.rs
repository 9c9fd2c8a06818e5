use std::path::PathBuf;

use clap::Args;
use marf_run::{Context, Error, report::report as plain, report_view::with_view};

use super::options::StoreArgs;
use crate::terminal::eprint_line;

/// Arguments of `report`.
#[derive(Debug, Clone, Args)]
pub struct ReportArgs {
    /// File to write
    #[arg(long, value_name = "FILE", default_value = "report.html")]
    out: PathBuf,
    /// Number of the run, as `marf log` lists it [default: the newest one]
    #[arg(long, value_name = "NUMBER")]
    run: Option<u64>,
    /// Include a 3-D view of the field, in one file of at most 15 MB
    #[arg(long)]
    with_3d: bool,
    #[command(flatten)]
    store: StoreArgs,
}

/// `marf report`: writes the report of the newest run.
pub fn report(args: ReportArgs, context: Context) -> Result<(), Error> {
    let write = if args.with_3d { with_view } else { plain };
    write(&args.store.context(context), &args.out, args.run)?;
    eprint_line(&format!("wrote {}", args.out.display()));
    Ok(())
}
