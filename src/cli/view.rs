//! `marf view`: the report, the progress of a running program and a 3-D view, served on one port.

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;
use std::sync::Arc;

use clap::Args;
use marf_cache::{Digest, Store};
use marf_engine::{Cancel, NodeRun, RunRecord, document, run_of};
use marf_field::Device;
use marf_schema::bootstrap::Metrics;
use marf_schema::output::{SCENE, WEIGHTS};
use marf_stage::Document;
use marf_view::{DepthInterval, FieldSource, Options, RunContent, Server, Source, ViewError};
use parking_lot::Mutex;

use super::args::Global;
use super::error::{CliError, Diagnostic};
use super::scenes;
use super::session::{bootstraps_of, existing_store, is_aside};
use marf_progress::event_folder;
use marf_report as show;
use crate::terminal::{eprint_line, print_line};

/// Arguments of `view`.
#[derive(Debug, Clone, Args)]
#[command(after_help = AFTER_HELP)]
pub struct ViewArgs {
    /// Number of the run [default: the last one with a report or a field, anew at each load]
    #[arg(long, value_name = "NUMBER")]
    pub run: Option<u64>,
    /// Port; 0 takes a free one
    #[arg(long, value_name = "PORT", default_value_t = 8460)]
    pub port: u16,
    /// Name or address to listen on; what is no loopback address needs a token
    #[arg(long, value_name = "HOST", default_value = "127.0.0.1")]
    pub host: String,
    /// Token that a browser has to bring: 16 letters and digits or more; the address that is printed holds it
    #[arg(long, value_name = "TOKEN")]
    pub token: Option<String>,
    /// Path below which everything is served, for a proxy that forwards it, e.g. `/mars`
    #[arg(long, value_name = "PATH")]
    pub prefix: Option<String>,
}

const AFTER_HELP: &str = "\
Nothing is fetched from anywhere, and nothing in the store is changed. From another machine: `ssh -L 8460:127.0.0.1:8460 HOST`, \
then open http://127.0.0.1:8460/ there. The 3-D view is rendered here, on the CPU unless --device names a GPU.";

/// `marf view`: serves until Ctrl-C.
pub fn view(global: &Global, args: &ViewArgs, cancel: &Cancel) -> Result<(), CliError> {
    let source = StoreSource {
        store: existing_store(global, cancel)?,
        run: args.run,
        newest: Mutex::default(),
    };
    let options = Options {
        host: args.host.clone(),
        port: args.port,
        token: args.token.clone(),
        prefix: args.prefix.clone().unwrap_or_default(),
        threads: global.threads,
        device: global.device.clone().unwrap_or(Device::Cpu),
    };
    let server = Server::bind(options, Arc::new(source))?;
    print_line(&server.address());
    eprint_line("Ctrl-C stops it");
    Ok(server.serve(|| cancel.is_set())?)
}

/// The store as the page reads it.
struct StoreSource {
    store: Store,
    /// The run that the user named.
    run: Option<u64>,
    /// The last run of the store when it was last looked for, and the run to show then.
    newest: Mutex<(Option<u64>, Option<u64>)>,
}

impl StoreSource {
    /// Returns the run to show; none if no run has kept a report or a field.
    fn record(&self) -> Result<Option<RunRecord>, String> {
        let read = |number: u64| run_of(&self.store, number).map_err(|error| error.to_string());
        if let Some(number) = self.run {
            return read(number).map(Some);
        }
        let numbers = self.store.run_numbers().map_err(|error| error.to_string())?;
        // A run that cannot be read is passed over here: `marf log` names it.
        let mut runs = numbers.into_iter().rev().filter_map(|number| read(number).ok());
        let has_much = |run: &RunRecord| self.report(run).is_some() || trained(run).next().is_some();
        Ok(runs.find(|run| !is_aside(run) && has_much(run)))
    }

    /// Returns the last run of the same pipeline before a run that has a field.
    fn trained_before(&self, run: &RunRecord) -> Option<RunRecord> {
        let numbers = self.store.run_numbers().ok()?.into_iter().rev();
        let earlier = numbers.filter(|number| *number < run.number);
        let mut runs = earlier.filter_map(|number| run_of(&self.store, number).ok());
        runs.find(|before| before.pipeline == run.pipeline && trained(before).next().is_some())
    }

    /// Returns the digest of the report that a run has kept.
    fn report(&self, run: &RunRecord) -> Option<Digest> {
        let digest = run.documents.get(document::REPORT)?.digest;
        self.store.contains(&digest).then_some(digest)
    }

    /// Returns the numbers of runs after the shown one that have kept no report.
    fn later_without(&self, shown: u64) -> Vec<u64> {
        let numbers = self.store.run_numbers().unwrap_or_default();
        let runs = numbers.into_iter().filter(|number| *number > shown);
        let own = |number: &u64| run_of(&self.store, *number).is_ok_and(|run| !is_aside(&run));
        runs.filter(own).collect()
    }

