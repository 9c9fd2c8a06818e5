//! A small pipeline with an archive: archive -> pick -> sum -> many (two children).

use std::collections::BTreeMap;

use marf_cache::{
    Sha256, Store, digest_of,
    manifest::{Leaf, LeafRef, ManifestError, Root, Row},
};
use marf_engine::{Cancel, Edge, Graph, NodeDecl, Options, RunRecord, SilentListener};
use marf_stage::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

macro_rules! stage {
    ($stage:ident { $($field:ident : $ty:ty),* }, $name:literal, $ports:expr, $outputs:expr, $work:ident) => {
        #[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
        #[serde(deny_unknown_fields)]
        pub struct $stage { $($field: $ty),* }
        impl Stage for $stage {
            fn params(&self) -> serde_json::Value { key_params(self, &[]) }
            fn work(&self) -> Work<'_> { Work::$work(self) }
        }
        impl Define for $stage {
            type Params = Self;
            const NAME: &'static str = $name;
            const ABOUT: &'static str = "a stage of a test";
            const VERSION: u32 = 1;
            const PORTS: &'static [Port] = $ports;
            const OUTPUTS: &'static [&'static str] = $outputs;
            fn new(params: Self) -> Result<Self, ParamError> { Ok(params) }
        }
    };
}

const SUM: &str = "sum";
stage!(Archive { sols: u32 }, "archive", &[], &[PHOTOS, VERDICTS], Source);
stage!(
    Pick { without: String },
    "pick",
    &[Port::required("input", PHOTOS)],
    &[PHOTOS],
    Set
);
stage!(
    Sum { times: u64 },
    "sum",
    &[Port::required("input", PHOTOS)],
    &[SUM],
    Set
);
stage!(
    Many { b: u64 },
    "many",
    &[Port::required("input", SUM)],
    &["mean"],
    Expand
);
stage!(
    Draw { seed: u64 },
    "draw",
    &[Port::required("input", SUM)],
    &["draw"],
    Set
);

const TABLE: &[StageDef] = &[
    define::<Archive>(),
    define::<Pick>(),
    define::<Sum>(),
    define::<Many>(),
    define::<Draw>(),
];

/// The picture of a product.
pub fn picture(id: &str) -> Vec<u8> {
    format!("picture {id}").into_bytes()
}

/// The products of a sol.
pub fn ids(sol: u32) -> [String; 3] {
    ["a", "b", "c"].map(|name| format!("{name}{sol}"))
}

impl Source for Archive {
    fn list(&self, _ctx: &Ctx<'_>) -> Result<Listing, StageError> {
        let shards = (1..=self.sols).map(|shard| Shard {
            shard,
            fingerprint: digest_of(&shard),
        });
        Ok(Listing {
            shards: shards.collect(),
            ..Listing::default()
        })
    }

    fn fetch(&self, ctx: &Ctx<'_>, shard: u32) -> Result<Fetched, StageError> {
        let mut fetched = Fetched::default();
        for id in ids(shard) {
            let bytes = picture(&id);
            let blake3 = ctx.put(&bytes)?;
            fetched.origins.push(Origin {
                file: format!("{id}.png"),
                kind: OriginKind::Photo,
                blake3,
                bytes: Some(bytes.len() as u64),
                sha256: Some(Sha256::from_content(&bytes)),
                url: Some(format!("https://host/{id}.png")),
                fetched: Some("2026-11-22T08:00:00Z".to_owned()),
                reason: None,
            });
            fetched.rows.push(Row {
                id,
                blobs: BTreeMap::from([("image".to_owned(), blake3)]),
                facts: serde_json::Value::Null,
            });
        }
        Ok(fetched)
    }
}

fn leaves(ctx: &Ctx<'_>, inputs: &Inputs) -> Result<Vec<LeafRef>, StageError> {
    let fail = |error: ManifestError| StageError::new(error.to_string());
    let root = ctx.get(inputs.required(PHOTOS)?)?;
    let mut leaves = Vec::new();
    for block in Root::blocks(&root).map_err(fail)? {
        leaves.extend(Root::decode_leaves(&ctx.get(&block.digest)?).map_err(fail)?);
    }
    Ok(leaves)
}

