//! Actions computed without their pipeline, and nodes that another machine computes.

use std::{
    collections::BTreeMap,
    path::PathBuf,
    sync::{
        Arc,
        atomic::{AtomicUsize, Ordering},
    },
    time::Duration,
};

use marf_cache::{Action, Digest, Record, Store, Upstream};
use marf_engine::{
    ActionError, ActionJob, Cancel, Executor, Graph, NodeState, Options, Order, Outcome, SilentListener,
    action_at,
};
use marf_stage::StageError;
use parking_lot::Mutex;
use serde_json::{Value, json};

use crate::common::*;

/// The blobs of another store.
struct Blobs(Store);

impl Upstream for Blobs {
    fn blob(&self, digest: &Digest) -> Result<Option<Vec<u8>>, String> {
        Ok(self.0.get(digest).ok().map(|bytes| bytes.to_vec()))
    }
}

/// Returns the parameters of an action with the fixture, which is in no key.
fn params_of(action: &Action, fixture: u64) -> Value {
    let mut params = action.params.clone();
    params["fixture"] = fixture.into();
    params
}

/// A machine with a store of its own, which computes nodes of some stages.
#[derive(Debug)]
struct Machine {
    own: PathBuf,
    of_run: PathBuf,
    fixture: u64,
    stages: &'static [&'static str],
    fails: bool,
    gpu: Option<&'static str>,
    /// Names of the nodes that it computed, with the number of results in their orders.
    computed: Mutex<Vec<(String, usize)>>,
    busy: AtomicUsize,
    most_busy: AtomicUsize,
}

impl Machine {
    fn new(folder: &tempfile::TempDir, fixture: u64, stages: &'static [&'static str]) -> Self {
        Self {
            own: folder.path().join("machine"),
            of_run: folder.path().join(".marf"),
            fixture,
            stages,
            fails: false,
            gpu: None,
            computed: Mutex::default(),
            busy: AtomicUsize::new(0),
            most_busy: AtomicUsize::new(0),
        }
    }

    fn compute(&self, action: &Action, order: &Order<'_>) -> Result<Record, ActionError> {
        let upstream = Blobs(Store::open(&self.of_run).unwrap());
        let store = Store::open(&self.own).unwrap().with_upstream(Arc::new(upstream));
        let record = run_action(action, params_of(action, self.fixture), &store, order.cancel)?;
        for blob in store.belongings(&record).unwrap().blobs {
            order.store.put(&store.get(&blob).unwrap()).unwrap();
        }
        Ok(record)
    }
}

fn run_action(action: &Action, params: Value, store: &Store, cancel: &Cancel) -> Result<Record, ActionError> {
    ActionJob::new(action, params, TABLE)?.run(store, &options(1), &SilentListener, cancel)
}

impl Machine {
    /// Computes an action, and puts its record and every blob of it into the store of the run.
    fn bring(&self, action: &Action, order: &Order<'_>) -> Result<(), StageError> {
        let made = self.compute(action, order);
        order
            .store
            .put_record(made.map_err(|error| StageError::new(error.to_string()))?);
        order.store.commit().unwrap();
        Ok(())
    }
}

impl Executor for Machine {
    fn machine_of(&self, stage: &str) -> Option<marf_engine::Machine<'_>> {
        let gpu = self.gpu;
        self.stages
            .contains(&stage)
            .then_some(marf_engine::Machine { gpu })
    }

    fn takes(&self, action: &Action) -> bool {
        self.stages.contains(&action.stage.as_str())
    }

    fn slots(&self) -> usize {
        2
    }

    fn execute(&self, order: &Order<'_>) -> Result<(), StageError> {
        let busy = self.busy.fetch_add(1, Ordering::SeqCst) + 1;
        self.most_busy.fetch_max(busy, Ordering::SeqCst);
        std::thread::sleep(Duration::from_millis(20));
        let made = if self.fails {
            Err(StageError::new("the machine is on fire").hint("put it out"))
        } else {
            self.bring(order.action, order)
        };
        self.busy.fetch_sub(1, Ordering::SeqCst);
        made?;
        self.computed
            .lock()
            .push((order.node.to_owned(), order.results.len()));
        Ok(())
    }
}

