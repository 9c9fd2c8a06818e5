//! Sentences with numbers say those of the documents that they are about.

use super::fixture::{full, giving, node};
use super::fixture_documents::{spread, training};

use super::*;
use marf_schema::bootstrap::OutOfBag;
use marf_schema::train::{Curve, Target};

#[test]
fn sentences_of_a_run_have_the_numbers_of_its_documents() {
    let (store, nodes) = full();
    let html = store.report(&nodes);
    for text in [
        "Graph of 9 nodes, inputs on the left",
        "10 rays, 100 samples in all.",
        "up to 0.5 px",
        "up to 1 px",
        "up to 2 px",
        ", reprojection error 0.4 px",
        "0.012 m, 0.04 m at most (site 3)",
        "duplicate: closest calls, 6 verdicts of 6 within half of their threshold",
        "The members are trainings on the same photos, each with a seed of its own. Where they differ, the field is not sure. The total deviation adds their errors at photos trained on",
        "Too few errors are within the deviation of the members",
        "mean standard deviation 5.4 gray levels",
        "off: no camera has 4 photos with enough matched points",
        "3 settings, 1 seeds each where one knob is turned, measured on a processor, 2 cores.",
    ] {
        assert!(html.contains(text), "{text}");
    }
    // The value of a figure follows its name.
    for (name, value) in [
        ("mean standard deviation", "5.4 gray levels"),
        (
            "error of the order by standard deviation (AUSE, 0 is best)",
            "0.29",
        ),
        ("errors within 1 deviation (68 % if normal)", "55 %"),
        ("errors within 2 deviations (95 % if normal)", "81 %"),
    ] {
        let after = html.split_once(name).unwrap().1;
        let shown = after
            .split(['<', '>'])
            .find(|part| part.starts_with(|first: char| first.is_ascii_digit()));
        assert_eq!(shown, Some(value), "{name}");
    }
}

#[test]
fn the_table_of_intervals_has_the_numbers_of_gray_and_of_the_depth() {
    let (store, nodes) = full();
    let html = store.report(&nodes);
    for [name, gray, depth] in [
        [
            "half of the 90 % interval at the median pixel",
            "± 16 of 255 levels",
            "± 3.2 % of it",
        ],
        ["it is the spread of the members times", "2.6", "2.6"],
        ["with a spread of at least", "2 of 255 levels", "0.4 % of it"],
        ["half of the errors are at most", "5 of 255 levels", "1 % of it"],
        [
            "errors inside at places it was not fitted on, mean (range)",
            "88.2 % (86 % to 93 %)",
            "88.2 % (86 % to 93 %)",
        ],
        ["stated and found shares differ in the mean by", "2 %", "2 %"],
        [
            "pixels without an interval: no photo saw what they show",
            "1.2 %",
            "1.2 %",
        ],
        ["compared", "12,345 pixels, 5 places", "12,345 pixels, 5 places"],
    ] {
        let row = format!(
            "<th scope=\"row\">{name}</th><td class=\"number\">{gray}</td><td class=\"number\">{depth}</td>"
        );
        assert!(html.contains(&row), "{row}");
    }
    for quantity in ["gray", "depth"] {
        let note = format!("Note on the interval of {quantity}: only 5 places were held out");
        assert!(html.contains(&note), "{note}");
    }
}

#[test]
fn sentences_of_members_and_of_a_target_have_the_numbers_of_their_documents() {
    let mut store = fixture::Store::default();
    let mut metrics = spread(Vec::new());
    metrics.out_of_bag = Some(OutOfBag {
        photos: 7,
        psnr: 21.25,
        psnr_in_bag: Some(24.5),
    });
    let mut reached = training(marf_schema::example::scores());
    reached.target = Some(Target {
        psnr: 24.0,
        reached_at: Some(1600),
        validation_psnr: 24.5,
        validation_photos: 9,
        forecast: None,
    });
    let outputs = [
        store.document(&metrics),
        ("maps/v1-mean.png", store.put_picture(1)),
    ];
    let curve = store.document(&Curve(Vec::new()));
    let trained = [store.document(&reached), curve];
    let nodes = [
        giving(node("train", &[]), trained),
        giving(node("bootstrap", &["train"]), outputs),
    ];
    let html = store.report(&nodes);
    for text in [
        "7 photos that some members did not draw: PSNR of these members 21.25 dB, 24.50 dB where they did.",
        "reached after 1,600 steps",
    ] {
        assert!(html.contains(text), "{text}: {html}");
    }
}

