//! Names and messages as people see them: no character acts, hides or turns round what stands next to it.

use std::borrow::Cow;

/// Escapes control characters, line feeds too, and characters that change the direction or the lines of a text: `\n`, `\u{1b}`,
/// `\u{202e}`.
pub fn visible(text: &str) -> Cow<'_, str> {
    escaped(text, acts, |char| char.escape_default().to_string())
}

/// Escapes the same characters in a JSON document or a page, which has line feeds of its own. `escape` gives the form of the document.
pub fn visible_document(text: &str, escape: impl Fn(char) -> String) -> Cow<'_, str> {
    escaped(text, |char| acts(char) && char != '\n' && char != '\t', escape)
}

fn escaped(text: &str, acts: impl Fn(char) -> bool, escape: impl Fn(char) -> String) -> Cow<'_, str> {
    if !text.contains(&acts) {
        return Cow::Borrowed(text);
    }
    let mut seen = String::with_capacity(text.len() + 16);
    for char in text.chars() {
        if acts(char) {
            seen += &escape(char);
        } else {
            seen.push(char);
        }
    }
    Cow::Owned(seen)
}

/// Returns true for a control character, a mark or override of direction, and a separator of lines.
fn acts(char: char) -> bool {
    char.is_control()
        || matches!(
            char,
            '\u{61c}' | '\u{200e}' | '\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2066}'..='\u{2069}'
        )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_character_of_a_name_acts_and_ordinary_names_are_unchanged() {
        for (name, expected) in [
            ("a\u{1b}[2J\r\nholds\t", "a\\u{1b}[2J\\r\\nholds\\t"),
            ("a\u{202e}gnp.exe", "a\\u{202e}gnp.exe"),
            ("\u{9b}31m\u{7f}", "\\u{9b}31m\\u{7f}"),
            (
                "\u{2066}\u{2069}\u{61c}\u{2028}",
                "\\u{2066}\\u{2069}\\u{61c}\\u{2028}",
            ),
        ] {
            assert_eq!(visible(name), expected);
        }
        for name in ["Fotos/Ärger 火星 \\n.png", "דוגמה.jpg", ""] {
            assert!(matches!(visible(name), Cow::Borrowed(_)), "{name}");
        }
    }

    #[test]
    fn a_document_keeps_its_lines_and_has_its_own_form_of_escapes() {
        let escape = |char| format!("\\u{:04x}", u32::from(char));
        let json = "{\n\t\"name\": \"a\u{202e}\u{7f}\"\n}";
        assert_eq!(
            visible_document(json, escape),
            "{\n\t\"name\": \"a\\u202e\\u007f\"\n}"
        );
    }
}
