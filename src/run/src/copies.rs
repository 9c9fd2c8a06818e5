//! Copies of objects outside the store. They are marked with their object and run, if their format has a place for it.

use std::borrow::Cow;
use std::path::Path;

use marf_cache::Digest;
use marf_cache::file::{FileKind, Links, read};
use marf_provenance::stamp::Stamp;

/// Formats in which a mark disturbs no reader that we know.
const MARKED: [&str; 4] = ["html", "json", "ply", "png"];
/// Files whose readers refuse unknown keys.
const STRICT: [&str; 1] = ["scene.json"];

/// Returns the bytes that become a file: the object, with a mark where there is a place for one.
pub fn copy<'a>(path: &Path, object: &Digest, bytes: &'a [u8], run: Option<Digest>) -> Cow<'a, [u8]> {
    let extension = path.extension().unwrap_or_default();
    let name = path.file_name().unwrap_or_default();
    let has_place =
        MARKED.iter().any(|marked| extension == *marked) && !STRICT.iter().any(|strict| name == *strict);
    let marked = run.filter(|_| has_place).and_then(|run| {
        let object = *object;
        Stamp { object, run }.add_to(bytes)
    });
    marked.map_or(Cow::Borrowed(bytes), Cow::Owned)
}

/// Returns whether a file is a copy of an object, with a mark or without.
pub fn is_copy(path: &Path, object: &Digest) -> bool {
    let Ok(bytes) = read(path, FileKind::Result, Links::Followed) else {
        return false;
    };
    match Stamp::take_from(&bytes) {
        Some((bytes, stamp)) => stamp.object == *object && Digest::from_content(&bytes) == *object,
        None => Digest::from_content(&bytes) == *object,
    }
}

/// Returns the bytes of the object that a file is a copy of: the file without its mark.
pub fn object_of(file: Vec<u8>) -> Vec<u8> {
    match Stamp::take_from(&file) {
        Some((object, _)) => object,
        None => file,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_copy_is_known_again_and_a_changed_one_is_not() {
        let dir = tempfile::tempdir().unwrap();
        let bytes = b"{\"psnr\": 20}";
        let (object, run) = (Digest::from_content(bytes), Digest::from_content(b"run"));
        for (name, is_marked) in [
            ("metrics.json", true),
            ("scene.json", false),
            ("sol-00001.jsonl", false),
        ] {
            let path = dir.path().join(name);
            let copy = copy(&path, &object, bytes, Some(run));
            assert_eq!(copy.len() > bytes.len(), is_marked, "{name}");
            std::fs::write(&path, &copy).unwrap();
            assert!(is_copy(&path, &object), "{name}");
            std::fs::write(&path, String::from_utf8_lossy(&copy).replace("20", "21")).unwrap();
            assert!(!is_copy(&path, &object), "{name}");
        }
        assert_eq!(*copy(Path::new("metrics.json"), &object, bytes, None), *bytes);
        assert!(!is_copy(&dir.path().join("absent"), &object));
    }
}
