//! `marf export crate`.

use marf_engine::Cancel;
use marf_export::{CrateOptions, Data, Photos, write_crate};
use serde_json::json;

use super::super::args::Global;
use super::super::error::CliError;
use super::super::output::print_json;
use super::super::session::existing_store;
use super::{CrateArgs, run};
use crate::cli::trust::signing_key;
use crate::terminal::print_line;

pub(super) fn export(global: &Global, args: &CrateArgs, cancel: &Cancel) -> Result<(), CliError> {
    let key = args.key.as_deref().map(signing_key).transpose()?;
    let store = existing_store(global, cancel)?;
    let handed = run::load(&store, args.run)?;
    let options = CrateOptions {
        data: match args.without_data {
            true => Data::Named,
            false => Data::Included,
        },
        photos: match args.items.is_empty() {
            true => Photos::All,
            false => Photos::Chosen(args.items.clone()),
        },
        license: args.license.as_deref(),
        key: key.as_ref(),
    };
    let written = write_crate(&handed, &run::reader(&store), &options, &args.dir)?;
    if global.json {
        return print_json(&json!({
            "crate": args.dir,
            "run": handed.id,
            "files": written.files,
            "bytes": written.bytes,
            "named": written.named,
            "manifest_sha256": written.manifest,
        }));
    }
    print_line(&format!(
        "wrote {}: run {} of {}, {} files, {} bytes, {} files named only",
        args.dir.display(),
        handed.id,
        handed.pipeline,
        written.files,
        written.bytes,
        written.named
    ));
    print_line(&format!("manifest SHA-256 {}", written.manifest));
    Ok(())
}
