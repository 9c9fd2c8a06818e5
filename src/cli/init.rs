use super::args::{Global, Mission};
use super::error::{CliError, Diagnostic};
use super::files;
use marf_config as config;
use crate::terminal::eprint_line;

/// `marf init`: writes a commented pipeline; never over one that is there.
pub fn init(global: &Global, mission: Mission) -> Result<(), CliError> {
    if global.file.exists() {
        let diagnostic = Diagnostic::new(format!("{} is there already", global.file.display()));
        return Err(CliError::Usage(
            diagnostic.hint("name another with --file, or remove it"),
        ));
    }
    let name = match mission {
        Mission::Demo => "demo",
        Mission::Places => "mission",
        Mission::Folder => "folder",
        Mission::Perseverance => "perseverance",
        Mission::Curiosity => "curiosity",
        Mission::Ingenuity => "ingenuity",
    };
    let template = config::template(name).ok_or_else(|| CliError::failed(format!("no template `{name}`")))?;
    files::write(&global.file, template.text.as_bytes())?;
    eprint_line(&format!("wrote {}: {}", global.file.display(), template.about));
    Ok(())
}
