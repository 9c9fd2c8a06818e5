//! Tiny stages for tests of the engine: an archive in memory, a filter, a fold, a sum, an expansion.

#![allow(clippy::unwrap_used, reason = "a test that is set up wrong should stop")]
#![allow(dead_code, reason = "each test file uses its own part")]

use std::{
    collections::BTreeMap,
    sync::{
        Arc, LazyLock, Mutex,
        atomic::{AtomicU64, Ordering},
    },
    time::Duration,
};

use marf_cache::{ContentHash, Digest, Store, digest_of, manifest::Row};
use marf_engine::{Cancel, Edge, Event, Graph, Listener, NodeDecl, Options, RunRecord};
use marf_stage::*;
use schemars::JsonSchema;
use serde::Deserialize;

type AtMeasure = Box<dyn Fn(usize) + Send>;
type AtSum = Arc<dyn Fn() + Send + Sync>;

/// What the tests' archive holds (shard -> name -> number), and what was asked of it. Each test has its own, by
/// a number that is no part of any key.
#[derive(Default)]
pub struct World {
    pub archive: Mutex<BTreeMap<u32, BTreeMap<String, u64>>>,
    pub fetched: Mutex<Vec<u32>>,
    pub measured: Mutex<Vec<String>>,
    pub folded: Mutex<Vec<u32>>,
    pub ran: AtomicU64,
    /// Called at every measure with the number measured before.
    pub at_measure: Mutex<Option<AtMeasure>>,
    /// Called when a sum begins.
    pub at_sum: Mutex<Option<AtSum>>,
    pub extra_threads: Mutex<Vec<usize>>,
}

static WORLDS: LazyLock<Mutex<BTreeMap<u64, Arc<World>>>> = LazyLock::new(Mutex::default);
static NEXT: AtomicU64 = AtomicU64::new(1);

pub fn new_world() -> (u64, Arc<World>) {
    let number = NEXT.fetch_add(1, Ordering::Relaxed);
    let world = Arc::new(World::default());
    WORLDS.lock().unwrap().insert(number, Arc::clone(&world));
    (number, world)
}

fn world(number: u64) -> Arc<World> {
    Arc::clone(&WORLDS.lock().unwrap()[&number])
}

impl World {
    pub fn put(&self, shard: u32, name: &str, number: u64) {
        let mut archive = self.archive.lock().unwrap();
        archive.entry(shard).or_default().insert(name.to_owned(), number);
    }

    /// Ten photos of this shard with the numbers 0..10 times the shard.
    pub fn put_shard(&self, shard: u32) {
        (0..10).for_each(|number| self.put(shard, &format!("s{shard}-{number}"), number * u64::from(shard)));
    }

    pub fn take_fetched(&self) -> Vec<u32> {
        std::mem::take(&mut self.fetched.lock().unwrap())
    }

    pub fn take_measured(&self) -> usize {
        std::mem::take(&mut *self.measured.lock().unwrap()).len()
    }

    pub fn take_folded(&self) -> Vec<u32> {
        std::mem::take(&mut self.folded.lock().unwrap())
    }

    /// Forgets what was asked so far.
    pub fn forget(&self) {
        self.take_fetched();
        self.take_measured();
        self.take_folded();
        self.take_ran();
    }

    pub fn take_ran(&self) -> u64 {
        self.ran.swap(0, Ordering::Relaxed)
    }
}

/// Which world a stage of a test lives in; never in a key.
#[derive(Debug, Clone, Copy, Default, Deserialize, JsonSchema)]
#[serde(transparent)]
pub struct In(pub u64);

impl ContentHash for In {
    fn walk(&self, listener: &mut dyn marf_cache::Visitor) {
        listener.open("In", 0);
        listener.close();
    }
}

/// Parameters of a measure that has none.
#[derive(ContentHash)]
struct Nothing {}

