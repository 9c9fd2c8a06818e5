//! Which nodes ran when: the engine runs nodes that changed, and no others.

use crate::common::*;

use marf_cache::{Action, Digest};
use marf_engine::{
    EngineError, Graph, Listings, NodeState, Outcome, PlanOptions, PlanState, PlannedNode, RunSource,
    last_run, plan, why,
};

/// A store with the pipeline's first run in it.
pub fn after_first_run() -> (
    tempfile::TempDir,
    marf_cache::Store,
    TestPipeline,
    std::sync::Arc<Fixture>,
    marf_engine::RunRecord,
) {
    let (dir, store) = fresh_store();
    let (number, fixture) = new_fixture();
    fixture.put_shard(1);
    fixture.put_shard(2);
    let pipeline = TestPipeline::new(number);
    let (record, log) = run_on(&pipeline.graph(), &store);
    assert_eq!(record.outcome, Outcome::Done, "{:?}", node_events(&log));
    (dir, store, pipeline, fixture, record)
}

#[test]
fn everything_runs_the_first_time_and_gives_the_hand_worked_answer() {
    let (_dir, store, _pipeline, fixture, record) = after_first_run();
    // Shard 1 holds 0..=9, shard 2 the even numbers 0..=18. Numbers up to 12 stay, and one of each n / 2 is kept: 0 2 4 6 8 of shard 1,
    // then 10 (5) and 12 (6) of shard 2.
    assert_eq!(text(&store, &record, "sum", "sum"), "sum 42");
    assert_eq!(
        text(&store, &record, "many", "mean"),
        "sum 42 0\nsum 42 2\nsum 42 4\n"
    );
    assert_eq!(fixture.take_fetched(), vec![1, 2]);
    assert_eq!(fixture.take_measured(), 20 + 17);
    assert_eq!(fixture.take_folded(), vec![1, 2]);
    assert_eq!(fixture.take_ran(), 4);
    let counts = &record.node("distinct").unwrap().counts;
    assert_eq!(
        (counts["photos"], counts["rejected"], counts["measured"]),
        (7, 10, 17)
    );
}

#[test]
fn nothing_runs_when_nothing_changed() {
    let (_dir, store, pipeline, fixture, first) = after_first_run();
    let before = (
        fixture.take_fetched(),
        fixture.take_measured(),
        fixture.take_folded(),
        fixture.take_ran(),
    );
    assert_eq!(before.1, 37);
    let graph = pipeline.graph();
    let planned = plan(&graph, &store, Some(&first), &PlanOptions::default()).unwrap();
    assert!(
        planned.iter().all(|node| node.state == PlanState::Fresh),
        "{planned:?}"
    );
    let (record, log) = run_on(&graph, &store);
    assert_eq!(ran(&log), Vec::<String>::new());
    assert_eq!(record.outcome, Outcome::Done);
    assert_eq!(
        (
            fixture.take_fetched(),
            fixture.take_measured(),
            fixture.take_ran()
        ),
        (vec![], 0, 0)
    );
    let names = |record: &marf_engine::RunRecord| -> Vec<_> {
        record
            .nodes
            .iter()
            .map(|node| (node.name.clone(), node.key, node.outputs.clone()))
            .collect()
    };
    assert_eq!(
        names(&record),
        names(&first),
        "children of a reused node are told too"
    );
}

/// A plan and the runs of one program see one archive, whatever is put into it meanwhile. The next program sees the new state.
#[test]
fn graphs_that_share_listings_ask_a_source_once() {
    let (_dir, store, pipeline, fixture, _) = after_first_run();
    fixture.take_fetched();
    fixture.put_shard(3);
    let listings = Listings::default();
    let (record, _) = run_on(&pipeline.graph().sharing(&listings), &store);
    assert_eq!(fixture.take_fetched(), vec![3]);
    fixture.put_shard(4);
    let graph = pipeline.graph().sharing(&listings);
    let planned = plan(&graph, &store, Some(&record), &PlanOptions::default()).unwrap();
    assert!(
        planned.iter().all(|node| node.state == PlanState::Fresh),
        "{planned:?}"
    );
    let (again, log) = run_on(&graph, &store);
    assert_eq!(ran(&log), Vec::<String>::new());
    assert_eq!(again.nodes[0].key, record.nodes[0].key);
    let _ = run_on(&pipeline.graph().sharing(&Listings::default()), &store);
    assert_eq!(fixture.take_fetched(), vec![4]);
}

