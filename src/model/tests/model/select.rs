use std::collections::BTreeMap;

use marf_cache::{Digest, Output, Store};
use marf_engine::{NodeRun, NodeState, Outcome, Purpose, RUN_FORMAT, RunRecord, RunSource, document};
use marf_model::select::{Selected, Subject, newest, newest_derived, newest_whole, newest_with};
use proptest::prelude::*;

use super::common::fresh_store;

/// The nodes of the pipeline of these tests.
const NODES: [&str; 3] = ["extract", "train", "bootstrap"];

fn of_file(file: &str) -> RunSource {
    RunSource::Pipeline {
        file: file.to_owned(),
    }
}

fn of_folder(folder: &str) -> RunSource {
    RunSource::Folder {
        verb: "filter".to_owned(),
        folder: folder.to_owned(),
    }
}

fn subject(file: &str, name: &str) -> Subject {
    Subject::Pipeline {
        source: of_file(file),
        name: Some(name.to_owned()),
    }
}

fn no_warning(message: String) {
    panic!("{message}");
}

/// Stores a run with its source and the state of each node. `None` leaves a node out of the run.
fn stored(store: &Store, name: &str, source: RunSource, states: [Option<NodeState>; 3]) -> RunRecord {
    let tree = serde_json::json!({"node": BTreeMap::from(NODES.map(|node| (node, serde_json::json!({}))))});
    let tree = tree.to_string();
    let resolved = Output {
        digest: store.put(tree.as_bytes()).unwrap(),
        bytes: tree.len() as u64,
    };
    let node = |(name, state): (&&str, Option<NodeState>)| {
        Some(NodeRun {
            name: (*name).to_owned(),
            stage: (*name).to_owned(),
            parent: None,
            edges: Vec::new(),
            inputs: BTreeMap::new(),
            key: None,
            state: state?,
            reason: String::new(),
            cause: None,
            hint: None,
            seconds: 0.0,
            started_unix_s: None,
            outputs: BTreeMap::new(),
            counts: BTreeMap::new(),
        })
    };
    let nodes: Vec<NodeRun> = NODES.iter().zip(states).filter_map(node).collect();
    let is_done = nodes.iter().all(|node| node.state.is_good());
    let run = RunRecord {
        number: 0,
        root: None,
        format: RUN_FORMAT,
        id: format!("run {}", store.run_numbers().unwrap().len()),
        pipeline: name.to_owned(),
        source,
        command: "marf".to_owned(),
        program: "marf".to_owned(),
        build: None,
        started_unix_s: 0,
        seconds: 0.0,
        outcome: if is_done { Outcome::Done } else { Outcome::Failed },
        digest: Digest::from_content(b"declared"),
        threads: 1,
        nodes,
        documents: BTreeMap::from([(document::RESOLVED.to_owned(), resolved)]),
        latest: BTreeMap::new(),
    };
    run.store(store, no_warning).unwrap()
}

const GOOD: Option<NodeState> = Some(NodeState::Finished);
const BAD: Option<NodeState> = Some(NodeState::Failed);

fn derived(from: &RunRecord, purpose: Purpose) -> RunSource {
    RunSource::Derived {
        from: from.root,
        purpose,
    }
}

fn is_trained(run: &RunRecord) -> bool {
    run.node("train").is_some_and(|node| node.state.is_good())
}

#[test]
fn a_folder_verb_is_no_run_of_the_pipeline_next_to_it_and_the_newest_where_there_is_none() {
    let (_dir, store) = fresh_store();
    let none = Subject::without_file(&store, no_warning).unwrap();
    assert_eq!(none, Subject::Any);
    let run = stored(&store, "demo", of_file("pipeline.toml"), [GOOD; 3]);
    assert_eq!(Subject::without_file(&store, no_warning).unwrap(), Subject::Any);
    let filter = stored(&store, "filter", of_folder("photos"), [GOOD, None, None]);
    let own = newest(&store, &subject("pipeline.toml", "demo"), no_warning).unwrap();
    assert_eq!(own, Some(run));
    let folder = Subject::without_file(&store, no_warning).unwrap();
    assert_eq!(folder, Subject::Folder);
    assert_eq!(newest(&store, &folder, no_warning).unwrap(), Some(filter));
}

#[test]
fn a_pipeline_is_its_file_and_its_name() {
    let (_dir, store) = fresh_store();
    let one = stored(&store, "demo", of_file("a.toml"), [GOOD; 3]);
    let two = stored(&store, "demo", of_file("b.toml"), [GOOD; 3]);
    let renamed = stored(&store, "other", of_file("a.toml"), [GOOD; 3]);
    let run = |subject: &Subject| newest(&store, subject, no_warning).unwrap();
    assert_eq!(run(&subject("a.toml", "demo")), Some(one));
    assert_eq!(run(&subject("b.toml", "demo")), Some(two));
    let any_name = Subject::Pipeline {
        source: of_file("a.toml"),
        name: None,
    };
    assert_eq!(run(&any_name), Some(renamed));
    assert_eq!(run(&subject("c.toml", "demo")), None);
}

