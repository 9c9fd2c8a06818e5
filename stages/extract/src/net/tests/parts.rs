//! Unfinished downloads.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::time::{Duration, Instant};

use super::*;
use marf_loopback::{Reply, Server};

/// A folder for parts, and a folder around it in which nothing else may appear.
struct Folder(tempfile::TempDir);

impl Folder {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        fs::create_dir(folder.path().join("parts")).unwrap();
        Self(folder)
    }

    fn part(&self, name: &str) -> PathBuf {
        self.0.path().join("parts").join(name)
    }

    /// Files by name, and their lengths.
    fn files(&self) -> BTreeMap<String, u64> {
        let around = fs::read_dir(self.0.path()).unwrap().count();
        assert_eq!(around, 1, "something was written outside the parts' folder");
        let files = fs::read_dir(self.0.path().join("parts")).unwrap();
        files
            .map(|file| file.unwrap())
            .map(|file| {
                (
                    file.file_name().into_string().unwrap(),
                    file.metadata().unwrap().len(),
                )
            })
            .collect()
    }
}

fn kept(server: &Server, path: &str, part: &Path) -> Download {
    Download {
        part: Some(part.to_owned()),
        ..download(server, path)
    }
}

/// One try only, so that the next call is a next run.
fn hasty(server: &Server) -> Client {
    Client::new(
        permit(),
        ClientSettings {
            tries: 1,
            ..quick(&[server])
        },
    )
    .unwrap()
}

/// Leaves a part of `after` bytes.
fn cut(server: &Server, folder: &Folder, after: usize) -> Download {
    let download = kept(server, "/a", &folder.part("a.part"));
    server.script("/a", vec![Reply::Cut { after }]);
    kind(one(&hasty(server), &download));
    assert_eq!(
        folder.files().get("a.part"),
        Some(&(after as u64)),
        "{:?}",
        folder.files()
    );
    server.clear();
    download
}

#[test]
fn a_cut_download_goes_on_by_range() {
    let (server, folder) = (Server::start().unwrap(), Folder::new());
    let body = noise(3, 300_000);
    server.file("/a", body.clone());
    let download = cut(&server, &folder, 200_000);
    let client = hasty(&server);
    assert_eq!(bytes(one(&client, &download)), body);
    let request = server.requests().remove(0);
    assert_eq!(request.header("range"), Some("bytes=134464-"));
    assert!(
        request.header("if-range").unwrap().starts_with('"'),
        "{request:?}"
    );
    let traffic = client.traffic();
    assert_eq!((traffic.resumed, traffic.bytes), (1, 165_536));
    forget(&folder.part("a.part"));
    assert!(folder.files().is_empty(), "{:?}", folder.files());
}

#[test]
fn tries_within_a_call_go_on_too_even_without_a_part() {
    let server = Server::start().unwrap();
    let body = noise(3, 300_000);
    server.file("/a", body.clone());
    server.script(
        "/a",
        vec![Reply::Cut { after: 100_000 }, Reply::Cut { after: 100_000 }],
    );
    let client = client(&server);
    assert_eq!(bytes(one(&client, &download(&server, "/a"))), body);
    let ranges: Vec<Option<String>> = server
        .requests()
        .iter()
        .map(|request| request.header("range").map(str::to_owned))
        .collect();
    assert_eq!(
        ranges,
        [
            None,
            Some("bytes=50000-".to_owned()),
            Some("bytes=84464-".to_owned())
        ]
    );
    assert_eq!(client.traffic().bytes, 300_000 + 50_000 + 65_536);
}

#[test]
fn a_changed_file_begins_from_zero() {
    let (server, folder) = (Server::start().unwrap(), Folder::new());
    server.file("/a", noise(3, 300_000));
    let download = cut(&server, &folder, 200_000);
    server.file("/a", noise(4, 310_000));
    assert_eq!(bytes(one(&hasty(&server), &download)), noise(4, 310_000));
    assert_eq!(server.requests().len(), 1, "a 200 is taken as it is");
}