    /// Returns a run as it is shown.
    fn shown(&self, run: &RunRecord) -> Result<RunContent, String> {
        let report = match self.report(run) {
            Some(kept) => text(&self.store.get(&kept).map_err(|error| error.to_string())?)?,
            None => show::sentence_page(&without_report(run)),
        };
        let (mut objects, mut fields) = (objects(run), self.fields(run));
        if fields.is_empty()
            && let Some(earlier) = self.trained_before(run)
        {
            objects.extend(self::objects(&earlier));
            fields = self.fields(&earlier);
            for field in &mut fields {
                field.node = format!("{} of run {}", field.node, earlier.number);
            }
        }
        Ok(RunContent {
            number: Some(run.number),
            report,
            pages: scenes::pages(run),
            objects,
            fields,
        })
    }

    /// Returns the trained fields of a run with the retrainings of each.
    fn fields(&self, run: &RunRecord) -> Vec<FieldSource> {
        trained(run)
            .filter_map(|node| {
                Some(FieldSource {
                    node: node.name.clone(),
                    weights: node.outputs.get(WEIGHTS)?.digest,
                    scene: node.outputs.get(SCENE)?.digest,
                    members: members(run, node),
                    depth_interval: self.depth_interval(run, node),
                })
            })
            .collect()
    }

    /// Returns what the bootstrap of a training tells of its depths; none where it tells nothing or its metrics are lost.
    fn depth_interval(&self, run: &RunRecord, trained: &NodeRun) -> Option<DepthInterval> {
        let metrics = bootstraps_of(run, &trained.name).find_map(|node| {
            let bytes = self.store.get(&node.outputs.get(Metrics::OUTPUT)?.digest).ok()?;
            Metrics::decode(&bytes).ok()
        });
        let calibration = metrics?.heldout?.depth_calibration?;
        Some(DepthInterval {
            floor: calibration.floor,
            factor: calibration.factor90,
        })
    }
}

impl Source for StoreSource {
    fn newest(&self) -> Option<u64> {
        // Asked several times a second: the runs are read only where there is another one.
        let last = self.store.run_numbers().ok()?.into_iter().next_back();
        let mut newest = self.newest.lock();
        if newest.0 != last {
            *newest = (last, self.record().ok().flatten().map(|run| run.number));
        }
        newest.1
    }

    fn content(&self) -> Result<RunContent, String> {
        let Some(run) = self.record()? else {
            let sentence =
                "No run of this store has ended with a report or a field yet. What runs now is shown here.";
            return Ok(RunContent {
                number: None,
                report: show::sentence_page(sentence),
                pages: BTreeMap::new(),
                objects: BTreeSet::new(),
                fields: Vec::new(),
            });
        };
        if self.run.is_none() {
            let later = self.later_without(run.number);
            if !later.is_empty() {
                eprint_line(&format!(
                    "run {} is shown: {later:?} after it kept no report",
                    run.number
                ));
            }
        }
        self.shown(&run)
    }

    fn content_of(&self, run: u64) -> Result<RunContent, String> {
        if self.run.is_some_and(|named| named != run) {
            return Err(format!(
                "this page is of run {run}, and another is shown now: load it again"
            ));
        }
        let run = run_of(&self.store, run).map_err(|error| error.to_string())?;
        self.shown(&run)
    }

    fn object(&self, digest: &Digest) -> Option<Arc<[u8]>> {
        self.store.get(digest).ok()
    }

    fn event_folder(&self) -> PathBuf {
        event_folder(&self.store)
    }
}

fn text(bytes: &[u8]) -> Result<String, String> {
    String::from_utf8(bytes.to_vec()).map_err(|error| format!("the report is no text: {error}"))
}

/// Returns the sentence in place of a report: of `marf fit`, `marf calibrate` and runs that were stopped.
fn without_report(run: &RunRecord) -> String {
    format!("Run {} (`{}`) has kept no report.", run.number, run.command)
}

/// Returns what a run names: outputs of its nodes, and documents.
fn objects(run: &RunRecord) -> BTreeSet<Digest> {
    let outputs = run.nodes.iter().flat_map(|node| node.outputs.values());
    outputs
        .chain(run.documents.values())
        .map(|output| output.digest)
        .collect()
}

/// Returns the nodes of a run that have trained a field.
fn trained(run: &RunRecord) -> impl Iterator<Item = &NodeRun> {
    let whole = run.nodes.iter().filter(|node| node.parent.is_none());
    whole.filter(|node| {
        [WEIGHTS, SCENE]
            .iter()
            .all(|output| node.outputs.contains_key(*output))
    })
}

/// Returns the fields that the bootstraps of a training have trained.
fn members(run: &RunRecord, trained: &NodeRun) -> Vec<Digest> {
    let parents: Vec<&str> = bootstraps_of(run, &trained.name)
        .map(|node| node.name.as_str())
        .collect();
    let of_it = |node: &&NodeRun| {
        node.parent
            .as_deref()
            .is_some_and(|parent| parents.contains(&parent))
    };
    let weights = run
        .nodes
        .iter()
        .filter(of_it)
        .filter_map(|node| node.outputs.get(WEIGHTS));
    weights.map(|weights| weights.digest).collect()
}

impl From<ViewError> for CliError {
    fn from(error: ViewError) -> Self {
        let diagnostic = Diagnostic {
            message: error.to_string(),
            cause: None,
            hint: error.hint().map(str::to_owned),
        };
        match error {
            ViewError::Access(_) | ViewError::Prefix(_) => Self::Usage(diagnostic),
            _ => Self::Failed(diagnostic),
        }
    }
}
