//! The Planetary Data System: folder pages, versions, alarms, the lock, faults.

use super::*;

/// Mounts sol 1 and returns the name of one of its pictures that is not a thumbnail.
pub(super) fn one_photo(server: &Server) -> String {
    let mut names = mount(server, 1..=1).into_iter();
    names.find(|name| &name[27..28] == "N").unwrap()
}

#[test]
fn pixels_and_labels_of_the_sols_asked_for_are_joined_by_product() {
    let server = Server::start().unwrap();
    let names = mount(&server, 1..=3);
    let place = Place::new();
    let brought = place.bring(&place.archive(&server, "1..=2")).unwrap();
    let sols: Vec<u32> = brought.listing.shards.iter().map(|shard| shard.shard).collect();
    assert_eq!(sols, [1, 2]);
    let thumbnails = |name: &&String| &name[27..28] == "T";
    let of_sols = |name: &&String| ["0001", "0002"].contains(&&name[4..8]);
    for name in names.iter().filter(of_sols) {
        match thumbnails(&name) {
            true => assert_eq!(brought.reason(name), "thumbnail"),
            false => assert!(
                brought.verdicts.iter().any(|verdict| verdict.file == *name),
                "{name}"
            ),
        }
    }
    let placed = brought
        .facts
        .values()
        .filter(|facts| !facts["prior"].is_null())
        .count();
    assert!(placed > 10, "{placed} of {} have a camera", brought.facts.len());
    let asked = server.requests();
    assert!(
        asked.iter().all(|request| !request.path().contains("/00003/")),
        "sol 3 was not asked for"
    );
    assert!(asked.iter().all(|request| {
        !names
            .iter()
            .filter(thumbnails)
            .any(|name| request.path().ends_with(name.as_str()))
    }));
    place.holds_only_lock();
    let agent = asked[0].header("user-agent").unwrap();
    assert!(agent.starts_with("marf/"), "{agent}");
}

#[test]
fn the_second_time_nothing_is_fetched_and_the_fingerprints_stay() {
    let server = Server::start().unwrap();
    mount(&server, [1, 2, 40]);
    let place = Place::new();
    let archive = place.archive(&server, "1..=40");
    let first = place.bring(&archive).unwrap();
    let lock = place.lock();
    server.clear();
    let again = place.bring(&archive).unwrap();
    assert_eq!((first.listing, first.rows), (again.listing, again.rows));
    assert_eq!(pictures(&server), 0);
    let asked: Vec<String> = server
        .requests()
        .iter()
        .map(|request| request.path().to_owned())
        .collect();
    assert!(
        asked.iter().any(|path| path.contains("/00040/")),
        "a young sol is listed again: {asked:?}"
    );
    assert!(
        !asked.iter().any(|path| path.contains("/00001/")),
        "an old one is not: {asked:?}"
    );
    assert_eq!(place.lock(), lock);
}

#[test]
fn a_new_sol_brings_only_its_own_products() {
    let server = Server::start().unwrap();
    mount(&server, 1..=2);
    let place = Place::new();
    let before = place.bring(&place.archive(&server, "1..=9")).unwrap();
    let new = mount(&server, [3]);
    server.clear();
    let after = place.bring(&place.archive(&server, "1..=9")).unwrap();
    assert_eq!(after.listing.shards[..2], before.listing.shards);
    assert_eq!(after.listing.shards.len(), 3);
    let wanted = new.iter().filter(|name| &name[27..28] == "N").count();
    assert_eq!(pictures(&server), wanted);
}

#[test]
fn another_mirror_gives_the_same_fingerprints_and_is_asked_when_the_first_fails() {
    let (good, bad) = (Server::start().unwrap(), Server::start().unwrap());
    mount(&good, 1..=1);
    let place = Place::new();
    let direct = place.bring(&place.archive(&good, "1")).unwrap();
    bad.faults(0, 0.0);
    let bases = json!([bad.url("/nowhere"), good.url("/img/data")]);
    let other = Place::new();
    let archive = with(other.archive(&good, "1"), "/base", bases);
    let fallen_back = other.bring(&archive).unwrap();
    assert_eq!(
        (direct.listing, direct.rows),
        (fallen_back.listing, fallen_back.rows)
    );
}

