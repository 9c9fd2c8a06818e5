//! Printing: data to stdout, everything else to stderr.

use std::io::Write as _;

/// Prints a line to stdout; a reader that has gone away is not an error.
pub fn print_line(text: &str) {
    let _ = writeln!(std::io::stdout().lock(), "{text}");
}

/// Prints a line to stderr.
pub fn eprint_line(text: &str) {
    let _ = writeln!(std::io::stderr().lock(), "{text}");
}

/// Escapes control characters but the line feed.
pub fn escape_control(text: &str) -> String {
    let escape = |char: char| {
        if char.is_control() && char != '\n' {
            char.escape_default().to_string()
        } else {
            char.to_string()
        }
    };
    text.chars().map(escape).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn control_characters_are_escaped_and_line_feeds_are_kept() {
        assert_eq!(escape_control("é\u{1b}[2J\n\t"), "é\\u{1b}[2J\n\\t");
    }
}
