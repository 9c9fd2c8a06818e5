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
        "90 % interval of gray levels: 2.6 times the spread, which is at least 2 of 255. At a place that it was not fitted on it \
         covers 88.2 % of the errors, the mean of 5 places (86 % to 93 %) with 12,345 compared pixels. Shares inside differ from \
         the stated shares by 2 % in the mean. 1.2 % of the pixels have none: no photo saw what they show.",
        "90 % interval of the depth: 2.6 times the spread, which is at least 0.4 % of it.",
        "3 settings, 1 seeds each where one knob is turned, measured on a processor, 2 cores.",
    ] {
        assert!(html.contains(text), "{text}");
    }
    // The value of a figure follows its name.
    for (name, value) in [
        ("errors within 1 deviation (68 % if normal)", "0.55"),
        ("errors within 2 deviations (95 % if normal)", "0.81"),
    ] {
        let after = html.split_once(name).unwrap().1;
        let shown = after
            .split(['<', '>'])
            .find(|part| part.starts_with(|first: char| first.is_ascii_digit()));
        assert_eq!(shown, Some(value), "{name}");
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
