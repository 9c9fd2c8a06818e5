use std::path::PathBuf;

use clap::Args;
use clap::builder::PossibleValue;
use marf_config::TEMPLATES;
use marf_run::{Diagnostic, Error, files};

use crate::terminal::eprint_line;

/// Arguments of `init`.
#[derive(Debug, Clone, Args)]
pub struct InitArgs {
    /// Pipeline to write
    #[arg(long, value_name = "MISSION", value_parser = missions(), default_value = TEMPLATES[0].name)]
    mission: String,
    /// File to write
    #[arg(short, long, value_name = "FILE", default_value = "pipeline.toml")]
    file: PathBuf,
}

fn missions() -> [PossibleValue; TEMPLATES.len()] {
    TEMPLATES.map(|template| PossibleValue::new(template.name).help(template.about))
}

/// `marf init`: writes a commented pipeline. An existing file is not changed.
pub fn init(args: &InitArgs) -> Result<(), Error> {
    let (file, name) = (&args.file, &args.mission);
    if file.exists() {
        let diagnostic = Diagnostic::new(format!("{} is there already", file.display()));
        return Err(Error::Usage(
            diagnostic.hint("name another with --file, or remove it"),
        ));
    }
    let template =
        marf_config::template(name).ok_or_else(|| Error::failed(format!("no template `{name}`")))?;
    files::write(file, template.text.as_bytes())?;
    eprint_line(&format!("wrote {}: {}", file.display(), template.about));
    Ok(())
}
