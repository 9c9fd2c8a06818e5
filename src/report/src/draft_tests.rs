//! The report of a run that goes on or was stopped, with a draft.

use marf_engine::{NodeState, Outcome};
use marf_model::Run;

use super::fixture::{Store, full, run};
use super::tests::check_balance;
use super::write;

/// A run whose draft is done. The training is done too, or waits with all that reads it.
fn with_draft(training: NodeState) -> (Store, Run<'static>) {
    let (store, mut nodes) = full();
    let at = nodes.iter().position(|node| node.run.name == "tune").unwrap();
    let mut draft = nodes
        .iter()
        .find(|node| node.run.name == "train")
        .unwrap()
        .clone();
    draft.run.name = "draft".to_owned();
    nodes.insert(at, draft);
    if !training.is_good() {
        for node in nodes.iter_mut().skip(at + 1) {
            node.run.state = training;
            node.run.outputs.clear();
            node.worked_s = None;
        }
    }
    (store, run(&nodes))
}

#[test]
fn a_draft_is_shown_as_one_until_its_training_is_done() {
    let (store, mut run) = with_draft(NodeState::Cancelled);
    (run.record.outcome, run.record.seconds) = (Outcome::Cancelled, 65.0);
    let html = store.with_report_of(&run, write);
    check_balance(&html);
    for text in [
        "The run goes on: 4 of 10 nodes done after 65 s.",
        "Load it again",
        "10 nodes: 3 ran, 1 reused, 6 waiting, 3.0 s",
        "This is a draft, as `train` has no result yet.",
        "<dt>error of new views, draft</dt><dd>15 of 255",
        "draft of the field from there",
        "<h3>draft: 1 view</h3>",
    ] {
        assert!(html.contains(text), "{text}: {html}");
    }
    assert!(!html.contains("Uncertainty was not measured"), "it will be");

    run.record.number = 5;
    let html = store.with_report_of(&run, write);
    for text in [
        "Run 5 was stopped: 4 of 10 nodes done after 65 s.",
        "Run the same command again to continue.",
    ] {
        assert!(html.contains(text), "{text}");
    }
    assert!(!html.contains("goes on"));

    let (store, run) = with_draft(NodeState::Finished);
    let html = store.with_report_of(&run, write);
    for text in [
        "goes on",
        "was stopped",
        "This is a draft",
        "<h3>draft: 1 view</h3>",
    ] {
        assert!(!html.contains(text), "{text}");
    }
    assert!(html.contains("<h3>train: 1 view</h3>"));
}
