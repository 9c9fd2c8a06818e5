//! A check of XML before it is parsed.

/// Returns the largest number of attributes of a tag, counted as `=` outside quotes.
pub(super) fn most_attributes(bytes: &[u8]) -> usize {
    let (mut rest, mut most) = (bytes, 0);
    while let Some(start) = rest.iter().position(|byte| *byte == b'<') {
        rest = &rest[start..];
        let skipped = [
            (&b"<!--"[..], &b"-->"[..]),
            (b"<![CDATA[", b"]]>"),
            (b"<?", b"?>"),
        ]
        .into_iter()
        .find(|(open, _)| rest.starts_with(open));
        if let Some((_, close)) = skipped {
            let end = rest.windows(close.len()).position(|window| window == close);
            rest = &rest[end.map_or(rest.len(), |end| end + close.len())..];
            continue;
        }
        let (attributes, length) = tag(rest);
        most = most.max(attributes);
        rest = &rest[length..];
    }
    most
}

/// Returns the attributes and the length of the tag at the start of `bytes`.
fn tag(bytes: &[u8]) -> (usize, usize) {
    let (mut quote, mut attributes) = (None, 0);
    for (index, byte) in bytes.iter().enumerate() {
        match (quote, byte) {
            (Some(open), byte) if open == *byte => quote = None,
            (Some(_), _) => {}
            (None, b'"' | b'\'') => quote = Some(*byte),
            (None, b'=') => attributes += 1,
            (None, b'>') => return (attributes, index + 1),
            _ => {}
        }
    }
    (attributes, bytes.len())
}
