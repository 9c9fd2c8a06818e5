//! The report of a run that failed.

use marf_engine::NodeState;
use marf_model::{Run, RunNode};

use super::fixture::{full, node, run};
use super::tests::check_balance;
use super::write;

#[test]
fn the_cause_of_a_failed_run_comes_before_all_tables_and_drawings() {
    let (store, nodes) = full();
    let mut run = completed_run(nodes.clone());
    let train = run
        .nodes
        .iter_mut()
        .find(|node| node.run.name == "train")
        .unwrap();
    (train.run.cause, train.run.hint) = (Some("no room".to_owned()), Some("free <2 GB".to_owned()));
    let html = store.with_report_of(&run, write);
    check_balance(&html);
    let body = html.split_once("<body>").unwrap().1;
    let first = ["<table", "<svg", "<img", "<nav"].map(|tag| body.find(tag).unwrap());
    let first = first.into_iter().min().unwrap();
    for text in [
        "train failed: </strong>disk full",
        "Cause: no room",
        "What to do: free &lt;2 GB",
    ] {
        let at = body.find(text).unwrap_or_else(|| panic!("{text}"));
        assert!(
            at < first,
            "{text} at {at}, the first table, drawing or link at {first}"
        );
    }

    // A mission in which all scenes fail: the first ones are explained, the rest named.
    let failing = |number: usize| {
        let mut failed = node(&format!("calibrate@{number}"), &[]);
        (failed.run.state, failed.run.reason) = (NodeState::Failed, format!("reason {number}"));
        failed
    };
    let html = store.report(&(0..9).map(failing).collect::<Vec<_>>());
    let alarm = html
        .split_once("role=\"alert\"")
        .unwrap()
        .1
        .split_once("</div>")
        .unwrap()
        .0;
    assert!(
        alarm.contains("reason 2") && !alarm.contains("reason 3"),
        "{alarm}"
    );
    assert!(
        alarm.contains("Failed too: calibrate@3, ") && alarm.contains("calibrate@8"),
        "{alarm}"
    );
}

/// A run in which the training failed, with what run 7 made.
fn completed_run(nodes: Vec<RunNode>) -> Run<'static> {
    let mut earlier = run(&nodes);
    earlier.record.number = 7;
    failed_run(nodes).completed(earlier)
}

fn failed_run(nodes: Vec<RunNode>) -> Run<'static> {
    let mut failed = run(&nodes);
    let mut nodes = failed.nodes.iter_mut();
    let train = &mut nodes.find(|node| node.run.name == "train").unwrap().run;
    (train.state, train.reason) = (NodeState::Failed, "disk full".to_owned());
    train.outputs.clear();
    failed.nodes.retain(|node| node.run.name != "video");
    failed
}

#[test]
fn what_an_earlier_run_made_is_shown_with_its_number() {
    let (store, nodes) = full();
    let failed = failed_run(nodes.clone());
    assert!(!store.with_report_of(&failed, write).contains("Of run"));
    let run = completed_run(nodes);
    let train = run.node("train").unwrap();
    assert_eq!(
        (train.run.state, train.run.reason.as_str()),
        (NodeState::Failed, "disk full")
    );
    let html = store.with_report_of(&run, write);
    check_balance(&html);
    for text in [
        "Of run 7, the last whole one, as this run has not made them: train, skipped&lt;i&gt;, video.",
        "not part of this run",
        "outputs of run 7",
        "train failed:",
        "24.57 dB",
    ] {
        assert!(html.contains(text), "{text}");
    }
}