#[test]
fn a_rest_that_does_not_fit_begins_from_zero() {
    let faults = [
        Reply::StaleRest,
        Reply::ShiftedRest(1),
        Reply::ShiftedRest(-5_000),
        Reply::LyingRest(1),
        Reply::LyingRest(70_000),
        Reply::NoRest,
        Reply::with(206, "Content-Range", "bytes 134464-299999/*"),
        Reply::status(206),
    ];
    for fault in faults {
        let name = format!("{fault:?}");
        let (server, folder) = (Server::start().unwrap(), Folder::new());
        let body = noise(3, 300_000);
        server.file("/a", body.clone());
        let download = cut(&server, &folder, 200_000);
        server.script("/a", vec![fault]);
        assert_eq!(bytes(one(&client(&server), &download)), body, "{name}");
        let ranges: Vec<bool> = server
            .requests()
            .iter()
            .map(|request| request.header("range").is_some())
            .collect();
        assert_eq!(ranges, [true, false], "{name}");
    }
}

/// Some hosts make an `ETag` from times, and several hosts may be behind one name.
#[test]
fn two_versions_under_one_etag_are_never_mixed() {
    let (server, folder) = (Server::start().unwrap(), Folder::new());
    let version = |seed| server.file_with("/a", noise(seed, 300_000), Some("\"same\""), None);
    version(3);
    let download = cut(&server, &folder, 200_000);
    version(4);
    assert_eq!(bytes(one(&client(&server), &download)), noise(4, 300_000));
    let ranges = server.requests();
    let ranges: Vec<_> = ranges.iter().map(|request| request.header("range")).collect();
    assert_eq!(ranges, [Some("bytes=134464-"), None]);
}

#[test]
fn without_a_strong_validator_nothing_is_continued() {
    for (etag, modified) in [
        (None, None),
        (Some("W/\"weak\""), None),
        (Some("bare"), Some("yesterday")),
    ] {
        let (server, folder) = (Server::start().unwrap(), Folder::new());
        server.file_with("/a", noise(1, 9_000), etag, modified);
        server.script("/a", vec![Reply::Cut { after: 4_000 }]);
        let download = kept(&server, "/a", &folder.part("a.part"));
        assert_eq!(bytes(one(&client(&server), &download)), noise(1, 9_000));
        assert!(
            server
                .requests()
                .iter()
                .all(|request| request.header("range").is_none()),
            "{etag:?} {modified:?}"
        );
    }
}

#[test]
fn a_finished_part_needs_no_request() {
    let (server, folder) = (Server::start().unwrap(), Folder::new());
    server.file("/a", noise(1, 9_000));
    let download = kept(&server, "/a", &folder.part("a.part"));
    let first = one(&hasty(&server), &download).unwrap();
    server.clear();
    assert_eq!(one(&hasty(&server), &download).unwrap(), first);
    assert_eq!(one(&hasty(&server), &download).unwrap(), first, "and stays");
    assert!(server.requests().is_empty());
    forget(&folder.part("a.part"));
    assert_eq!(one(&hasty(&server), &download).unwrap(), first);
    assert_eq!(server.requests().len(), 1);
}

#[test]
fn a_part_that_does_not_verify_is_fetched_again() {
    type Damage = fn(&Path, &Path);
    let damages: [(&str, Damage); 6] = [
        ("a flipped byte", |part, _| {
            let mut bytes = fs::read(part).unwrap();
            bytes[500] ^= 1;
            fs::write(part, bytes).unwrap();
        }),
        ("a shorter part", |part, _| {
            let bytes = fs::read(part).unwrap();
            fs::write(part, &bytes[..1_000]).unwrap();
        }),
        ("no sidecar", |_, sidecar| fs::remove_file(sidecar).unwrap()),
        ("an empty sidecar", |_, sidecar| {
            fs::write(sidecar, b"").unwrap();
        }),
        ("a sidecar of another length", |_, sidecar| {
            let text = fs::read_to_string(sidecar).unwrap();
            fs::write(
                sidecar,
                text.replace("\"bytes\":6000", "\"bytes\":18446744073709551615"),
            )
            .unwrap();
        }),
        ("a sidecar that says complete", |_, sidecar| {
            let text = fs::read_to_string(sidecar).unwrap();
            fs::write(sidecar, text.replace("\"complete\":false", "\"complete\":true")).unwrap();
        }),
    ];
    for (name, damage) in damages {
        let (server, folder) = (Server::start().unwrap(), Folder::new());
        server.file("/a", noise(1, 9_000));
        let download = cut(&server, &folder, 6_000);
        damage(&folder.part("a.part"), &folder.part("a.part.json"));
        assert_eq!(bytes(one(&hasty(&server), &download)), noise(1, 9_000), "{name}");
        assert_eq!(server.requests()[0].header("range"), None, "{name}");
    }
}

