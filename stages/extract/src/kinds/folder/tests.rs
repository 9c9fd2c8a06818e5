use std::fs::{self, File};
use std::path::Path;
use std::time::{Duration, SystemTime};

use marf_cache::Digest;
use marf_stage::harness::Harness;
use marf_stage::{Ctx, Keep, OriginKind};

use super::survey::{Reading, Source, Survey};
use super::table::Table;
use super::walk::walk;
use crate::archive::Known;
use crate::stat::now_ns;

const DEPTH: usize = 32;
const LIMIT_BYTES: u64 = 2_000_000;
/// A survey that begins so much later finds that all files of a test have rested.
const REST_NS: i64 = 60_000_000_000;

fn harness(dir: &Path) -> Harness {
    let mut harness = Harness::default();
    harness.scratch = dir.join("scratch");
    harness
}

fn archive(dir: &Path) -> std::path::PathBuf {
    let root = dir.join("archive");
    fs::create_dir_all(root.join("b/c")).unwrap();
    for name in ["a.png", "b/a.png", "b/c/a.png", "b/a.txt", "é.png"] {
        fs::write(root.join(name), format!("\x7fnothing {name}")).unwrap();
    }
    root
}

fn source(root: &Path, reading: Reading) -> Source {
    Source {
        root: root.to_owned(),
        depth: DEPTH,
        reading,
        keep: Keep::Copy,
        limit_bytes: LIMIT_BYTES,
    }
}

fn rested(ctx: &Ctx<'_>, root: &Path, reading: Reading) -> Survey {
    Survey::begun_at(now_ns() + REST_NS, ctx, &source(root, reading)).unwrap()
}

fn digests(survey: &Survey, root: &Path) -> Vec<(String, Digest)> {
    let files = survey.shards.values().flatten();
    files
        .map(|index| survey.file(&source(root, Reading::All), *index))
        .map(|file| (file.name, file.digest))
        .collect()
}

/// Writes a table that says of every file that its bytes are those of `lie`.
fn lie(ctx: &Ctx<'_>, root: &Path, began_ns: i64) {
    let files = walk(ctx, root, DEPTH).unwrap();
    let known = Known {
        kind: OriginKind::Photo,
        reason: None,
        digest: Digest::from_content(b"lie"),
        sol: Some(7),
    };
    let path = Table::path(ctx.scratch, root, DEPTH).unwrap();
    Table::new(&files, &vec![known; files.len()], began_ns).write(&path);
}

#[test]
fn a_file_whose_state_is_known_is_not_read_unless_asked_for() {
    let dir = tempfile::tempdir().unwrap();
    let (root, harness) = (archive(dir.path()), harness(dir.path()));
    let truth = digests(&rested(&harness.ctx(), &root, Reading::Changed), &root);
    assert_eq!(truth.len(), 5);
    assert_eq!(
        truth,
        digests(&rested(&harness.ctx(), &root, Reading::Changed), &root)
    );
    lie(&harness.ctx(), &root, now_ns() + REST_NS);
    let believed = rested(&harness.ctx(), &root, Reading::Changed);
    assert!(
        digests(&believed, &root)
            .iter()
            .all(|(_, digest)| *digest == Digest::from_content(b"lie"))
    );
    assert_eq!(
        believed.shards.keys().collect::<Vec<_>>(),
        [&7],
        "kind, digest and sol are of the table"
    );
    assert_eq!(
        truth,
        digests(&rested(&harness.ctx(), &root, Reading::All), &root)
    );
    assert_eq!(
        truth,
        digests(&rested(&harness.ctx(), &root, Reading::Changed), &root),
        "reading all repairs the table"
    );
}

#[test]
fn a_file_that_had_not_rested_is_read_again() {
    let dir = tempfile::tempdir().unwrap();
    let (root, harness) = (archive(dir.path()), harness(dir.path()));
    // The files are fresh, so the survey keeps none of them. Entries of the table can only come from another survey.
    drop(Survey::begun_at(now_ns(), &harness.ctx(), &source(&root, Reading::Changed)).unwrap());
    let path = Table::path(&harness.scratch, &root, DEPTH).unwrap();
    assert_eq!(Table::open(&path).0.len(), 0);
    let rested = rested(&harness.ctx(), &root, Reading::Changed);
    assert_eq!(Table::open(&path).0.len(), digests(&rested, &root).len());
}

#[test]
fn a_file_that_was_replaced_by_one_of_the_same_size_and_time_is_read() {
    let dir = tempfile::tempdir().unwrap();
    let (root, harness) = (archive(dir.path()), harness(dir.path()));
    let before = digests(&rested(&harness.ctx(), &root, Reading::Changed), &root);
    let path = root.join("b/a.png");
    let meta = fs::metadata(&path).unwrap();
    let bytes = vec![b'x'; meta.len() as usize];
    // In place, then by another file under the name.
    fs::write(&path, &bytes).unwrap();
    File::options()
        .append(true)
        .open(&path)
        .unwrap()
        .set_modified(meta.modified().unwrap())
        .unwrap();
    let edited = digests(&rested(&harness.ctx(), &root, Reading::Changed), &root);
    assert!(edited.contains(&("b/a.png".to_owned(), Digest::from_content(&bytes))));
    assert_eq!(before.iter().zip(&edited).filter(|(a, b)| a != b).count(), 1);
    let other = root.join("other");
    fs::write(&other, vec![b'y'; bytes.len()]).unwrap();
    File::options()
        .append(true)
        .open(&other)
        .unwrap()
        .set_modified(meta.modified().unwrap())
        .unwrap();
    fs::rename(&other, &path).unwrap();
    let replaced = digests(&rested(&harness.ctx(), &root, Reading::Changed), &root);
    assert!(replaced.contains(&(
        "b/a.png".to_owned(),
        Digest::from_content(&vec![b'y'; bytes.len()])
    )));
}