#[test]
fn locked_takes_what_the_lock_names_and_offline_opens_no_connection() {
    let server = Server::start().unwrap();
    mount(&server, 1..=2);
    let place = Place::new();
    let archive = place.archive(&server, "1..=9");
    let online = place.bring(&archive).unwrap();
    mount(&server, [3]);
    server.clear();
    let offline = place.bring(&access(&archive, Access::Offline)).unwrap();
    assert_eq!((&online.listing, &online.rows), (&offline.listing, &offline.rows));
    assert_eq!(online.verdicts, offline.verdicts);
    let locked = place.bring(&access(&archive, Access::Locked)).unwrap();
    assert_eq!((&online.listing, &online.rows), (&locked.listing, &locked.rows));
    assert!(server.requests().is_empty(), "everything was here");

    // On another machine: the lock, and an empty store.
    let other = Place::new();
    other.take_lock(&place.lock());
    let archive = other.archive(&server, "1..=9");
    let error = other.bring(&access(&archive, Access::Offline)).err().unwrap();
    assert!(error.to_string().contains("not in the store"), "{error}");
    assert!(server.requests().is_empty());
    let moved = other.bring(&access(&archive, Access::Locked)).unwrap();
    assert_eq!((&online.listing, &online.rows), (&moved.listing, &moved.rows));
    assert!(
        server
            .requests()
            .iter()
            .all(|request| !request.path().ends_with('/')),
        "nothing is listed"
    );
}

#[test]
fn locked_names_the_product_whose_bytes_are_others() {
    let server = Server::start().unwrap();
    let name = one_photo(&server);
    let place = Place::new();
    place.bring(&place.archive(&server, "1")).unwrap();
    let other = Place::new();
    other.take_lock(&place.lock());
    server.file(
        &format!("{BROWSE}/00001/{BELOW}/{name}"),
        *b"\x89PNG\r\n\x1a\nother",
    );
    let error = other
        .bring(&access(&other.archive(&server, "1"), Access::Locked))
        .err()
        .unwrap();
    assert!(
        error.to_string().contains(&name) && error.to_string().contains("marf.lock"),
        "{error}"
    );
}

#[test]
fn other_bytes_under_a_known_name_are_an_alarm_and_both_are_kept() {
    let server = Server::start().unwrap();
    let name = one_photo(&server);
    let place = Place::new();
    let archive = place.archive(&server, "1");
    let before = place.bring(&archive).unwrap();
    let path = format!("{BROWSE}/00001/{BELOW}/{name}");
    server.file_with(
        &path,
        *b"\x89PNG\r\n\x1a\nother",
        Some("\"new\""),
        Some("Wed, 02 Mar 2022 10:20:00 GMT"),
    );
    let alarmed = place.bring(&archive).unwrap();
    assert_ne!(before.listing, alarmed.listing, "the sol is brought again");
    assert_eq!(before.rows, alarmed.rows, "the first bytes stay in use");
    let reason = alarmed.reason(&format!("{name} (other bytes)"));
    let digest = marf_cache::Digest::from_content(b"\x89PNG\r\n\x1a\nother");
    assert!(
        reason.starts_with("alarm") && reason.contains(&digest.to_string()),
        "{reason}"
    );
    assert!(place.harness.get(&digest).is_some(), "the other bytes are kept");
    assert!(place.lock_says(&digest.to_string()));
    server.clear();
    let settled = place.bring(&archive).unwrap();
    assert_eq!(pictures(&server), 0);
    assert!(
        settled
            .reason(&format!("{name} (other bytes)"))
            .starts_with("alarm")
    );
}

#[test]
fn a_newer_version_replaces_the_old_and_says_so() {
    let server = Server::start().unwrap();
    let name = one_photo(&server);
    let place = Place::new();
    let archive = place.archive(&server, "1");
    place.bring(&archive).unwrap();
    let newer = name.replace("LMJ01.", "LMJ02.");
    let bytes = image_bytes(9);
    server.file(&format!("{BROWSE}/00001/{BELOW}/{newer}"), bytes.clone());
    let both = place.bring(&archive).unwrap();
    assert_eq!(both.reason(&name), "version 01 is superseded by 02");
    assert!(both.kept().contains(&newer) && !both.kept().contains(&name));
    // Some archives take the old one away.
    server.remove(&format!("{BROWSE}/00001/{BELOW}/{name}"));
    let alone = place.bring(&archive).unwrap();
    assert_eq!(both.rows, alone.rows);
    assert_eq!(alone.reason(&name), "version 01 is superseded by 02");
}

