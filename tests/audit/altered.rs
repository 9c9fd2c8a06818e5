//! Which command finds a file that was altered in one bit.

use marf_loopback::Server;
use serde_json::Value;

use super::common::{copy, marf};
use super::{files, ran};

/// An entry of a pack: its kind, its id and where its payload lies.
struct Entry {
    kind: u8,
    id: String,
    payload: std::ops::Range<usize>,
}

/// Returns the entries of a pack, as docs/design/packs-and-records.md describes it, and the offset of its table.
fn entries(pack: &[u8]) -> (Vec<Entry>, usize) {
    let number = |at: usize, bytes: usize| -> usize {
        pack[at..at + bytes]
            .iter()
            .rev()
            .fold(0, |number, byte| number << 8 | usize::from(*byte))
    };
    let (mut at, table, mut found) = (12, number(pack.len() - 52, 8), Vec::new());
    while at < table {
        let payload = at + 37..at + 37 + number(at + 33, 4);
        found.push(Entry {
            kind: pack[at],
            id: pack[at + 1..at + 33]
                .iter()
                .map(|byte| format!("{byte:02x}"))
                .collect(),
            payload: payload.clone(),
        });
        at = payload.end;
    }
    (found, table)
}

/// Each kind of file of a store with one bit flipped: who finds it, and by which exit code.
#[test]
fn one_bit_in_every_kind_of_file_is_found() {
    let dir = ran();
    let status: Value =
        serde_json::from_str(&marf(dir.path(), &["status", "--json"]).exits(0).stdout).unwrap();
    let node = |name: &str| {
        let nodes = status["nodes"].as_array().unwrap();
        nodes.iter().find(|node| node["name"] == name).unwrap().clone()
    };
    let key = node("train")["key"].as_str().unwrap().to_owned();
    let scene = node("calibrate")["outputs"]["scene"]["digest"]
        .as_str()
        .unwrap()
        .to_owned();
    let report = status["documents"]["report.html"]["digest"]
        .as_str()
        .unwrap()
        .to_owned();
    let store = dir.path().join(".marf");
    let mut names = Vec::new();
    files(&store, &store, &mut names);
    let packs: Vec<&String> = names.iter().filter(|name| name.ends_with(".pack")).collect();
    // The file, the place of the bit, what it is.
    let mut flips: Vec<(String, usize, &str)> = Vec::new();
    let mut memos = 0;
    for pack in packs {
        let bytes = std::fs::read(store.join(pack)).unwrap();
        let (found, table) = entries(&bytes);
        for entry in found {
            let middle = (entry.payload.start + entry.payload.end) / 2;
            let what = match entry.kind {
                0 if entry.id == key => "an action",
                0 if entry.id == scene => "an output",
                1 if entry.id == key => "a record",
                2 => {
                    memos += 1;
                    if memos > 1 { continue } else { "a memo" }
                }
                _ => continue,
            };
            flips.push((pack.clone(), middle, what));
        }
        flips.push((pack.clone(), table + 1, "the table of a pack"));
        flips.push((pack.clone(), bytes.len() - 1, "the end of a pack"));
    }
    let loose = format!("cas/{}/{}", &report[..2], &report[2..]);
    flips.push((loose, 1000, "a document"));
    let of = |start: &str| names.iter().find(|name| name.starts_with(start)).unwrap().clone();
    flips.push((of("runs/"), 40, "a run root"));
    flips.push(("format".to_owned(), 1, "the format"));
    for what in ["an action", "a record", "a memo", "a document"] {
        assert!(flips.iter().any(|(.., kind)| *kind == what), "no {what} to alter");
    }
    for (file, at, what) in flips {
        let altered = tempfile::tempdir().unwrap();
        copy(dir.path(), altered.path());
        let path = altered.path().join(".marf").join(&file);
        let mut bytes = std::fs::read(&path).unwrap();
        bytes[at] ^= 4;
        std::fs::remove_file(&path).unwrap();
        std::fs::write(&path, bytes).unwrap();
        let fsck = marf(altered.path(), &["cache", "fsck", "--read-data"]);
        // Opening the store reports and repairs the format.
        let is_found = fsck.code == 1 || fsck.stderr.contains("the file `format` of the store was damaged");
        assert!(is_found, "{what}: fsck: {} {}", fsck.stdout, fsck.stderr);
        if what != "the format" {
            let told = marf(altered.path(), &["audit", "out/train/metrics.json", "--verify"]);
            let code = if what == "a memo" { 0 } else { 4 };
            assert_eq!(told.code, code, "{what}: audit: {} {}", told.stdout, told.stderr);
        }
    }
}

