//! Pipelines of one folder, for verbs that take one.

use std::path::{Path, PathBuf};

use marf_cache::file::{FileKind, Links, read};
use marf_calibrate::import::names_in_transforms;

use crate::error::{Diagnostic, Error};

/// The photos of a verb, and where the file with their cameras is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PhotoFolder {
    /// The folder with the photos.
    pub photos: PathBuf,
    /// The folder with the cameras, if it is another one.
    cameras: Option<PathBuf>,
    /// The file with the cameras, if it was given instead of its folder.
    file: Option<String>,
}

impl PhotoFolder {
    /// Returns the photos of a folder, or of a `transforms.json`.
    ///
    /// If that file names photos on this disk that are outside its folder, and none inside, they are read from there. So a verb can take
    /// `B` after `marf calibrate A --out B/transforms.json`.
    ///
    /// # Errors
    /// A file that is not a `transforms….json`.
    pub fn new(given: &Path) -> Result<Self, Error> {
        let (folder, file) = if given.is_file() {
            let file = given
                .file_name()
                .unwrap_or_default()
                .to_string_lossy()
                .into_owned();
            if !file.starts_with("transforms") || !file.ends_with(".json") {
                let message = format!("{} is a file, not a folder with photos", given.display());
                return Err(Error::Usage(Diagnostic::new(message).hint(
                    "give the folder with the photos, or a file with cameras named `transforms.json` or `transforms….json`",
                )));
            }
            let folder = given.parent().filter(|folder| !folder.as_os_str().is_empty());
            (folder.unwrap_or(Path::new(".")).to_owned(), Some(file))
        } else {
            (given.to_owned(), None)
        };
        let json = folder.join(file.as_deref().unwrap_or("transforms.json"));
        let (photos, cameras) = match folder_elsewhere(&folder, &json) {
            Some(photos) => (photos, Some(folder)),
            None => (folder, None),
        };
        Ok(Self {
            photos,
            cameras,
            file,
        })
    }

    /// Returns a pipeline that finds the cameras of the photos.
    pub fn calibration(&self, name: &str, method: &str) -> String {
        let (archive, beside) = match &self.cameras {
            Some(folder) => (
                format!(
                    "[archive.beside]\nkind = \"folder\"\npath = {}\n[node.beside]\nuses = \"extract\"\narchive = \"beside\"\n",
                    text(&folder.to_string_lossy())
                ),
                "beside",
            ),
            None => (String::new(), "extract"),
        };
        let file = self
            .file
            .as_ref()
            .map_or_else(String::new, |file| format!("file = {}\n", text(file)));
        format!(
            "{}{archive}[node.calibrate]\ninput = \"extract\"\ncameras = \"{beside}\"\nmethod = \"{method}\"\n{file}",
            photos(name, &self.photos)
        )
    }

    /// Returns a pipeline that takes the cameras of the photos from their labels, for each stop of the rover by itself: from one to the next
    /// labels know its position to decimetres only.
    pub fn stops(&self, name: &str) -> String {
        format!(
            "{}[node.scenes]\ninput = \"extract\"\nby = \"label\"\nmin_photos = 2\nmax_span_m = 0.001\n\
             [node.calibrate]\ninput = \"scenes\"\nmethod = \"labels\"\nhold_every = 0\nmin_registered = 1\n",
            photos(name, &self.photos)
        )
    }

    /// Returns a pipeline that finds the cameras of the photos and writes them for other programs. `photos_at` is the path of the photos'
    /// folder in transforms.json.
    pub fn cameras(&self, name: &str, method: &str, photos_at: &str, undistort: bool) -> String {
        format!(
            "{}[node.cameras]\ninput = \"calibrate\"\nphotos = \"extract\"\nphotos_at = {}\nundistort = {undistort}\n",
            self.calibration(name, method),
            text(photos_at)
        )
    }

    /// Returns a pipeline that trains a field on the photos, with cameras stored next to them or from structure from motion. Keys of the
    /// training may be appended.
    pub fn training(&self, name: &str) -> String {
        format!(
            "{}[node.train]\ninput = \"calibrate\"\n",
            self.calibration(name, "auto")
        )
    }
}

/// Returns a text as TOML has it.
fn text(value: &str) -> toml::Value {
    toml::Value::String(value.to_owned())
}