/// Checks that a page has each of these texts.
#[track_caller]
fn has(html: &str, texts: &[&str]) {
    for text in texts {
        assert!(html.contains(text), "`{text}` is not in {html}");
    }
}

#[test]
fn the_first_sentence_is_of_what_the_run_has_come_to() {
    let (store, nodes) = full();
    has(&store.report(&nodes[..2]), &["4 of 7 photos were kept."]);
    has(
        &store.report(&nodes[..3]),
        &["4 of 7 photos have a camera.", "1 of 5 photos have no camera."],
    );
    let mut store = fixture::Store::default();
    let mut scores = marf_schema::example::scores();
    scores.apart = Some(marf_schema::scores::Apart {
        extrapolated: 1,
        psnr_extrapolated: 12.0,
        psnr_others: None,
    });
    let judged = scores.views.len();
    let trained = [store.document(&training(scores))];
    has(
        &store.report(&[giving(node("train", &[]), trained)]),
        &[&format!(
            "1 of {} look where no photo trained on does.",
            format::count(judged, "held-out photo")
        )],
    );
}

#[test]
fn what_a_filter_did_has_its_numbers() {
    let mut store = fixture::Store::default();
    let mut judged = |kind: &str, name: &str| {
        let verdicts = ["a.jpg", "b.jpg", "c.jpg"].map(|id| fixture::verdict(id, kind));
        let rows = verdicts
            .iter()
            .filter(|verdict| verdict.verdict == "keep")
            .map(|verdict| fixture::row(&mut store, &verdict.id, 9))
            .collect();
        let outputs = [
            (marf_stage::PHOTOS, store.put_photos(rows)),
            (marf_stage::VERDICTS, store.put_verdicts(&verdicts)),
        ];
        giving(node(name, &["extract"]), outputs)
    };
    let nodes = [
        node("extract", &[]),
        judged("keep", "shape"),
        judged("blur", "blur"),
    ];
    has(
        &store.report(&nodes),
        &["3 in, all kept", "Photos rejected: 3 (3 by blur)."],
    );
}

#[test]
fn a_part_of_a_set_that_is_gone_is_named_with_its_set() {
    let (store, nodes) = full();
    let is_named = |digest: &marf_cache::Digest| {
        let mut poor = fixture::Store::default();
        poor.blobs.clone_from(&store.blobs);
        poor.blobs.remove(digest);
        poor.report(&nodes).contains("A part of photos of extract")
    };
    assert!(!store.report(&nodes).contains("A part of "));
    assert!(store.blobs.keys().any(is_named));
}

#[test]
fn depths_and_changes_have_the_numbers_of_their_documents() {
    let mut store = fixture::Store::default();
    let depth: marf_schema::depth::Metrics = serde_json::from_value(serde_json::json!({
        "unit": "metres", "photos": [], "pairs": [], "refused": {}, "share": 0.6251, "confirmed_share": 0.25, "sky_share": 0.2,
        "median_sigma_share": 0.0125, "points": 7, "cell": 0.1, "map": null, "missing": {},
    }))
    .unwrap();
    let time = |sol: u32, photos: u32| serde_json::json!({"sols": [sol, sol + 1], "photos": photos, "psnr": 23.456, "area_m2": 9.0});
    let noise = |interval: f64| serde_json::json!({"interval": interval, "factor": 1.0});
    let changes: marf_schema::changes::ChangesReport = serde_json::from_value(serde_json::json!({
        "before": time(1, 4), "after": time(8, 1), "cell_m": 0.05, "size": [2, 2], "first_m": [0.0, 0.0],
        "axes": [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], "origin": "the world", "compared_m2": 6.5,
        "changed_m2": 0.75, "undecided_m2": 0.25, "registration": {"offset_m": 0.012, "tilt": [0.0, 0.0], "gain": [1.0, 1.0, 1.0]},
        "height": noise(0.034), "brightness": noise(0.1), "colour": noise(0.1), "patches": [],
    }))
    .unwrap();
    let depths = [store.document(&depth)];
    let compared = [store.document(&changes)];
    let html = store.report(&[
        giving(node("depth", &[]), depths),
        giving(node("changes", &[]), compared),
    ]);
    has(
        &html,
        &[
            "<strong>62.5 %</strong> of the pixels a depth, two pairs confirm 25.0 % of all, and one standard deviation is 1.2 % of the \
             distance in the median. 20.0 % of the pixels show sky, which has none.",
            "Before: 4 photos of sols 1, 2, PSNR 23.46 dB. After: 1 photo of sols 8, 9, PSNR 23.46 dB. Both show 6.5 m²: \
             <strong>0.75 m² changed</strong>, 0.25 m² undecided.",
            "Where nothing changed, 90 % of the cells (0.05 m) differ by less than 0.034 m. The two times lie 0.012 m apart in height",
        ],
    );
}

