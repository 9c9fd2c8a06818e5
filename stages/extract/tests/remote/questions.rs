//! Number of requests of a run with nothing new, and that new files are still found.

use super::*;

const COLLECTION: &str = "/img/data/mars2020/mars2020_mastcamz_ops_raw";

/// Puts the inventories of both collections next to their trees, as a release of this date does.
fn release(server: &Server, date: &str) {
    for side in ["browse", "data"] {
        let path = format!("{COLLECTION}/{side}/collection_{side}_inventory.csv");
        server.file_with(&path, *b"P,urn:nasa:pds:x", None, Some(date));
    }
}

fn asked(server: &Server) -> Vec<String> {
    server.requests().iter().map(|one| one.target.clone()).collect()
}

#[test]
fn a_run_with_nothing_new_asks_one_question_a_tree_where_inventories_are_shown() {
    let server = Server::start().unwrap();
    mount(&server, [1, 2, 40]);
    release(&server, "Tue, 01 Mar 2022 10:20:00 GMT");
    let place = Place::new();
    let archive = place.archive(&server, "1..=40");
    let first = place.bring(&archive).unwrap();
    server.clear();
    let again = place.list(&archive).unwrap();
    assert_eq!(again.shards, first.listing.shards);
    let mut pages = asked(&server);
    pages.sort();
    assert_eq!(
        pages,
        [format!("{COLLECTION}/browse/"), format!("{COLLECTION}/data/")]
    );

    // A product of a known sol comes late, with the inventory of its release.
    let late = "ZL0_0040_0668000000_100EBY_N0030000ZCAM00001_0340LMJ01.png";
    server.file(&format!("{BROWSE}/00040/{BELOW}/{late}"), image_bytes(9));
    release(&server, "Wed, 01 Jun 2022 10:20:00 GMT");
    let found = place.bring(&archive).unwrap();
    assert!(found.kept().contains(late));
    server.clear();
    assert_eq!(place.list(&archive).unwrap().shards, found.listing.shards);
    assert_eq!(server.requests().len(), 2);
}

#[test]
fn a_release_under_way_is_looked_at_again() {
    let server = Server::start().unwrap();
    mount(&server, [1]);
    let now = httpdate::fmt_http_date(std::time::SystemTime::now());
    release(&server, &now);
    let place = Place::new();
    let archive = place.archive(&server, "1");
    place.bring(&archive).unwrap();
    // The inventory was there before this product of its release.
    let late = "ZL0_0001_0668000000_100EBY_N0030000ZCAM00001_0340LMJ01.png";
    server.file(&format!("{BROWSE}/00001/{BELOW}/{late}"), image_bytes(9));
    assert!(place.bring(&archive).unwrap().kept().contains(late));
}

#[test]
fn an_old_sol_that_is_wholly_pinned_is_asked_for_by_nobody() {
    let server = Server::start().unwrap();
    mount(&server, [1, 2, 40]);
    let place = Place::new();
    let archive = place.archive(&server, "1..=40");
    let first = place.bring(&archive).unwrap();
    // On another machine with the lock alone, or where the scratch folder is lost.
    std::fs::remove_dir_all(&place.harness.scratch).unwrap();
    server.clear();
    assert_eq!(place.list(&archive).unwrap().shards, first.listing.shards);
    assert!(
        !asked(&server)
            .iter()
            .any(|path| path.contains("/00001/") || path.contains("/00002/")),
        "{:?}",
        asked(&server)
    );
    // Requested with other product types, it is listed again: its products of those types are not pinned.
    let other = with(archive, "/products", json!(["ECM", "EBY", "EDR", "EJP"]));
    server.clear();
    place.list(&other).unwrap();
    assert!(asked(&server).iter().any(|path| path.contains("/00001/")));
}

#[test]
fn an_old_sol_that_did_not_come_whole_is_listed_again() {
    let server = Server::start().unwrap();
    let names: Vec<String> = mount(&server, [1, 40]).into_iter().collect();
    let name = names
        .iter()
        .find(|name| &name[4..8] == "0001" && &name[27..28] == "N")
        .unwrap();
    let path = format!("{BROWSE}/00001/{BELOW}/{name}");
    server.script(&path, vec![Reply::status(503).always()]);
    let place = Place::new();
    let archive = with(place.archive(&server, "1..=40"), "/network/tries", json!(1));
    assert!(place.bring(&archive).is_err());
    server.script(&path, vec![]);
    std::fs::remove_dir_all(&place.harness.scratch).unwrap();
    assert!(place.bring(&archive).unwrap().kept().contains(name));
}