#[test]
fn a_fifth_of_all_requests_spoilt_gives_the_same_bytes() {
    let server = Server::start().unwrap();
    mount(&server, 1..=2);
    let quiet = Place::new();
    let expected = quiet.bring(&quiet.archive(&server, "1..=2")).unwrap();
    let plain = server.requests().len();
    server.clear();
    server.faults(7, 0.2);
    let place = Place::new();
    let archive = with(place.archive(&server, "1..=2"), "/network/tries", json!(10));
    let brought = place.bring(&archive).unwrap();
    assert_eq!(
        (&expected.listing, &expected.rows),
        (&brought.listing, &brought.rows)
    );
    assert!(server.requests().len() > plain, "faults were met");
    place.holds_only_lock();
    println!(
        "20 % faults: {} requests, {plain} without; most at once {}",
        server.requests().len(),
        server.most_at_once()
    );
}

#[test]
fn what_is_listed_and_gone_is_a_verdict_and_what_fails_for_now_stops_with_the_rest_kept() {
    let server = Server::start().unwrap();
    let names: Vec<String> = mount(&server, 1..=1)
        .into_iter()
        .filter(|name| &name[27..28] == "N")
        .collect();
    let path = |name: &str| format!("{BROWSE}/00001/{BELOW}/{name}");
    server.script(&path(&names[0]), vec![Reply::status(404).always()]);
    server.script(&path(&names[1]), vec![Reply::status(503).always()]);
    server.script(&path(&names[2]), vec![Reply::firewall().always()]);
    let place = Place::new();
    let archive = with(place.archive(&server, "1"), "/network/tries", json!(2));
    let error = place.bring(&archive).err().unwrap();
    assert!(error.to_string().starts_with("2 of "), "{error}");
    server.script(&path(&names[1]), vec![]);
    server.script(&path(&names[2]), vec![]);
    server.clear();
    let brought = place.bring(&archive).unwrap();
    assert_eq!(brought.reason(&names[0]), "listed, but the server answered 404");
    assert_eq!(
        pictures(&server),
        3,
        "the two that failed, and the one that was gone once more"
    );
}

#[test]
fn a_refusal_is_final_when_the_next_run_gets_it_too() {
    let server = Server::start().unwrap();
    let names: Vec<String> = mount(&server, 1..=1)
        .into_iter()
        .filter(|name| &name[27..28] == "N")
        .collect();
    let path = |name: &str| format!("{BROWSE}/00001/{BELOW}/{name}");
    server.script(&path(&names[0]), vec![Reply::status(403).always()]);
    server.script(&path(&names[1]), vec![Reply::status(403)]);
    server.script(&path(&names[2]), vec![Reply::status(401)]);
    let place = Place::new();
    let archive = place.archive(&server, "1");
    let error = place.bring(&archive).err().unwrap();
    assert!(error.to_string().starts_with("3 of "), "{error}");
    let is_complete = || place.lock()["jezero/sol-00001.toml"].contains("\ncomplete = ");
    assert!(!is_complete());
    server.clear();
    let brought = place.bring(&archive).unwrap();
    assert_eq!(pictures(&server), 3, "all that were refused");
    assert_eq!(brought.reason(&names[0]), "listed, but the server answered 403");
    let refused = |verdict: &&Verdict| verdict.reason.starts_with("listed, but the server answered");
    assert_eq!(brought.verdicts.iter().filter(refused).count(), 1);
    assert!(is_complete());
}

/// The trees, and the page of the collection above each.
fn is_below_collection(target: &str) -> bool {
    [BROWSE, DATA]
        .iter()
        .any(|tree| target.starts_with(tree.trim_end_matches("sol")))
}

#[test]
fn a_hostile_listing_gives_no_name_and_no_request_outside_its_folder() {
    let Some(folder) = real("bad-inputs/own") else {
        return;
    };
    let server = Server::start().unwrap();
    mount(&server, 1..=1);
    let page = std::fs::read(folder.join("index_hostile.html")).unwrap();
    let reply = Reply::Status(200, vec![("Content-Type".into(), "text/html".into())], page);
    server.script(&format!("{BROWSE}/00001/{BELOW}/"), vec![reply.always()]);
    let place = Place::new();
    drop(place.bring(&place.archive(&server, "1")));
    let stray: Vec<String> = server
        .requests()
        .iter()
        .map(|request| request.target.clone())
        .filter(|target| !is_below_collection(target) || target.contains(".."))
        .collect();
    assert!(stray.is_empty(), "{stray:?}");
    place.holds_only_lock();
}

