//! Choice of the file next to the photos that holds the cameras.

use std::collections::{BTreeMap, BTreeSet};

use marf_cache::Digest;
use marf_stage::StageError;

use super::cameras::Role;

/// The chosen file or files.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Source {
    /// transforms.json, or the parts of a set split into training, validation and test.
    Transforms(Vec<(String, Role)>),
    /// A COLMAP model: cameras, images, points3D as `.bin`.
    Binary([String; 3]),
    /// The same as `.txt`.
    Text([String; 3]),
}

impl Source {
    /// The file that names the photos, for messages.
    pub fn name(&self) -> String {
        match self {
            Self::Transforms(names) => names.first().map(|(name, _)| name.clone()).unwrap_or_default(),
            Self::Binary(names) | Self::Text(names) => names[1].clone(),
        }
    }
}

/// Names and digests of the files next to the photos.
type Files = BTreeMap<String, Digest>;

/// The source that is used.
#[derive(Debug)]
pub(super) struct Chosen {
    pub source: Source,
    /// The file that names the photos.
    pub source_name: String,
    /// What else could have been used, where a model was preferred to others.
    pub choice: Option<String>,
}

impl Chosen {
    fn new(source: Source, choice: Option<String>) -> Self {
        Self {
            source_name: source.name(),
            source,
            choice,
        }
    }
}

/// Chooses the named file, or the first by [`rank`]: of programs that write a JSON and a model both are of one solution.
pub(super) fn choose(files: &Files, wanted: Option<&str>) -> Result<Chosen, StageError> {
    let mut candidates = candidates(files);
    if let Some(wanted) = wanted {
        let wanted = wanted.trim_start_matches("./").trim_end_matches('/');
        let source = named(files, wanted).ok_or_else(|| absent(files, wanted))?;
        return Ok(Chosen::new(source, None));
    }
    candidates.sort_by_key(|name| rank(name));
    let [first, others @ ..] = candidates.as_slice() else {
        return Err(none(files));
    };
    let equals = |name: &&String| is_json(first) && is_json(name) && folder(name) == folder(first);
    if others.iter().any(|name| equals(&name)) {
        return Err(StageError::new(format!(
            "{} files hold cameras: {}",
            candidates.len(),
            listed(candidates.iter())
        ))
        .hint(format!("choose one, for example `file = \"{first}\"`")));
    }
    let source = named(files, first).ok_or_else(|| absent(files, first))?;
    let passed: Vec<&String> = others
        .iter()
        .filter(|name| is_json(name) == is_json(first))
        .collect();
    let choice = (!passed.is_empty()).then(|| format!("not used: {}", listed(passed.iter().copied())));
    Ok(Chosen::new(source, choice))
}

fn is_json(name: &str) -> bool {
    name.ends_with(".json")
}

/// Returns the sort key of a file, the first is used: a JSON before models, then those at the top, in `sparse/0` and in `sparse`, then
/// those in fewer folders, then by name.
fn rank(name: &str) -> (bool, usize, usize, String) {
    const FIRST: [&str; 3] = ["", "sparse/0/", "sparse/"];
    let folder = folder(name);
    let place = FIRST
        .iter()
        .position(|first| *first == folder)
        .unwrap_or(FIRST.len());
    (!is_json(name), place, name.matches('/').count(), name.to_owned())
}

/// Returns the error if no file has cameras.
fn none(files: &Files) -> StageError {
    let what = if files.is_empty() {
        "no file next to the photos holds cameras".to_owned()
    } else {
        format!(
            "none of {} next to the photos holds cameras alone",
            listed(files.keys())
        )
    };
    StageError::new(what).hint(
        "put a transforms.json, or cameras and images of a COLMAP model (.bin or .txt, also in sparse/0, colmap/sparse/0 and the like), \
         into the archive's folder. \
         `marf calibrate DIR` finds the cameras of photos that have none, as `method = \"sfm\"` does",
    )
}

/// Returns the error if the named file is not there.
fn absent(files: &Files, wanted: &str) -> StageError {
    StageError::new(format!(
        "`{wanted}` is not a file with cameras next to the photos"
    ))
    .cause(format!("there are: {}", listed(files.keys())))
    .hint("change `file`")
}