#[test]
fn a_feed_that_tells_how_much_it_has_is_asked_once() {
    let server = Server::start().unwrap();
    server.file("/p/a.png", image_bytes(3));
    let picture = server.url("/p/a.png");
    let total = Arc::new(Mutex::new(3_usize));
    let (told, place) = (Arc::clone(&total), Place::new());
    server.feed("/rss/api/", move |_, query| {
        let total = *told.lock().unwrap();
        let record = |number: usize| {
            json!({"imageid": format!("NLF_{number:04}"), "sol": 7 + number, "camera": {"instrument": "NAVCAM_LEFT"},
                   "image_files": {"full_res": picture}})
        };
        let images: Vec<Value> = (0..total).map(record).collect();
        let answer = match query.contains("latest=true") {
            true => json!({"latest_sol": 7 + total - 1, "total": total}),
            false => json!({"images": images, "total_results": total}),
        };
        Some(answer.to_string().into_bytes())
    });
    let first = place.bring(&place.feed(&server, "0..=99")).unwrap();
    assert_eq!(first.rows.len(), 3);
    server.clear();
    assert_eq!(
        place.list(&place.feed(&server, "0..=99")).unwrap().shards,
        first.listing.shards
    );
    assert_eq!(server.requests().len(), 1);
    *total.lock().unwrap() = 4;
    assert_eq!(place.bring(&place.feed(&server, "0..=99")).unwrap().rows.len(), 4);
}

fn curiosity(place: &Place, server: &Server, instrument: &str) -> Archive {
    let archive = with(place.archive(server, "0..=4000"), "/mission", json!("curiosity"));
    with(archive, "/instrument", json!(instrument))
}

#[test]
fn a_bundle_with_products_in_the_folders_of_sols_is_asked_once() {
    let server = Server::start().unwrap();
    let name = |number: u32| format!("NLB_58600418{number}EDR_F0721234NCAM00295M1");
    for (number, sol) in [(1, 2_123), (2, 2_124)] {
        server.file(
            &format!(
                "/img/data/msl/msl_navcam_raw/DATA/SOL{sol:05}/{}.IMG",
                name(number)
            ),
            img(),
        );
    }
    let place = Place::new();
    let archive = curiosity(&place, &server, "navcam");
    let first = place.bring(&archive).unwrap();
    server.clear();
    assert_eq!(place.list(&archive).unwrap().shards, first.listing.shards);
    assert_eq!(asked(&server), ["/img/data/msl/msl_navcam_raw/DATA/"]);
    server.file(
        &format!("/img/data/msl/msl_navcam_raw/DATA/SOL02125/{}.IMG", name(3)),
        img(),
    );
    assert_eq!(place.bring(&archive).unwrap().rows.len(), 3);
}

/// One request shows new volumes, another new sols of the newest volume: the first page does not show the inside of a
/// volume.
#[test]
fn volumes_are_asked_for_until_they_are_closed() {
    let server = Server::start().unwrap();
    let file = |volume: u32, sol: u32| {
        let name = format!("{sol:04}ML0121141200805116C00_DRCL.IMG");
        server.file(
            &format!("/img/data/msl/MSLMST_{volume:04}/DATA/RDR/SURFACE/{sol:04}/{name}"),
            img(),
        );
    };
    (1..=5).for_each(|volume| file(volume, volume * 90));
    let place = Place::new();
    let archive = curiosity(&place, &server, "mastcam");
    let first = place.bring(&archive).unwrap();
    assert_eq!(first.rows.len(), 5);
    server.clear();
    assert_eq!(place.list(&archive).unwrap().shards, first.listing.shards);
    assert_eq!(
        asked(&server),
        ["/img/data/msl/", "/img/data/msl/MSLMST_0005/DATA/RDR/SURFACE/"]
    );
    file(5, 451);
    file(6, 540);
    assert_eq!(place.bring(&archive).unwrap().rows.len(), 7);
}
