//! The raw-image feed of Mars 2020: real records replayed, pages, records that cannot be used.

use super::*;

/// The saved records of a folder by id, each with its picture on the server.
fn saved(server: &Server, folder: &Path) -> Vec<Value> {
    let mut records = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap().map(Result::unwrap) {
        let path = entry.path();
        if path.extension().is_none_or(|extension| extension != "json") {
            continue;
        }
        let mut record: Value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
        let picture = ["png", "jpg"]
            .map(|end| path.with_extension(end))
            .into_iter()
            .find(|path| path.exists());
        let picture = picture.unwrap();
        let name = picture.file_name().unwrap().to_string_lossy().into_owned();
        let address = format!("/mars2020-raw-images/{name}");
        server.file(&address, std::fs::read(&picture).unwrap());
        record["image_files"]["full_res"] = json!(server.url(&address));
        records.push(record);
    }
    records.sort_by_key(|record| record["imageid"].to_string());
    records
}

#[test]
fn the_saved_records_of_the_real_feed_are_replayed_and_only_new_ones_fetched() {
    let Some(folder) = real("m2020_navcam_feed") else {
        return;
    };
    let server = Server::start().unwrap();
    let mut records = saved(&server, &folder);
    let total = records.len();
    play(&server, records.clone());

    let place = Place::new();
    let early = place.bring(&place.feed(&server, "50..=400")).unwrap();
    let (early_pictures, early_requests) = (served(&server), server.requests().len());
    assert_eq!(early.rows.len(), early_pictures);
    server.clear();
    let all = place.bring(&place.feed(&server, "50..=900")).unwrap();
    assert_eq!(all.rows.len(), total);
    assert_eq!(
        served(&server),
        total - early_pictures,
        "only new pictures are fetched"
    );
    println!(
        "sols 50 to 400: {early_pictures} pictures in {early_requests} requests; then all: {} in {}",
        served(&server),
        server.requests().len()
    );
    // The same as from the folder of files, but for the names of pages.
    let local = common::bring(common::folder(&folder)).unwrap();
    assert_eq!(local.rows.len(), total);
    for (_, row) in &local.rows {
        let id = row.id.rsplit('/').next().unwrap();
        let (mine, theirs) = (&all.facts[id], &row.facts);
        assert_eq!(mine["prior"], theirs["prior"], "{id}");
        assert_eq!(
            (&mine["width"], &mine["sol"]),
            (&theirs["width"], &theirs["sol"]),
            "{id}"
        );
    }
    server.clear();
    let offline = place
        .bring(&access(&place.feed(&server, "50..=900"), Access::Offline))
        .unwrap();
    assert_eq!((&all.listing, &all.rows), (&offline.listing, &offline.rows));
    assert!(server.requests().is_empty());

    // On another machine: records come with the listing only, and are held against the lock.
    let other = Place::new();
    other.take_lock(&place.lock());
    let locked = other
        .bring(&access(&other.feed(&server, "50..=900"), Access::Locked))
        .unwrap();
    assert_eq!((&all.listing, &all.rows), (&locked.listing, &locked.rows));

    // A revised record: used, said, and refused by name where the old one is locked and lost.
    let young = records
        .iter()
        .position(|record| record["sol"].as_u64().unwrap() > 840)
        .unwrap();
    records[young]["camera"]["camera_position"] = json!("(0,0,0)");
    let id = records[young]["imageid"].as_str().unwrap().to_owned();
    play(&server, records);
    let revised = place.bring(&place.feed(&server, "50..=900")).unwrap();
    assert!(
        revised
            .reason(&format!("{id}.json (other bytes)"))
            .contains("revised")
    );
    assert_ne!(revised.rows[&id], all.rows[&id]);
    let late = Place::new();
    late.take_lock(&other.lock());
    let error = late
        .bring(&access(&late.feed(&server, "50..=900"), Access::Locked))
        .err()
        .unwrap();
    assert!(error.to_string().contains(&id), "{error}");
}

