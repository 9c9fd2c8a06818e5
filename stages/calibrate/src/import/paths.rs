//! Paths that other programs write.

/// Some editors put it at the start of a text.
pub(super) const BYTE_ORDER_MARK: &[u8] = b"\xef\xbb\xbf";

/// Returns a path as the archive has it: relative to its root, with `/`. The path begins at `folder`, which ends with `/`.
///
/// A path from elsewhere (absolute, with a drive, or leading out of the archive by `..`) begins with `/`: only its tail means something
/// here. `None` for a path that names nothing.
pub(super) fn path(folder: &str, text: &str) -> Option<String> {
    let text = text.replace('\\', "/");
    let has_drive = text.as_bytes().get(1) == Some(&b':');
    let mut is_elsewhere = text.starts_with('/') || has_drive;
    let joined = if is_elsewhere {
        text
    } else {
        format!("{folder}{text}")
    };
    let mut parts: Vec<&str> = Vec::new();
    for part in joined.split('/') {
        match part {
            "" | "." => {}
            ".." => is_elsewhere |= parts.pop().is_none(),
            part => parts.push(part),
        }
    }
    let path = parts.join("/");
    let start = if is_elsewhere { "/" } else { "" };
    (!path.is_empty()).then(|| format!("{start}{path}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_path_is_relative_to_the_archive_or_begins_with_a_slash() {
        for (folder, text, expected) in [
            ("", "./a.jpg", Some("a.jpg")),
            ("sub/", "images//a.jpg", Some("sub/images/a.jpg")),
            ("sub/", "../b", Some("b")),
            ("sub/", "../../A/b.png", Some("/A/b.png")),
            ("sub/", "/home/x/../y/a.jpg", Some("/home/y/a.jpg")),
            ("sub/", "C:\\scan\\a.jpg", Some("/C:/scan/a.jpg")),
            ("", "\\\\server\\scan\\a.jpg", Some("/server/scan/a.jpg")),
            ("", "images\\a.jpg", Some("images/a.jpg")),
            ("", "", None),
            ("", "..", None),
        ] {
            assert_eq!(path(folder, text).as_deref(), expected, "{text}");
        }
    }
}
