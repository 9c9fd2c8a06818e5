use std::path::PathBuf;

use clap::Args;
use marf_run::{Context, Error};

use crate::terminal::eprint_line;

/// Arguments of `report`.
#[derive(Debug, Clone, Args)]
pub struct ReportArgs {
    /// Where to
    #[arg(long, value_name = "FILE", default_value = "report.html")]
    out: PathBuf,
}

/// `marf report`: writes the report of the last run.
pub fn report(args: &ReportArgs, context: &Context) -> Result<(), Error> {
    marf_run::report::report(context, &args.out)?;
    eprint_line(&format!("wrote {}", args.out.display()));
    Ok(())
}
