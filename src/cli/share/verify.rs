//! `marf verify`: checks what was handed over, without a store.

use std::path::{Path, PathBuf};

use clap::Args;
use marf_export::dsse::Envelope;
use marf_export::subjects_in;
use marf_export::verify::{OpenCrate, OpenError, Report, Signature, verify};
use marf_keys::PublicKey;

use super::super::args::Global;
use super::super::copies::object_of;
use super::super::error::{CliError, Diagnostic};
use super::super::output::print_json;
use super::super::trust::public_key;
use super::altered;
use crate::terminal::print_line;

/// Arguments of `verify`.
#[derive(Debug, Clone, Args)]
pub struct VerifyArgs {
    /// A folder of `export crate`, or a file of `export attest`
    #[arg(value_name = "CRATE|STATEMENT")]
    pub path: PathBuf,
    /// Check the signature with this public key (PEM)
    #[arg(long, value_name = "FILE")]
    pub key: Option<PathBuf>,
    /// A file that the statement must be about
    #[arg(long, value_name = "FILE")]
    pub subject: Vec<PathBuf>,
}

/// `marf verify`.
pub fn verify_path(global: &Global, args: &VerifyArgs) -> Result<(), CliError> {
    let key = args.key.as_deref().map(public_key).transpose()?;
    if args.path.is_file() {
        let key = key.ok_or_else(|| {
            CliError::Usage(
                Diagnostic::new(
                    "a statement is worth what its signature is worth: name a public key with --key",
                )
                .hint("`openssl pkey -in KEY.pem -pubout -out PUB.pem` writes it"),
            )
        })?;
        return verify_statement(args, &key);
    }
    if !args.subject.is_empty() {
        return Err(CliError::usage(
            "--subject goes with a statement, not with a crate",
        ));
    }
    let report = verify(&args.path, key.as_ref()).map_err(open_error)?;
    match global.json {
        true => print_json(&report)?,
        false => print_report(&report),
    }
    without_faults(&args.path, &report)
}

/// Checks a crate, and prints nothing.
///
/// # Errors
/// A folder that is no crate; a crate that does not hold.
pub fn verify_crate(folder: &Path) -> Result<(), CliError> {
    without_faults(folder, &verify(folder, None).map_err(open_error)?)
}

/// Opens a crate.
///
/// # Errors
/// A folder that is no crate, or one of a newer form.
pub fn open_crate(folder: &Path) -> Result<OpenCrate, CliError> {
    OpenCrate::open(folder).map_err(open_error)
}

fn without_faults(folder: &Path, report: &Report) -> Result<(), CliError> {
    match report.faults.len() {
        0 => Ok(()),
        faults => Err(altered(
            Diagnostic::new(format!("{} does not hold; faults: {faults}", folder.display()))
                .hint("ask whoever made it for another copy; trust nothing in this one"),
        )),
    }
}

fn open_error(error: OpenError) -> CliError {
    let diagnostic = Diagnostic::new(error.to_string());
    match error {
        OpenError::Newer { .. } => CliError::Newer(diagnostic.hint("a newer marf reads it")),
        OpenError::NoCrate { .. } | OpenError::Foreign { .. } => {
            CliError::Usage(diagnostic.hint("`marf export crate` writes crates"))
        }
        OpenError::BadRun { .. } => altered(diagnostic),
    }
}

fn print_report(report: &Report) {
    print_line(&format!("run {}, root {}", report.run, report.root));
    if let Some(manifest) = &report.manifest_sha256 {
        print_line(&format!("manifest SHA-256 {manifest}"));
    }
    print_line(&format!(
        "{} files in the bag, {} named only; {} actions gave their keys; {} photos followed to files of the archive",
        report.files, report.named, report.actions, report.photos
    ));
    print_line(match report.signature {
        Signature::None => "not signed",
        Signature::NotChecked => "signed; name a public key with --key to check by whom",
        Signature::Good => "signed by this key",
        Signature::Bad => "the signature does not hold",
    });
    for fault in &report.faults {
        print_line(&format!("fault: {}", crate::terminal::escape_control(fault)));
    }
    if report.faults.is_empty() {
        print_line("holds");
    }
}

/// Checks a statement: its signature, and that it is about the files named.
fn verify_statement(args: &VerifyArgs, key: &PublicKey) -> Result<(), CliError> {
    let refuse = |error: String| altered(Diagnostic::new(format!("{}: {error}", args.path.display())));
    let bytes = std::fs::read(&args.path).map_err(|error| refuse(error.to_string()))?;
    let envelope = Envelope::decode(&bytes)
        .map_err(|error| CliError::usage(format!("{}: {error}", args.path.display())))?;
    let statement = envelope.verify(key).map_err(|error| refuse(error.to_string()))?;
    let subjects = subjects_in(&statement).ok_or_else(|| refuse("it is no in-toto statement".to_owned()))?;
    for file in &args.subject {
        let found = std::fs::read(file)
            .map_err(|error| CliError::usage(format!("{} cannot be read: {error}", file.display())))?;
        let found = marf_cache::Sha256::of(&object_of(found));
        let subject = subjects.iter().find(|(_, digest)| *digest == found);
        let (name, _) = subject.ok_or_else(|| refuse(format!("it is not about {}", file.display())))?;
        print_line(&format!("{} is {name}", file.display()));
    }
    print_line(&format!(
        "signed by this key; files it is about: {}",
        subjects.len()
    ));
    Ok(())
}
