use clap::{Args, ValueEnum};
use marf_run::Error;

use super::output::print_json;

/// Arguments of `schema`.
#[derive(Debug, Clone, Args)]
pub struct SchemaArgs {
    /// What to describe
    #[arg(value_enum, value_name = "OF", default_value_t = SchemaOf::Pipeline)]
    subject: SchemaOf,
}

/// What `schema` prints.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum SchemaOf {
    /// pipeline.toml
    Pipeline,
    /// A line of `run --json`
    Events,
}

/// `marf schema`: prints a JSON schema.
pub fn schema(args: &SchemaArgs) -> Result<(), Error> {
    match args.subject {
        SchemaOf::Pipeline => print_json(&marf_config::schema()),
        SchemaOf::Events => print_json(&marf_progress::event_schema()),
    }
}
