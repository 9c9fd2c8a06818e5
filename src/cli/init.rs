use clap::{Args, ValueEnum};
use marf_run::{Diagnostic, Error, files};

use super::global::Global;
use crate::terminal::eprint_line;

/// Arguments of `init`.
#[derive(Debug, Clone, Args)]
pub struct InitArgs {
    /// Which one
    #[arg(long, value_enum, default_value_t = Mission::Demo)]
    mission: Mission,
}

/// Pipelines that `init` writes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Mission {
    /// A built-in Mars, offline
    Demo,
    /// The built-in Mars at three places, each a scene
    #[value(name = "mission")]
    Places,
    /// Photos in a folder
    Folder,
    /// Mars 2020 Mastcam-Z and Navcam
    Perseverance,
    /// MSL Mastcam and Navcam
    Curiosity,
    /// The helicopter's colour camera
    Ingenuity,
}

/// `marf init`: writes a commented pipeline; never over one that is there.
pub fn init(global: &Global, args: &InitArgs) -> Result<(), Error> {
    if global.file.exists() {
        let diagnostic = Diagnostic::new(format!("{} is there already", global.file.display()));
        return Err(Error::Usage(
            diagnostic.hint("name another with --file, or remove it"),
        ));
    }
    let name = match args.mission {
        Mission::Demo => "demo",
        Mission::Places => "mission",
        Mission::Folder => "folder",
        Mission::Perseverance => "perseverance",
        Mission::Curiosity => "curiosity",
        Mission::Ingenuity => "ingenuity",
    };
    let template =
        marf_config::template(name).ok_or_else(|| Error::failed(format!("no template `{name}`")))?;
    files::write(&global.file, template.text.as_bytes())?;
    eprint_line(&format!("wrote {}: {}", global.file.display(), template.about));
    Ok(())
}