#[test]
fn a_new_threshold_measures_nothing_and_an_equal_result_stops_there() {
    let (_dir, store, mut pipeline, fixture, first) = after_first_run();
    fixture.take_measured();
    pipeline.most = 13; // no number is 13: the same photos stay
    let graph = pipeline.graph();
    let planned = why(&graph, &store, Some(&first), &PlanOptions::default(), "at_most").unwrap();
    assert_eq!(planned.state, PlanState::WillRun);
    assert_eq!(planned.reason, "params.most: 12 -> 13");
    let downstream = why(&graph, &store, Some(&first), &PlanOptions::default(), "sum").unwrap();
    assert_eq!(downstream.state, PlanState::MayRun);
    assert_eq!(downstream.reason, "upstream distinct may run");
    let (record, log) = run_on(&graph, &store);
    assert_eq!(ran(&log), vec!["at_most"]);
    assert_eq!(fixture.take_measured(), 0);
    assert_eq!(record.node("distinct").unwrap().state, NodeState::Reused);

    pipeline.most = 4;
    let (record, log) = run_on(&pipeline.graph(), &store);
    assert_eq!(fixture.take_measured(), 0, "a decision never measures");
    assert_eq!(reason_of(&log, "at_most").unwrap(), "params.most: 13 -> 4");
    assert_eq!(reason_of(&log, "sum").unwrap(), "input photos changed");
    assert_eq!(text(&store, &record, "sum", "sum"), "sum 6");
}

#[test]
fn going_back_to_an_old_parameter_runs_nothing() {
    let (_dir, store, mut pipeline, _fixture, _) = after_first_run();
    pipeline.most = 4;
    run_on(&pipeline.graph(), &store);
    pipeline.most = 12;
    let last = last_run(&store, "test", &RunSource::default(), no_warning).unwrap();
    let planned = plan(&pipeline.graph(), &store, last.as_ref(), &PlanOptions::default()).unwrap();
    let states: Vec<PlanState> = planned.iter().map(|node| node.state).collect();
    assert_eq!(states[0], PlanState::Fresh);
    assert!(
        states[1..].iter().all(|state| *state == PlanState::Cached),
        "{states:?}"
    );
    let (_, log) = run_on(&pipeline.graph(), &store);
    assert_eq!(ran(&log), Vec::<String>::new());
}

#[test]
fn of_a_new_shard_only_that_shard_is_fetched_measured_and_folded() {
    let (_dir, store, pipeline, fixture, _) = after_first_run();
    fixture.clear_log();
    fixture.put_shard(3);
    let (record, log) = run_on(&pipeline.graph(), &store);
    assert_eq!(
        reason_of(&log, "archive").unwrap(),
        "shard 3 is new; 3 shards there"
    );
    assert_eq!(fixture.take_fetched(), vec![3]);
    assert_eq!(
        fixture.take_measured(),
        10 + 5,
        "ten of the shard, and the five of them up to 12 again"
    );
    assert_eq!(
        fixture.take_folded(),
        vec![3],
        "the fold goes on from its last state"
    );
    assert_eq!(record.node("archive").unwrap().counts["fetched"], 1);
    for node in ["at_most", "distinct"] {
        assert_eq!(record.node(node).unwrap().counts["decided"], 1, "{node}");
    }
}