/// Returns the folder that holds all photos and masks that a transforms.json names, if they are on this disk and none is in its own folder.
fn folder_elsewhere(folder: &Path, json: &Path) -> Option<PathBuf> {
    let own = folder.canonicalize().ok()?;
    let names = names_in_transforms(&read(json, FileKind::Document, Links::Followed).ok()?);
    let on_disk = |name: &String| folder.join(name.replace('\\', "/")).canonicalize().ok();
    let files: Vec<PathBuf> = names
        .iter()
        .filter_map(on_disk)
        .filter(|file| file.is_file())
        .collect();
    let is_own = |file: &PathBuf| file.starts_with(&own);
    let elsewhere: Vec<&PathBuf> = files.iter().filter(|file| !is_own(file)).collect();
    let masks = own.join("masks");
    if files.iter().any(|file| is_own(file) && !file.starts_with(&masks)) {
        return None;
    }
    let mut shared = elsewhere.first()?.parent()?.to_owned();
    while !elsewhere.iter().all(|file| file.starts_with(&shared)) {
        shared = shared.parent()?.to_owned();
    }
    // Photos that share no folder but the root of the disk are not one archive.
    shared.parent().is_some().then_some(shared)
}

/// Returns the beginning of a pipeline with the photos of a folder.
pub fn photos(name: &str, dir: &Path) -> String {
    let path = toml::Value::String(dir.to_string_lossy().into_owned());
    format!(
        "name = \"{name}\"\n[archive.folder]\nkind = \"folder\"\npath = {path}\n[node.extract]\narchive = \"folder\"\n"
    )
}

/// Rewrites hints about the archive in pipeline.toml for a verb that has a folder instead.
pub fn for_folder(error: Error) -> Error {
    error.map_hint(|hint| {
        let hint = hint.replace("`path` of the archive", "DIR");
        hint.replace("`sols` of the archive", "`--set archive.folder.sols=…`")
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn folders() -> tempfile::TempDir {
        let dir = tempfile::tempdir().unwrap();
        for file in ["A/images/1.jpg", "A/images/2.jpg", "B/masks/1.png", "C/x.jpg"] {
            let path = dir.path().join(file);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, b"photo").unwrap();
        }
        dir
    }

    fn with_frames(folder: &Path, names: &[&str]) {
        let frames: Vec<serde_json::Value> = names
            .iter()
            .map(|name| serde_json::json!({"file_path": name, "mask_path": "masks/1.png"}))
            .collect();
        let json = serde_json::json!({ "frames": frames });
        std::fs::write(folder.join("transforms.json"), json.to_string()).unwrap();
    }

    #[test]
    fn photos_that_a_file_names_outside_its_folder_are_read_where_they_are() {
        let dir = folders();
        let (a, b) = (dir.path().join("A/images"), dir.path().join("B"));
        with_frames(&b, &["../A/images/1.jpg", "..\\A\\images\\2.jpg"]);
        for given in [b.clone(), b.join("transforms.json")] {
            let found = PhotoFolder::new(&given).unwrap();
            assert_eq!(found.photos, a.canonicalize().unwrap());
            let text = found.training("fit");
            assert!(
                text.contains("cameras = \"beside\"") && text.contains("method = \"auto\""),
                "{text}"
            );
            assert_eq!(
                text.contains("file = \"transforms.json\""),
                given.is_file(),
                "{text}"
            );
        }
        with_frames(&b, &[a.join("1.jpg").to_str().unwrap(), "/gone/2.jpg"]);
        assert_eq!(PhotoFolder::new(&b).unwrap().photos, a.canonicalize().unwrap());
    }

    #[test]
    fn photos_in_the_folder_or_nowhere_are_sought_in_the_folder() {
        let dir = folders();
        let c = dir.path().join("C");
        for names in [&["x.jpg", "../A/images/1.jpg"][..], &["/gone/1.jpg"]] {
            with_frames(&c, names);
            let found = PhotoFolder::new(&c).unwrap();
            assert_eq!(found.photos, c);
            assert!(found.training("fit").contains("cameras = \"extract\""));
        }
    }

    #[test]
    fn a_hint_about_the_archive_names_the_argument() {
        let hint = |text: &str| for_folder(Error::Failed(Diagnostic::new("x").hint(text)));
        for (text, said) in [
            ("set `path` of the archive to the folder", "set DIR to the folder"),
            (
                "widen `sols` of the archive",
                "widen `--set archive.folder.sols=…`",
            ),
            ("free space there", "free space there"),
        ] {
            assert_eq!(hint(text).diagnostic().unwrap().hint.as_deref(), Some(said));
        }
    }

    #[test]
    fn a_file_that_holds_no_cameras_is_refused_with_the_way_out() {
        let dir = folders();
        let error = PhotoFolder::new(&dir.path().join("C/x.jpg")).unwrap_err();
        let Error::Usage(diagnostic) = error else {
            panic!("{error:?}");
        };
        assert!(diagnostic.message.contains("is a file"), "{diagnostic:?}");
        assert!(diagnostic.hint.unwrap().contains("transforms.json"));
    }
}
