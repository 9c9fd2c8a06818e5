//! `marf verify`: checks a crate or a signed statement, without a store.

use std::path::PathBuf;

use clap::Args;
use marf_engine::Cancel;
use marf_export::verify::{Report, Signature};
use marf_progress::format::count;
use marf_run::export::{CrateCheck, Statement, VerifyResult, verify_path};
use marf_run::{Answer, Error};

use super::output::print_json;
use crate::terminal::{print_line, print_lines};

/// Arguments of `verify`.
#[derive(Debug, Clone, Args)]
#[command(after_help = AFTER_HELP)]
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

const AFTER_HELP: &str = "\
Exit codes: 0 intact, and signed with the key if one is given, 4 altered, 8 made by a newer marf, 13 intact but not signed with the key.";

/// `marf verify`.
pub fn verify(args: &VerifyArgs, cancel: &Cancel) -> Result<(), Error> {
    match verify_path(&args.path, args.key.as_deref(), &args.subject, cancel)? {
        VerifyResult::Crate(check) => {
            if args.json {
                print_json(&check)?;
            } else {
                print_lines(text(&check));
            }
            check.is_whole(&args.path)
        }
        VerifyResult::Statement(statement) if args.json => print_json(&statement),
        VerifyResult::Statement(Statement { found, subjects }) => {
            print_line(&format!(
                "This statement is signed with the given key and covers {}.",
                count(subjects, "file")
            ));
            for (name, file) in found {
                print_line(&format!("  {} is {name}", file.display()));
            }
            Ok(())
        }
    }
}

/// Returns the answer on a crate in a sentence that takes no knowledge of marf.
fn sentence(check: &CrateCheck) -> String {
    let Report {
        files,
        photos,
        faults,
        signature,
        named,
        ..
    } = &check.report;
    if check.answer == Answer::Altered {
        return format!(
            "This crate is not intact: it was altered or damaged ({}). Do not trust it.",
            count(faults.len(), "fault")
        );
    }
    let intact = format!(
        "This crate is intact: all {} of its data have the listed bytes, and it traces {} to files of the archive.",
        count(*files as usize, "file"),
        count(*photos as usize, "photo")
    );
    let left_out = match named {
        0 => String::new(),
        named => format!(
            " It leaves out {}, which were not checked.",
            count(*named as usize, "file")
        ),
    };
    let signed = match signature {
        Signature::Good => "It is signed with the given key.",
        Signature::Missing => "But it is not signed, so the given key cannot show who made it.",
        Signature::OtherKey => "But it is signed with another key than the given one.",
        Signature::NotChecked => {
            "It is signed. To check who made it, name the author's public key with --key."
        }
        Signature::None | Signature::Bad => "It is not signed, so it does not show who made it.",
    };
    format!("{intact}{left_out} {signed}")
}

fn text(check: &CrateCheck) -> Vec<String> {
    let report = &check.report;
    let mut lines = vec![sentence(check)];
    lines.extend(report.faults.iter().map(|fault| format!("fault: {fault}")));
    lines.push(String::new());
    lines.push(format!("run {}, root {}", report.run, report.root));
    let manifest = report.manifest_sha256.iter();
    lines.extend(manifest.map(|manifest| format!("manifest SHA-256 {manifest}")));
    lines.push(format!(
        "{} in data/, {} named by digest only, {} checked against their keys",
        count(report.files as usize, "file"),
        report.named,
        count(report.actions as usize, "action")
    ));
    lines
}