macro_rules! stage {
    ($stage:ident, $params:ident { $($field:ident : $ty:ty),* }, $name:literal, $version:literal,
     [$($port:expr),*], [$($output:expr),*], $work:ident, $threads:expr) => {
        #[derive(Debug, Clone, Deserialize, JsonSchema, ContentHash)]
        #[serde(deny_unknown_fields)]
        pub struct $params { pub world: In, $(pub $field: $ty),* }
        pub struct $stage(pub $params);
        impl Stage for $stage {
            fn params(&self) -> &dyn ContentHash { &self.0 }
            fn work(&self) -> Work<'_> { Work::$work(self) }
            fn threads(&self) -> Threads { $threads }
        }
        impl Define for $stage {
            type Params = $params;
            const NAME: &'static str = $name;
            const ABOUT: &'static str = "a stage of a test";
            const VERSION: u32 = $version;
            const PORTS: &'static [Port] = &[$($port),*];
            const OUTPUTS: &'static [&'static str] = &[$($output),*];
            fn new(params: $params) -> Result<Self, ParamError> { Ok(Self(params)) }
        }
    };
}

const INPUT: Port = Port::required("input", PHOTOS);
stage!(
    Archive,
    ArchiveParams {},
    "archive",
    1,
    [],
    [PHOTOS, VERDICTS, COMPANIONS],
    Source,
    Threads::One
);
stage!(
    AtMost,
    AtMostParams { most: u64 },
    "at_most",
    1,
    [INPUT],
    [PHOTOS, VERDICTS],
    Map,
    Threads::All
);
stage!(
    Distinct,
    DistinctParams { by: u64 },
    "distinct",
    1,
    [INPUT],
    [PHOTOS, VERDICTS],
    Fold,
    Threads::All
);
stage!(
    Sum,
    SumParams { times: u64 },
    "sum",
    1,
    [INPUT, Port::optional("input", COMPANIONS)],
    ["sum"],
    Set,
    Threads::All
);
stage!(
    Draw,
    DrawParams { seed: u64 },
    "draw",
    1,
    [Port::required("input", "sum")],
    ["draw"],
    Set,
    Threads::One
);
stage!(
    Many,
    ManyParams { b: u64, unlucky: u64 },
    "many",
    1,
    [Port::required("input", "sum")],
    ["mean"],
    Expand,
    Threads::One
);
stage!(
    Broken,
    BrokenParams { how: String },
    "broken",
    1,
    [INPUT],
    ["sum"],
    Set,
    Threads::One
);

impl Source for Archive {
    fn list(&self, _ctx: &Ctx<'_>) -> Result<Listing, StageError> {
        let world = world(self.0.world.0);
        let archive = world.archive.lock().unwrap();
        if archive.is_empty() {
            return Err(StageError::new("the archive is empty").hint("fill it"));
        }
        let shards = archive.iter().map(|(shard, photos)| Shard {
            shard: *shard,
            fingerprint: digest_of(photos),
        });
        Ok(Listing {
            shards: shards.collect(),
            companions: BTreeMap::new(),
            note: (archive.len() > 2).then(|| format!("{} shards there", archive.len())),
        })
    }

    fn fetch(&self, ctx: &Ctx<'_>, shard: u32) -> Result<Fetched, StageError> {
        let world = world(self.0.world.0);
        world.fetched.lock().unwrap().push(shard);
        let photos = world.archive.lock().unwrap()[&shard].clone();
        let mut fetched = Fetched::default();
        for (name, number) in photos {
            let image = ctx.put(format!("image {number}").as_bytes())?;
            let blobs = BTreeMap::from([("image".to_owned(), image)]);
            fetched.rows.push(Row {
                id: name.clone(),
                blobs,
                facts: serde_json::json!({ "shard": shard }),
            });
            fetched.verdicts.push(verdict(&name, Keeps(true), None));
        }
        Ok(fetched)
    }
}

/// Whether a photo stays.
struct Keeps(bool);

fn verdict(id: &str, keeps: Keeps, score: Option<f64>) -> Verdict {
    Verdict {
        id: id.to_owned(),
        file: format!("{id}.png"),
        verdict: match keeps {
            Keeps(true) => Verdict::KEEP.to_owned(),
            Keeps(false) => "size".to_owned(),
        },
        score,
        threshold: None,
        twin: None,
        reason: String::new(),
    }
}

fn number_of(ctx: &Ctx<'_>, row: &Row) -> Result<u64, StageError> {
    let text = String::from_utf8(ctx.get(&row.blobs["image"])?.to_vec()).unwrap();
    Ok(text.strip_prefix("image ").unwrap().parse().unwrap())
}

