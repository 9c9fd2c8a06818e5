//! What stops a sol says which file, how many and what to do, with the numbers of the server and of marf.lock.

use super::*;

/// Message, cause and hint of a failure.
fn parts(error: StageError) -> [String; 3] {
    let StageError::Failed { message, cause, hint } = error else {
        panic!("{error:?}");
    };
    [message, cause.unwrap_or_default(), hint.unwrap_or_default()]
}

#[test]
fn files_that_do_not_come_are_counted_and_the_first_is_named() {
    let server = Server::start().unwrap();
    let names: Vec<String> = mount(&server, 1..=1)
        .into_iter()
        .filter(|name| &name[27..28] == "N")
        .collect();
    let path = format!("{BROWSE}/00001/{BELOW}/{}", names[0]);
    server.script(&path, vec![Reply::firewall().always()]);
    let place = Place::new();
    let archive = with(place.archive(&server, "1"), "/network/tries", json!(1));
    let [message, cause, _] = parts(place.bring(&archive).err().unwrap());
    let words: Vec<&str> = message.split(' ').collect();
    assert_eq!((words[0], words[1]), ("1", "of"), "{message}");
    assert!(
        message.ends_with(" files of sol 1 could not be fetched"),
        "{message}"
    );
    assert!(words[2].parse::<usize>().unwrap() >= names.len(), "{message}");
    assert!(cause.contains(" answered a web page, not the file"), "{cause}");
    assert!(cause.contains(&names[0]), "{cause}");
}

#[test]
fn files_that_are_not_here_are_counted_where_no_server_may_be_asked() {
    let server = Server::start().unwrap();
    mount(&server, 1..=1);
    let place = Place::new();
    place.bring(&place.archive(&server, "1")).unwrap();
    let lock = place.lock();
    let pinned = lock["jezero/sol-00001.toml"].matches("bytes = ").count();
    let other = Place::new();
    other.take_lock(&lock);
    let offline = access(&other.archive(&server, "1"), Access::Offline);
    let [message, cause, hint] = parts(other.bring(&offline).err().unwrap());
    assert_eq!(message, format!("{pinned} files of sol 1 are not in the store"));
    assert!(
        cause.starts_with("the first is `") && hint == "run once without --offline",
        "{cause} {hint}"
    );
    // The hint is the way out.
    other.bring(&other.archive(&server, "1")).unwrap();
    other.bring(&offline).unwrap();
}

#[test]
fn other_bytes_than_the_pinned_ones_are_told_with_both_sizes_and_digests() {
    let server = Server::start().unwrap();
    let name = mount(&server, 1..=1)
        .into_iter()
        .find(|name| &name[27..28] == "N")
        .unwrap();
    let place = Place::new();
    place.bring(&place.archive(&server, "1")).unwrap();
    let lock = place.lock();
    let line = lock["jezero/sol-00001.toml"]
        .lines()
        .find(|line| line.contains(&name))
        .unwrap();
    let field = |key: &str| {
        let value = line.split_once(&format!("{key} = ")).unwrap().1;
        value
            .split([',', ' '])
            .next()
            .unwrap()
            .trim_matches('"')
            .to_owned()
    };
    let other = Place::new();
    other.take_lock(&lock);
    let new = b"\x89PNG\r\n\x1a\nother";
    server.file(&format!("{BROWSE}/00001/{BELOW}/{name}"), *new);
    let locked = access(&other.archive(&server, "1"), Access::Locked);
    let [message, cause, _] = parts(other.bring(&locked).err().unwrap());
    assert_eq!(message, format!("`{name}` of sol 1 is not what `marf.lock` pins"));
    let said = format!(
        " gave 13 bytes with blake3 {}, locked are {} bytes with {}",
        marf_cache::Digest::from_content(new),
        field("bytes"),
        field("blake3")
    );
    assert!(cause.ends_with(&said), "{said}: {cause}");
}

#[test]
fn a_sol_that_no_server_and_no_lock_has_is_told() {
    let server = Server::start().unwrap();
    mount(&server, 1..=1);
    let place = Place::new();
    let archive = place.archive(&server, "1");
    let locked = access(&archive, Access::Locked);
    let [message, cause, _] = parts(place.list(&locked).unwrap_err());
    assert_eq!(message, "archive `jezero` has no product of the sols asked for");
    assert!(cause.ends_with(" no sol at all"), "{cause}");
    place.bring(&archive).unwrap();
    let stage = archive.stage();
    let error = source(stage.as_ref())
        .fetch(&place.harness.ctx(), 9)
        .err()
        .unwrap();
    let [message, _, hint] = parts(error);
    assert_eq!(message, "archive `jezero` has no sol 9 any more");
    assert_eq!(hint, "run again to list it again");
}

#[test]
fn a_feed_that_is_not_there_or_is_another_is_told_with_its_place() {
    let server = Server::start().unwrap();
    let place = Place::new();
    let nowhere = server.url("/nowhere");
    let feed = with(place.feed(&server, "5"), "/base", json!([nowhere]));
    let [message, _, hint] = parts(place.list(&feed).unwrap_err());
    assert_eq!(message, format!("the feed is not at {nowhere}"));
    assert!(hint.contains("set `base` of the archive"), "{hint}");
    server.feed("/rss/api/", |_, query| {
        let latest = query.contains("latest=true").then(|| json!({"latest_sol": 7}));
        Some(latest.unwrap_or(json!({"pictures": []})).to_string().into_bytes())
    });
    let [message, _, _] = parts(place.list(&place.feed(&server, "5")).unwrap_err());
    assert_eq!(message, "the feed's answer for sols 5 to 5 has no `images`");
}

#[test]
fn an_archive_that_cannot_be_is_refused_at_its_key() {
    let server = Server::start().unwrap();
    let place = Place::new();
    let refused = |archive: Archive| stage_in(archive.table, archive.context).err().unwrap().message;
    let mut bare = place.archive(&server, "1");
    bare.context.lock = None;
    let said = refused(bare);
    assert!(
        said.contains("an archive on a server can only be read as part of a pipeline"),
        "{said}"
    );
    let of = |mission: &str, instrument: &str, level: &str| {
        let archive = with(place.archive(&server, "1"), "/mission", json!(mission));
        with(
            with(archive, "/instrument", json!(instrument)),
            "/level",
            json!(level),
        )
    };
    for (mission, instrument, sentence) in [
        (
            "ingenuity",
            "helicam",
            "the helicopter's bundle has level `edr` only",
        ),
        (
            "curiosity",
            "navcam",
            "of Curiosity's Navcam only level `edr` is known here",
        ),
    ] {
        let said = refused(of(mission, instrument, "rdr"));
        assert!(said.contains(sentence), "{said}");
        let archive = of(mission, instrument, "edr");
        assert!(stage_in(archive.table, archive.context).is_ok(), "{mission}");
    }
}