#[test]
fn scenes_of_a_mission_are_counted() {
    let mut store = fixture::Store::default();
    let group =
        |photos: &[&str]| serde_json::json!({"name": "g", "reason": "few", "photos": photos, "sols": [1]});
    let scenes: marf_schema::scenes::Scenes = serde_json::from_value(serde_json::json!({
        "scenes": [group(&["a", "b"]), group(&["c"])], "skipped": [group(&["d"])], "stops": [],
    }))
    .unwrap();
    let split = [store.document(&scenes)];
    has(
        &store.report(&[giving(node("scenes", &[]), split)]),
        &["2 scenes of 3 photos; 1 group left out."],
    );
}

#[test]
fn pictures_films_and_starts_are_named_with_their_sizes_and_digests() {
    let mut store = fixture::Store::default();
    let mut metrics = training(marf_schema::example::scores());
    let weights = marf_cache::Digest::from_content(b"weights");
    metrics.warm_start = Some(marf_schema::train::WarmStart::From(weights));
    // 6 MB of text hold 4.5 MB.
    let long = store.put(&[&b"\0\0\0\x18ftyp"[..], &vec![0; 4_599_992]].concat());
    let short = store.put(&[&b"\0\0\0\x18ftyp"[..], &vec![0; 992]].concat());
    let render = store.put_picture(90);
    let trained = [
        store.document(&metrics),
        store.document(&Curve(Vec::new())),
        ("heldout/v1.png", render),
        ("photo/v1.png", store.put_picture(100)),
    ];
    let film = |name: &str, digest| giving(node(name, &[]), [(marf_schema::output::VIDEO, digest)]);
    let nodes = [
        giving(node("train", &[]), trained),
        giving(node("again", &["train"]), [("heldout/v1.png", render)]),
        film("video", long),
        film("small", short),
    ];
    let html = store.report(&nodes);
    has(
        &html,
        &[
            &format!("the field {} of the run before", weights.short()),
            &format!(
                "The film has 4.6 MB, too much for this page. It is object {} of the store.",
                long.short()
            ),
            "<h3>again</h3><p>The same renders as above.</p>",
            "Worst first. Error: |render - photo|, mean of the channels.",
        ],
    );
    assert_eq!(html.matches("<video").count(), 1, "the one that fits");
}

#[test]
fn photos_trained_on_are_counted_among_those_that_an_evaluation_shows() {
    let mut store = fixture::Store::default();
    let mut scores = marf_schema::example::scores();
    let nearest = serde_json::json!({
        "id": "0001", "distance": 1.0, "angle_deg": 2.0, "uncovered_share": 0.0, "extrapolates": false,
    });
    scores.views.push(marf_schema::scores::PhotoScores {
        name: "0002".to_owned(),
        nearest: serde_json::from_value(nearest).unwrap(),
        ..scores.views[0].clone()
    });
    let metrics = marf_schema::evaluate::Metrics { scores, scale: 1 };
    let outputs = [
        store.document(&metrics),
        ("heldout/0001.png", store.put_picture(90)),
        ("heldout/0002.png", store.put_picture(80)),
    ];
    let nodes = [giving(node("evaluate", &[]), outputs)];
    for (params, heading) in [
        (
            serde_json::json!({"views": "all"}),
            "evaluate: 2 views, 1 of photos trained on<",
        ),
        (
            serde_json::json!({"views": "train"}),
            "evaluate: 2 views, 1 of photos trained on<",
        ),
        (serde_json::json!({"views": "heldout"}), "evaluate: 2 views<"),
        (serde_json::json!({}), "evaluate: 2 views<"),
    ] {
        store.params.insert("evaluate".to_owned(), params);
        has(&store.report(&nodes), &[heading]);
    }
}

#[test]
fn charts_of_uncertainty_have_the_values_of_their_document() {
    let (store, nodes) = full();
    // 0.012 and 0.013 of 255 are left without the half that is most uncertain.
    has(
        &store.report(&nodes),
        &[
            "Mean error without the most uncertain pixels",
            "<title>by standard deviation most uncertain pixels taken away, % 50, mean absolute error, gray levels 3.06</title>",
            "<title>by total deviation most uncertain pixels taken away, % 50, mean absolute error, gray levels 3.31",
        ],
    );
    let mut store = fixture::Store::default();
    let mut metrics = spread(Vec::new());
    metrics.heldout.as_mut().unwrap().depth_calibration = None;
    let outputs = [
        store.document(&metrics),
        ("maps/v1-interval.png", store.put_picture(1)),
    ];
    has(
        &store.report(&[giving(node("bootstrap", &[]), outputs)]),
        &[
            "No interval of the depth: it takes 100 sparse points in photos of two places that are held out.",
            "90 % interval, gray levels",
        ],
    );
}