/// At most eight names.
fn listed<'a>(names: impl ExactSizeIterator<Item = &'a String>) -> String {
    const MOST: usize = 8;
    let rest = names.len().saturating_sub(MOST);
    let mut text: Vec<String> = names.take(MOST).map(|name| format!("`{name}`")).collect();
    if rest > 0 {
        text.push(format!("{rest} more"));
    }
    text.join(", ")
}

/// Files that could be meant: every transforms.json, every first part of a split set, every COLMAP model once.
pub(super) fn candidates(files: &Files) -> Vec<String> {
    let is_json = |name: &&String| matches!(base(name), "transforms.json" | "transforms_train.json");
    let transforms = files.keys().filter(is_json).cloned();
    let folders: BTreeSet<String> = files.keys().map(|name| folder(name)).collect();
    let model = |folder: &String| {
        let complete = |kind| {
            names(folder, kind)
                .iter()
                .take(2)
                .all(|name| files.contains_key(name))
        };
        let kind = ["bin", "txt"].into_iter().find(|kind| complete(kind))?;
        let [cameras, _, _] = names(folder, kind);
        Some(cameras)
    };
    transforms.chain(folders.iter().filter_map(model)).collect()
}

/// Returns the source of a name: a JSON file, a file of a COLMAP model, or its folder.
fn named(files: &Files, wanted: &str) -> Option<Source> {
    if wanted.ends_with(".json") {
        return files.contains_key(wanted).then(|| transforms(files, wanted));
    }
    let kinds = ["bin", "txt"].into_iter();
    let folder_of = |kind: &str| {
        let file = names(&folder(wanted), kind).iter().any(|name| name == wanted);
        if file { folder(wanted) } else { prefix(wanted) }
    };
    let is_file = ["bin", "txt"]
        .into_iter()
        .find(|kind| wanted.ends_with(&format!(".{kind}")));
    for kind in kinds.filter(|kind| is_file.is_none_or(|one| one == *kind)) {
        let folder = folder_of(kind);
        let names = names(&folder, kind);
        if names.iter().take(2).all(|name| files.contains_key(name)) {
            return Some(match kind {
                "bin" => Source::Binary(names),
                _ => Source::Text(names),
            });
        }
    }
    None
}

/// A set split into `…_train`, `…_val` and `…_test` is one source, the last two for measuring.
fn transforms(files: &Files, wanted: &str) -> Source {
    let mut parts = vec![(wanted.to_owned(), Role::Open)];
    if let Some(start) = wanted.strip_suffix("_train.json") {
        let others = ["_val.json", "_test.json"].map(|end| format!("{start}{end}"));
        let others: Vec<_> = others
            .into_iter()
            .filter(|name| files.contains_key(name))
            .collect();
        if !others.is_empty() {
            parts[0].1 = Role::Train;
        }
        parts.extend(others.into_iter().map(|name| (name, Role::HeldOut)));
    }
    Source::Transforms(parts)
}

/// Returns the three files of a COLMAP model.
fn names(folder: &str, kind: &str) -> [String; 3] {
    ["cameras", "images", "points3D"].map(|name| format!("{folder}{name}.{kind}"))
}

/// Returns the last component of a path.
fn base(name: &str) -> &str {
    name.rsplit('/').next().unwrap_or(name)
}

/// The part up to and including the last slash. Empty at the top.
pub(super) fn folder(name: &str) -> String {
    name[..name.len() - base(name).len()].to_owned()
}

