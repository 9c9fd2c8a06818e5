use super::fixture::{HOSTILE, full, giving, node, verdict};

use super::*;
use marf_cache::{Digest, Output};
use marf_engine::NodeState;
use marf_schema::{folds, masks, train};
use marf_stage::{Document, PHOTOS, VERDICTS};

const VOID: [&str; 4] = ["meta", "img", "br", "hr"];
const TITLES: [&str; 14] = [
    "Pipeline",
    "Nodes",
    "What changed",
    "Filters",
    "Rejected photos",
    "Kept photos",
    "How firm the verdicts are",
    "Cameras",
    "Tuning",
    "Training",
    "Held-out photos",
    "Uncertainty",
    "Fly-through",
    "Time against quality",
];

/// Walks all tags: each that is opened is closed, in order. Returns how many there were.
pub(super) fn check_balance(html: &str) -> usize {
    let mut open: Vec<&str> = Vec::new();
    let mut count = 0;
    let body = html.strip_prefix("<!DOCTYPE html>").unwrap();
    for part in body.split('<').skip(1) {
        let (tag, _) = part
            .split_once('>')
            .unwrap_or_else(|| panic!("`<{part}` never ends"));
        count += 1;
        let name = tag.split([' ', '\n']).next().unwrap();
        match name.strip_prefix('/') {
            Some(closed) => assert_eq!(open.pop(), Some(closed), "closes out of order"),
            None if VOID.contains(&name) => {}
            None => open.push(name),
        }
    }
    assert!(open.is_empty(), "never closed: {open:?}");
    count
}

#[test]
fn every_section_is_there_and_every_tag_is_closed() {
    let (store, nodes) = full();
    let html = store.report(&nodes);
    assert!(check_balance(&html) > 400);
    for title in TITLES {
        assert!(html.contains(&format!("<h2>{title}</h2>")), "{title}");
    }
    assert!(
        !html.contains("class=\"missing\""),
        "something of a full run is not shown: {html}"
    );
}

#[test]
fn known_figures_have_their_unit() {
    let (store, nodes) = full();
    let html = store.report(&nodes);
    for text in [
        "9 nodes: 7 ran, 1 reused, 1 skipped, 7.0 s of work in 1.0 s",
        "Differs from run 3 in 2 nodes.",
        "<p class=\"quiet\">shape: the outputs are equal</p>",
        "7 in, 6 kept, 1 rejected (1 decode)",
        "score 12.5, threshold 20, 7.5 below",
        "4 cameras, 1 held out; 1 sparse point; 1 unit is 2 m",
        "PSNR 24.00 dB",
        "PSNR after an affine fit to each photo</dt><dd>26.50 dB",
        "one for all photos, as `field.gain` or `fit` says: tones differ by 34.0 % between photos at 1240 matched points, 5.0 %",
        "nearest photo trained on 3 m, 90°",
        "figcaption>standard deviation<",
        "where, from above, ringed: nearest trained on",
        "filled by mean reprojection error",
        "class=\"held-out error0\"",
        "24.57 dB",
        "Trial 01 is chosen.",
        "error of a random order",
        "1 file that gave no photo",
        "kept in its place",
    ] {
        assert!(html.contains(text), "{text}");
    }
}

#[test]
fn text_of_the_outside_never_becomes_a_tag() {
    let (store, nodes) = full();
    let html = store.report(&nodes);
    assert!(html.matches("&lt;img src=x onerror=alert(1)&gt;.jpg").count() > 10);
    for raw in [
        HOSTILE,
        "<script",
        "<b>",
        "<i>",
        "<3>",
        "<x>",
        "onerror=alert(1)>",
    ] {
        assert!(!html.contains(raw), "{raw}");
    }
}

#[test]
fn a_quote_in_a_name_does_not_leave_its_attribute() {
    let hostile = "\" onload=\"alert(1)";
    let mut one = node(hostile, &[hostile]);
    one.run.reason = hostile.to_owned();
    let mut store = fixture::Store::default();
    let params = serde_json::json!({hostile: hostile});
    store.params.insert(hostile.to_owned(), params);
    let html = store.report(&[one]);
    assert!(!html.contains(hostile), "{html}");
    check_balance(&html);
}