/// As after a kill: bytes the sidecar does not vouch for are cut off.
#[test]
fn bytes_beyond_the_sidecar_are_fetched_again() {
    let (server, folder) = (Server::start().unwrap(), Folder::new());
    server.file("/a", noise(1, 9_000));
    let download = cut(&server, &folder, 6_000);
    let mut longer = fs::read(folder.part("a.part")).unwrap();
    longer.extend([0; 700]);
    fs::write(folder.part("a.part"), longer).unwrap();
    assert_eq!(bytes(one(&hasty(&server), &download)), noise(1, 9_000));
    assert_eq!(server.requests()[0].header("range"), Some("bytes=3000-"));
    assert_eq!(folder.files()["a.part"], 9_000);
}

#[test]
fn a_part_never_mixes_hosts() {
    let (first, second, folder) = (Server::start().unwrap(), Server::start().unwrap(), Folder::new());
    // Equal validators: only the address distinguishes the two.
    first.file_with("/a", noise(1, 9_000), Some("\"same\""), None);
    second.file_with("/a", noise(2, 9_000), Some("\"same\""), None);
    let mut both = kept(&first, "/a", &folder.part("a.part"));
    both.urls.push(Url::parse(&second.url("/a")).unwrap());
    first.script(
        "/a",
        vec![Reply::Cut { after: 5_000 }, Reply::status(503).always()],
    );
    let settings = ClientSettings {
        tries: 2,
        ..quick(&[&first, &second])
    };
    let client = Client::new(permit(), settings).unwrap();
    assert_eq!(bytes(one(&client, &both)), noise(2, 9_000));
    assert_eq!(second.requests()[0].header("range"), None);
    forget(&folder.part("a.part"));
    // A part of the second mirror goes on there, though the first is preferred.
    first.script("/a", vec![Reply::status(403)]);
    second.script(
        "/a",
        vec![Reply::Cut { after: 5_000 }, Reply::Cut { after: 4_500 }],
    );
    kind(one(&client, &both));
    first.clear();
    second.clear();
    assert_eq!(bytes(one(&client, &both)), noise(2, 9_000));
    assert_eq!(second.requests()[0].header("range"), Some("bytes=3500-"));
    assert!(first.requests().is_empty());
}

#[test]
fn a_part_of_another_address_is_not_taken() {
    let (server, folder) = (Server::start().unwrap(), Folder::new());
    server.file("/a", noise(1, 9_000));
    server.file("/b", noise(2, 9_000));
    bytes(one(&hasty(&server), &kept(&server, "/a", &folder.part("a.part"))));
    let other = kept(&server, "/b", &folder.part("a.part"));
    assert_eq!(bytes(one(&hasty(&server), &other)), noise(2, 9_000));
}

#[test]
fn a_part_that_another_process_holds_is_left_to_it() {
    let (server, folder) = (Server::start().unwrap(), Folder::new());
    server.file("/a", noise(1, 9_000));
    let held = fs::File::create(folder.part("a.part")).unwrap();
    held.lock().unwrap();
    let download = kept(&server, "/a", &folder.part("a.part"));
    assert_eq!(bytes(one(&hasty(&server), &download)), noise(1, 9_000));
    assert_eq!(folder.files(), BTreeMap::from([("a.part".to_owned(), 0)]));
}