fn measure_number(number: u64, ctx: &Ctx<'_>, row: &Row) -> Result<Vec<u8>, StageError> {
    let world = world(number);
    let before = {
        let mut measured = world.measured.lock().unwrap();
        measured.push(row.id.clone());
        measured.len() - 1
    };
    if let Some(at_measure) = world.at_measure.lock().unwrap().as_ref() {
        at_measure(before);
    }
    Ok(number_of(ctx, row)?.to_le_bytes().to_vec())
}

fn read(measure: &[u8]) -> u64 {
    u64::from_le_bytes(measure.try_into().unwrap())
}

impl Measure for AtMost {
    fn measure_params(&self) -> &dyn ContentHash {
        &Nothing {}
    }

    fn measure(&self, ctx: &Ctx<'_>, row: &Row) -> Result<Vec<u8>, StageError> {
        measure_number(self.0.world.0, ctx, row)
    }
}

impl Map for AtMost {
    fn decide(&self, items: &[Measured<'_>]) -> Result<Vec<Verdict>, StageError> {
        let score = |item: &Measured<'_>| read(item.measure);
        let judge = |item: &Measured<'_>| {
            verdict(
                &item.row.id,
                Keeps(score(item) <= self.0.most),
                Some(score(item) as f64),
            )
        };
        Ok(items.iter().map(judge).collect())
    }
}

impl Measure for Distinct {
    fn measure_params(&self) -> &dyn ContentHash {
        &Nothing {}
    }

    fn measure(&self, ctx: &Ctx<'_>, row: &Row) -> Result<Vec<u8>, StageError> {
        measure_number(self.0.world.0, ctx, row)
    }
}

impl Fold for Distinct {
    fn fold(
        &self,
        state: Option<&[u8]>,
        items: &[Measured<'_>],
    ) -> Result<(Vec<u8>, Vec<Verdict>), StageError> {
        let world = world(self.0.world.0);
        world
            .folded
            .lock()
            .unwrap()
            .extend(items.first().map(|item| item.shard));
        let mut seen: std::collections::BTreeSet<u64> = state
            .map(|state| serde_json::from_slice(state).unwrap())
            .unwrap_or_default();
        let judge = |item: &Measured<'_>| {
            verdict(
                &item.row.id,
                Keeps(seen.insert(read(item.measure) / self.0.by)),
                None,
            )
        };
        let verdicts = items.iter().map(judge).collect();
        Ok((serde_json::to_vec(&seen).unwrap(), verdicts))
    }
}

impl Set for Sum {
    fn run(&self, ctx: &Ctx<'_>, inputs: &Inputs) -> Result<Outputs, StageError> {
        let world = world(self.0.world.0);
        world.ran.fetch_add(1, Ordering::Relaxed);
        world.extra_threads.lock().unwrap().push(ctx.threads);
        let at_sum = world.at_sum.lock().unwrap().clone();
        if let Some(at_sum) = at_sum {
            at_sum();
        }
        ctx.check()?;
        let root = marf_cache::manifest::Root::decode(&ctx.get(inputs.required(PHOTOS)?)?).unwrap();
        let mut sum = 0;
        for leaf in &root.leaves {
            for row in marf_cache::manifest::Leaf::decode(&ctx.get(&leaf.leaf)?)
                .unwrap()
                .rows
            {
                sum += number_of(ctx, &row)? * self.0.times;
            }
        }
        Ok(BTreeMap::from([(
            "sum".to_owned(),
            ctx.put(format!("sum {sum}").as_bytes())?,
        )]))
    }
}

impl Set for Draw {
    fn run(&self, ctx: &Ctx<'_>, inputs: &Inputs) -> Result<Outputs, StageError> {
        world(self.0.world.0).ran.fetch_add(1, Ordering::Relaxed);
        std::thread::sleep(Duration::from_millis(1)); // so that two of them overlap
        let sum = ctx.get(inputs.required("sum")?)?;
        if self.0.seed == 1313 {
            return Err(StageError::new("seed 1313 brings bad luck"));
        }
        let drawn = format!("{} {}", String::from_utf8_lossy(&sum), self.0.seed * 7 % 5);
        Ok(BTreeMap::from([("draw".to_owned(), ctx.put(drawn.as_bytes())?)]))
    }
}

