//! Paths in manifests.

/// Returns a path as a manifest writes it: `%`, line feed and carriage return as `%25`, `%0A`, `%0D` (RFC 8493, 2.1.3).
pub fn encode_path(path: &str) -> String {
    path.replace('%', "%25").replace('\n', "%0A").replace('\r', "%0D")
}

/// Returns the path that a manifest writes as this.
pub fn decode_path(text: &str) -> String {
    let lines = text.replace("%0A", "\n").replace("%0a", "\n");
    let lines = lines.replace("%0D", "\r").replace("%0d", "\r");
    lines.replace("%25", "%")
}

/// Returns true if a path with `/` stays in its folder on every system: no empty, `.` or `..` part, no `\`,
/// `:` or NUL.
pub fn is_safe(path: &str) -> bool {
    let is_plain = |part: &str| !matches!(part, "" | "." | "..") && !part.contains(['\\', ':', '\0']);
    path.split('/').all(is_plain)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_paths_that_stay_in_their_folder_are_safe() {
        for safe in ["a", "data/x y.png", "a/...", "é"] {
            assert!(is_safe(safe), "{safe}");
        }
        for unsafe_path in [
            "", "/a", "a/", "a//b", "..", "a/../b", "./a", "a\\b", "c:/x", "a\0",
        ] {
            assert!(!is_safe(unsafe_path), "{unsafe_path}");
        }
    }

    proptest::proptest! {
        #[test]
        fn a_path_survives_a_manifest(path in "[a%0-9AD\r\n/é]{0,12}") {
            let encoded = encode_path(&path);
            proptest::prop_assert!(!encoded.contains(['\r', '\n']));
            proptest::prop_assert_eq!(decode_path(&encoded), path);
        }
    }
}
