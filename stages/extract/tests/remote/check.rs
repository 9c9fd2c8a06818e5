//! One page of each kind, a label and a picture, compared with what the readers expect.

use marf_extract::{Check, CheckState, CheckedArchive};
use marf_stage::Cancel;

use super::*;

fn checked(archive: &Archive) -> Vec<Check> {
    let archive = CheckedArchive::new(archive.table.clone(), archive.context.clone()).unwrap();
    archive.check(&Cancel::default()).unwrap()
}

/// What was asked for, with its state.
fn states(checks: &[Check]) -> Vec<(&str, CheckState)> {
    checks
        .iter()
        .map(|check| (check.what.as_str(), check.state))
        .collect()
}

fn of<'a>(checks: &'a [Check], what: &str) -> &'a Check {
    let check = checks.iter().find(|check| check.what == what);
    check.unwrap_or_else(|| panic!("no check of {what}: {checks:#?}"))
}

/// Returns the only check that differs.
fn differing(checks: &[Check]) -> &Check {
    let differ: Vec<&Check> = checks
        .iter()
        .filter(|check| check.state == CheckState::Differs)
        .collect();
    assert_eq!(differ.len(), 1, "{checks:#?}");
    differ[0]
}

fn all_well(checks: &[Check]) {
    assert!(
        checks.iter().all(|check| check.state == CheckState::AsExpected),
        "{checks:#?}"
    );
}

/// The built-in Mars of two sols, and its archive.
fn mars() -> (Server, Place, Archive) {
    let (server, place) = (Server::start().unwrap(), Place::new());
    mount(&server, 1..=2);
    for collection in [BROWSE, DATA] {
        let name = format!("{}/collection_inventory.csv", collection.trim_end_matches("/sol"));
        server.file(&name, "not read");
    }
    let archive = place.archive(&server, "1..=9");
    (server, place, archive)
}

#[test]
fn an_archive_as_expected_is_asked_for_one_of_each() {
    let (server, place, archive) = mars();
    let checks = checked(&archive);
    all_well(&checks);
    let whats: Vec<&str> = checks.iter().map(|check| check.what.as_str()).collect();
    let tree = ["page of the collection", "page of sols"];
    let sol = ["page of sol 2", "page of sol 2", "label", "picture"];
    assert_eq!(whats, [tree.as_slice(), &tree, &sol].concat());
    assert_eq!(
        server.requests().len(),
        checks.len(),
        "no request without its check"
    );
    assert_eq!(server.most_at_once(), 1);
    assert!(
        of(&checks, "page of sols").found.contains("2 sols from 1 to 2"),
        "{checks:#?}"
    );
    assert!(
        of(&checks, "label").found.contains("sol 2, instrument"),
        "{checks:#?}"
    );
    assert!(
        of(&checks, "picture").found.contains("24 x 18 pixels"),
        "{checks:#?}"
    );
    assert!(
        place.lock().is_empty() && !place.dir.path().join("scratch").exists(),
        "nothing is kept"
    );
}

#[test]
fn pages_of_another_form_differ_and_what_they_would_name_is_not_checked() {
    let (server, _place, archive) = mars();
    let page = format!("{BROWSE}/00002/{BELOW}/");
    server.script(&page, vec![Reply::firewall().always()]);
    // The labels are listed still, but no picture is.
    server.script(
        &format!("{BROWSE}/00001/{BELOW}/"),
        vec![Reply::firewall().always()],
    );
    let checks = checked(&archive);
    let first = of(&checks, "page of sol 2");
    assert_eq!(first.state, CheckState::Differs);
    assert!(first.found.contains("not a folder listing"), "{first:?}");
    assert_eq!(first.url.as_deref(), Some(server.url(&page).as_str()));
    for what in ["label", "picture"] {
        assert_eq!(of(&checks, what).state, CheckState::NotChecked, "{checks:#?}");
    }

    let (server, _place, archive) = mars();
    let undated = "<html><h1>Index of x</h1><pre><a href=\"00001/\">00001/</a> -\n</pre></html>";
    let reply = Reply::Status(200, Vec::new(), undated.into());
    server.script(&format!("{BROWSE}/"), vec![reply.always()]);
    assert!(differing(&checked(&archive)).found.contains("shows no dates"));

    for (file, part) in [
        (
            "IMG_0001.png",
            "follows the scheme of the mission, as `IMG_0001.png`",
        ),
        ("ZL0_0003.webp", "none of its 1 entries ends in .png"),
    ] {
        let (server, _place, archive) = mars();
        server.file(&format!("{BROWSE}/00003/{BELOW}/{file}"), image_bytes(3));
        let checks = checked(&archive);
        assert!(differing(&checks).found.contains(part), "{checks:#?}");
        assert_eq!(
            of(&checks, "picture").state,
            CheckState::AsExpected,
            "of an earlier sol: {checks:#?}"
        );
    }

    let (server, _place, archive) = mars();
    server.script(&format!("{DATA}/"), vec![Reply::status(404).always()]);
    let checks = checked(&archive);
    assert!(
        of(&checks, "label").found.starts_with("no label of `"),
        "{checks:#?}"
    );
    assert!(
        checks
            .iter()
            .any(|check| check.found == "the server answers status 404"),
        "{checks:#?}"
    );
}