#[test]
fn the_plan_says_how_many_photos_of_how_many_shards_a_node_will_look_at() {
    let (_dir, store, mut pipeline, fixture, first) = after_first_run();
    fixture.put_shard(3);
    let extents = |pipeline: &TestPipeline| -> Vec<_> {
        let planned = plan(&pipeline.graph(), &store, Some(&first), &PlanOptions::default()).unwrap();
        let of = |node: &PlannedNode| node.extent.map(|extent| (extent.shards, extent.photos));
        planned.iter().map(of).collect()
    };
    assert_eq!(
        extents(&pipeline),
        vec![Some((1, None)); 5],
        "one shard is not fetched yet, and goes through"
    );
    fixture.archive.lock().remove(&3);
    pipeline.most = 4;
    assert_eq!(
        extents(&pipeline),
        vec![
            None,
            Some((2, Some(20))),
            Some((2, Some(20))),
            Some((2, Some(20))),
            Some((2, Some(20)))
        ]
    );
}

#[test]
fn every_photo_that_was_added_edited_or_removed_is_named() {
    let (_dir, store, pipeline, fixture, first) = after_first_run();
    fixture.put(2, "s2-9", 11);
    fixture.put(3, "new", 1);
    fixture.archive.lock().get_mut(&1).unwrap().remove("s1-0");
    let graph = pipeline.graph();
    let to_archive = marf_engine::Options {
        to: vec!["archive".to_owned()],
        ..options(2)
    };
    run_with(&graph, &store, &to_archive, &marf_engine::Cancel::default());
    for node in ["at_most", "sum"] {
        let changes =
            marf_engine::photo_changes(&graph, &store, Some(&first), &PlanOptions::default(), node).unwrap();
        let words: Vec<String> = changes.iter().map(ToString::to_string).collect();
        assert_eq!(
            words,
            [
                "photo 00001/s1-0 is gone",
                "photo 00002/s2-9 changed",
                "photo 00003/new is new"
            ],
            "{node}: what it reads is not known, so the nearest node upstream answers"
        );
    }
}

#[test]
fn a_plan_ends_when_the_user_stops_it_while_a_source_is_listed() {
    let (_dir, store, pipeline, fixture, first) = after_first_run();
    let (graph, last) = (pipeline.graph(), Some(&first));
    let asked = |question: &dyn Fn(&PlanOptions<'_>) -> Option<EngineError>| {
        let options = PlanOptions::default();
        let cancel = options.cancel.clone();
        *fixture.at_list.lock() = Some(std::sync::Arc::new(move || cancel.set()));
        question(&options)
    };
    for error in [
        asked(&|options| plan(&graph, &store, last, options).err()),
        asked(&|options| why(&graph, &store, last, options, "sum").err()),
        asked(&|options| marf_engine::photo_changes(&graph, &store, last, options, "sum").err()),
    ] {
        assert!(matches!(error, Some(EngineError::Stopped)), "{error:?}");
    }
}

/// A trial of an older stage would be served for a newer one if the versions of children were in no key of their parent.
#[test]
fn a_newer_stage_of_the_children_runs_them_and_their_parent() {
    let (_dir, store, pipeline, _fixture, first) = after_first_run();
    let mut table = TABLE.to_vec();
    let draw = table.iter_mut().find(|def| def.name == "draw").unwrap();
    draw.version = 2;
    let newer = Graph::new(pipeline.nodes(), &table).unwrap();
    let planned = why(&newer, &store, Some(&first), &PlanOptions::default(), "many").unwrap();
    assert_eq!(planned.reason, "version of stage draw 1 -> 2");
    let (_, log) = run_on(&newer, &store);
    assert_eq!(
        ran(&log),
        vec!["many", "many/member-00", "many/member-01", "many/member-02"]
    );
}

