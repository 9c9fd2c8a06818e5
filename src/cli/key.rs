//! `marf key`: keys that sign.

use std::path::PathBuf;

use clap::{Args, Subcommand};
use marf_run::Error;
use marf_run::key::new_key;

use super::output::print_json;
use crate::terminal::print_line;

/// Verbs of `key`.
#[derive(Debug, Clone, Subcommand)]
pub enum KeyVerb {
    /// Make a key, which signs what is sent to shared stores
    New(NewArgs),
}

/// Arguments of `key new`.
#[derive(Debug, Clone, Args)]
pub struct NewArgs {
    /// File of the private key. The public key is written next to it, as .pub.pem [default: marf/key.pem in your configuration folder, from
    /// where it is used without an option]
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Print one JSON document to stdout
    #[arg(long)]
    json: bool,
}

/// `marf key`.
pub fn key(verb: KeyVerb) -> Result<(), Error> {
    let KeyVerb::New(args) = verb;
    let key = new_key(args.out.as_deref())?;
    if args.json {
        return print_json(&key);
    }
    print_line(&format!(
        "private key {}: keep it to yourself",
        key.private.display()
    ));
    print_line(&format!(
        "public key  {}: for `[store] trust` and `marf verify --key` of others",
        key.public.display()
    ));
    print_line(&format!("id          {}", key.id));
    Ok(())
}