impl Expand for Many {
    fn expand(&self, _ctx: &Ctx<'_>, inputs: &Inputs) -> Result<Vec<NodeSpec>, StageError> {
        let spec = |seed: u64| NodeSpec {
            name: format!("member-{seed:02}"),
            stage: "draw".to_owned(),
            params: serde_json::json!({ "world": self.0.world.0, "seed": if seed == self.0.unlucky { 1313 } else { seed } }),
            inputs: inputs.clone(),
        };
        Ok((0..self.0.b).map(spec).collect())
    }

    fn reduce(&self, ctx: &Ctx<'_>, _inputs: &Inputs, children: &[Outputs]) -> Result<Outputs, StageError> {
        let mut all = Vec::new();
        for child in children {
            all.extend_from_slice(&ctx.get(&child["draw"])?);
            all.push(b'\n');
        }
        Ok(BTreeMap::from([("mean".to_owned(), ctx.put(&all)?)]))
    }
}

impl Set for Broken {
    fn run(&self, ctx: &Ctx<'_>, _inputs: &Inputs) -> Result<Outputs, StageError> {
        match self.0.how.as_str() {
            "panics" => panic!("index 7 of 3"),
            "forgets" => Ok(Outputs::new()),
            "invents" => Ok(BTreeMap::from([("sum".to_owned(), Digest::of(b"never stored"))])),
            "adds" => {
                let blob = ctx.put(b"x")?;
                Ok(BTreeMap::from([
                    ("sum".to_owned(), blob),
                    ("more".to_owned(), blob),
                ]))
            }
            _ => Err(StageError::new("no number is right")
                .cause("numbers")
                .hint("use letters")),
        }
    }
}

/// Writes down its input behind what it wrote before, where it may see that.
pub struct Diary(DiaryParams);

#[derive(Debug, Clone, Deserialize, JsonSchema, ContentHash)]
#[serde(deny_unknown_fields)]
pub struct DiaryParams {
    pub world: In,
    pub extend: bool,
}

impl Stage for Diary {
    fn params(&self) -> &dyn ContentHash {
        &self.0
    }

    fn work(&self) -> Work<'_> {
        Work::Set(self)
    }

    fn earlier(&self) -> Option<&'static str> {
        self.0.extend.then_some("diary")
    }
}

impl Define for Diary {
    type Params = DiaryParams;
    const NAME: &'static str = "diary";
    const ABOUT: &'static str = "a stage of a test";
    const VERSION: u32 = 1;
    const PORTS: &'static [Port] = &[Port::required("input", "sum")];
    const OUTPUTS: &'static [&'static str] = &["diary"];

    fn new(params: DiaryParams) -> Result<Self, ParamError> {
        Ok(Self(params))
    }
}

impl Set for Diary {
    fn run(&self, ctx: &Ctx<'_>, inputs: &Inputs) -> Result<Outputs, StageError> {
        let earlier = inputs
            .optional(EARLIER)
            .map(|digest| ctx.get(digest))
            .transpose()?;
        let mut pages = earlier.map(|pages| pages.to_vec()).unwrap_or_default();
        pages.extend_from_slice(&ctx.get(inputs.required("sum")?)?);
        pages.push(b'\n');
        Ok(BTreeMap::from([("diary".to_owned(), ctx.put(&pages)?)]))
    }
}

pub const TABLE: &[StageDef] = &[
    define::<Diary>(),
    define::<Archive>(),
    define::<AtMost>(),
    define::<Distinct>(),
    define::<Sum>(),
    define::<Draw>(),
    define::<Many>(),
    define::<Broken>(),
];

pub fn def(name: &str) -> StageDef {
    *TABLE.iter().find(|def| def.name == name).unwrap()
}

/// Declares a node; edges as `key=upstream`.
pub fn node(name: &str, stage: &str, world: u64, params: serde_json::Value, edges: &[&str]) -> NodeDecl {
    let def = def(stage);
    let mut params = params;
    params["world"] = world.into();
    let edges = edges.iter().map(|edge| {
        let (key, upstream) = edge.split_once('=').unwrap();
        Edge {
            key: key.to_owned(),
            upstream: upstream.to_owned(),
        }
    });
    NodeDecl {
        name: name.to_owned(),
        stage: def,
        bound: (def.bind)(params).unwrap(),
        edges: edges.collect(),
    }
}

