//! Printing: data to stdout, everything else to stderr. Every text is escaped here, so that no name in it can drive the terminal or look
//! like a line of this program.

use std::io::Write as _;

use marf_report::{visible, visible_document};

/// Prints a line to stdout. A reader that has gone away is not an error.
pub fn print_line(text: &str) {
    let _ = writeln!(std::io::stdout().lock(), "{}", visible(text));
}

/// Prints lines to stdout.
pub fn print_lines(lines: impl IntoIterator<Item = impl AsRef<str>>) {
    lines.into_iter().for_each(|line| print_line(line.as_ref()));
}

/// Prints a line to stderr.
pub fn eprint_line(text: &str) {
    let _ = writeln!(std::io::stderr().lock(), "{}", visible(text));
}

/// Prints a JSON document to stdout.
pub fn print_document(json: &str) {
    let escape = |char| format!("\\u{:04x}", u32::from(char));
    let _ = writeln!(std::io::stdout().lock(), "{}", visible_document(json, escape));
}

/// Prints a text of this program, in which there is no name of a file, as it is.
pub fn print_own(text: &str) {
    let _ = writeln!(std::io::stdout().lock(), "{text}");
}
