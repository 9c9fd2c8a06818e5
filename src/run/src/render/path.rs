//! The path of a rendering: one of those that a scene has, or a file of bookmarks.

use std::path::Path;

use marf_cache::Digest;
use marf_cache::file::{FileKind, Links, read as read_file};
use marf_scene::Scene;
use marf_scene::path::typical_camera;
use marf_schema::render::{PathKind, Place};
use serde::Deserialize;
use serde_json::{Value, json};

use crate::copies::object_of;
use crate::error::{Diagnostic, Error};
use marf_config::nearest::did_you_mean;

/// The paths that the command line has a word for, as pipeline.toml.
const PATHS: [PathKind; 4] = [
    PathKind::Train,
    PathKind::Heldout,
    PathKind::Flythrough,
    PathKind::Orbit,
];

/// The scene that a bookmark was set in.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct SetIn {
    run: u64,
    field: String,
    scene: Digest,
}

/// A camera of a file.
#[derive(Debug, Clone, Deserialize)]
struct Bookmark {
    #[serde(flatten)]
    place: Place,
    /// None in the `poses.json` of another render, and where somebody wrote it.
    of: Option<SetIn>,
}

/// Where the camera goes, and the scenes that a file's bookmarks were set in.
#[derive(Debug, Clone, PartialEq)]
pub struct PathWithOrigins {
    /// Where the camera goes.
    pub path: CameraPath,
    set_in: Vec<SetIn>,
}

impl PathWithOrigins {
    /// Returns a sentence on the bookmarks that were set in another scene than the one of this digest. None if there are no such bookmarks.
    pub fn of_other_scene(&self, scene: &Digest) -> Option<String> {
        let others: Vec<&SetIn> = self.set_in.iter().filter(|of| of.scene != *scene).collect();
        let SetIn { run, field, .. } = others.first()?;
        Some(format!(
            "{} of the bookmarks were set in another scene (`{field}` in run {run}): they look at the same things only where the frame of \
             the scene has stayed; `--run {run}` renders that one",
            others.len()
        ))
    }
}

/// Where the camera goes.
#[derive(Debug, Clone, PartialEq)]
pub enum CameraPath {
    /// A path that follows from the scene.
    OfScene(PathKind),
    /// To each of some cameras, at least one.
    Stills(Vec<Place>),
    /// Smoothly through some cameras, one at the least.
    Through(Vec<Place>),
}

/// Reads `--path`. `frames` is the number of pictures, if the user gave one.
///
/// # Errors
/// A text that is neither a word nor a file, or a file without bookmarks.
pub fn read(given: &str, frames: Option<u32>) -> Result<PathWithOrigins, Error> {
    if let Some(kind) = PATHS.iter().find(|kind| kind.name() == given) {
        let path = CameraPath::OfScene(*kind);
        return Ok(PathWithOrigins {
            path,
            set_in: Vec::new(),
        });
    }
    let bookmarks = bookmarks(Path::new(given))?;
    let set_in = bookmarks.iter().filter_map(|mark| mark.of.clone()).collect();
    let places = bookmarks.into_iter().map(|mark| mark.place).collect();
    let path = match frames {
        None => CameraPath::Stills(places),
        Some(_) => CameraPath::Through(places),
    };
    Ok(PathWithOrigins { path, set_in })
}

fn bookmarks(file: &Path) -> Result<Vec<Bookmark>, Error> {
    let name = file.display();
    let bytes = read_file(file, FileKind::Document, Links::Followed).map_err(|error| {
        let words = PATHS.map(PathKind::name);
        let near = did_you_mean(&name.to_string(), words);
        let all = format!("take one of {}, or a file of bookmarks", words.join(", "));
        let message = format!("--path {name}: not a path, and not a readable file: {error}");
        Error::Usage(Diagnostic::new(message).hint(near.unwrap_or(all)))
    })?;
    let refuse = |why: String| {
        let hint = "`marf view` saves bookmarks: Bookmarks, Add this view, Download as JSON";
        Error::Usage(Diagnostic::new(format!("--path {name}: {why}")).hint(hint))
    };
    let places: Vec<Bookmark> = serde_json::from_slice(&object_of(bytes))
        .map_err(|error| refuse(format!("it is not a list of bookmarks: {error}")))?;
    if places.is_empty() {
        return Err(refuse("it holds no bookmark".to_owned()));
    }
    Ok(places)
}

impl CameraPath {
    /// Returns whether a film is made: stills are looked at one by one.
    pub fn has_film(&self) -> bool {
        !matches!(self, Self::Stills(_))
    }