#[test]
fn a_key_is_the_digest_of_a_stored_action_and_a_part_has_its_own() {
    let (_dir, store, _pipeline, _fixture, first) = after_first_run();
    for node in &first.nodes {
        let key = node.key.unwrap();
        let bytes = store.get(&key).unwrap();
        assert_eq!(Digest::from_content(&bytes), key);
        let action = Action::decode(&bytes).unwrap();
        assert_eq!(action.stage, node.stage);
        let record = store.record(&key).unwrap().unwrap();
        if let Some(parts) = record.parts {
            let parts = set_of(&store, &parts).leaves;
            assert_eq!(parts.len(), 2, "{}", node.name);
            for part in parts {
                let action = Action::decode(&store.get(&part.leaf).unwrap()).unwrap();
                assert_eq!(
                    (action.shard, action.stage),
                    (Some(part.shard), node.stage.clone())
                );
                assert!(store.hit(&part.leaf).unwrap().is_some());
            }
        }
    }
}

#[test]
fn history_does_not_show_in_a_result() {
    let (_dir, store, pipeline, fixture, _) = after_first_run();
    fixture.put_shard(3);
    let (grown, _) = run_on(&pipeline.graph(), &store);
    let (_dir2, other) = fresh_store();
    let (anew, _) = run_on(&pipeline.graph(), &other);
    for node in &grown.nodes {
        assert_eq!(
            Some(&node.outputs),
            anew.node(&node.name).map(|node| &node.outputs),
            "{}",
            node.name
        );
    }
}

#[test]
fn one_changed_photo_is_measured_alone() {
    let (_dir, store, pipeline, fixture, _) = after_first_run();
    fixture.clear_log();
    fixture.put(2, "s2-9", 11);
    let (_, log) = run_on(&pipeline.graph(), &store);
    assert_eq!(reason_of(&log, "archive").unwrap(), "shard 2 changed");
    assert_eq!((fixture.take_fetched(), fixture.take_measured()), (vec![2], 2));
    assert_eq!(fixture.take_folded(), vec![2]);
}

#[test]
fn from_three_members_to_five_two_run() {
    let (_dir, store, mut pipeline, fixture, _) = after_first_run();
    fixture.take_ran();
    pipeline.b = 5;
    let (record, log) = run_on(&pipeline.graph(), &store);
    assert_eq!(ran(&log), vec!["many", "many/member-03", "many/member-04"]);
    assert_eq!(reason_of(&log, "many").unwrap(), "params.b: 3 -> 5");
    assert_eq!(fixture.take_ran(), 2);
    assert_eq!(record.node("many").unwrap().counts["children"], 5);
    let members = record
        .nodes
        .iter()
        .filter(|node| node.parent.as_deref() == Some("many"));
    assert_eq!(members.count(), 5);
}

#[test]
fn a_raised_version_runs_the_node_and_decides_all_again() {
    let (_dir, store, mut pipeline, fixture, _) = after_first_run();
    fixture.take_measured();
    pipeline.version = 2;
    let (record, log) = run_on(&pipeline.graph(), &store);
    assert_eq!(
        ran(&log),
        vec!["at_most"],
        "its result is the same, so nothing below it ran"
    );
    assert_eq!(reason_of(&log, "at_most").unwrap(), "stage version 1 -> 2");
    assert_eq!(record.node("at_most").unwrap().counts["decided"], 2);
    assert_eq!(fixture.take_measured(), 0, "the measure has a version of its own");
}

#[test]
fn threads_do_not_show_in_any_digest() {
    let (number, fixture) = new_fixture();
    (1..4).for_each(|shard| fixture.put_shard(shard));
    let graph = TestPipeline::new(number).graph();
    let digests = [1, 2, 4].map(|threads| {
        let (_dir, store) = fresh_store();
        let (record, _) = run_with(&graph, &store, &options(threads), &marf_engine::Cancel::default());
        assert_eq!(record.threads, threads);
        let nodes = record.nodes.into_iter();
        nodes
            .map(|node| (node.name, node.key, node.outputs))
            .collect::<Vec<_>>()
    });
    assert_eq!(digests[0], digests[1]);
    assert_eq!(digests[0], digests[2]);
    let given = fixture.sum_threads.lock().clone();
    assert_eq!(given, vec![1, 2, 4], "alone it gets all threads");
}
