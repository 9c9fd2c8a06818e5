use std::fs;
use std::path::Path;

use marf_stage::harness::Harness;
use marf_stage::{LOCK_FILE, StageError};

use super::*;
use crate::remote::catalog::SolFiles;

fn pin(byte: u8) -> Pin {
    Pin {
        bytes: 7,
        blake3: Digest::from_content(&[byte]),
        sha256: Sha256::from_content(&[byte]),
        url: "https://a.example/x \"y\".png".to_owned(),
        fetched: "2026-11-21T21:55:22Z".to_owned(),
        validators: Validators {
            etag: Some("\"1-2\"".to_owned()),
            modified: None,
        },
        listed: Some("2022-03-01T10:20".to_owned()),
        others: BTreeSet::from([Digest::from_content(b"other")]),
    }
}

fn pins() -> SolPins {
    SolPins {
        files: BTreeMap::from([("A.png".to_owned(), pin(1)), ("B.xml".to_owned(), pin(2))]),
        left_out: BTreeMap::from([("T.png".to_owned(), "thumbnail".to_owned())]),
        gone: BTreeMap::from([("G.png".to_owned(), 404)]),
        complete: Some("EDR ECM".to_owned()),
    }
}

fn lock(folder: &Path, archive: &str) -> Lock {
    Lock {
        path: folder.join(LOCK_FILE),
        archive: archive.to_owned(),
        asked: "pds mars \"x\"".to_owned(),
    }
}

fn write(lock: &Lock, sol: u32, base: &SolPins, pins: &SolPins) -> Result<Vec<SolPins>, StageError> {
    let change = Change {
        sol,
        base: base.clone(),
        pins: pins.clone(),
    };
    lock.write(&Harness::default().ctx(), vec![change])
}

fn read(lock: &Lock, sol: u32) -> Result<Option<SolPins>, StageError> {
    lock.open()?.pins(sol)
}

fn names(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).unwrap();
    let mut names: Vec<String> = entries
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    names
}

/// What an error says: message, cause and hint.
fn all_of(error: &StageError) -> String {
    format!("{error:?}")
}

/// Results are found by it.
#[test]
fn the_fingerprint_of_a_sol_stays_what_it_was() {
    let mut files = SolFiles::from_pins(&pins());
    assert_eq!(files.fingerprint(&pins()).short(), "e09f83a1e3cf");
    if let Some(file) = files.files.get_mut("A.png") {
        file.listed = Some("2023-01-01T00:00".to_owned());
    }
    assert_eq!(
        files.fingerprint(&pins()).short(),
        "fddb0b34b4e3",
        "listed as changed"
    );
}

#[test]
fn what_is_written_is_read_by_sol() {
    let dir = tempfile::tempdir().unwrap();
    for name in ["jezero", "a.b c", "\"", "é", "", "Jezero", "../up"] {
        let lock = lock(dir.path(), name);
        assert_eq!(read(&lock, 1).unwrap(), None, "{name}");
        for sol in [1, 12, 100_000, u32::MAX] {
            write(&lock, sol, &SolPins::default(), &pins()).unwrap();
            assert_eq!(read(&lock, sol).unwrap(), Some(pins()), "{name}");
        }
        assert_eq!(
            *lock.open().unwrap().sols(),
            BTreeSet::from([1, 12, 100_000, u32::MAX])
        );
    }
    assert_eq!(names(dir.path()), [LOCK_FILE]);
    let folders = names(&dir.path().join(LOCK_FILE));
    assert_eq!(
        folders.len(),
        8,
        "a folder an archive, and the README: {folders:?}"
    );
    let text = fs::read_to_string(dir.path().join(LOCK_FILE).join("jezero/sol-00012.toml")).unwrap();
    let products: Vec<&str> = text.lines().filter(|line| line.contains("name = ")).collect();
    let starts = ["A.png", "B.xml", "G.png", "T.png"].map(|name| format!("  {{ name = \"{name}\", "));
    assert_eq!(products.len(), starts.len(), "one line a product: {text}");
    assert!(
        products
            .iter()
            .zip(&starts)
            .all(|(line, start)| line.starts_with(start)),
        "{text}"
    );
}

