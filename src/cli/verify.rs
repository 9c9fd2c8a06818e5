//! `marf verify`: checks a crate or a signed statement, without a store.

use std::path::PathBuf;

use clap::Args;
use marf_engine::Cancel;
use marf_export::verify::{Report, Signature};
use marf_run::Error;
use marf_run::export::{Statement, VerifyResult, verify_path, without_faults};

use super::output::print_json;
use crate::terminal::print_line;

/// Arguments of `verify`.
#[derive(Debug, Clone, Args)]
pub struct VerifyArgs {
    /// Folder of `export crate`, or file of `export attest`
    #[arg(value_name = "CRATE|STATEMENT")]
    pub path: PathBuf,
    /// Check the signature with this public key (PEM)
    #[arg(long, value_name = "FILE")]
    pub key: Option<PathBuf>,
    /// File that the statement must be about
    #[arg(long, value_name = "FILE")]
    pub subject: Vec<PathBuf>,
    /// Print one JSON document to stdout
    #[arg(long)]
    json: bool,
}

/// `marf verify`.
pub fn verify(args: &VerifyArgs, cancel: &Cancel) -> Result<(), Error> {
    match verify_path(&args.path, args.key.as_deref(), &args.subject, cancel)? {
        VerifyResult::Crate(report) => {
            if args.json {
                print_json(&report)?;
            } else {
                print_report(&report);
            }
            without_faults(&args.path, &report)
        }
        VerifyResult::Statement(statement) if args.json => print_json(&statement),
        VerifyResult::Statement(Statement { found, subjects }) => {
            for (name, file) in found {
                print_line(&format!("{} is {name}", file.display()));
            }
            print_line(&format!("signed by this key, files covered: {subjects}"));
            Ok(())
        }
    }
}

fn print_report(report: &Report) {
    print_line(&format!("run {}, root {}", report.run, report.root));
    if let Some(manifest) = &report.manifest_sha256 {
        print_line(&format!("manifest SHA-256 {manifest}"));
    }
    print_line(&format!(
        "{} files in the bag, {} named only, {} actions match their keys, {} photos traced to files of the archive",
        report.files, report.named, report.actions, report.photos
    ));
    print_line(match report.signature {
        Signature::None => "not signed",
        Signature::NotChecked => "signed. Name a public key with --key to check the signature",
        Signature::Good => "signed by this key",
        Signature::Bad => "the signature does not hold",
    });
    for fault in &report.faults {
        print_line(&format!("fault: {fault}"));
    }
    if report.faults.is_empty() {
        print_line("holds");
    }
}
