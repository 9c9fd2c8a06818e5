//! A check of XML before it is parsed: the parser takes more than linear time for nested and repeated names.

/// Deepest nesting of elements. Real labels have at most 10 levels.
const MAX_DEPTH: usize = 100;
/// Most attributes of one element. Real labels have up to 30.
const MAX_ATTRIBUTES: usize = 1_000;
/// Most comparisons of names. Real labels take up to 18,000.
const MAX_COMPARISONS: usize = 20_000_000;

/// A limit that is exceeded.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum TooMuchWork {
    /// An element whose number of attributes would keep the parser busy.
    #[error("an element has more than {MAX_ATTRIBUTES} attributes")]
    Attributes,
    /// Elements whose nesting would keep the parser busy.
    #[error("elements are nested more than {MAX_DEPTH} deep")]
    Depth,
    /// Names that would keep the parser busy.
    #[error("its attributes and namespaces take more than {MAX_COMPARISONS} comparisons")]
    Namespaces,
}

/// The start tag of an element, or its end.
#[derive(Debug, Default, Clone, Copy)]
struct Tag {
    /// Bytes with both brackets.
    length: usize,
    /// `=` outside quotes.
    attributes: usize,
    /// Attributes that declare a namespace.
    declared: usize,
    /// It closes an element.
    closes: bool,
    /// It is an element without content.
    empty: bool,
}

/// Checks what decides how long the parser works.
///
/// The parser compares each attribute with all others of its element, each prefix with the namespaces in scope, and all
/// namespaces in scope with each other where an element declares one.
///
/// # Errors
/// The first limit that is exceeded.
pub(super) fn check(bytes: &[u8]) -> Result<(), TooMuchWork> {
    // Namespaces in scope, per open element.
    let mut scopes = vec![0];
    let (mut rest, mut comparisons) = (bytes, 0_usize);
    while let Some(start) = rest.iter().position(|byte| *byte == b'<') {
        rest = &rest[start..];
        if let Some(length) = skipped(rest) {
            rest = &rest[length..];
            continue;
        }
        let tag = tag(rest);
        rest = &rest[tag.length..];
        if tag.closes {
            scopes.pop();
            continue;
        }
        if tag.attributes > MAX_ATTRIBUTES {
            return Err(TooMuchWork::Attributes);
        }
        let scope = scopes.last().unwrap_or(&0) + tag.declared;
        let lookups = if tag.declared > 0 { scope } else { 0 } + tag.attributes + 1;
        comparisons = comparisons.saturating_add(scope * lookups + tag.attributes * tag.attributes);
        if comparisons > MAX_COMPARISONS {
            return Err(TooMuchWork::Namespaces);
        }
        if tag.empty {
            continue;
        }
        scopes.push(scope);
        if scopes.len() > MAX_DEPTH + 1 {
            return Err(TooMuchWork::Depth);
        }
    }
    Ok(())
}

/// Returns the length of a comment, of characters as they are, or of an instruction.
fn skipped(bytes: &[u8]) -> Option<usize> {
    let kinds = [
        (&b"<!--"[..], &b"-->"[..]),
        (b"<![CDATA[", b"]]>"),
        (b"<?", b"?>"),
    ];
    let (open, close) = kinds.into_iter().find(|(open, _)| bytes.starts_with(open))?;
    let content = &bytes[open.len()..];
    let end = content.windows(close.len()).position(|window| window == close);
    Some(end.map_or(bytes.len(), |end| open.len() + end + close.len()))
}

/// Reads the tag at the start of `bytes`.
fn tag(bytes: &[u8]) -> Tag {
    let mut tag = Tag {
        length: bytes.len(),
        closes: bytes.starts_with(b"</"),
        ..Tag::default()
    };
    let mut quote = None;
    for (index, byte) in bytes.iter().enumerate() {
        match (quote, byte) {
            (Some(open), byte) if open == *byte => quote = None,
            (Some(_), _) => {}
            (None, b'"' | b'\'') => quote = Some(*byte),
            (None, b'=') => tag.attributes += 1,
            (None, b'x') if bytes[index..].starts_with(b"xmlns") => tag.declared += 1,
            (None, b'>') => {
                tag.length = index + 1;
                tag.empty = bytes[index - 1] == b'/';
                return tag;
            }
            _ => {}
        }
    }
    tag
}

#[cfg(test)]
mod tests;