fn with(machine: &Arc<Machine>) -> Options {
    let executor: Arc<Machine> = Arc::clone(machine);
    Options {
        executor: Some(executor),
        ..options(2)
    }
}

/// Sums and members computed elsewhere have the keys and the bytes of those computed here.
#[test]
fn nodes_computed_elsewhere_are_those_computed_here() {
    let (number, fixture) = new_fixture();
    fixture.put_shard(1);
    fixture.put_shard(2);
    let pipeline = TestPipeline {
        b: 5,
        ..TestPipeline::new(number)
    };
    let (_here, store_here) = fresh_store();
    let (here, _) = run_on(&pipeline.graph(), &store_here);
    let (folder, store) = fresh_store();
    let machine = Arc::new(Machine::new(&folder, number, &["sum", "draw", "at_most"]));
    let (there, log) = run_with(&pipeline.graph(), &store, &with(&machine), &Cancel::default());
    assert_eq!(there.outcome, Outcome::Done, "{:?}", node_events(&log));
    let nodes = |record: &marf_engine::RunRecord| -> Vec<_> {
        let nodes = record.nodes.iter();
        nodes
            .map(|node| (node.name.clone(), node.key, node.outputs.clone()))
            .collect()
    };
    assert_eq!(nodes(&there), nodes(&here));
    let mut computed = machine.computed.lock().clone();
    computed.sort();
    let names: Vec<&str> = computed.iter().map(|(name, _)| name.as_str()).collect();
    assert_eq!(
        names,
        [
            "many/member-00",
            "many/member-01",
            "many/member-02",
            "many/member-03",
            "many/member-04",
            "sum"
        ]
    );
    assert_eq!(computed.last().unwrap().1, 3, "a sum may read of three results");
    assert_eq!(
        machine.most_busy.load(Ordering::SeqCst),
        2,
        "five members on two slots"
    );
    assert_eq!(ran(&log).len(), 3 + 1 + 1 + 5);

    let (_, log) = run_with(&pipeline.graph(), &store, &with(&machine), &Cancel::default());
    assert_eq!(ran(&log), Vec::<String>::new());
}

/// Every node of a run that no archive is read for, each from the blobs of its store alone. Parts of nodes are refused.
#[test]
fn each_node_is_computed_again_from_its_inputs_alone() {
    let (number, fixture) = new_fixture();
    for shard in 1..=3 {
        fixture.put_shard(shard);
    }
    let (folder, store) = fresh_store();
    let crowd = node(
        "crowd",
        "crowd",
        number,
        json!({ "enough": 2 }),
        &["input=archive"],
    );
    let nodes = TestPipeline::new(number).nodes().into_iter().chain([crowd]);
    run_on(&Graph::new(nodes.collect(), TABLE).unwrap(), &store);
    let mut computed: BTreeMap<String, usize> = BTreeMap::new();
    for record in store.records().unwrap() {
        let action = action_at(&store, &record.key).unwrap().unwrap();
        let mut params = params_of(&action, number);
        if action.stage == "crowd" {
            params["enough"] = 2.into();
        }
        let blobs = Blobs(Store::open(folder.path().join(".marf")).unwrap());
        let empty = tempfile::tempdir().unwrap();
        let alone = Store::open(empty.path()).unwrap().with_upstream(Arc::new(blobs));
        let made = run_action(&action, params, &alone, &Cancel::default());
        if action.stage == "archive" {
            assert!(matches!(made, Err(ActionError::Source { .. })), "{made:?}");
            continue;
        }
        if let Some(part) = action.part {
            assert!(matches!(made, Err(ActionError::Part { .. })), "{part}: {made:?}");
            // A chain begins with the digest of nothing, which nobody stores.
            let start = Digest::from_content(&[]);
            for (name, input) in action.inputs.iter().filter(|(_, input)| **input != start) {
                assert!(store.get(input).is_ok(), "{part}: `{name}` {input}");
            }
            *computed.entry(part).or_default() += 1;
            continue;
        }
        let made = made.unwrap_or_else(|error| panic!("{action:?}: {error}"));
        assert_eq!(made.outputs, record.outputs, "{action:?}");
        assert_eq!(made.needs, record.needs, "{action:?}");
        *computed.entry("whole".to_owned()).or_default() += 1;
    }
    let expected = [("decide", 6), ("fold", 3), ("summarise", 6), ("whole", 8)];
    assert_eq!(
        computed,
        BTreeMap::from(expected.map(|(part, count)| (part.to_owned(), count)))
    );
}