#[test]
fn nothing_is_asked_of_the_network_and_nothing_runs() {
    let (store, nodes) = full();
    let html = store.report(&nodes);
    for forbidden in [
        "http:", "https:", "//", "<script", "<link", "<iframe", "@import", "url(",
    ] {
        let scheme_free: String = html.split("data:").map(skip_base64).collect();
        assert!(!scheme_free.contains(forbidden), "{forbidden}");
    }
    for image in html.split("<img").skip(1) {
        let tag = image.split('>').next().unwrap();
        assert!(
            tag.contains("src=\"data:image/") && tag.contains("alt=\""),
            "{}",
            &tag[..tag.len().min(80)]
        );
        assert!(!tag.contains("alt=\"\""), "an empty alternative text");
    }
}

/// The alphabet of base64 has a slash: pictures are left out of the search.
fn skip_base64(part: &str) -> &str {
    match part.split_once(";base64,") {
        Some((_, rest)) => rest.split_once('"').map_or("", |(_, after)| after),
        None => part,
    }
}

#[test]
fn objects_that_are_gone_or_damaged_are_said_in_words() {
    let (mut store, nodes) = full();
    let whole = store.blobs.clone();
    store.blobs.clear();
    let empty = store.report(&nodes);
    check_balance(&empty);
    assert!(empty.matches("is not in the store").count() >= 8, "{empty}");
    assert!(!empty.contains("<img"), "{empty}");
    store.blobs = whole
        .keys()
        .map(|digest| (*digest, b"{\"\x00\xff".as_slice().into()))
        .collect();
    let damaged = store.report(&nodes);
    check_balance(&damaged);
    assert!(
        damaged.matches("cannot be read and is not shown").count() >= 8,
        "{damaged}"
    );
}

#[test]
fn each_object_may_be_gone_on_its_own() {
    let (mut store, nodes) = full();
    for digest in store.blobs.keys().copied().collect::<Vec<_>>() {
        let bytes = store.blobs.remove(&digest).unwrap();
        let html = store.report(&nodes);
        assert!(html.contains("is not in the store"), "{}", digest.short());
        store.blobs.insert(digest, bytes);
    }
}

#[test]
fn a_run_without_outputs_says_so_in_every_section() {
    let mut failed = node("train", &[]);
    failed.run.state = NodeState::Failed;
    failed.run.reason = "step 31: loss is not finite".to_owned();
    let html = fixture::Store::default().report(&[failed]);
    check_balance(&html);
    assert!(html.contains("1 node: 1 failed"), "{html}");
    assert!(
        html.contains("<strong>train failed: </strong>step 31: loss is not finite"),
        "{html}"
    );
    assert!(html.matches("No node of this run gave").count() >= 7, "{html}");
    check_balance(&fixture::Store::default().report(&[]));
}

#[test]
fn a_report_is_the_same_bytes_every_time() {
    let (store, nodes) = full();
    assert_eq!(store.report(&nodes), store.report(&nodes));
}

#[test]
fn json_of_another_shape_is_no_panic() {
    let (mut store, nodes) = full();
    let digests: Vec<Digest> = store.blobs.keys().copied().collect();
    for shape in [
        "null",
        "3",
        "[]",
        "{}",
        "[[1]]",
        "{\"views\": 1, \"trials\": 2}",
        "[{\"step\": \"x\"}]",
        "\"<b>\"",
    ] {
        store.blobs = digests
            .iter()
            .map(|digest| (*digest, shape.as_bytes().into()))
            .collect();
        check_balance(&store.report(&nodes));
    }
}

#[test]
fn a_scene_of_few_photos_is_judged_on_all_and_one_of_many_says_that_it_is_not() {
    let mut store = fixture::Store::default();
    let scores = marf_schema::example::scores();
    let mut metrics = folds::Metrics {
        photos: 9,
        below: 24,
        judged: Some(folds::Judged {
            scores,
            steps: 1000,
            steps_of_whole: 4000,
            folds: Vec::new(),
        }),
    };
    let mut shown = |metrics: &folds::Metrics| {
        let outputs = [
            store.document(metrics),
            ("heldout/0001.png", store.put_picture(90)),
        ];
        store.report(&[giving(node("folds", &["train"]), outputs)])
    };
    let html = shown(&metrics);
    check_balance(&html);
    for text in [
        "fewer than 24 photos",
        "for 1,000 steps of the 4,000",
        "20.00 dB",
        "folds: 1 view",
    ] {
        assert!(html.contains(text), "{text}: {html}");
    }
    (metrics.photos, metrics.judged) = (24, None);
    assert!(shown(&metrics).contains("24 photos: not judged by folds"));
    metrics.photos = 2;
    assert!(shown(&metrics).contains("All photos were taken at one place"));
}

