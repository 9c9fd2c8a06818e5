//! marf.lock: pins are part of a sol's identity, are restored if they are lost, and survive writes of other
//! processes.

use std::path::PathBuf;
use std::sync::Arc;

use marf_cache::Digest;
use marf_stage::{BlobError, Blobs, Ctx, Keep};

use super::*;

const SOL_1: &str = "jezero/sol-00001.toml";

fn fingerprints(listing: &Listing) -> Vec<Digest> {
    listing.shards.iter().map(|shard| shard.fingerprint).collect()
}

/// Changes the first digit of the first digest that is pinned in a text.
fn with_another_digest(text: &str) -> String {
    let at = text.find("blake3 = \"").unwrap() + "blake3 = \"".len();
    let other = if &text[at..=at] == "0" { "1" } else { "0" };
    format!("{}{other}{}", &text[..at], &text[at + 1..])
}

#[test]
fn a_pin_that_was_changed_is_refused_by_name_though_the_store_has_the_product() {
    let server = Server::start().unwrap();
    mount(&server, 1..=2);
    let place = Place::new();
    let archive = place.archive(&server, "1..=2");
    let locked = access(&archive, Access::Locked);
    let brought = place.bring(&archive).unwrap();
    let before = place.list(&locked).unwrap();
    assert_eq!(
        fingerprints(&before),
        fingerprints(&brought.listing),
        "what came is what is locked"
    );
    let mut lock = place.lock();
    let text = with_another_digest(&lock[SOL_1]);
    lock.insert(SOL_1.to_owned(), text.clone());
    place.take_lock(&lock);
    let after = place.list(&locked).unwrap();
    assert_ne!(before.shards[0], after.shards[0], "the sol is another one now");
    assert_eq!(before.shards[1], after.shards[1]);
    let name = text.lines().find(|line| line.contains("blake3")).unwrap();
    let name = name.split('"').nth(1).unwrap();
    let error = place.bring(&locked).err().unwrap().to_string();
    assert!(error.contains(name) && error.contains("marf.lock"), "{error}");
    // Online the pin is requested too: the archive does not have the pinned file.
    let error = place.bring(&archive).err().unwrap().to_string();
    assert!(error.contains(name), "{error}");
}

#[test]
fn what_was_left_out_and_what_was_gone_are_part_of_the_fingerprint() {
    let server = Server::start().unwrap();
    mount(&server, 1..=1);
    let place = Place::new();
    let locked = access(&place.archive(&server, "1"), Access::Locked);
    place.bring(&place.archive(&server, "1")).unwrap();
    let (lock, before) = (place.lock(), place.list(&locked).unwrap());
    for (from, to) in [
        ("\"thumbnail\"", "\"by hand\""),
        ("]\n", "  { name = \"Z.png\", status = 404 },\n]\n"),
        ("]\n", "  { name = \"Z.png\", status = 410 },\n]\n"),
    ] {
        let mut changed = lock.clone();
        changed.insert(SOL_1.to_owned(), lock[SOL_1].replacen(from, to, 1));
        assert_ne!(changed, lock);
        place.take_lock(&changed);
        assert_ne!(before.shards, place.list(&locked).unwrap().shards, "{to}");
    }
    place.take_lock(&lock);
    assert_eq!(before.shards, place.list(&locked).unwrap().shards);
}

#[test]
fn a_lost_lock_is_written_again_as_it_was_and_no_product_is_asked_for() {
    let server = Server::start().unwrap();
    mount(&server, [1, 2, 40]);
    let place = Place::new();
    let archive = place.archive(&server, "1..=40");
    let brought = place.bring(&archive).unwrap();
    let lock = place.lock();
    for lost in [
        &["marf.lock"][..],
        &["marf.lock", "scratch"],
        &["marf.lock/jezero/sol-00002.toml"],
    ] {
        for path in lost {
            let path = place.dir.path().join(path);
            match path.is_dir() {
                true => std::fs::remove_dir_all(path).unwrap(),
                false => std::fs::remove_file(path).unwrap(),
            }
        }
        server.clear();
        let listed = place.list(&archive).unwrap();
        assert_eq!(listed.note, None, "nothing to fetch");
        assert_eq!(fingerprints(&listed), fingerprints(&brought.listing));
        assert_eq!(place.lock(), lock, "{lost:?}");
        let files = server
            .requests()
            .iter()
            .filter(|one| !one.path().ends_with('/'))
            .count();
        assert_eq!(files, 0);
    }
    let offline = place.list(&access(&archive, Access::Offline)).unwrap();
    assert_eq!(fingerprints(&offline), fingerprints(&brought.listing));
}

#[test]
fn without_its_lock_a_locked_run_names_what_is_missing() {
    let server = Server::start().unwrap();
    mount(&server, 1..=1);
    let place = Place::new();
    let archive = place.archive(&server, "1");
    place.bring(&archive).unwrap();
    std::fs::remove_dir_all(place.dir.path().join("marf.lock")).unwrap();
    for kind in [Access::Locked, Access::Offline] {
        let error = place.list(&access(&archive, kind)).unwrap_err().to_string();
        assert!(error.contains("no product of the sols"), "{error}");
    }
}