#[test]
fn what_fails_elsewhere_fails_with_its_reason_and_the_rest_goes_on() {
    let (number, fixture) = new_fixture();
    fixture.put_shard(1);
    let (folder, store) = fresh_store();
    let machine = Arc::new(Machine {
        fails: true,
        ..Machine::new(&folder, number, &["draw"])
    });
    let pipeline = TestPipeline::new(number);
    let (record, log) = run_with(&pipeline.graph(), &store, &with(&machine), &Cancel::default());
    assert_eq!(record.outcome, Outcome::Failed);
    assert_eq!(record.node("sum").unwrap().state, NodeState::Finished);
    let failed = format!("{:?}", node_events(&log));
    assert!(failed.contains("the machine is on fire"), "{failed}");
}

/// An action of the pipeline's sum, in a store that has its inputs.
fn summed() -> (tempfile::TempDir, Store, u64, Action) {
    let (dir, store) = fresh_store();
    let (number, fixture) = new_fixture();
    fixture.put_shard(1);
    let (record, _) = run_on(&TestPipeline::new(number).graph(), &store);
    let key = record.node("sum").unwrap().key.unwrap();
    let action = action_at(&store, &key).unwrap().unwrap();
    (dir, store, number, action)
}

#[test]
fn an_action_that_this_program_would_make_otherwise_is_refused() {
    let (_dir, store, number, action) = summed();
    type Edit = dyn Fn(&mut Action);
    let refused = |change: &Edit| {
        let mut action = action.clone();
        change(&mut action);
        let params = params_of(&action, number);
        run_action(&action, params, &store, &Cancel::default())
            .unwrap_err()
            .to_string()
    };
    let cases: [(&Edit, &str); 6] = [
        (
            &|action| action.stage = "tea".to_owned(),
            "stage `tea`, which this program does not have",
        ),
        (&|action| action.version = 7, "stage version 7 -> 1"),
        (
            &|action| action.part = Some("decide".to_owned()),
            "part `decide` of stage `sum`",
        ),
        (
            &|action| action.backend = Some("a card".to_owned()),
            "stage `sum` on a card, and here is cpu",
        ),
        (
            &|action| action.params = json!({"times": "often"}),
            "stage `sum`: ",
        ),
        (
            &|action| action.stage = "archive".to_owned(),
            "stage `archive`, which reads an archive",
        ),
    ];
    for (change, expected) in cases {
        let error = refused(change);
        assert!(error.contains(expected), "{error}");
    }
    let archive = Action {
        stage: "archive".to_owned(),
        params: json!({}),
        ..action.clone()
    };
    let params = params_of(&archive, number);
    let error = run_action(&archive, params, &store, &Cancel::default()).unwrap_err();
    assert!(matches!(error, ActionError::Source { .. }), "{error}");
}

#[test]
fn an_action_with_a_result_is_not_computed_again_and_a_wish_to_stop_is_heard() {
    let (_dir, store, number, action) = summed();
    let compute =
        |store: &Store, cancel: &Cancel| run_action(&action, params_of(&action, number), store, cancel);
    let known = compute(&store, &Cancel::default()).unwrap();
    assert_eq!(known, store.record(&action.key()).unwrap().unwrap());
    let empty = tempfile::tempdir().unwrap();
    let bare = Store::open(empty.path()).unwrap();
    let cancel = Cancel::default();
    cancel.set();
    let stopped = compute(&bare, &cancel).unwrap_err();
    assert!(matches!(stopped, ActionError::Stopped), "{stopped}");
    // Without inputs, and without the nodes that would compute them.
    let failed = compute(&bare, &Cancel::default()).unwrap_err();
    assert!(matches!(failed, ActionError::Failed(_)), "{failed}");
}
