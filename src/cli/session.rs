//! A pipeline, its graph and its store: what most verbs begin with.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use marf_cache::manifest::ManifestError;
use marf_cache::{Digest, Store, StoreError};
use marf_engine::{Cancel, EngineError, Graph, GraphError, Listings, NodeDecl, NodeRun, Outcome, RunRecord};
use marf_provenance::LineageError;
use marf_schema::bootstrap;
use marf_schema::scenes::Scenes;
use marf_stage::{Document, Verdict};

use super::args::Global;
use super::error::{CliError, Diagnostic};
use marf_config::scenes::ByScene;
use marf_config::{self as config, Pipeline, SharedStore};
use crate::terminal::eprint_line;

/// What the name of a pipeline is followed by in runs of exports: they are no runs of the pipeline.
pub const EXPORTS: &str = " (export)";

/// What the name of a pipeline is followed by in runs of `marf trade`.
pub const TRADES: &str = " (trade)";

/// What the name of a pipeline is followed by in runs that only tell which scenes there are.
pub const SCENES: &str = " (scenes)";

/// Tells whether a run is no run of the pipeline as it is: it made a file for another program, a point of a trade, or told the scenes.
pub fn is_aside(run: &RunRecord) -> bool {
    is_aside_name(&run.pipeline)
}

/// As [`is_aside`], of the name of a run's pipeline.
pub fn is_aside_name(pipeline: &str) -> bool {
    [EXPORTS, TRADES, SCENES]
        .iter()
        .any(|aside| pipeline.ends_with(aside))
}

/// Returns the last run of a pipeline among runs, oldest first.
pub fn last_of(runs: &[RunRecord]) -> Option<&RunRecord> {
    runs.iter().rev().find(|run| !is_aside(run))
}

/// A pipeline ready to plan and run.
pub struct Session {
    /// Name of the pipeline.
    pub name: String,
    /// The graph of its nodes.
    pub graph: Graph,
    /// Where results are.
    pub store: Store,
    /// Nodes as the report shows them: name, one line about the stage, parameters.
    pub nodes: Vec<NodeInfo>,
    /// The pipeline as written.
    pub written: String,
    /// The pipeline with all overrides applied, as JSON.
    pub tree: serde_json::Value,
    /// The nodes that are to run for each scene; none where nothing is split by place, or they do so already.
    pub by_scene: Option<ByScene>,
    /// Names of the scenes that nodes run for.
    pub scenes: Vec<String>,
    /// What its archives have told.
    listings: Listings,
    /// The store that results are shared through.
    pub shared: Option<SharedStore>,
    /// Whether the user wants to stop.
    cancel: Cancel,
}

/// What a report shows of a node beside its run.
#[derive(Debug, Clone, PartialEq)]
pub struct NodeInfo {
    /// Its name.
    pub name: String,
    /// One line about its stage.
    pub about: &'static str,
    /// Of a filter: what in its table keeps photos that it rejects.
    pub relax: Option<&'static str>,
    /// Its parameters as given.
    pub params: serde_json::Value,
}

impl Session {
    /// Loads the pipeline that the global arguments name.
    ///
    /// # Errors
    /// A bad pipeline, or a store that cannot be opened.
    pub fn open(global: &Global, cancel: &Cancel) -> Result<Self, CliError> {
        let loaded = config::load(&global.file, &global.sets, &global.options())?;
        let unnamed = || unnamed(&global.file);
        let store = open_store(&store_dir(global, &global.file), cancel)?;
        Self::of(
            (loaded.pipeline, loaded.text),
            unnamed,
            store,
            Listings::default(),
            cancel,
        )
    }

    /// Loads the text of a pipeline that a verb has built for one folder.
    ///
    /// # Errors
    /// As [`Session::open`].
    pub fn implicit(text: &str, global: &Global, cancel: &Cancel) -> Result<Self, CliError> {
        let pipeline =
            config::check(text, &global.sets, &global.options(), Path::new("")).map_err(|error| {
                CliError::Usage(Diagnostic {
                    message: error.render(Path::new("(built-in pipeline)"), text),
                    cause: None,
                    hint: error.hint,
                })
            })?;
        let store = open_store(&store_dir(global, Path::new("")), cancel)?;
        Self::of(
            (pipeline, text.to_owned()),
            || "built-in".to_owned(),
            store,
            Listings::default(),
            cancel,
        )
    }

    /// Takes a pipeline that an earlier run had, changed or not, under a name, with the store of that run.
    ///
    /// # Errors
    /// Nodes that form no graph.
    pub fn again(
        pipeline: Pipeline,
        written: String,
        name: String,
        store: Store,
        cancel: &Cancel,
    ) -> Result<Self, CliError> {
        let mut session = Self::of(
            (pipeline, written),
            String::new,
            store,
            Listings::default(),
            cancel,
        )?;
        session.name = name;
        Ok(session)
    }