#[test]
fn a_scene_without_scale_has_a_bar_in_its_own_units() {
    let mut store = fixture::Store::default();
    let mut scene = fixture::scene();
    let drawn = |scene: &marf_scene::Scene, store: &mut fixture::Store| {
        let outputs = [(marf_schema::output::SCENE, store.put(&scene.encode().unwrap()))];
        let placed = [store.document(&super::fixture_documents::calibration("import", 4, 0.4))];
        store.report(&[giving(giving(node("calibrate", &[]), outputs), placed)])
    };
    let bar = |html: &str, end: &str| -> f64 {
        let before = html
            .split_once(end)
            .unwrap_or_else(|| panic!("no{end}: {html}"))
            .0;
        before.rsplit('>').next().unwrap().parse().unwrap()
    };
    // The unit is 2 m, and the bar has a round length in either.
    let metres = bar(&drawn(&scene, &mut store), " m</text>");
    scene.metres_per_unit = None;
    let units = bar(&drawn(&scene, &mut store), " units, no scale</text>");
    assert!(
        (0.4..=1.25).contains(&(2.0 * units / metres)),
        "{units} units, {metres} m"
    );
}

/// Documents list each photo, which is megabytes of thousands. The page has pictures and drawings of them, and sums.
#[test]
fn folded_metrics_have_no_list_of_photos() {
    let mut store = fixture::Store::default();
    let mut metrics = super::fixture_documents::calibration("import", 1000, 0.4);
    let photo = metrics.photos[0].clone();
    metrics.photos = (0..1000)
        .map(|index| marf_schema::calibrate::PhotoMetrics {
            id: format!("listed-{index}"),
            ..photo.clone()
        })
        .collect();
    metrics.missing = vec![marf_schema::calibrate::Missing {
        file: "listed-elsewhere".to_owned(),
        reason: String::new(),
    }];
    metrics.stereo_pairs = vec![marf_schema::rigs::StereoPair {
        photos: ["listed-left", "listed-right"].map(str::to_owned),
        angle_deg: 0.1,
        distance_m: 0.01,
        verdict: marf_schema::rigs::Verdict::Rigid,
    }];
    let outputs = [(
        marf_schema::output::SCENE,
        store.put(&fixture::scene().encode().unwrap()),
    )];
    let placed = [store.document(&metrics)];
    let mut reached = training(marf_schema::example::scores());
    reached.drawn = Some(metrics.photos.iter().map(|photo| photo.id.clone()).collect());
    let trained = [store.document(&reached), store.document(&Curve(Vec::new()))];
    let html = store.report(&[
        giving(giving(node("calibrate", &[]), outputs), placed),
        giving(node("train", &["calibrate"]), trained),
    ]);
    for summary in ["all metrics of the calibration", "all metrics"] {
        let (_, text) = html.split_once(&format!("<summary>{summary}</summary>")).unwrap();
        let text = text.split_once("</details>").unwrap().0;
        assert!(!text.contains("listed-"), "{summary}: {text}");
    }
}

#[test]
fn lost_photos_have_their_advice_and_metrics_are_whole() {
    let lost = |reason: &str| {
        let unplaced = [marf_scene::Unplaced {
            id: "a".to_owned(),
            reason: reason.to_owned(),
        }];
        unplaced::table(&unplaced).into_string()
    };
    has(
        &lost("no label gives its camera"),
        &["fetch the labels with the photos, or take `method = &quot;sfm&quot;`, which needs none"],
    );
    has(
        &lost("panorama: turned in place"),
        &["the camera only turned: add photos from other places, or take `method = &quot;labels&quot;`"],
    );
    let (store, nodes) = full();
    let html = store.report(&nodes);
    has(&html, &["all metrics of the calibration"]);
    // Every number of the document is in the text that is said to hold all.
    let metrics = serde_json::to_value(super::fixture_documents::calibration("x", 4, 0.4)).unwrap();
    let text = html.split_once("all metrics of the calibration").unwrap().1;
    let text = text.split_once("</details>").unwrap().0;
    for key in metrics["totals"].as_object().unwrap().keys() {
        assert!(text.contains(&format!("&quot;{key}&quot;: ")), "{key}: {text}");
    }
}