#[test]
fn a_firewall_in_place_of_a_listing_is_an_error_with_the_way_out() {
    let server = Server::start().unwrap();
    mount(&server, 1..=1);
    server.script(&format!("{BROWSE}/"), vec![Reply::firewall().always()]);
    let place = Place::new();
    let error = place.list(&place.archive(&server, "1")).unwrap_err();
    let StageError::Failed { message, hint, .. } = &error else {
        panic!("{error:?}");
    };
    assert!(
        message.contains("is not a listing") && hint.as_ref().unwrap().contains("base"),
        "{error:?}"
    );
    server.script(&format!("{BROWSE}/"), vec![]);
    let nowhere = with(
        place.archive(&server, "1"),
        "/base",
        json!([server.url("/moved")]),
    );
    let error = place.list(&nowhere).unwrap_err();
    assert!(error.to_string().contains("no sols in"), "{error}");
    let empty = place.list(&place.archive(&server, "700")).unwrap_err();
    assert!(empty.to_string().contains("no product of the sols"), "{empty}");
}

#[test]
fn a_lock_of_another_camera_is_no_answer() {
    let server = Server::start().unwrap();
    mount(&server, 1..=1);
    let place = Place::new();
    let archive = place.archive(&server, "1");
    place.bring(&archive).unwrap();
    let navcam = with(archive, "/instrument", json!("navcam"));
    let error = place.list(&access(&navcam, Access::Locked)).unwrap_err();
    assert!(error.to_string().contains("pins other products"), "{error}");
    let folder = BROWSE.replace("mastcamz", "navcam");
    server.folder(&format!("{folder}/"));
    server.folder(&format!("{}/", DATA.replace("mastcamz", "navcam")));
    let name = "NLF_0001_0667035659_559EBY_N0010052NCAM00500_00_0LLJ01.png";
    server.file(&format!("{folder}/00001/ids/edr/ncam/{name}"), image_bytes(2));
    let brought = place.bring(&navcam).unwrap();
    assert_eq!(brought.rows.len(), 1);
    assert_eq!(
        brought.verdicts.len(),
        1,
        "nothing of the other camera is said: {:?}",
        brought.verdicts
    );
    assert!(place.lock_says("asked = \"pds perseverance navcam edr browse\""));
}

/// Fingerprints are part of keys: where one of these changes, everything of every archive is brought again.
#[test]
fn fingerprints_of_remote_archives_stay_what_they_are() {
    let server = Server::start().unwrap();
    let name = "ZL0_0012_0668000000_100EBY_N0030000ZCAM00001_0340LMJ01";
    let old = "ZL0_0012_0668000000_100ECM_N0030000ZCAM00001_0340LMJ01";
    for stem in [name, old] {
        server.file(&format!("{BROWSE}/00012/{BELOW}/{stem}.png"), image_bytes(3));
    }
    server.file(&format!("{DATA}/00012/{BELOW}/{name}.xml"), "<label/>");
    let place = Place::new();
    let archive = place.archive(&server, "12");
    let fresh = place.list(&archive).unwrap().shards[0].fingerprint.to_string();
    place.bring(&archive).unwrap();
    let fetched = place.list(&archive).unwrap().shards[0].fingerprint.to_string();

    let record = json!({"imageid": "GOOD", "sol": 5, "camera": {"instrument": "NAVCAM_LEFT"}, "sample_type": "Full",
        "image_files": {"full_res": "https://mars.nasa.gov/p/good.png"}});
    play(&server, vec![record]);
    let hosts = json!(["https://mars.nasa.gov"]);
    let feed = with(place.feed(&server, "5"), "/picture_hosts", hosts);
    let feed = place.list(&feed).unwrap().shards[0].fingerprint.to_string();
    let listed = "72eb6684c3f6573b6d5be68c2c78ec50b36743d0396e60312456e33c5c83a89b";
    let pinned = "c3ea414bbe0b248e309e1bc914d9ef282f4da534e030c252513b7529549721b7";
    let one_record = "6e18b7128bcf81bf16089c02fdcd3c7124152cd203caa50c7c521383ee51eca3";
    assert_eq!([fresh, fetched, feed], [listed, pinned, one_record]);
}