    /// Returns the keys of the node that say where the camera goes.
    pub fn keys(&self) -> Vec<(&'static str, Value)> {
        let (kind, keyframes) = match self {
            Self::OfScene(kind) => (*kind, None),
            Self::Stills(places) => (PathKind::Stills, Some(places)),
            Self::Through(places) => (PathKind::Keyframes, Some(places)),
        };
        let keyframes = keyframes.map(|places| ("keyframes", json!(places)));
        [("path", json!(kind))].into_iter().chain(keyframes).collect()
    }

    /// Returns the number of pictures: `asked`, else all photos for paths to photos. None lets the stage choose.
    pub fn frames(&self, asked: Option<u32>, scene: &Scene) -> Option<u32> {
        let all = || u32::try_from(scene.frames.len()).ok();
        match self {
            Self::OfScene(PathKind::Train | PathKind::Heldout) => asked.or_else(all),
            _ => asked,
        }
    }

    /// Returns width and height, pixels, of the pictures at full size: those of the first bookmark, or of a typical photo.
    pub fn natural_size(&self, scene: &Scene) -> [u32; 2] {
        let (Self::Stills(places) | Self::Through(places)) = self else {
            let mut widths: Vec<u32> = scene.frames.iter().map(|frame| frame.camera.width).collect();
            widths.sort_unstable();
            let width = widths.get(widths.len() / 2).copied().unwrap_or(1);
            return [width, typical_camera(scene, width).height];
        };
        places
            .first()
            .map_or([1, 1], |place| [place.camera.width, place.camera.height])
    }

    /// Returns the default width: that of the first bookmark. None for other paths, which use the default of the stage.
    pub fn default_width(&self) -> Option<u32> {
        match self {
            Self::OfScene(_) => None,
            Self::Stills(places) | Self::Through(places) => places.first().map(|place| place.camera.width),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refused(given: &str) -> Diagnostic {
        match read(given, None).unwrap_err() {
            Error::Usage(diagnostic) => diagnostic,
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn words_are_paths_and_what_is_neither_word_nor_file_is_told_with_the_nearest_word() {
        assert_eq!(
            read("flythrough", None).unwrap().path,
            CameraPath::OfScene(PathKind::Flythrough)
        );
        let error = refused("orbti");
        assert!(error.message.contains("--path orbti"), "{error:?}");
        assert_eq!(error.hint.as_deref(), Some("did you mean `orbit`?"));
        assert!(refused("no/such.json").hint.unwrap().contains("flythrough"));
    }

    #[test]
    fn bookmarks_are_stills_or_keyframes_and_an_empty_list_is_neither() {
        let dir = tempfile::tempdir().unwrap();
        let file = |name: &str, text: &str| {
            let path = dir.path().join(name);
            std::fs::write(&path, text).unwrap();
            path.display().to_string()
        };
        // As the page of `marf view` writes it.
        let one = r#"[{"name": "0001", "camera": {"width": 640, "height": 480, "fx_px": 500, "fy_px": 500, "cx_px": 320, "cy_px": 240},
            "cam_from_world": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 2.5]]}]"#;
        let good = file("good.json", one);
        let stills = read(&good, None).unwrap();
        assert!(
            !stills.path.has_film() && stills.path.default_width() == Some(640),
            "{stills:?}"
        );
        let film = read(&good, Some(24)).unwrap();
        assert!(film.path.has_film(), "{film:?}");
        let keys = film.path.keys();
        assert_eq!(keys[0], ("path", json!("keyframes")));
        assert_eq!(keys[1].1[0]["cam_from_world"][2][3], 2.5);
        assert_eq!(stills.of_other_scene(&Digest::from_content(b"any")), None);
        let scene = Digest::from_content(b"scene");
        let of = format!(r#"[{{"of": {{"run": 3, "field": "train", "scene": "{scene}"}}, "name""#);
        let named = read(&file("named.json", &one.replace(r#"[{"name""#, &of)), None).unwrap();
        assert_eq!(named.of_other_scene(&scene), None);
        let told = named.of_other_scene(&Digest::from_content(b"another")).unwrap();
        assert!(
            told.starts_with("1 of the bookmarks") && told.contains("`train` in run 3"),
            "{told}"
        );
        // The node gets only the camera: the key does not depend on where the bookmark was set.
        assert_eq!(named.path.keys(), stills.path.keys());
        for (text, word) in [
            ("[]", "no bookmark"),
            ("{}", "not a list"),
            ("[{\"name\": \"a\"}]", "camera"),
        ] {
            let error = refused(&file("bad.json", text));
            assert!(error.message.contains(word), "{text}: {error:?}");
            assert!(error.hint.unwrap().contains("Download as JSON"));
        }
    }
}