impl Set for Pick {
    fn run(&self, ctx: &Ctx<'_>, inputs: &Inputs) -> Result<Outputs, StageError> {
        let mut kept = Root::default();
        for leaf in leaves(ctx, inputs)? {
            let mut rows = Leaf::decode(&ctx.get(&leaf.leaf)?).unwrap().rows;
            rows.retain(|row| row.id != self.without);
            kept.leaves.push(LeafRef {
                shard: leaf.shard,
                rows: rows.len() as u32,
                leaf: ctx.put(&Leaf { rows }.encode())?,
            });
        }
        let root = kept.write(|bytes| ctx.put(bytes))?;
        Ok(Outputs::from([(PHOTOS.to_owned(), root)]))
    }
}

impl Set for Sum {
    fn run(&self, ctx: &Ctx<'_>, inputs: &Inputs) -> Result<Outputs, StageError> {
        let rows: u64 = leaves(ctx, inputs)?.iter().map(|leaf| u64::from(leaf.rows)).sum();
        let text = format!("{} rows times {}", rows, self.times);
        Ok(Outputs::from([(SUM.to_owned(), ctx.put(text.as_bytes())?)]))
    }
}

impl Set for Draw {
    fn run(&self, ctx: &Ctx<'_>, inputs: &Inputs) -> Result<Outputs, StageError> {
        let text = format!("{} {}", inputs.required(SUM)?, self.seed);
        Ok(Outputs::from([("draw".to_owned(), ctx.put(text.as_bytes())?)]))
    }
}

impl Expand for Many {
    fn children(&self) -> Vec<ChildStage> {
        vec![ChildStage {
            stage: "draw",
            params: serde_json::json!({ "seed": 0 }),
        }]
    }

    fn expand(&self, _ctx: &Ctx<'_>, inputs: &Inputs) -> Result<Vec<NodeSpec>, StageError> {
        let child = |seed: u64| NodeSpec {
            name: format!("draw-{seed}"),
            stage: "draw".to_owned(),
            params: serde_json::json!({ "seed": seed }),
            inputs: inputs.clone(),
        };
        Ok((0..self.b).map(child).collect())
    }

    fn reduce(&self, ctx: &Ctx<'_>, _inputs: &Inputs, children: &[Outputs]) -> Result<Outputs, StageError> {
        let text = format!("mean of {}", children.len());
        Ok(Outputs::from([("mean".to_owned(), ctx.put(text.as_bytes())?)]))
    }
}

/// What varies from run to run.
#[derive(Debug, Clone)]
pub struct Pipeline {
    pub sols: u32,
    pub without: &'static str,
    pub times: u64,
}

impl Default for Pipeline {
    fn default() -> Self {
        Self {
            sols: 2,
            without: "b1",
            times: 1,
        }
    }
}

impl Pipeline {
    fn graph(&self) -> Graph {
        let node = |name: &str, params: serde_json::Value, upstream: Option<&str>| {
            let stage = *TABLE.iter().find(|def| def.name == name).unwrap();
            let edge = |upstream: &str| Edge::new("input", upstream);
            NodeDecl {
                name: name.to_owned(),
                stage,
                bound: (stage.bind)(params).unwrap(),
                edges: upstream.map(edge).into_iter().collect(),
            }
        };
        let json = serde_json::json!({"sols": self.sols});
        let nodes = vec![
            node("archive", json, None),
            node(
                "pick",
                serde_json::json!({"without": self.without}),
                Some("archive"),
            ),
            node("sum", serde_json::json!({"times": self.times}), Some("pick")),
            node("many", serde_json::json!({"b": 2}), Some("sum")),
        ];
        Graph::new(nodes, TABLE).unwrap()
    }

    /// Runs it on a store.
    pub fn run(&self, store: &Store) -> RunRecord {
        let options = Options {
            pipeline: "test".to_owned(),
            command: "marf run".to_owned(),
            ..Options::default()
        };
        marf_engine::run(
            &self.graph(),
            store,
            &options,
            &SilentListener,
            &Cancel::default(),
        )
        .unwrap()
    }
}

/// Returns an empty store in a temporary folder.
pub fn fresh_store() -> (tempfile::TempDir, Store) {
    let dir = tempfile::tempdir().unwrap();
    let store = Store::open(dir.path().join(".marf")).unwrap();
    (dir, store)
}
