use super::args::{Global, Mission};
use super::error::{CliError, Complaint};
use super::files;
use crate::config;

/// `marf init`: writes a commented pipeline; never over one that is there.
pub fn init(global: &Global, mission: Mission) -> Result<(), CliError> {
    if global.file.exists() {
        let complaint = Complaint::new(format!("{} is there already", global.file.display()));
        return Err(CliError::Usage(
            complaint.hint("name another with --file, or remove it"),
        ));
    }
    let name = match mission {
        Mission::Demo => "demo",
        Mission::Folder => "folder",
        Mission::Perseverance => "perseverance",
        Mission::Curiosity => "curiosity",
        Mission::Ingenuity => "ingenuity",
    };
    let template = config::template(name).ok_or_else(|| CliError::failed(format!("no template `{name}`")))?;
    files::write(&global.file, template.text.as_bytes())?;
    crate::talk(&format!("wrote {}: {}", global.file.display(), template.about));
    Ok(())
}