#[test]
fn a_sol_writes_its_own_file_and_nothing_else() {
    let dir = tempfile::tempdir().unwrap();
    let lock = lock(dir.path(), "a");
    for sol in [1, 2] {
        write(&lock, sol, &SolPins::default(), &pins()).unwrap();
    }
    // Bytes that no writer would choose stay as they are.
    let other = dir.path().join(LOCK_FILE).join("a/sol-00002.toml");
    let text = fs::read_to_string(&other).unwrap() + "# by hand\n";
    fs::write(&other, &text).unwrap();
    let mut changed = pins();
    changed.gone.clear();
    write(&lock, 1, &pins(), &changed).unwrap();
    write(&lock, 2, &pins(), &pins()).unwrap();
    assert_eq!(
        fs::read_to_string(&other).unwrap(),
        text,
        "writing the same changes nothing"
    );
    assert_eq!(read(&lock, 1).unwrap(), Some(changed));
}

#[test]
fn two_pipelines_that_ask_an_archive_of_one_name_for_other_things_have_a_folder_each() {
    let dir = tempfile::tempdir().unwrap();
    let first = lock(dir.path(), "a");
    let second = Lock {
        asked: "pds venus".to_owned(),
        ..first.clone()
    };
    write(&first, 1, &SolPins::default(), &pins()).unwrap();
    let other = second.open().unwrap().other;
    assert_eq!(other.as_deref(), Some("pds mars \"x\""));
    write(&second, 1, &SolPins::default(), &SolPins::default()).unwrap();
    write(&second, 2, &SolPins::default(), &pins()).unwrap();
    assert_eq!(read(&first, 1).unwrap(), Some(pins()));
    assert_eq!(read(&first, 2).unwrap(), None);
    assert_eq!(read(&second, 2).unwrap(), Some(pins()));
    assert_eq!(second.open().unwrap().other, None);
}

#[test]
fn many_writers_of_one_sol_lose_nothing() {
    let dir = tempfile::tempdir().unwrap();
    let lock = &lock(dir.path(), "a");
    std::thread::scope(|scope| {
        for writer in 0..8_u8 {
            scope.spawn(move || {
                // Each starts from nothing, as processes do that were started together.
                let mut base = SolPins::default();
                for number in 0..8_u8 {
                    let mut mine = base.clone();
                    mine.files
                        .insert(format!("{writer}-{number}.png"), pin(writer * 8 + number));
                    base = write(lock, 5, &base, &mine).unwrap().remove(0);
                }
                write(lock, u32::from(writer), &SolPins::default(), &pins()).unwrap();
            });
        }
    });
    let merged = read(lock, 5).unwrap().unwrap();
    assert_eq!(merged.files.len(), 64 + pins().files.len());
    assert_eq!(lock.open().unwrap().sols().len(), 8);
    assert_eq!(names(&lock.path), ["README", "a"], "nothing unfinished is left");
}

#[test]
fn two_changes_of_a_sol_are_merged_product_by_product() {
    let dir = tempfile::tempdir().unwrap();
    let lock = lock(dir.path(), "a");
    let base = pins();
    write(&lock, 1, &SolPins::default(), &base).unwrap();
    let (mut ours, mut theirs) = (base.clone(), base.clone());
    theirs.files.insert("C.png".to_owned(), pin(3));
    theirs.files.insert("D.png".to_owned(), pin(4));
    theirs.gone.clear();
    theirs.complete = None;
    ours.files.remove("B.xml");
    ours.files.insert("D.png".to_owned(), pin(5));
    ours.files.insert("G.png".to_owned(), pin(6));
    ours.gone.clear();
    write(&lock, 1, &base, &theirs).unwrap();
    let merged = write(&lock, 1, &base, &ours).unwrap().remove(0);
    assert_eq!(read(&lock, 1).unwrap(), Some(merged.clone()));
    let known: Vec<&str> = merged.files.keys().map(String::as_str).collect();
    assert_eq!(known, ["A.png", "C.png", "D.png", "G.png"]);
    let both = &merged.files["D.png"];
    assert_eq!(both.blake3, pin(4).blake3, "what was written first stays in use");
    assert!(both.others.contains(&pin(5).blake3), "the other bytes are kept");
    assert!(merged.gone.is_empty());
    assert_eq!(
        merged.complete, None,
        "theirs was not complete, and ours did not make it so"
    );
}

