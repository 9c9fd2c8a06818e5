//! `marf man`: manual pages, one a verb, from the same text as `--help`.

use std::path::Path;

use clap::{Command, CommandFactory};
use clap_mangen::Man;
use marf_run::{Error, files};

use super::args::Cli;
use crate::terminal::print_line;

/// Writes `marf.1`, and `marf-VERB.1` of every verb, into a folder.
pub fn man(dir: &Path) -> Result<(), Error> {
    let mut command = Cli::command();
    command.build();
    let mut written = 0;
    write(&command, dir, &mut written)?;
    print_line(&format!(
        "wrote {written} pages to {}: `man -l {}` shows the first",
        dir.display(),
        dir.join("marf.1").display()
    ));
    Ok(())
}

/// Writes the page of a command, and those of the commands below it.
fn write(command: &Command, dir: &Path, written: &mut u32) -> Result<(), Error> {
    let page = Man::new(command.clone());
    let mut bytes = Vec::new();
    page.render(&mut bytes)
        .map_err(|error| Error::failed(format!("a manual page cannot be made: {error}")))?;
    files::write(&dir.join(page.get_filename()), &bytes)?;
    *written += 1;
    let mut below = command
        .get_subcommands()
        .filter(|command| !command.is_hide_set() && command.get_name() != "help");
    below.try_for_each(|command| write(command, dir, written))
}