#[test]
fn what_stands_still_is_shown_with_the_way_to_hide_it() {
    let mut store = fixture::Store::default();
    let camera = |name: &str, share: f64| masks::CameraReport {
        name: name.to_owned(),
        width: 640,
        height: 480,
        photos: 12,
        pairs: 36,
        moved: 35,
        share,
        found: "so <b>".to_owned(),
    };
    let metrics = masks::Metrics {
        cameras: vec![camera("NAV-640x480", 0.2), camera("640x480", 0.0)],
    };
    let outputs = [
        store.document(&metrics),
        ("overlay/NAV-640x480.png", store.put_picture(90)),
    ];
    let html = store.report(&[giving(node("masks", &["blur"]), outputs)]);
    check_balance(&html);
    for text in [
        "masks/NAV-640x480.png",
        "so &lt;b&gt;",
        "12 photos, moved in 35 of 36 pairs",
        "in red",
    ] {
        assert!(html.contains(text), "{text}: {html}");
    }
    assert_eq!(html.matches("in red").count(), 1);
}

#[test]
fn metrics_of_an_older_version_become_one_sentence_and_the_rest_is_shown() {
    let (mut store, mut nodes) = full();
    let older = store.put(br#"{"psnr": 24.5, "views": []}"#);
    let trained = nodes.iter_mut().find(|node| node.run.name == "train").unwrap();
    let older = Output {
        digest: older,
        bytes: 1,
    };
    trained
        .run
        .outputs
        .insert(train::Metrics::OUTPUT.to_owned(), older);
    let html = store.report(&nodes);
    check_balance(&html);
    for text in [
        "metrics of train cannot be read and is not shown: missing field",
        "PSNR against step",
        "no figures recorded",
    ] {
        assert!(html.contains(text), "{text}");
    }
}

#[test]
fn a_long_list_of_rejected_photos_is_cut_and_counted() {
    let mut store = fixture::Store::default();
    let names: Vec<String> = (0..75).map(|index| format!("{index:03}.jpg")).collect();
    let rows = names.iter().map(|id| fixture::row(&mut store, id, 9)).collect();
    let verdicts: Vec<_> = names.iter().map(|id| verdict(id, "blur")).collect();
    let outputs = [
        (PHOTOS, store.put_photos(rows)),
        (VERDICTS, store.put_verdicts(&verdicts)),
    ];
    let html = store.report(&[node("extract", &[]), giving(node("blur", &["extract"]), outputs)]);
    assert!(html.contains("blur: 75 photos of 75"), "{html}");
    assert_eq!(
        html.matches("45 photos not shown.").count(),
        2,
        "rejected and kept"
    );
}

#[test]
fn a_linked_report_has_addresses_in_place_of_pictures_films_and_style() {
    let (store, nodes) = full();
    let live = LiveParts {
        up: "../",
        head: html! { link rel="icon" href="icon.svg"; },
        navigation: html! { a href="#live" { "Live" } },
        main: html! { section #live {} },
    };
    let page = store.with_report(&nodes, |report| linked(report, &live));
    check_balance(&page.html.replace("<link", "<meta"));
    for gone in ["Content-Security-Policy", "<style", "data:", "<script", HOSTILE] {
        assert!(!page.html.contains(gone), "{gone}");
    }
    assert!(
        page.html
            .contains("<nav aria-label=\"Contents\"><a href=\"#live\">Live</a>")
    );
    assert!(page.html.contains("<main><section id=\"live\"></section>"));
    let pictures = page.html.matches("<img").count();
    assert_eq!(
        page.html
            .matches("<img loading=\"lazy\" src=\"../object/")
            .count(),
        pictures
    );
    assert!(pictures > 10, "{pictures}");
    let addresses: Vec<&str> = page.html.split("\"../object/").skip(1).collect();
    for address in addresses {
        let digest: Digest = address[..64].parse().unwrap();
        let is_film = page.objects.contains(&digest) && store.blobs.contains_key(&digest);
        assert!(is_film || page.files.contains_key(&digest), "{digest}");
    }
    assert_eq!(page.objects.len(), 1, "the film is not copied");
    for (digest, file) in &page.files {
        assert_eq!(Digest::from_content(&file.bytes), *digest);
        assert!(["image/jpeg", "image/png", "text/css; charset=utf-8"].contains(&file.media));
    }
}