/// Returns a folder with its slash.
fn prefix(folder: &str) -> String {
    if folder.is_empty() || folder == "." {
        String::new()
    } else {
        format!("{folder}/")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn files(names: &[&str]) -> Files {
        names
            .iter()
            .map(|name| ((*name).to_owned(), Digest::from_content(name.as_bytes())))
            .collect()
    }

    fn used(names: &[&str]) -> Chosen {
        choose(&files(names), None).unwrap()
    }

    #[test]
    fn the_only_file_is_taken_and_of_several_the_json() {
        let one = used(&["transforms.json", "notes.txt"]);
        assert_eq!(
            one.source,
            Source::Transforms(vec![("transforms.json".to_owned(), Role::Open)])
        );
        let model = [
            "sparse/0/cameras.bin",
            "sparse/0/images.bin",
            "sparse/0/cameras.txt",
            "sparse/0/images.txt",
        ];
        assert!(
            matches!(used(&model).source, Source::Binary([cameras, ..]) if cameras == "sparse/0/cameras.bin")
        );
        let mut both = files(&model);
        both.extend(files(&["transforms.json"]));
        let chosen = choose(&both, None).unwrap();
        assert_eq!((chosen.source, chosen.choice), (one.source, None));
        let split = files(&["transforms.json", "transforms_train.json"]);
        let error = choose(&split, None).unwrap_err().to_string();
        assert!(
            error.contains("`transforms.json`") && error.contains("`transforms_train.json`"),
            "{error}"
        );
        for (wanted, text) in [
            ("sparse/0", false),
            ("sparse/0/images.txt", true),
            ("./sparse/0/", false),
        ] {
            let source = choose(&both, Some(wanted)).unwrap().source;
            assert_eq!(matches!(source, Source::Text(_)), text, "{wanted}");
        }
    }

    #[test]
    fn of_several_models_the_usual_one_is_used_and_the_others_are_named() {
        let model = |folders: &[&str]| {
            let both = |folder: &&str| [format!("{folder}cameras.txt"), format!("{folder}images.txt")];
            let names: Vec<String> = folders.iter().flat_map(both).collect();
            used(&names.iter().map(String::as_str).collect::<Vec<_>>())
        };
        for (folders, expected) in [
            (&["colmap/sparse/0/"][..], "colmap/sparse/0/"),
            (&["colmap_text/"], "colmap_text/"),
            (&["dense/sparse/", "sparse/0/", "sparse/1/"], "sparse/0/"),
            (&["colmap/sparse/0/", "colmap/sparse/1/"], "colmap/sparse/0/"),
            (&["distorted/sparse/0/", "sparse/"], "sparse/"),
        ] {
            let chosen = model(folders);
            assert_eq!(chosen.source_name, format!("{expected}images.txt"));
            assert_eq!(chosen.choice.is_some(), folders.len() > 1, "{chosen:?}");
        }
        let choice = model(&["sparse/1/", "sparse/0/"]).choice.unwrap();
        assert_eq!(choice, "not used: `sparse/1/cameras.txt`");
        let chosen = used(&["transforms.json", "colmap/transforms.json"]);
        assert_eq!(chosen.source_name, "transforms.json");
        assert_eq!(chosen.choice.unwrap(), "not used: `colmap/transforms.json`");
    }

    #[test]
    fn what_is_not_there_is_named_with_what_is() {
        let StageError::Failed { message, hint, .. } = choose(&files(&["cameras.bin"]), None).unwrap_err()
        else {
            panic!("no failure")
        };
        assert_eq!(
            message,
            "none of `cameras.bin` next to the photos holds cameras alone"
        );
        assert!(
            hint.unwrap()
                .starts_with("put a transforms.json, or cameras and images of a COLMAP model")
        );
        // What the hint names is used.
        for model in ["", "sparse/0/", "colmap/sparse/0/"] {
            for ending in ["bin", "txt"] {
                let named = ["cameras", "images"].map(|name| format!("{model}{name}.{ending}"));
                used(&named.each_ref().map(String::as_str));
            }
        }
        let error = choose(&files(&[]), None).unwrap_err().to_string();
        assert!(
            error.contains("no file next to the photos holds cameras"),
            "{error}"
        );
        let error = choose(&files(&["transforms.json"]), Some("other.json"))
            .unwrap_err()
            .to_string();
        assert!(error.contains("`other.json`"), "{error}");
    }

    #[test]
    fn the_parts_of_a_split_set_come_together() {
        let set = files(&[
            "transforms_test.json",
            "transforms_train.json",
            "transforms_val.json",
        ]);
        let Source::Transforms(parts) = choose(&set, None).unwrap().source else {
            panic!("no transforms");
        };
        let roles: Vec<Role> = parts.iter().map(|part| part.1).collect();
        assert_eq!(roles, [Role::Train, Role::HeldOut, Role::HeldOut]);
        let alone = used(&["transforms_train.json"]).source;
        assert_eq!(
            alone,
            Source::Transforms(vec![("transforms_train.json".to_owned(), Role::Open)])
        );
    }
}