#[test]
fn what_is_made_from_a_run_is_attached_to_it_and_stands_for_nothing() {
    let (_dir, store) = fresh_store();
    let run = stored(&store, "demo", of_file("a.toml"), [GOOD; 3]);
    let twin = stored(&store, "demo", of_file("b.toml"), [GOOD; 3]);
    let export = stored(&store, "demo", derived(&run, Purpose::Export), [GOOD; 3]);
    let trade = stored(&store, "demo", derived(&run, Purpose::Trade), [GOOD; 3]);
    let scenes = RunSource::Derived {
        from: None,
        purpose: Purpose::Scenes,
    };
    stored(&store, "demo", scenes, [GOOD; 3]);
    let demo = subject("a.toml", "demo");
    assert_eq!(newest(&store, &demo, no_warning).unwrap().as_ref(), Some(&run));
    assert_eq!(
        newest(&store, &Subject::Any, no_warning).unwrap().as_ref(),
        Some(&twin)
    );
    let of = |run: &RunRecord, purpose: Purpose| {
        newest_derived(&store, run, purpose, no_warning, |_| true).unwrap()
    };
    assert_eq!(of(&run, Purpose::Trade).as_ref(), Some(&trade));
    assert_eq!(of(&export, Purpose::Trade).as_ref(), Some(&trade));
    assert_eq!(of(&twin, Purpose::Trade), None);
    assert_eq!(of(&run, Purpose::Render), None);
}

#[test]
fn a_run_with_a_failure_is_passed_over_and_told() {
    let (_dir, store) = fresh_store();
    let demo = subject("a.toml", "demo");
    let whole = || newest_whole(&store, &demo, no_warning).unwrap();
    assert_eq!(whole(), None);
    let failed = stored(&store, "demo", of_file("a.toml"), [BAD, None, None]);
    assert_eq!(whole(), None);
    let some = stored(&store, "demo", of_file("a.toml"), [GOOD, BAD, None]);
    let of_some = Selected {
        run: some.clone(),
        newer: None,
    };
    assert_eq!(whole(), Some(of_some));
    let part = stored(&store, "demo", of_file("a.toml"), [GOOD, None, None]);
    let newer = stored(&store, "demo", of_file("a.toml"), [GOOD, BAD, None]);
    let of_part = Selected {
        run: part,
        newer: Some(newer),
    };
    assert_eq!(whole(), Some(of_part));
    let all = stored(&store, "demo", of_file("a.toml"), [GOOD; 3]);
    let last = stored(&store, "demo", of_file("a.toml"), [BAD, None, None]);
    let of_all = Selected {
        run: all,
        newer: Some(last),
    };
    assert_eq!(whole(), Some(of_all));
    assert!(failed.number < some.number);
}

/// The runs that a verb leaves in a store.
#[derive(Debug, Clone)]
enum Step {
    /// A run of a pipeline: the file, the name, the states.
    Pipeline(bool, bool, [Option<NodeState>; 3]),
    Folder,
    /// Made from one of the runs before.
    Derived(prop::sample::Index, Purpose),
}

fn step() -> impl Strategy<Value = Step> {
    let state = prop_oneof![Just(GOOD), Just(Some(NodeState::Reused)), Just(BAD), Just(None)];
    let states = [state.clone(), state.clone(), state];
    let purpose = prop_oneof![
        Just(Purpose::Export),
        Just(Purpose::Render),
        Just(Purpose::Trade),
        Just(Purpose::Comparison),
        Just(Purpose::Scenes),
    ];
    prop_oneof![
        4 => (any::<bool>(), any::<bool>(), states)
            .prop_map(|(file, name, states)| Step::Pipeline(file, name, states)),
        1 => Just(Step::Folder),
        2 => (any::<prop::sample::Index>(), purpose).prop_map(|(from, purpose)| Step::Derived(from, purpose)),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    /// After any steps, the answers are those of the pipeline's own runs alone, taken from the newest on.
    #[test]
    fn no_step_of_another_pipeline_folder_or_export_changes_an_answer(steps in prop::collection::vec(step(), 1..9)) {
        let (_dir, store) = fresh_store();
        let mut runs: Vec<RunRecord> = Vec::new();
        for step in steps {
            runs.push(match step {
                Step::Pipeline(file, name, states) => {
                    let name = if name { "demo" } else { "other" };
                    let file = if file { "a.toml" } else { "b.toml" };
                    stored(&store, name, of_file(file), states)
                }
                Step::Folder => stored(&store, "filter", of_folder("photos"), [GOOD, None, None]),
                Step::Derived(from, purpose) => {
                    let from = runs.get(from.index(runs.len().max(1)));
                    let source = RunSource::Derived { from: from.and_then(|run| run.root), purpose };
                    stored(&store, "demo", source, [GOOD; 3])
                }
            });
        }
        let demo = subject("a.toml", "demo");
        let own: Vec<&RunRecord> = runs
            .iter()
            .rev()
            .filter(|run| run.source == of_file("a.toml") && run.pipeline == "demo")
            .collect();
        let first = |wanted: &dyn Fn(&RunRecord) -> bool| own.iter().find(|run| wanted(run)).map(|run| (*run).clone());
        prop_assert_eq!(newest(&store, &demo, no_warning).unwrap(), first(&|_| true));
        prop_assert_eq!(newest_with(&store, &demo, no_warning, is_trained).unwrap(), first(&is_trained));
        let good = |run: &RunRecord| run.nodes.iter().filter(|node| node.state.is_good()).count();
        let whole = first(&|run| good(run) == NODES.len())
            .or_else(|| first(&|run| good(run) > 0 && run.outcome == Outcome::Done))
            .or_else(|| first(&|run| good(run) > 0));
        let selected = newest_whole(&store, &demo, no_warning).unwrap();
        prop_assert_eq!(selected.as_ref().map(|selected| &selected.run), whole.as_ref());
        let is_newer = |run: &RunRecord| whole.as_ref().is_some_and(|whole| whole.number < run.number);
        let newer = first(&|_| true).filter(is_newer);
        prop_assert_eq!(selected.and_then(|selected| selected.newer), newer);
    }
}