#[test]
fn a_file_that_cannot_be_read_is_named_with_its_line_and_the_way_out() {
    let dir = tempfile::tempdir().unwrap();
    let lock = lock(dir.path(), "a");
    for sol in [1, 2] {
        write(&lock, sol, &SolPins::default(), &pins()).unwrap();
    }
    let path = lock.path.join("a/sol-00001.toml");
    let good = fs::read_to_string(&path).unwrap();
    let conflict = good.replacen("  {", "<<<<<<< HEAD\n  {", 1);
    let line = |start: &str| good.lines().find(|line| line.contains(start)).unwrap().to_owned();
    let twice = good.replace("]\n", &format!("{}\n]\n", line("A.png")));
    let cases = [
        (conflict, 6, "the conflict is not resolved"),
        (
            good.replace("version = 2", "version = 3"),
            2,
            "a newer marf wrote it",
        ),
        (
            good.replace("version = 2", "version = 3\nwhat = 1"),
            2,
            "a newer marf wrote it",
        ),
        (good.replace("sol = 1\n", "sol = 7\n"), 3, "it is of sol 7"),
        (good.replace("bytes = 7", "bytes = seven"), 6, ""),
        (
            good.replacen("blake3 = \"", "blake3 = \"x", 1),
            6,
            "the line of `A.png` is not whole",
        ),
        (
            good.replace("name = \"B.xml\"", "what = 1, name = \"B.xml\""),
            7,
            "unknown field",
        ),
        (good[..good.len() / 2].to_owned(), 6, "unclosed array"),
        (twice, 10, "`A.png` is there twice"),
        (String::new(), 1, "missing field `version`"),
    ];
    for (text, line, cause) in cases {
        fs::write(&path, &text).unwrap();
        let error = all_of(&read(&lock, 1).unwrap_err());
        assert!(
            error.contains("sol-00001.toml") && error.contains(&format!("line {line},")),
            "{error}"
        );
        assert!(
            error.contains(cause) && error.contains("version control"),
            "{cause}: {error}"
        );
        let refused = write(&lock, 1, &SolPins::default(), &pins()).unwrap_err();
        assert!(
            all_of(&refused).contains(&format!("line {line},")),
            "never written over: {refused:?}"
        );
        assert_eq!(fs::read_to_string(&path).unwrap(), text);
        assert_eq!(read(&lock, 2).unwrap(), Some(pins()), "only that sol fails");
    }
    fs::write(&path, b"version = 2\nsol = 1\n\xff\n").unwrap();
    assert!(all_of(&read(&lock, 1).unwrap_err()).contains("line 3 is not UTF-8"));
    let asked = lock.path.join("a/archive.toml");
    fs::write(&asked, "version = 9\n").unwrap();
    let error = all_of(&lock.open().unwrap_err());
    assert!(
        error.contains("archive.toml") && error.contains("line 1,"),
        "{error}"
    );
}

#[test]
fn what_waits_for_another_writer_can_be_stopped() {
    let dir = tempfile::tempdir().unwrap();
    let lock = lock(dir.path(), "a");
    write(&lock, 1, &SolPins::default(), &pins()).unwrap();
    let held = fs::File::open(lock.path.join("README")).unwrap();
    held.lock().unwrap();
    let harness = Harness::default();
    harness.cancel.set();
    let change = Change {
        sol: 2,
        base: SolPins::default(),
        pins: pins(),
    };
    assert!(matches!(
        lock.write(&harness.ctx(), vec![change]),
        Err(StageError::Cancelled)
    ));
    drop(held);
    assert_eq!(read(&lock, 2).unwrap(), None);
}