#[test]
fn a_label_that_lacks_what_is_needed_differs() {
    let label = |change: &dyn Fn(&str) -> String| {
        let (server, _place, archive) = mars();
        for file in drawn(2).iter().filter(|file| file.name.ends_with(".xml")) {
            let text = change(std::str::from_utf8(&file.bytes).unwrap());
            let name = file.name.rsplit('/').next().unwrap();
            server.file(&format!("{DATA}/00002/{BELOW}/{name}"), text);
        }
        let checks = checked(&archive);
        let differing = differing(&checks);
        assert_eq!(differing.what, "label", "{checks:#?}");
        differing.found.clone()
    };
    let without = |name: &str| {
        let name = name.to_owned();
        move |text: &str| {
            assert!(text.contains(&format!("{name}>")), "{name}: {text}");
            text.replace(&name, "renamed")
        }
    };
    assert!(label(&without("mars2020:sol_number")).contains("it has no sol"));
    assert!(label(&without("Observing_System_Component")).contains("it has no instrument"));
    assert!(label(&without("geom:Camera_Model_Parameters")).contains("label has no camera"));
    assert!(label(&|_| "<html/>".to_owned()).contains("root is not `Product_Observational`"));
    let moved = label(&|text| text.replace("sol_number>2<", "sol_number>7<"));
    assert!(moved.contains("it says sol 7, its place says sol 2"), "{moved}");
}

#[test]
fn a_picture_that_is_gone_or_is_none_differs() {
    let (server, _place, archive) = mars();
    let found = of(&checked(&archive), "picture").url.clone().unwrap();
    let path = found.trim_start_matches(&server.origin()).to_owned();
    server.script(&path, vec![Reply::status(404).always()]);
    let checks = checked(&archive);
    let gone = differing(&checks);
    assert_eq!(
        (gone.what.as_str(), gone.found.as_str()),
        ("picture", "the server answers status 404")
    );
    server.script(&path, vec![Reply::firewall().always()]);
    assert_eq!(differing(&checked(&archive)).what, "picture");
    server.script(
        &path,
        vec![Reply::Redirect("https://elsewhere.example/a.png".to_owned()).always()],
    );
    assert!(differing(&checked(&archive)).found.contains("elsewhere.example"));
}

#[test]
fn a_silent_server_is_asked_no_more() {
    let (server, _place, archive) = mars();
    let collection = format!("{}/", BROWSE.trim_end_matches("/sol"));
    server.script(&collection, vec![Reply::Silent.always()]);
    let checks = checked(&archive);
    let unchecked = checks.iter().all(|check| check.state == CheckState::NotChecked);
    assert!(unchecked && checks.len() > 3, "{checks:#?}");
    assert!(checks[0].found.contains("no byte for"), "{checks:#?}");
    assert!(checks[1].found.contains("did not answer"), "{checks:#?}");
    assert_eq!(server.requests().len(), 2, "a try and another");

    let stopped = Cancel::default();
    stopped.set();
    let archive = CheckedArchive::new(archive.table, archive.context).unwrap();
    assert!(matches!(archive.check(&stopped), Err(StageError::Cancelled)));
    assert_eq!(server.requests().len(), 2);
}

#[test]
fn size_and_checksum_are_compared_where_the_label_has_them() {
    let (server, place) = (Server::start().unwrap(), Place::new());
    let product = bundle::Version::new(2, 1, 1);
    bundle::release(&server, &[product]);
    let camera = |checks: &[Check]| differing(checks).found.ends_with("label has no camera");
    let archive = bundle::archive(&place, &server);
    // The label has no camera, which is not what this is about.
    let checks = checked(&archive);
    assert!(camera(&checks), "{checks:#?}");
    let mut longer = product.pixels();
    longer.push(0);
    server.file(&product.path("IMG"), longer);
    let found = of(&checked(&archive), "picture").found.clone();
    assert!(
        found.contains("it has 641 bytes, its label says 640") && found.contains("its MD5 is"),
        "{found}"
    );
    let mut other = product.pixels();
    other[600] ^= 1;
    server.file(&product.path("IMG"), other);
    let found = of(&checked(&archive), "picture").found.clone();
    assert!(
        found.contains("its MD5 is") && !found.contains("it has"),
        "{found}"
    );
}