    fn of(
        (pipeline, written): (Pipeline, String),
        unnamed: impl FnOnce() -> String,
        store: Store,
        listings: Listings,
        cancel: &Cancel,
    ) -> Result<Self, CliError> {
        let info = |node: &config::Node| NodeInfo {
            name: node.name.clone(),
            about: node.def.about,
            relax: node.def.relax,
            params: node.params.clone(),
        };
        let nodes = pipeline.nodes.iter().map(info).collect();
        let by_scene = ByScene::of(&pipeline);
        let graph = graph_of(pipeline.nodes)?.sharing(&listings);
        Ok(Self {
            name: pipeline.name.unwrap_or_else(unnamed),
            graph,
            store,
            nodes,
            written,
            tree: pipeline.tree,
            shared: pipeline.shared,
            by_scene,
            scenes: Vec::new(),
            listings,
            cancel: cancel.clone(),
        })
    }

    /// Returns the session with its nodes for each of these scenes; as it is where nothing is split by place.
    ///
    /// # Errors
    /// A file that was changed meanwhile.
    pub fn for_scenes(self, scenes: &Scenes, global: &Global) -> Result<Self, CliError> {
        let Some(by_scene) = &self.by_scene else {
            return Ok(self);
        };
        let names: Vec<String> = scenes.scenes.iter().map(|scene| scene.name.clone()).collect();
        let loaded = config::load(&global.file, &global.sets, &global.options())?;
        let tree = by_scene.expanded(&loaded.pipeline, &names);
        let base = global.file.parent().unwrap_or(Path::new(""));
        let pipeline = config::check_tree(&tree, &global.options(), base)
            .map_err(|error| CliError::usage(format!("the pipeline by scene: {}", error.message)))?;
        let (store, listings, cancel) = (self.store, self.listings, self.cancel);
        Ok(Self {
            name: self.name,
            scenes: names,
            by_scene: self.by_scene,
            ..Self::of((pipeline, self.written), String::new, store, listings, &cancel)?
        })
    }

    /// Returns the session with its nodes for each scene that a run has found, if it has.
    ///
    /// # Errors
    /// As [`Session::for_scenes`]; a store that cannot be read.
    pub fn for_scenes_of(self, run: Option<&RunRecord>, global: &Global) -> Result<Self, CliError> {
        let split = self.by_scene.as_ref().map(|by_scene| by_scene.split.as_str());
        let node = split.and_then(|split| run?.node(split));
        match node.filter(|node| node.outputs.contains_key(Scenes::OUTPUT)) {
            None => Ok(self),
            Some(node) => {
                let scenes: Scenes = self.document(node)?;
                self.for_scenes(&scenes, global)
            }
        }
    }

    /// Returns an error if the user wants to stop.
    ///
    /// # Errors
    /// [`CliError::Interrupted`].
    pub fn check(&self) -> Result<(), CliError> {
        match self.cancel.is_set() {
            true => Err(CliError::Interrupted),
            false => Ok(()),
        }
    }

    /// Reads a document that a node has written.
    ///
    /// # Errors
    /// An output that the node or the store does not have, or that is no such document.
    pub fn document<D: Document>(&self, node: &NodeRun) -> Result<D, CliError> {
        let bytes = self.output(node, D::OUTPUT)?;
        D::decode(&bytes)
            .map_err(|error| CliError::failed(format!("{} of `{}`: {error}", D::OUTPUT, node.name)))
    }

    /// Reads an output of a node.
    ///
    /// # Errors
    /// An output that the node or the store does not have.
    pub fn output(&self, node: &NodeRun, name: &str) -> Result<Arc<[u8]>, CliError> {
        Ok(self.store.get(&digest(node, name)?)?)
    }

    /// Reads the verdicts of a node, by shard and id.
    ///
    /// # Errors
    /// Verdicts that the store has lost, or bytes that are none.
    pub fn verdicts(&self, root: &Digest) -> Result<Vec<Verdict>, CliError> {
        marf_engine::sets::verdicts(root, |digest| Ok(self.store.get(digest)?))
    }

    /// Returns the last run of this pipeline.
    ///
    /// # Errors
    /// A store that cannot be read.
    pub fn last(&self) -> Result<Option<RunRecord>, CliError> {
        Ok(marf_engine::last_run(&self.store, &self.name, warn)?)
    }

    /// Returns the last run of this pipeline that came before a run, which need not be stored yet, was done and has other keys.
    ///
    /// # Errors
    /// A store that cannot be read.
    pub fn before(&self, record: &RunRecord) -> Result<Option<RunRecord>, CliError> {
        self.earlier(record, |run| {
            run.outcome == Outcome::Done && !run.has_keys_of(record)
        })
    }

    /// Returns the last wanted run of this pipeline that came before a run, which need not be stored yet.
    ///
    /// # Errors
    /// A store that cannot be read.
    pub fn earlier(
        &self,
        record: &RunRecord,
        wanted: impl Fn(&RunRecord) -> bool,
    ) -> Result<Option<RunRecord>, CliError> {
        let is_earlier = |run: &RunRecord| record.number == 0 || run.number < record.number;
        let wanted = |run: &RunRecord| is_earlier(run) && wanted(run);
        Ok(marf_engine::last_run_where(
            &self.store,
            &self.name,
            warn,
            wanted,
        )?)
    }