#[test]
fn what_brings_nothing_leaves_nothing() {
    let (server, folder) = (Server::start().unwrap(), Folder::new());
    let download = kept(&server, "/a", &folder.part("a.part"));
    assert!(matches!(
        one(&hasty(&server), &download),
        Ok(Answer::Absent { .. })
    ));
    server.script("/a", vec![Reply::Endless]);
    kind(one(&hasty(&server), &download));
    assert!(folder.files().is_empty(), "{:?}", folder.files());
    // With a validator too: a body that is too large stays too large.
    server.file("/a", noise(1, 9_000));
    server.script("/a", vec![Reply::Endless]);
    let error = kind(one(&hasty(&server), &download));
    assert!(matches!(*error.kind, NetErrorKind::TooLarge { .. }), "{error}");
    assert!(folder.files().is_empty(), "{:?}", folder.files());
    cut(&server, &folder, 6_000);
    server.remove("/a");
    assert!(matches!(
        one(&hasty(&server), &download),
        Ok(Answer::Absent { .. })
    ));
    assert!(
        folder.files().is_empty(),
        "gone there, gone here: {:?}",
        folder.files()
    );
}

#[test]
fn a_part_that_cannot_be_written_is_named() {
    let (server, folder) = (Server::start().unwrap(), Folder::new());
    server.file("/a", *b"a");
    fs::write(folder.part("file"), b"").unwrap();
    let part = folder.part("file").join("a.part");
    let error = kind(one(&hasty(&server), &kept(&server, "/a", &part)));
    assert!(
        matches!(&*error.kind, NetErrorKind::Part { path, .. } if *path == part),
        "{error}"
    );
    let twice = [kept(&server, "/a", &part), kept(&server, "/a", &part)];
    let error = hasty(&server).get_all(&Cancel::default(), &twice, &mut |_, _| Ok(()));
    assert!(error.unwrap_err().to_string().contains("share the part"));
}

#[test]
fn a_stopped_download_goes_on_at_the_next_call() {
    let (server, folder) = (Server::start().unwrap(), Folder::new());
    server.file("/small", *b"small");
    server.file("/a", noise(5, 900_000));
    let every = Duration::from_millis(10);
    server.script("/a", vec![Reply::Drip { bytes: 10_000, every }]);
    let downloads = [
        download(&server, "/small"),
        kept(&server, "/a", &folder.part("a.part")),
    ];
    let cancel = Cancel::default();
    let mut stopped = None;
    let ended = client(&server).get_all(&cancel, &downloads, &mut |index, _| {
        assert_eq!(index, 0, "the large one cannot be done");
        while folder.files().get("a.part").is_none_or(|length| *length < 50_000) {
            std::thread::yield_now();
        }
        cancel.set();
        stopped = Some(Instant::now());
        Ok(())
    });
    assert!(matches!(ended, Err(StageError::Cancelled)), "{ended:?}");
    let took = stopped.unwrap().elapsed();
    assert!(took < Duration::from_secs(2), "{took:?}");
    let kept = folder.files()["a.part"];
    assert!((50_000..900_000).contains(&kept), "{kept}");
    server.clear();
    assert_eq!(bytes(one(&client(&server), &downloads[1])), noise(5, 900_000));
    let range = format!("bytes={}-", kept - kept.div_ceil(2).min(65_536));
    assert_eq!(server.requests()[0].header("range"), Some(range.as_str()));
}

#[test]
fn a_wish_to_stop_ends_every_kind_of_wait() {
    let server = Server::start().unwrap();
    server.script("/silent", vec![Reply::Silent.always()]);
    server.script("/later", vec![Reply::with(503, "Retry-After", "500").always()]);
    for path in ["/silent", "/later"] {
        let settings = ClientSettings {
            stall: Duration::from_secs(60),
            ..quick(&[&server])
        };
        let client = Client::new(permit(), settings).unwrap();
        let cancel = Cancel::default();
        let (cancel, server) = (&cancel, &server);
        let began = std::thread::scope(|scope| {
            let stopper = scope.spawn(move || {
                while server.requests_of(path).is_empty() {
                    std::thread::yield_now();
                }
                cancel.set();
                Instant::now()
            });
            let ended = client.get_all(cancel, &[download(server, path)], &mut |_, _| Ok(()));
            assert!(matches!(ended, Err(StageError::Cancelled)), "{path}: {ended:?}");
            stopper.join().unwrap()
        });
        assert!(began.elapsed() < Duration::from_secs(2), "{path}");
    }
}
