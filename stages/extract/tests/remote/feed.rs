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

/// A record as the feed has it, with a camera of nine components.
pub(super) fn navcam(server: &Server, sol: u32, number: u32) -> Value {
    let id = format!("NLF_{sol:04}_0671{number:06}_448ECM_N0031950NCAM00500_01_295J");
    let path = format!("/mars2020-raw-images/{id}01.png");
    server.file(&path, image_bytes((number % 17) as u8));
    json!({
        "imageid": id, "sol": sol, "site": 3, "drive": "1950", "sample_type": "Full", "link": "UNK",
        "attitude": "(0.8,0.0,0.0,0.6)", "date_received": "2021-04-11T16:01:56Z",
        "image_files": {"small": "UNK", "full_res": server.url(&path)},
        "camera": {
            "instrument": "NAVCAM_LEFT", "filter_name": "UNK", "camera_model_type": "CAHVORE",
            "camera_model_component_list": "(0.67,0.77,-1.96);(1,0,0);(8,200,0);(6,0,200);(1,0,0);(2e-06,0.05,-0.016);\
                                            (-0.0036,0.013,-0.024);2.0;0.0",
        },
        "extended": {"xyz": "(10.3,66.0,0.7)", "scaleFactor": "4", "dimension": "(16,12)", "mastAz": "UNK"},
    })
}

/// Answers as the feed does: newest sols first, numbers also as texts, an envelope around each page.
pub(super) fn play_in_its_envelope(server: &Server, records: Vec<Value>) {
    let sol = |record: &Value| record["sol"].as_u64().unwrap();
    server.feed("/rss/api/", move |_, query| {
        let value = |key: &str| {
            let mut pairs = query.split('&').filter_map(|pair| pair.split_once('='));
            pairs.find(|(name, _)| *name == key).map(|(_, value)| value.to_owned())
        };
        let newest = records.iter().map(sol).max()?;
        if value("latest").is_some() {
            let latest = json!({"latest": "2021-04-11T16:01:56Z", "latest_sol": newest, "latest_sols": [newest], "new_count": 9,
                                "sol_count": 7, "total": records.len(), "type": "mars2020"});
            return Some(latest.to_string().into_bytes());
        }
        let number = |key: &str| value(key)?.split(':').next()?.parse::<u64>().ok();
        let (first, last, page) = (number("condition_2")?, number("condition_3")?, number("page")?);
        let instruments = value("search")?;
        let is_searched = |record: &&Value| {
            let instrument = record["camera"]["instrument"].as_str().unwrap();
            instruments.split("%7C").any(|name| name == instrument) && (first..=last).contains(&sol(record))
        };
        let mut found: Vec<&Value> = records.iter().filter(is_searched).collect();
        found.sort_by_key(|record| std::cmp::Reverse(sol(record)));
        let images: Vec<&&Value> = found.iter().skip(100 * page as usize).take(100).collect();
        let page = json!({"images": images, "per_page": "100", "total_results": found.len(), "page": page.to_string(),
                          "mission": "mars2020", "type": "raw_images", "total_images": 700_000});
        Some(page.to_string().into_bytes())
    });
}

#[test]
fn pages_of_the_feed_are_read_to_their_end_and_then_only_new_records() {
    let server = Server::start().unwrap();
    let mut records: Vec<Value> = (0..130)
        .map(|number| navcam(&server, 50 + number % 3, number))
        .collect();
    for number in 200..220 {
        let mut thumbnail = navcam(&server, 51, number);
        thumbnail["sample_type"] = json!("Thumbnail");
        records.push(thumbnail);
    }
    play_in_its_envelope(&server, records.clone());
    let place = Place::new();
    let archive = place.feed(&server, "50..=60");
    let first = place.bring(&archive).unwrap();
    assert_eq!((first.rows.len(), served(&server)), (130, 130));
    assert_eq!(
        server.requests_of("/rss/api/").len(),
        1 + 2,
        "the latest sol, and two pages of 150 records"
    );
    for facts in first.facts.values() {
        assert_eq!(facts["prior"]["motion_counter"], json!([3, 1950]), "{facts}");
    }

    // A young sol gets a photo, and a new sol comes.
    records.extend([navcam(&server, 52, 300), navcam(&server, 53, 301)]);
    play_in_its_envelope(&server, records);
    server.clear();
    let second = place.bring(&archive).unwrap();
    assert_eq!((second.rows.len(), served(&server)), (132, 2));
    assert!(first.rows.iter().all(|(id, row)| second.rows[id] == *row));
    server.clear();
    assert_eq!(place.bring(&archive).unwrap().rows, second.rows);
    assert_eq!(server.requests().len(), 1, "the total is unchanged");
}