/// A photo from a server, with its label, pinned in marf.lock. The server is gone.
fn fetched() -> tempfile::TempDir {
    let server = Server::start().unwrap();
    let mut photo = std::io::Cursor::new(Vec::new());
    let picture = image::RgbImage::from_fn(64, 48, |x, y| image::Rgb([x as u8, y as u8, (x * y) as u8]));
    picture.write_to(&mut photo, image::ImageFormat::Png).unwrap();
    server.navcam(1, 0, photo.into_inner());
    let dir = tempfile::tempdir().unwrap();
    let archive = server.navcam_section("jezero", "1");
    let text = format!("name = \"lock\"\n{archive}[node.extract]\narchive = \"jezero\"\n");
    std::fs::write(dir.path().join("pipeline.toml"), text).unwrap();
    marf(dir.path(), &["run"]).exits(0);
    dir
}

/// Each field of a line of marf.lock with one bit flipped: `audit --verify` names it.
#[test]
fn one_bit_in_a_line_of_the_lock_is_found_and_the_field_named() {
    let dir = fetched();
    let lock = dir.path().join("marf.lock/jezero/sol-00001.toml");
    let whole = std::fs::read_to_string(&lock).unwrap();
    let audit = || marf(dir.path(), &["audit", "out/report.html", "--verify"]);
    audit().exits(0);
    let line = whole.find("{ name = ").unwrap();
    // The last digit or letter of a value. The changed bit keeps it a digit or a letter.
    for (field, bit, words) in [
        ("name", 2, "marf.lock has no product of this name"),
        ("bytes", 1, "marf.lock has bytes "),
        ("blake3", 1, "marf.lock has blake3 "),
        ("sha256", 1, "marf.lock has sha256 "),
        ("url", 2, "marf.lock has url "),
        ("fetched", 4, "marf.lock has fetched "),
    ] {
        let start = line + whole[line..].find(&format!("{field} = ")).unwrap() + field.len() + 3;
        let end = start + whole[start..].find([',', '}']).unwrap();
        let is_digit = |byte: &&u8| byte.is_ascii_digit() && (**byte ^ bit).is_ascii_digit();
        let value = &whole.as_bytes()[start..end];
        let at = end - 1 - value.iter().rev().position(|byte| is_digit(&byte)).unwrap();
        let mut bytes = whole.clone().into_bytes();
        bytes[at] ^= bit;
        std::fs::write(&lock, &bytes).unwrap();
        let told = audit().exits(6);
        assert!(told.stdout.contains(words), "{field}: {}", told.stdout);
        assert!(
            told.stderr
                .contains("an archive has changed a file that out/report.html was made from"),
            "{}",
            told.stderr
        );
    }
    let mut bytes = whole.into_bytes();
    bytes[line] ^= 1;
    std::fs::write(&lock, &bytes).unwrap();
    let told = audit().exits(1).stderr;
    assert!(told.contains("sol-00001.toml:"), "{told}");
}

/// Places of the index at which a bit is flipped.
const PLACES: usize = 12;

/// The index is made from the packs: fsck finds a flipped bit and rebuilds the index, or the bit changes nothing.
#[test]
fn one_bit_in_the_index_is_found_and_repaired_or_changes_nothing() {
    let dir = ran();
    let path = dir.path().join(".marf/index.sqlite");
    let whole = std::fs::read(&path).unwrap();
    let mut found = 0;
    for place in 0..PLACES {
        let at = place * whole.len() / PLACES + 7;
        let mut bytes = whole.clone();
        bytes[at] ^= 4;
        std::fs::remove_file(&path).unwrap();
        std::fs::write(&path, bytes).unwrap();
        let fsck = marf(dir.path(), &["cache", "fsck", "--repair"]).exits(0).stderr;
        let is_found = fsck.contains("repaired: ") || fsck.contains("is rebuilt from the packs");
        found += usize::from(is_found);
        let told = marf(dir.path(), &["audit", "out/train/metrics.json", "--verify"]);
        assert_eq!(
            told.code, 0,
            "byte {at}, found: {is_found}: {} {}",
            told.stdout, told.stderr
        );
    }
    // The rest is free space in pages.
    assert!(found > PLACES / 4, "{found} of {PLACES}");
}
