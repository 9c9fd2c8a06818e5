use marf_stage::LOCK_FILE;

use super::*;

fn pin(byte: u8) -> Pin {
    Pin {
        bytes: 7,
        blake3: Digest::of(&[byte]),
        url: "https://a.example/x \"y\".png".to_owned(),
        fetched: "2026-11-21T21:55:22Z".to_owned(),
        validators: Validators {
            etag: Some("\"1-2\"".to_owned()),
            modified: None,
        },
        listed: Some("2022-03-01T10:20".to_owned()),
        others: BTreeSet::from([Digest::of(b"other")]),
    }
}

fn pins() -> Pins {
    let sol = SolPins {
        files: BTreeMap::from([("A.png".to_owned(), pin(1)), ("B.xml".to_owned(), pin(2))]),
        left_out: BTreeMap::from([("T.png".to_owned(), "thumbnail".to_owned())]),
        gone: BTreeMap::from([("G.png".to_owned(), 404)]),
    };
    Pins {
        asked: "pds mars \"x\"".to_owned(),
        sols: BTreeMap::from([(1, sol.clone()), (12, sol)]),
    }
}

#[test]
fn what_is_written_is_read() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join(LOCK_FILE);
    assert_eq!(read(&path, "a").unwrap(), Pins::default());
    for name in ["jezero", "a.b c", "\"", "é", ""] {
        write(&path, name, &pins()).unwrap();
        assert_eq!(read(&path, name).unwrap(), pins(), "{name}");
    }
    let text = std::fs::read_to_string(&path).unwrap();
    assert_eq!(text.matches("\n[archive.").count(), 5, "{text}");
    assert_eq!(
        text.lines().filter(|line| line.contains("A.png")).count(),
        10,
        "one line a product"
    );
}

#[test]
fn another_archives_table_stays_to_the_byte() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join(LOCK_FILE);
    write(&path, "b", &pins()).unwrap();
    let before = std::fs::read_to_string(&path).unwrap();
    write(&path, "a", &Pins::default()).unwrap();
    write(&path, "c", &Pins::default()).unwrap();
    let after = std::fs::read_to_string(&path).unwrap();
    let table = &before[before.find("[archive.b]").unwrap()..];
    assert!(after.contains(table), "{after}");
    let order: Vec<_> = after.lines().filter(|line| line.starts_with('[')).collect();
    assert_eq!(order, ["[archive.a]", "[archive.b]", "[archive.c]"]);
    write(&path, "c", &Pins::default()).unwrap();
    assert_eq!(
        std::fs::read_to_string(&path).unwrap(),
        after,
        "writing the same changes nothing"
    );
}

#[test]
fn a_file_that_is_no_lock_is_refused_with_the_way_out() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join(LOCK_FILE);
    for (text, part) in [
        ("version = 2\n", "version is 2"),
        ("x", "TOML parse error"),
        (
            "version = 1\n[archive.a]\nasked = \"x\"\nproducts = [ { sol = 1, name = \"A\" } ]\n",
            "the line of `A`",
        ),
        (
            "version = 1\n[archive.a]\nasked = \"x\"\nproducts = [ { sol = 1, name = \"A\", what = 1 } ]\n",
            "unknown field",
        ),
    ] {
        std::fs::write(&path, text).unwrap();
        let error = read(&path, "a").unwrap_err();
        let StageError::Failed { .. } = &error else {
            panic!("{error:?}");
        };
        assert!(format!("{error:?}").contains(part), "{part}: {error:?}");
    }
}