#[test]
fn records_of_a_feed_that_cannot_be_used_are_verdicts() {
    let server = Server::start().unwrap();
    let good = server.url("/p/good.png");
    server.file("/p/good.png", image_bytes(3));
    let record = |id: &str, url: &str| {
        json!({"imageid": id, "sol": 5, "camera": {"instrument": "NAVCAM_LEFT"}, "sample_type": "Full",
               "image_files": {"full_res": url}})
    };
    let mut thumbnail = record("THUMB", &good);
    thumbnail["sample_type"] = json!("Thumbnail");
    let mut other = record("OTHER", &good);
    other["camera"]["instrument"] = json!("MCZ_LEFT");
    let mut unknown = record("NOPICTURE", "UNK");
    unknown["extended"] = json!({"scaleFactor": "UNK", "dimension": "UNK"});
    play(
        &server,
        vec![
            record("GOOD", &good),
            thumbnail,
            other,
            unknown,
            record("ELSEWHERE", "https://evil.example/a.png"),
            record("FILE", "file:///etc/passwd.png"),
            record("../../etc/x", &good),
        ],
    );
    let place = Place::new();
    let brought = place.bring(&place.feed(&server, "latest")).unwrap();
    assert_eq!(brought.rows.keys().collect::<Vec<_>>(), ["GOOD.png"]);
    assert_eq!(brought.reason("THUMB"), "thumbnail");
    assert!(brought.reason("OTHER").contains("another camera"));
    assert!(brought.reason("NOPICTURE").contains("names no picture"));
    assert!(brought.reason("ELSEWHERE").contains("evil.example"));
    assert!(brought.reason("FILE").contains("picture_hosts"));
    place.holds_only_lock();
}

#[test]
fn a_feed_is_read_page_by_page_also_where_it_ignores_what_it_is_asked() {
    let server = Server::start().unwrap();
    server.file("/p/a.png", image_bytes(3));
    let records: Vec<Value> = (0..250)
        .map(|number| {
            json!({"imageid": format!("NLF_{number:04}"), "sol": 7, "camera": {"instrument": "NAVCAM_LEFT"},
                   "image_files": {"full_res": server.url("/p/a.png")}})
        })
        .collect();
    play(&server, records.clone());
    let place = Place::new();
    let brought = place.bring(&place.feed(&server, "7")).unwrap();
    assert_eq!(brought.rows.len(), 250);
    assert_eq!(
        server.requests_of("/rss/api/").len(),
        1 + 3,
        "the latest sol, and three pages"
    );

    // Every page is the first one, and no total is reported.
    let stubborn = Server::start().unwrap();
    stubborn.file("/p/a.png", image_bytes(3));
    let picture = stubborn.url("/p/a.png");
    stubborn.feed("/rss/api/", move |_, query| {
        let mut record = records[0].clone();
        record["image_files"]["full_res"] = json!(picture);
        let latest = query.contains("latest=true").then(|| json!({"latest_sol": 7}));
        Some(
            latest
                .unwrap_or_else(|| json!({"images": [record]}))
                .to_string()
                .into_bytes(),
        )
    });
    let place = Place::new();
    assert_eq!(place.bring(&place.feed(&stubborn, "7")).unwrap().rows.len(), 1);
    assert_eq!(stubborn.requests_of("/rss/api/").len(), 1 + 2);
}

#[test]
fn the_latest_sol_is_the_latest_with_a_photo_of_this_camera() {
    let server = Server::start().unwrap();
    server.file("/p/a.png", image_bytes(3));
    let record = |sol: u32, instrument: &str| {
        json!({"imageid": format!("{instrument}_{sol}"), "sol": sol, "camera": {"instrument": instrument},
               "image_files": {"full_res": server.url("/p/a.png")}})
    };
    play(
        &server,
        vec![
            record(90, "NAVCAM_LEFT"),
            record(95, "NAVCAM_RIGHT"),
            record(100, "MCZ_LEFT"),
        ],
    );
    let place = Place::new();
    let brought = place.bring(&place.feed(&server, "latest")).unwrap();
    let sols: Vec<u32> = brought.listing.shards.iter().map(|shard| shard.shard).collect();
    assert_eq!((sols, brought.rows.len()), (vec![95], 1));
    let offline = place
        .bring(&access(&place.feed(&server, "latest"), Access::Offline))
        .unwrap();
    assert_eq!(brought.rows, offline.rows);
}
