//! `items`: a source that makes rows without photos, through the shipped engine, store and filters of facts. It measures the
//! cost of a run with a million items that has no work, or one sol of work.

use std::path::{Path, PathBuf};

use clap::Args;
use marf_cache::manifest::Row;
use marf_cache::{Digest, Store};
use marf_engine::{Cancel, Edge, Graph, NodeDecl, Options, Outcome, SilentListener};
use marf_run::Error;
use marf_scene::PhotoFacts;
use marf_stage::{
    Ctx, Define, Fetched, Listing, PHOTOS, ParamError, Port, Shard, Source, Stage, StageDef, StageError,
    VERDICTS, Verdict, Work, define, key_params,
};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::json;

use crate::output::{Result, go_on, print_json};
use crate::process::{bytes_below, run};

/// Arguments of `items`.
#[derive(Debug, Clone, Args)]
pub struct ItemsArgs {
    /// Rows
    #[arg(long, default_value_t = 1_000_000)]
    items: u64,
    /// Sols they are spread over
    #[arg(long, default_value_t = 1_000, value_parser = clap::value_parser!(u32).range(1..))]
    sols: u32,
    /// How often the run without a change is repeated
    #[arg(long, default_value_t = 3)]
    rounds: u32,
    /// Folder of the store
    #[arg(long, value_name = "DIR", default_value = "bench-items")]
    dir: PathBuf,
    /// Run once in this program with this many sols more, and print the nodes
    #[arg(long, hide = true)]
    more: Option<u32>,
}

/// Rows that are made from their numbers.
struct SyntheticItems(ItemsParams);

/// How many rows there are.
#[derive(Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct ItemsParams {
    /// Sols.
    sols: u32,
    /// Rows a sol.
    a_sol: u64,
}

impl Define for SyntheticItems {
    type Params = ItemsParams;
    const NAME: &'static str = "synthetic";
    const ABOUT: &'static str = "rows without photos";
    const VERSION: u32 = 1;
    const PORTS: &'static [Port] = &[];
    const OUTPUTS: &'static [&'static str] = &[PHOTOS, VERDICTS];

    fn new(params: ItemsParams) -> std::result::Result<Self, ParamError> {
        Ok(Self(params))
    }
}

impl Stage for SyntheticItems {
    /// The listing holds how many sols there are.
    fn params(&self) -> serde_json::Value {
        key_params(&self.0, &["sols"])
    }

    fn work(&self) -> Work<'_> {
        Work::Source(self)
    }
}

impl Source for SyntheticItems {
    fn list(&self, _ctx: &Ctx<'_>) -> std::result::Result<Listing, StageError> {
        let shard = |shard: u32| Shard {
            shard,
            fingerprint: Digest::from_content(&shard.to_le_bytes()),
        };
        Ok(Listing {
            shards: (0..self.0.sols).map(shard).collect(),
            ..Listing::default()
        })
    }

    fn fetch(&self, _ctx: &Ctx<'_>, shard: u32) -> std::result::Result<Fetched, StageError> {
        let id = |at: u64| format!("NLF_{shard:04}_{at:010}_000ECM_N0000000NCAM00000_00_0LLJ");
        let row = |at: u64| Row {
            id: id(at),
            blobs: [("image".to_owned(), Digest::from_content(id(at).as_bytes()))].into(),
            facts: PhotoFacts {
                file: format!("{}.jpg", id(at)),
                size_bytes: 20_000 + at * 7_919 % 80_000,
                width: if at.is_multiple_of(10) { 160 } else { 1280 },
                height: 960,
                bands: 3,
                sol: Some(shard),
                ..PhotoFacts::default()
            }
            .to_json(),
        };
        let verdict = |row: &Row| Verdict {
            id: row.id.clone(),
            file: format!("{}.jpg", row.id),
            verdict: Verdict::KEEP.to_owned(),
            score: None,
            threshold: None,
            twin: None,
            reason: String::new(),
        };
        let rows: Vec<Row> = (0..self.0.a_sol).map(row).collect();
        Ok(Fetched {
            verdicts: rows.iter().map(verdict).collect(),
            rows,
            ..Fetched::default()
        })
    }
}

/// Runs each phase as a program of its own. Prints one JSON line each.
///
/// # Errors
/// Returns an error if a folder cannot be written, a run fails, or the user wants to stop.
pub fn items(args: &ItemsArgs, cancel: &Cancel) -> Result {
    if let Some(more) = args.more {
        return run_once(args, args.sols.saturating_add(more), cancel);
    }
    let (program, dir) = (std::env::current_exe()?, args.dir.display().to_string());
    let (items, sols) = (args.items.to_string(), args.sols.to_string());
    for (phase, more, rounds) in [
        ("fill", "0", 1),
        ("no change", "0", args.rounds),
        ("one new sol", "1", 1),
    ] {
        for round in 1..=rounds {
            go_on(cancel)?;
            let arguments = [
                "items", "--items", &items, "--sols", &sols, "--dir", &dir, "--more", more,
            ];
            let (cost, nodes) = run(&program, Path::new("."), &arguments)?;
            print_json(&json!({
                "phase": phase, "round": round, "items": args.items, "sols": args.sols, "cost": cost,
                "store_bytes": bytes_below(&args.dir), "nodes": nodes,
            }))?;
        }
    }
    Ok(())
}

/// Runs the pipeline of synthetic items once and prints its nodes.
fn run_once(args: &ItemsArgs, sols: u32, cancel: &Cancel) -> Result {
    let graph = graph(sols, args.items / u64::from(args.sols))?;
    let store = Store::open(&args.dir)?;
    let options = Options {
        pipeline: "bench items".to_owned(),
        ..Options::default()
    };
    let record = marf_engine::run(&graph, &store, &options, &SilentListener, cancel)?;
    for node in &record.nodes {
        print_json(&json!({
            "node": node.name, "state": node.state, "counts": node.counts, "seconds": node.seconds,
        }))?;
    }
    match record.outcome {
        Outcome::Done => Ok(()),
        Outcome::Cancelled => Err(Error::Interrupted.into()),
        Outcome::Failed => Err("a node failed".into()),
    }
}

/// Returns the graph: the source and two filters that read facts alone.
fn graph(sols: u32, a_sol: u64) -> Result<Graph> {
    let mut table: Vec<StageDef> = marf_stages::stages().to_vec();
    table.push(define::<SyntheticItems>());
    let mut decls = Vec::new();
    for (name, params, upstream) in [
        ("synthetic", json!({"sols": sols, "a_sol": a_sol}), None),
        ("size", json!({}), Some("synthetic")),
        ("shape", json!({}), Some("size")),
    ] {
        let stage = table.iter().find(|def| def.name == name).copied();
        let stage = stage.ok_or_else(|| format!("unknown stage `{name}`"))?;
        decls.push(NodeDecl {
            name: name.to_owned(),
            stage,
            bound: (stage.bind)(params)?,
            edges: Vec::from_iter(upstream.map(|upstream| Edge::new("input", upstream))),
        });
    }
    Ok(Graph::new(decls, &table)?)
}
