//! The command and the archives of a run as its record keeps them: without folders of a machine.

use std::path::{Path, PathBuf};

use serde_json::Value;

/// Returns the words of a command in one line. Absolute paths in it become relative to the folder of the pipeline. Only the last part of a
/// path elsewhere is kept, so that a record names no folder of a machine.
pub fn recorded_command(words: &[String], pipeline: &Path) -> String {
    let folder = folder_of(pipeline);
    let words: Vec<String> = words.iter().map(|word| without_folders(word, folder)).collect();
    words.join(" ")
}

/// Shortens the paths of archives in a value, as [`recorded_command`] does.
pub fn forget_folders(archives: &mut Value, pipeline: &Path) {
    match archives {
        Value::String(text) => *text = shortened(text, folder_of(pipeline)),
        Value::Array(values) => values
            .iter_mut()
            .for_each(|value| forget_folders(value, pipeline)),
        Value::Object(table) => table
            .values_mut()
            .for_each(|value| forget_folders(value, pipeline)),
        _ => {}
    }
}

/// Returns the text of a pipeline with the paths of its archives as [`forget_folders`] writes them.
pub fn without_archive_folders(text: &str, archives: &Value, pipeline: &Path) -> String {
    match archives {
        Value::String(path) => ['"', '\''].iter().fold(text.to_owned(), |text, quote| {
            let short = shortened(path, folder_of(pipeline));
            text.replace(
                &format!("{quote}{path}{quote}"),
                &format!("{quote}{short}{quote}"),
            )
        }),
        Value::Array(values) => values.iter().fold(text.to_owned(), |text, value| {
            without_archive_folders(&text, value, pipeline)
        }),
        Value::Object(table) => table.values().fold(text.to_owned(), |text, value| {
            without_archive_folders(&text, value, pipeline)
        }),
        _ => text.to_owned(),
    }
}

fn folder_of(pipeline: &Path) -> &Path {
    match pipeline.parent() {
        Some(parent) if parent != Path::new("") => parent,
        _ => Path::new("."),
    }
}

/// Shortens the paths of one word: `/a/b`, `-C/a/b`, `--file=/a/b`, `node.key="/a/b"`, `node.key=["/a/b", "/c"]`.
fn without_folders(word: &str, folder: &Path) -> String {
    if word.contains('"') {
        let texts = word.split('"').map(|text| shortened(text, folder));
        return texts.collect::<Vec<_>>().join("\"");
    }
    let is_option = word.starts_with('-') && word.get(2..3) == Some("/");
    let value = if is_option {
        2
    } else {
        word.find('=').map_or(0, |at| at + 1)
    };
    let (name, value) = if word.starts_with('/') {
        ("", word)
    } else {
        word.split_at(value)
    };
    name.to_owned() + &shortened(value, folder)
}

/// Shortens a text that is an absolute path or the address of a folder.
fn shortened(text: &str, folder: &Path) -> String {
    if let Some(path) = text.strip_prefix("file://") {
        return format!("file://{}", shortened(path, folder));
    }
    let path = Path::new(text);
    if !path.is_absolute() {
        return text.to_owned();
    }
    let lexical = |path: &Path| std::path::absolute(path).ok();
    let resolved = |path: &Path| path.canonicalize().ok();
    let below = |form: &dyn Fn(&Path) -> Option<PathBuf>| {
        let (path, folder) = (form(path)?, form(folder)?);
        path.strip_prefix(folder).ok().map(Path::to_owned)
    };
    let last = || path.file_name().map(PathBuf::from);
    let short = below(&lexical).or_else(|| below(&resolved)).or_else(last);
    match short.unwrap_or_default() {
        short if short.as_os_str().is_empty() => ".".to_owned(),
        short => {
            let parts: Vec<_> = short.iter().map(|part| part.to_string_lossy()).collect();
            parts.join("/")
        }
    }
}

#[cfg(test)]
#[cfg(unix)]
mod tests {
    use super::*;

    #[test]
    fn absolute_paths_are_told_from_the_folder_of_the_pipeline_or_by_their_last_part() {
        let dir = tempfile::tempdir().unwrap();
        let project = dir.path().join("my project");
        std::fs::create_dir(&project).unwrap();
        std::os::unix::fs::symlink(&project, dir.path().join("link")).unwrap();
        let here = |rest: &str| format!("{}{rest}", project.display());
        let linked = format!("{}/link", dir.path().display());
        let words = [
            (here("/photos"), "photos"),
            (here(""), "."),
            (linked, "."),
            (format!("-C{}", here("/a")), "-Ca"),
            (format!("--file={}", here("/b.toml")), "--file=b.toml"),
            (
                format!("archive.folder.path={}", here("/p q")),
                "archive.folder.path=p q",
            ),
            ("fit.init=\"/home/me/a b.ply\"".to_owned(), "fit.init=\"a b.ply\""),
            ("x.y=[\"/home/me/a\", \"b\"]".to_owned(), "x.y=[\"a\", \"b\"]"),
            (
                "--remote=file:///home/me/store".to_owned(),
                "--remote=file://store",
            ),
            ("file:///home/me/store".to_owned(), "file://store"),
            ("/home/me/a=b".to_owned(), "a=b"),
            ("/".to_owned(), "."),
            ("s3://bucket/runs".to_owned(), "s3://bucket/runs"),
            (
                "https://pds.nasa.gov/data".to_owned(),
                "https://pds.nasa.gov/data",
            ),
            ("../photos".to_owned(), "../photos"),
            ("archive.demo.sols=1..=3".to_owned(), "archive.demo.sols=1..=3"),
            ("é=1".to_owned(), "é=1"),
            ("-é/x".to_owned(), "-é/x"),
        ];
        let file = project.join("pipeline.toml");
        for (word, expected) in words {
            assert_eq!(recorded_command(&[word], &file), expected);
        }
        let mut archives =
            serde_json::json!({"a": {"kind": "folder", "paths": [here("/photos"), "/home/me/b", "c"]}});
        let text = format!(
            "paths = [\"{}\", '/home/me/b', \"c\"] # /home/me/b",
            here("/photos")
        );
        assert_eq!(
            without_archive_folders(&text, &archives, &file),
            "paths = [\"photos\", 'b', \"c\"] # /home/me/b"
        );
        forget_folders(&mut archives, &file);
        assert_eq!(archives["a"]["paths"], serde_json::json!(["photos", "b", "c"]));
        let two = ["run".to_owned(), here("/x")];
        assert_eq!(recorded_command(&two, &file), "run x");
    }
}