#[test]
fn the_tree_of_curiosity_is_checked_in_either_layout() {
    let (server, place) = (Server::start().unwrap(), Place::new());
    trees::tree().iter().for_each(|edr| edr.mount(&server, 1));
    let archive = trees::archive(&place, &server, "1343");
    let checks = checked(&archive);
    all_well(&checks);
    let whats: Vec<&str> = checks.iter().map(|check| check.what.as_str()).collect();
    assert_eq!(
        whats,
        [
            "page of volumes",
            "page of sols",
            "page of sol 1343",
            "label",
            "picture"
        ]
    );
    assert_eq!(
        server.requests().len(),
        checks.len() + 1,
        "and the bundle, which is not there"
    );

    let mut longer = trees::tree().remove(1);
    longer.pixels.push(0);
    longer.mount(&server, 2);
    let checks = checked(&archive);
    assert!(
        differing(&checks)
            .found
            .ends_with("it has 1217 bytes, its label says 1216"),
        "{checks:#?}"
    );

    // An attached label, as Mastcam has it.
    let mastcam = with(archive.clone(), "/instrument", json!("mastcam"));
    server.file(
        "/img/data/msl/MSLMST_0005/DATA/RDR/SURFACE/0412/0412ML0121141200805116C00_DRCL.IMG",
        img(),
    );
    let checks = checked(&mastcam);
    assert!(
        of(&checks, "label").found.contains("it has no sol"),
        "{checks:#?}"
    );
    assert_eq!(of(&checks, "picture").state, CheckState::AsExpected);

    let empty = Server::start().unwrap();
    let checks = checked(&trees::archive(&place, &empty, "1343"));
    assert_eq!(differing(&checks).what, "page of volumes");
}

#[test]
fn a_feed_is_checked_by_its_latest_sol_and_a_page_of_records() {
    let (server, place) = (Server::start().unwrap(), Place::new());
    let records: Vec<Value> = (0..5)
        .map(|number| feed::navcam(&server, 50 + number, number))
        .collect();
    feed::play_in_its_envelope(&server, records.clone());
    for (sols, asked) in [
        ("latest", "records of sols 35 to 54"),
        ("50..=52", "records of sols 50 to 52"),
    ] {
        server.clear();
        let checks = checked(&place.feed(&server, sols));
        all_well(&checks);
        let expected = ["latest sol", asked, "label", "picture"].map(|what| (what, CheckState::AsExpected));
        assert_eq!(states(&checks), expected);
        assert_eq!(server.requests().len(), 3, "the record is the label");
    }
    let change = |change: &dyn Fn(&mut Value)| {
        let mut records = records.clone();
        records.iter_mut().for_each(change);
        feed::play_in_its_envelope(&server, records);
        differing(&checked(&place.feed(&server, "50..=52"))).clone()
    };
    let camera = change(&|record| {
        drop(
            record["camera"]
                .as_object_mut()
                .unwrap()
                .remove("camera_model_component_list"),
        )
    });
    assert!(
        camera.what == "label" && camera.found.contains("label has no camera"),
        "{camera:?}"
    );
    let named = change(&|record| record["image_files"] = json!({"url": "https://mars.nasa.gov/a.png"}));
    assert!(
        named.found.contains("none of its 3 records is taken") && named.found.contains("names no picture"),
        "{named:?}"
    );
    let size = change(&|record| record["extended"]["dimension"] = json!("(64,12)"));
    assert!(
        size.what == "picture" && size.found.contains("it is for 64x12 pixels"),
        "{size:?}"
    );

    server.feed("/rss/api/", |_, query| {
        let latest = query.contains("latest=true").then(|| json!({"latest_sol": 54}));
        Some(
            latest
                .unwrap_or_else(|| json!({"photos": []}))
                .to_string()
                .into_bytes(),
        )
    });
    let checks = checked(&place.feed(&server, "latest"));
    assert!(
        differing(&checks).found.contains("has no `images`"),
        "{checks:#?}"
    );
    server.feed("/rss/api/", |_, _| Some(b"<html/>".to_vec()));
    let checks = checked(&place.feed(&server, "latest"));
    assert!(differing(&checks).found.contains("not JSON"), "{checks:#?}");
}

#[test]
fn names_that_are_not_as_expected_differ() {
    let (server, _place, archive) = mars();
    for collection in [BROWSE, DATA] {
        let name = format!("{}/collection_inventory.csv", collection.trim_end_matches("/sol"));
        server.remove(&name);
    }
    let checks = checked(&archive);
    all_well(&checks);
    let found = &of(&checks, "page of the collection").found;
    assert!(
        found.ends_with("it names no inventory, so that each run asks for every young sol"),
        "{found}"
    );

    let (server, place) = (Server::start().unwrap(), Place::new());
    server.file(
        "/img/data/mars2020/mars2020_mastcamz_ops_raw/browse/sol/0001/a.png",
        image_bytes(3),
    );
    let checks = checked(&place.archive(&server, "1"));
    let found = &of(&checks, "page of sols").found;
    assert!(
        found.ends_with("none of its 1 entries is a folder like `00012`"),
        "{found}"
    );
    server.folder("/img/data/msl/MSLNAV_10/");
    let found = differing(&checked(&trees::archive(&place, &server, "1")))
        .found
        .clone();
    assert!(
        found.ends_with("none of its 1 entries is named like volume `MSLNAV_?XXX`"),
        "{found}"
    );

    let mut record = feed::navcam(&server, 50, 1);
    record["imageid"] = json!("UNK");
    feed::play_in_its_envelope(&server, vec![record]);
    let found = differing(&checked(&place.feed(&server, "latest"))).found.clone();
    assert_eq!(found, "none of its 1 records has `imageid` and `sol`");
}
