//! `marf bench items`: a source that makes rows without photos, through the shipped engine, store and filters of facts: what a
//! run costs that has a million items and nothing, or one sol, to do.

use std::path::Path;

use marf_cache::manifest::Row;
use marf_cache::{Digest, Store};
use marf_engine::{Cancel, Edge, Graph, NodeDecl, Options, Outcome, SilentListener};
use marf_scene::PhotoFacts;
use marf_stage::{
    Ctx, Define, Fetched, Listing, PHOTOS, ParamError, Port, Shard, Source, Stage, StageDef, StageError,
    VERDICTS, Verdict, Work, define, key_params,
};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::json;

use super::args::{ItemsArgs, ItemsPhase};
use super::child::{bytes_below, run};
use crate::cli::global::Global;
use crate::terminal::print_line;
use marf_run::{Diagnostic, Error};

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

    fn new(params: ItemsParams) -> Result<Self, ParamError> {
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
    fn list(&self, _ctx: &Ctx<'_>) -> Result<Listing, StageError> {
        let shard = |shard: u32| Shard {
            shard,
            fingerprint: Digest::from_content(&shard.to_le_bytes()),
        };
        Ok(Listing {
            shards: (0..self.0.sols).map(shard).collect(),
            ..Listing::default()
        })
    }

    fn fetch(&self, _ctx: &Ctx<'_>, shard: u32) -> Result<Fetched, StageError> {
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

/// Runs `marf bench items`: each phase as a program of its own, one JSON line each.
///
/// # Errors
/// A folder that cannot be written, a run that fails, the wish to stop.
pub fn items(global: &Global, args: &ItemsArgs, cancel: &Cancel) -> Result<(), Error> {
    if let Some(phase) = args.phase {
        return one_run(global, args, phase, cancel);
    }
    let phases = [
        (ItemsPhase::All, "fill", 1),
        (ItemsPhase::All, "no change", args.rounds),
        (ItemsPhase::OneMore, "one new sol", 1),
    ];
    for (phase, name, rounds) in phases {
        for round in 1..=rounds {
            if cancel.is_set() {
                return Err(Error::Interrupted);
            }
            let dir = std::path::absolute(&args.dir).unwrap_or_else(|_| args.dir.clone());
            let dir = dir.display().to_string();
            let (items, sols) = (args.items.to_string(), args.sols.to_string());
            let phase = phase.name();
            let arguments = [
                "bench", "items", "--items", &items, "--sols", &sols, "--dir", &dir, "--phase", phase,
            ];
            let (cost, lines) = run(Path::new("."), &arguments)?;
            let line = json!({
                "phase": name, "round": round, "items": args.items, "sols": args.sols, "cost": cost,
                "store_bytes": bytes_below(&args.dir), "nodes": lines,
            });
            print_line(&line.to_string());
        }
    }
    Ok(())
}

/// Runs the pipeline of synthetic items once and prints its nodes.
fn one_run(global: &Global, args: &ItemsArgs, phase: ItemsPhase, cancel: &Cancel) -> Result<(), Error> {
    let sols = match phase {
        ItemsPhase::All => args.sols,
        ItemsPhase::OneMore => args.sols.saturating_add(1),
    };
    let a_sol = args.items / u64::from(args.sols.max(1));
    let graph = graph(sols, a_sol)?;
    let store = Store::open(&args.dir)?;
    let options = Options {
        threads: global.threads,
        pipeline: "bench items".to_owned(),
        ..Options::default()
    };
    let record = marf_engine::run(&graph, &store, &options, &SilentListener, cancel)?;
    for node in &record.nodes {
        let line =
            json!({"node": node.name, "state": node.state, "counts": node.counts, "seconds": node.seconds});
        print_line(&line.to_string());
    }
    match record.outcome {
        Outcome::Done => Ok(()),
        Outcome::Cancelled => Err(Error::Interrupted),
        Outcome::Failed => Err(Error::Failed(Diagnostic::new("a node failed"))),
    }
}

/// Returns the graph: the source and two filters that read facts alone.
fn graph(sols: u32, a_sol: u64) -> Result<Graph, Error> {
    let mut table: Vec<StageDef> = marf_stages::stages().to_vec();
    table.push(define::<SyntheticItems>());
    let mut decls = Vec::new();
    let nodes = [
        ("synthetic", json!({"sols": sols, "a_sol": a_sol}), None),
        ("size", json!({}), Some("synthetic")),
        ("shape", json!({}), Some("size")),
    ];
    for (name, params, upstream) in nodes {
        let def = table.iter().find(|def| def.name == name).copied();
        let stage = def.ok_or_else(|| Error::failed(format!("there is no stage `{name}`")))?;
        let bound = (stage.bind)(params).map_err(|error| Error::failed(error.to_string()))?;
        let edge = upstream.map(|upstream| Edge::new("input", upstream));
        decls.push(NodeDecl {
            name: name.to_owned(),
            stage,
            bound,
            edges: edge.into_iter().collect(),
        });
    }
    Ok(Graph::new(decls, &table)?)
}
