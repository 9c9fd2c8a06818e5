//! Curiosity's volumes, bundle and feed.

use super::*;

#[test]
fn the_flat_feed_of_curiosity_is_read() {
    let server = Server::start().unwrap();
    server.file("/p/a.jpg", image_bytes(5));
    let url = server.url("/p/a.jpg");
    let record = |id: &str, mission: Value, thumbnail: bool| {
        json!({"imageid": id, "sol": "3050", "instrument": "NAV_LEFT_B", "mission": mission, "https_url": url,
               "is_thumbnail": thumbnail, "camera_model_component_list": null, "extended": {"mast_az": "UNK"}})
    };
    let items = vec![
        record("NLB_586004185EDR_F0721234NCAM00295M_", json!("msl"), false),
        record("NLB_586004186EDR_F0721234NCAM00295M_", json!(null), false),
        record("NLB_586004187EDR_T0721234NCAM00295M_", json!("msl"), true),
        record("ELSEWHERE", json!("mars2020"), false),
    ];
    server.feed("/api/v1/raw_image_items/", move |_, query| {
        let first = query.contains("page=0");
        let items = if first { items.clone() } else { Vec::new() };
        Some(
            json!({"items": items, "more": false, "total": 4, "page": 0})
                .to_string()
                .into_bytes(),
        )
    });
    server.feed("/api/v1/raw_image_items/msl/latest/", |_, _| {
        Some(b"{\"latest_sol\": 4000}".to_vec())
    });
    let place = Place::new();
    let archive = with(place.feed(&server, "3050"), "/mission", json!("curiosity"));
    let brought = place.bring(&archive).unwrap();
    assert_eq!(brought.rows.len(), 2, "{:?}", brought.rows.keys());
    assert_eq!(brought.reason("NLB_586004187EDR_T"), "thumbnail");
    assert_eq!(brought.reason("ELSEWHERE"), "of another mission");
}

#[test]
fn volumes_of_curiosity_are_crawled() {
    let server = Server::start().unwrap();
    let names = [
        "0412ML0121141200805116C00_DRCL",
        "0412ML0121141200805116C00_DRCX",
        "0412ML0121141200805116I00_DRCL",
    ];
    let volume = "/img/data/msl/MSLMST_0005";
    for name in names {
        server.file(&format!("{volume}/DATA/RDR/SURFACE/0412/{name}.IMG"), img());
    }
    server.folder("/img/data/msl/MSLNAV_0XXX/");
    server.folder("/img/data/msl/MSLMST_0006/DATA/RDR/SURFACE/");
    let place = Place::new();
    let of = |instrument: &str| {
        let archive = with(place.archive(&server, "412"), "/mission", json!("curiosity"));
        with(archive, "/instrument", json!(instrument))
    };
    let brought = place.bring(&of("mastcam")).unwrap();
    assert_eq!(brought.rows.keys().collect::<Vec<_>>(), [names[0]]);
    assert!(
        brought.reason(names[1]).contains("DRCL is taken"),
        "{}",
        brought.reason(names[1])
    );
    assert_eq!(brought.reason(names[2]), "thumbnail");
}

#[test]
fn the_navcam_of_curiosity_is_found_in_its_bundle_or_in_its_volumes() {
    let name = "NLB_586004185EDR_F0721234NCAM00295M1";
    for root in [
        "/img/data/msl/msl_navcam_raw/DATA",
        "/img/data/msl/MSLNAV_1XXX/DATA",
    ] {
        let server = Server::start().unwrap();
        server.file(&format!("{root}/SOL02123/{name}.IMG"), img());
        server.file(
            &format!("{root}/SOL02123/{}.IMG", name.replace("_F0", "_T0")),
            img(),
        );
        let place = Place::new();
        let archive = with(
            place.archive(&server, "2000..=2200"),
            "/mission",
            json!("curiosity"),
        );
        let brought = place
            .bring(&with(archive, "/instrument", json!("navcam")))
            .unwrap();
        assert_eq!(brought.rows.keys().collect::<Vec<_>>(), [name], "{root}");
        assert_eq!(brought.listing.shards[0].shard, 2_123);
        assert_eq!(brought.reason(&name.replace("_F0", "_T0")), "thumbnail");
    }
}