/// The tests' pipeline: archive, at_most, distinct, sum, many.
#[derive(Clone)]
pub struct Line {
    pub world: u64,
    pub most: u64,
    pub by: u64,
    pub times: u64,
    pub b: u64,
    /// The member that fails.
    pub unlucky: u64,
    pub version: u32,
}

impl Line {
    pub fn new(world: u64) -> Self {
        Self {
            world,
            most: 12,
            by: 2,
            times: 1,
            b: 3,
            unlucky: 99,
            version: 1,
        }
    }

    pub fn nodes(&self) -> Vec<NodeDecl> {
        let json = |key: &str, value: u64| serde_json::json!({ key: value });
        let mut nodes = vec![
            node("archive", "archive", self.world, serde_json::json!({}), &[]),
            node(
                "at_most",
                "at_most",
                self.world,
                json("most", self.most),
                &["input=archive"],
            ),
            node(
                "distinct",
                "distinct",
                self.world,
                json("by", self.by),
                &["input=at_most"],
            ),
            node(
                "sum",
                "sum",
                self.world,
                json("times", self.times),
                &["input=distinct"],
            ),
            node(
                "many",
                "many",
                self.world,
                serde_json::json!({ "b": self.b, "unlucky": self.unlucky }),
                &["input=sum"],
            ),
        ];
        nodes[1].stage.version = self.version;
        nodes
    }

    pub fn graph(&self) -> Graph {
        Graph::new(self.nodes(), TABLE).unwrap()
    }
}

/// Keeps all events.
#[derive(Default)]
pub struct Ears(pub Mutex<Vec<Event>>);

impl Listener for Ears {
    fn on_event(&self, event: &Event) {
        self.0.lock().unwrap().push(event.clone());
    }
}

/// What happened to each node, in the order it happened: `ran`, `reused`, `failed`, `skipped`.
pub fn happened(ears: &Ears) -> Vec<(String, String)> {
    let events = ears.0.lock().unwrap();
    let told = events.iter().filter_map(|event| match event {
        Event::Finished { node, .. } => Some((node.clone(), "ran".to_owned())),
        Event::Reused { node, .. } => Some((node.clone(), "reused".to_owned())),
        Event::Failed { node, message, .. } => Some((node.clone(), format!("failed: {message}"))),
        Event::Skipped { node, reason } => Some((node.clone(), format!("skipped: {reason}"))),
        _ => None,
    });
    told.collect()
}

/// The nodes that ran to their end, sorted.
pub fn ran(ears: &Ears) -> Vec<String> {
    let mut names: Vec<String> = happened(ears)
        .into_iter()
        .filter(|(_, what)| what == "ran")
        .map(|(node, _)| node)
        .collect();
    names.sort();
    names
}

pub fn reason_of(ears: &Ears, wanted: &str) -> Option<String> {
    let events = ears.0.lock().unwrap();
    events.iter().find_map(|event| match event {
        Event::WillRun { node, reason, .. } if node == wanted => Some(reason.clone()),
        _ => None,
    })
}

pub fn warnings(ears: &Ears) -> Vec<String> {
    let events = ears.0.lock().unwrap();
    let warnings = events.iter().filter_map(|event| match event {
        Event::Warning { message, .. } => Some(message.clone()),
        _ => None,
    });
    warnings.collect()
}

pub fn options(threads: usize) -> Options {
    Options {
        threads: std::num::NonZero::new(threads),
        pipeline: "test".to_owned(),
        ..Options::default()
    }
}

pub fn run_on(graph: &Graph, store: &Store) -> (RunRecord, Ears) {
    run_with(graph, store, &options(2), &Cancel::default())
}

pub fn run_with(graph: &Graph, store: &Store, options: &Options, cancel: &Cancel) -> (RunRecord, Ears) {
    let ears = Ears::default();
    let record = marf_engine::run(graph, store, options, &ears, cancel).unwrap();
    (record, ears)
}

pub fn fresh_store() -> (tempfile::TempDir, Store) {
    let dir = tempfile::tempdir().unwrap();
    let store = Store::open(dir.path().join(".marf")).unwrap();
    (dir, store)
}

pub fn text(store: &Store, record: &RunRecord, node: &str, output: &str) -> String {
    let output = record.node(node).unwrap().outputs[output];
    String::from_utf8(store.get(&output.digest).unwrap().to_vec()).unwrap()
}
