//! Nodes on a GPU run one after the other, and their backend id is in their key.
use std::num::NonZero;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Barrier};
use std::time::Duration;

use marf_cache::{Action, Store};
use marf_engine::{
    Cancel, Executor, Graph, Machine, NodeDecl, Options, Order, Outcome, SilentListener, action_at, run,
};
use marf_stage::{
    Ctx, Define, Inputs, Outputs, ParamError, Port, Set, Stage, StageError, Work, define, key_params,
};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Number of nodes on the device, and its maximum.
static RUNNING: AtomicUsize = AtomicUsize::new(0);
static MAX_RUNNING: AtomicUsize = AtomicUsize::new(0);
/// The three other nodes wait for each other: they end only if they run in parallel.
static CPU_NODES: Barrier = Barrier::new(3);

#[derive(Serialize, Deserialize, JsonSchema)]
struct Params {
    number: u64,
    on_gpu: bool,
}

struct DeviceStage(Params);

impl Stage for DeviceStage {
    fn params(&self) -> serde_json::Value {
        key_params(&self.0, &[])
    }

    fn work(&self) -> Work<'_> {
        Work::Set(self)
    }

    fn backend_id(&self) -> Option<String> {
        self.0.on_gpu.then(|| "a card, its driver".to_owned())
    }

    fn backend_id_on(&self, gpu: Option<&str>) -> Result<Option<String>, StageError> {
        match (self.0.on_gpu, gpu) {
            (true, None) => Err(StageError::new("it wants a card, and jobs have none")),
            (true, Some(gpu)) => Ok(Some(gpu.to_owned())),
            (false, _) => Ok(None),
        }
    }
}

impl Define for DeviceStage {
    type Params = Params;
    const NAME: &'static str = "device_stage";
    const ABOUT: &'static str = "";
    const VERSION: u32 = 1;
    const PORTS: &'static [Port] = &[];
    const OUTPUTS: &'static [&'static str] = &["out"];

    fn new(params: Params) -> Result<Self, ParamError> {
        Ok(Self(params))
    }
}

impl Set for DeviceStage {
    fn run(&self, ctx: &Ctx<'_>, _inputs: &Inputs) -> Result<Outputs, StageError> {
        if self.0.on_gpu {
            let inside = RUNNING.fetch_add(1, Ordering::SeqCst) + 1;
            MAX_RUNNING.fetch_max(inside, Ordering::SeqCst);
            std::thread::sleep(Duration::from_millis(50));
            RUNNING.fetch_sub(1, Ordering::SeqCst);
        } else {
            CPU_NODES.wait();
        }
        let digest = ctx.put(&self.0.number.to_le_bytes())?;
        Ok(Outputs::from([("out".to_owned(), digest)]))
    }
}

fn decl(number: u64, on_gpu: bool) -> NodeDecl {
    NodeDecl {
        name: format!("node-{number}"),
        stage: define::<DeviceStage>(),
        bound: Box::new(DeviceStage(Params { number, on_gpu })),
        edges: Vec::new(),
    }
}

#[test]
fn one_node_at_a_time_is_on_the_gpu_and_the_others_run_beside_it() {
    let decls = (0..6).map(|number| decl(number, number < 3)).collect();
    let graph = Graph::new(decls, &[define::<DeviceStage>()]).unwrap();
    let dir = tempfile::tempdir().unwrap();
    let store = Store::open(dir.path()).unwrap();
    let options = Options {
        threads: NonZero::new(6),
        pipeline: "devices".to_owned(),
        ..Options::default()
    };
    let record = run(&graph, &store, &options, &SilentListener, &Cancel::default()).unwrap();
    assert_eq!(record.outcome, Outcome::Done);
    assert_eq!(MAX_RUNNING.load(Ordering::SeqCst), 1);
    let made = store.record(&record.nodes[0].key.unwrap()).unwrap().unwrap();
    assert_eq!(made.metadata.device, "a card, its driver");
    let action = Action::decode(&store.get(&made.key).unwrap()).unwrap();
    assert_eq!(action.backend.as_deref(), Some("a card, its driver"));
}

/// A machine that answers for its card and computes nothing.
#[derive(Debug)]
struct Idle {
    gpu: Option<&'static str>,
    takes: bool,
}

impl Executor for Idle {
    fn machine_of(&self, _stage: &str) -> Option<Machine<'_>> {
        Some(Machine { gpu: self.gpu })
    }

    fn takes(&self, _action: &Action) -> bool {
        self.takes
    }

    fn slots(&self) -> usize {
        1
    }

    fn execute(&self, order: &Order<'_>) -> Result<(), StageError> {
        Err(StageError::new(format!("gpu: {}", order.needs.gpu)))
    }
}

/// The key of a node that another machine computes holds the backend of that machine. If the machine has another device than the node
/// wants, or does not take it, the node fails instead of being computed here.
#[test]
fn keys_hold_the_backend_of_the_machine_that_computes_the_node() {
    let dir = tempfile::tempdir().unwrap();
    let store = Store::open(dir.path()).unwrap();
    let graph = Graph::new(vec![decl(0, true)], &[define::<DeviceStage>()]).unwrap();
    let node = |gpu, takes| {
        let options = Options {
            executor: Some(Arc::new(Idle { gpu, takes })),
            ..Options::default()
        };
        let record = run(&graph, &store, &options, &SilentListener, &Cancel::default()).unwrap();
        record.nodes[0].clone()
    };
    let ordered = node(Some("another card"), true);
    let action = action_at(&store, &ordered.key.unwrap()).unwrap().unwrap();
    assert_eq!(action.backend.as_deref(), Some("another card"));
    assert!(ordered.reason.contains("gpu: true"), "{}", ordered.reason);
    let bare = node(None, true);
    assert!(bare.reason.contains("jobs have none"), "{}", bare.reason);
    let untaken = node(Some("another card"), false);
    assert!(untaken.reason.contains("which is not here"), "{}", untaken.reason);
    assert_eq!(untaken.key, ordered.key);
}