#[test]
fn a_file_of_a_time_to_come_is_read_each_time() {
    let dir = tempfile::tempdir().unwrap();
    let (root, harness) = (archive(dir.path()), harness(dir.path()));
    let later = SystemTime::now() + Duration::from_secs(3_600);
    File::options()
        .append(true)
        .open(root.join("a.png"))
        .unwrap()
        .set_modified(later)
        .unwrap();
    let all = digests(&rested(&harness.ctx(), &root, Reading::Changed), &root).len();
    let path = Table::path(&harness.scratch, &root, DEPTH).unwrap();
    assert_eq!(Table::open(&path).0.len(), all - 1);
}

#[test]
fn files_that_vanish_or_come_change_the_table() {
    let dir = tempfile::tempdir().unwrap();
    let (root, harness) = (archive(dir.path()), harness(dir.path()));
    drop(rested(&harness.ctx(), &root, Reading::Changed));
    let path = Table::path(&harness.scratch, &root, DEPTH).unwrap();
    fs::remove_file(root.join("b/a.png")).unwrap();
    drop(rested(&harness.ctx(), &root, Reading::Changed));
    assert_eq!(Table::open(&path).0.len(), 4);
    fs::write(root.join("b/b.png"), "new").unwrap();
    let found = digests(&rested(&harness.ctx(), &root, Reading::Changed), &root);
    assert!(found.contains(&("b/b.png".to_owned(), Digest::from_content(b"new"))));
    assert_eq!(Table::open(&path).0.len(), 5);
    let before = fs::metadata(&path).unwrap().modified().unwrap();
    drop(rested(&harness.ctx(), &root, Reading::Changed));
    assert_eq!(
        fs::metadata(&path).unwrap().modified().unwrap(),
        before,
        "written only where it changed"
    );
}

#[test]
fn a_table_that_is_damaged_or_cannot_be_written_costs_only_time() {
    let dir = tempfile::tempdir().unwrap();
    let (root, harness) = (archive(dir.path()), harness(dir.path()));
    let truth = digests(&rested(&harness.ctx(), &root, Reading::Changed), &root);
    let path = Table::path(&harness.scratch, &root, DEPTH).unwrap();
    let whole = fs::read(&path).unwrap();
    for index in 0..whole.len() {
        let mut flipped = whole.clone();
        flipped[index] ^= 0x40;
        fs::write(&path, flipped).unwrap();
        assert_eq!(Table::open(&path).0.len(), 0, "byte {index}");
    }
    assert_eq!(
        truth,
        digests(&rested(&harness.ctx(), &root, Reading::Changed), &root)
    );
    let mut nowhere = Harness::default();
    nowhere.scratch = root.join("a.png");
    assert_eq!(
        truth,
        digests(&rested(&nowhere.ctx(), &root, Reading::Changed), &root)
    );
    assert!(fs::metadata(root.join("a.png")).unwrap().is_file());
}

#[test]
fn the_number_of_threads_changes_nothing() {
    let dir = tempfile::tempdir().unwrap();
    let root = archive(dir.path());
    for number in 0..200 {
        fs::write(root.join(format!("{number:03}.png")), number.to_string()).unwrap();
    }
    let survey = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        let harness = Harness::default();
        let ctx = Ctx {
            threads,
            ..harness.ctx()
        };
        pool.install(|| digests(&rested(&ctx, &root, Reading::Changed), &root))
    };
    assert_eq!(survey(1), survey(4));
}

/// A dangling link, a file that is too large, and a link in circles.
#[test]
#[cfg(unix)]
fn what_cannot_be_read_has_its_reason() {
    let dir = tempfile::tempdir().unwrap();
    let (root, harness) = (archive(dir.path()), harness(dir.path()));
    std::os::unix::fs::symlink("nowhere", root.join("link.png")).unwrap();
    std::os::unix::fs::symlink("..", root.join("b/up")).unwrap();
    File::create(root.join("huge.img"))
        .unwrap()
        .set_len(LIMIT_BYTES + 1)
        .unwrap();
    let survey = rested(&harness.ctx(), &root, Reading::Changed);
    let reasons: Vec<String> = survey
        .shards
        .values()
        .flatten()
        .filter_map(|index| match survey.file(&source(&root, Reading::All), *index) {
            file if file.kind == OriginKind::Unreadable => Some(format!("{} {:?}", file.name, file.reason)),
            _ => None,
        })
        .collect();
    assert_eq!(reasons.len(), 3, "{reasons:?}");
    assert!(
        reasons[0].contains("b/up") && reasons[0].contains("leads back"),
        "{reasons:?}"
    );
    assert!(
        reasons[1].contains("huge.img") && reasons[1].contains("more than 2 MB: raise `max_file_mb`"),
        "{reasons:?}"
    );
    assert!(
        reasons[2].contains("link.png") && reasons[2].contains("not found"),
        "{reasons:?}"
    );
}