#[test]
fn a_file_that_cannot_be_read_fails_its_sol_alone() {
    let server = Server::start().unwrap();
    mount(&server, 1..=2);
    let place = Place::new();
    let archive = place.archive(&server, "1..=2");
    let before = place.bring(&archive).unwrap();
    let mut lock = place.lock();
    let conflict = format!("<<<<<<< HEAD\n{}", lock[SOL_1]);
    lock.insert(SOL_1.to_owned(), conflict.clone());
    place.take_lock(&lock);
    for archive in [
        archive.clone(),
        access(&archive, Access::Locked),
        access(&archive, Access::Offline),
    ] {
        let listing = place.list(&archive).unwrap();
        assert_eq!(listing.warnings.len(), 1, "{:?}", listing.warnings);
        assert!(
            listing.warnings[0].contains("sol-00001.toml`, line 1,"),
            "{:?}",
            listing.warnings
        );
        assert_eq!(listing.shards[1], before.listing.shards[1]);
        let stage = archive.stage();
        let error = source(stage.as_ref()).fetch(&place.harness.ctx(), 1).unwrap_err();
        assert!(error.to_string().contains("sol-00001.toml`, line 1,"), "{error}");
        assert!(source(stage.as_ref()).fetch(&place.harness.ctx(), 2).is_ok());
    }
    assert_eq!(place.lock()[SOL_1], conflict, "it is never written over");
}

#[test]
fn pipelines_that_run_at_once_in_one_folder_keep_each_others_pins() {
    let server = Server::start().unwrap();
    mount(&server, 1..=2);
    let record = json!({"imageid": "GOOD", "sol": 5, "camera": {"instrument": "NAVCAM_LEFT"}, "sample_type": "Full",
        "image_files": {"full_res": server.url("/p/good.png")}});
    server.file("/p/good.png", image_bytes(3));
    play(&server, vec![record]);
    let place = Place::new();
    let archives = [
        place.archive(&server, "1"),
        place.archive(&server, "2"),
        place.feed(&server, "5"),
    ];
    std::thread::scope(|scope| {
        for archive in &archives {
            // Each has a store and a scratch of its own, as other pipelines may.
            scope.spawn(move || Place::new().bring(archive).unwrap());
        }
    });
    let files: Vec<String> = place.lock().into_keys().collect();
    let expected = [
        "README",
        "jezero/archive.toml",
        SOL_1,
        "jezero/sol-00002.toml",
        "raws/archive.toml",
        "raws/sol-00005.toml",
    ];
    assert_eq!(files, expected);
}

/// A store that never becomes durable.
struct Forgetful<'a>(&'a Harness);

impl Blobs for Forgetful<'_> {
    fn get(&self, digest: &Digest) -> Result<Arc<[u8]>, BlobError> {
        Blobs::get(self.0, digest)
    }

    fn put(&self, bytes: &[u8]) -> Result<Digest, BlobError> {
        Blobs::put(self.0, bytes)
    }

    fn put_file(&self, path: &Path, max_bytes: u64, keep: Keep) -> Result<(Digest, Arc<[u8]>), BlobError> {
        self.0.put_file(path, max_bytes, keep)
    }

    fn contains(&self, digest: &Digest) -> bool {
        self.0.contains(digest)
    }

    fn commit(&self) -> Result<(), BlobError> {
        Err(BlobError {
            message: "no space left".to_owned(),
            lost: None,
        })
    }
}

/// A file is pinned only when the store has it for good, and its part stays until it is pinned. Whenever a process
/// dies, no received file is requested again.
#[test]
fn what_was_downloaded_before_a_death_is_not_downloaded_again() {
    let server = Server::start().unwrap();
    mount(&server, 1..=1);
    let place = Place::new();
    let archive = place.archive(&server, "1");
    let dying = Harness::default();
    let ctx = Ctx {
        blobs: &Forgetful(&dying),
        ..place.harness.ctx()
    };
    let stage = archive.stage();
    let shard = source(stage.as_ref()).list(&ctx).unwrap().shards[0].shard;
    let error = source(stage.as_ref()).fetch(&ctx, shard).unwrap_err();
    assert!(error.to_string().contains("no space left"), "{error}");
    assert!(
        place.lock().is_empty(),
        "nothing is pinned that the store may lose"
    );
    let came = pictures(&server);
    assert!(came > 5, "{came} pictures");
    server.clear();
    let brought = place.bring(&archive).unwrap();
    let files = server
        .requests()
        .iter()
        .filter(|one| !one.path().ends_with('/'))
        .count();
    assert_eq!(files, 0);
    assert!(brought.rows.len() > 5);
    assert!(place.harness.commits() > 0);
    let parts: Vec<PathBuf> = subfolders(&place.harness.scratch.join("downloads"));
    let left = std::fs::read_dir(place.harness.scratch.join("downloads"))
        .unwrap()
        .count();
    assert_eq!(
        (parts.len(), left),
        (0, 0),
        "parts are deleted when their bytes are pinned"
    );
}

#[test]
fn of_two_versions_under_one_etag_no_mixture_is_pinned() {
    let server = Server::start().unwrap();
    let name = super::pds::one_photo(&server);
    let path = format!("{BROWSE}/00001/{BELOW}/{name}");
    let version = |byte: u8| [&b"\x89PNG\r\n\x1a\n"[..], &[byte; 9_000]].concat();
    let mount = |byte| server.file_with(&path, version(byte), Some("\"same\""), None);
    mount(1);
    server.script(&path, vec![Reply::Cut { after: 6_000 }]);
    let place = Place::new();
    let archive = with(place.archive(&server, "1"), "/network/tries", json!(1));
    place.bring(&archive).err().unwrap();
    mount(2);
    server.clear();
    place.bring(&archive).err().unwrap();
    assert!(
        server.requests_of(&path)[0].header("range").is_some(),
        "it goes on"
    );
    let brought = place.bring(&archive).unwrap();
    let whole = marf_cache::Digest::from_content(&version(2));
    let lock = place.lock();
    let line = lock
        .values()
        .flat_map(|text| text.lines())
        .find(|line| line.contains(&name));
    let line = line.unwrap_or_else(|| panic!("{:?}", brought.verdicts));
    assert!(
        line.contains(&whole.to_string()) && !line.contains("others"),
        "{line}"
    );
}