    /// Tells whether a run has made every node of this pipeline, or found it made.
    pub fn is_whole(&self, run: &RunRecord) -> bool {
        let has = |info: &NodeInfo| run.node(&info.name).is_some_and(|node| node.state.is_good());
        self.nodes.iter().all(has)
    }
}

/// Returns the graph of the nodes of a pipeline.
///
/// # Errors
/// Nodes that form no graph.
pub fn graph_of(nodes: Vec<config::Node>) -> Result<Graph, CliError> {
    let decls = nodes.into_iter().map(|node| NodeDecl {
        name: node.name,
        stage: node.def,
        bound: node.stage,
        edges: node.edges,
    });
    Ok(Graph::new(decls.collect(), marf_stages::stages())?)
}

/// Returns the name of a pipeline that has none: that of its file, with eight digits that tell it from files of the same name
/// in other folders. Two pipelines that share a store are then never compared with each other.
pub fn unnamed(file: &Path) -> String {
    let whole = std::path::absolute(file).unwrap_or_else(|_| file.to_owned());
    let digits = &Digest::of(whole.as_os_str().as_encoded_bytes()).to_string()[..8];
    let stem = file.file_stem().unwrap_or_default().to_string_lossy();
    format!("{stem}-{digits}")
}

/// Prints a warning.
pub fn warn(message: String) {
    eprint_line(&format!("warning: {message}"));
}

/// Returns the node of this name.
///
/// # Errors
/// A run without that node.
pub fn node_named<'r>(record: &'r RunRecord, name: &str) -> Result<&'r NodeRun, CliError> {
    let node = record.nodes.iter().find(|node| node.name == name);
    node.ok_or_else(|| CliError::failed(format!("the run has no node `{name}`")))
}

/// Returns the bootstraps of a run that retrain the field of a node.
pub fn bootstraps_of<'r>(run: &'r RunRecord, trained: &str) -> impl Iterator<Item = &'r NodeRun> {
    let retrains = move |node: &&NodeRun| {
        let reads = node.edges.iter().any(|edge| edge.upstream == trained);
        reads && node.stage == bootstrap::Metrics::STAGE
    };
    run.nodes.iter().filter(retrains)
}

/// Returns the digest of an output of a node.
///
/// # Errors
/// Names the output that the node does not have.
pub fn digest(node: &NodeRun, name: &str) -> Result<Digest, CliError> {
    let output = node.outputs.get(name);
    let output = output.ok_or_else(|| CliError::failed(format!("`{}` has no output `{name}`", node.name)))?;
    Ok(output.digest)
}

/// Opens a store, making it if need be; its waits for other programs end with the wish to stop.
///
/// # Errors
/// A place that cannot be written, or a store that another process holds.
pub fn open_store(dir: &Path, cancel: &Cancel) -> Result<Store, CliError> {
    let stop = cancel.clone();
    Ok(Store::open_interruptible(dir, move || stop.is_set())?)
}

/// Opens a store that must be there already: reading verbs make none.
///
/// # Errors
/// Names the place where no store is.
pub fn existing_store(global: &Global, cancel: &Cancel) -> Result<Store, CliError> {
    let dir = store_dir(global, &global.file);
    if !dir.is_dir() {
        let diagnostic = Diagnostic::new(format!("there is no store at {}", dir.display()));
        return Err(CliError::Failed(
            diagnostic.hint("`marf run` makes one; name another with --store"),
        ));
    }
    open_store(&dir, cancel)
}

/// `--store`, or `.marf` beside the pipeline.
pub fn store_dir(global: &Global, file: &Path) -> PathBuf {
    let beside = || {
        file.parent()
            .map(Path::to_path_buf)
            .unwrap_or_default()
            .join(".marf")
    };
    global.store.clone().unwrap_or_else(beside)
}

impl From<StoreError> for CliError {
    fn from(error: StoreError) -> Self {
        super::cache::open_error(error)
    }
}

impl From<ManifestError> for CliError {
    fn from(error: ManifestError) -> Self {
        Self::failed(error.to_string())
    }
}

impl From<EngineError> for CliError {
    fn from(error: EngineError) -> Self {
        match error {
            EngineError::Store(error) => error.into(),
            EngineError::UnknownNode { .. } => Self::usage(error.to_string()),
            EngineError::BadRun { .. } | EngineError::BadSet(_) | EngineError::Threads { .. } => {
                Self::failed(error.to_string())
            }
        }
    }
}

impl From<LineageError> for CliError {
    fn from(error: LineageError) -> Self {
        match error {
            LineageError::Store(error) => error.into(),
            LineageError::Run(error) => error.into(),
            error => Self::failed(error.to_string()),
        }
    }
}

impl From<GraphError> for CliError {
    fn from(error: GraphError) -> Self {
        Self::usage(error.to_string())
    }
}
