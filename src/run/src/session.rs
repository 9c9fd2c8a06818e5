//! A pipeline, its graph and its store: what most verbs begin with.

use std::path::Path;
use std::sync::Arc;

use marf_cache::{Digest, RunMetadata, Store};
use marf_config::scenes::ByScene;
use marf_config::{self as config, PipelineDocument, SharedStore};
use marf_engine::{
    Graph, Listings, NodeDecl, NodeRun, Purpose, RunRecord, RunSource, forget_folders,
    without_archive_folders,
};
use marf_model::select::Subject;
use marf_scene::Scene;
use marf_schema::bootstrap;
use marf_schema::output::SCENE;
use marf_schema::scenes::Scenes;
use marf_stage::{Document, Verdict};

use crate::context::{Context, open_store};
use crate::error::{Diagnostic, Error};

/// A pipeline ready to plan and run.
pub struct Session {
    /// Name of the pipeline.
    pub name: String,
    /// What its runs are runs of.
    pub source: RunSource,
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
    /// The nodes to run for each scene. None if nothing is split by place, or the nodes are expanded already.
    pub by_scene: Option<ByScene>,
    /// Names of the scenes that nodes run for.
    pub scenes: Vec<String>,
    /// The pipeline of a verb, which is in no file.
    built_in: Option<String>,
    /// The listings of its archives.
    listings: Listings,
    /// The store that results are shared through.
    pub shared: Option<SharedStore>,
    /// The context of the request.
    pub context: Context,
}

/// The description of a node in a report, in addition to its run.
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
    /// Loads the pipeline of a context.
    ///
    /// # Errors
    /// A bad pipeline, or a store that cannot be opened.
    pub fn open(context: &Context) -> Result<Self, Error> {
        let loaded = config::load(&context.file, &context.sets, &context.config)?;
        let name = loaded.pipeline.name.clone();
        let name = name.unwrap_or_else(|| unnamed(&context.file));
        let store = context.open_store()?;
        let source = RunSource::from_file(&store, &context.file);
        Self::new(context, loaded, name, source, store)
    }

    /// Loads the text of a pipeline that a verb has built for one folder.
    ///
    /// # Errors
    /// As [`Session::open`].
    pub fn implicit(context: &Context, text: &str, verb: &str, folder: &Path) -> Result<Self, Error> {
        let pipeline = built_in(context, text)?;
        let store = open_store(&context.store_dir(Path::new("")), &context.cancel)?;
        let name = pipeline.name.clone().unwrap_or_else(|| "built-in".to_owned());
        let source = RunSource::from_folder(&store, verb, folder);
        let text = text.to_owned();
        let document = PipelineDocument {
            pipeline,
            text: text.clone(),
        };
        let session = Self::new(context, document, name, source, store)?;
        Ok(Self {
            built_in: Some(text),
            ..session
        })
    }

    /// Takes a pipeline and its store. `source` is what its runs are runs of.
    ///
    /// # Errors
    /// Nodes that form no graph.
    pub fn new(
        context: &Context,
        document: PipelineDocument,
        name: String,
        source: RunSource,
        store: Store,
    ) -> Result<Self, Error> {
        let PipelineDocument { pipeline, text } = document;
        let listings = Listings::default();
        let mut tree = pipeline.tree.clone();
        let written = without_archive_folders(&text, &tree["archive"], &context.file);
        if let Some(archives) = tree.get_mut("archive") {
            forget_folders(archives, &context.file);
        }
        let info = |node: &config::Node| {
            let mut params = node.params.clone();
            if let Some(archive) = params.get_mut("archive") {
                forget_folders(archive, &context.file);
            }
            NodeInfo {
                name: node.name.clone(),
                about: node.def.about,
                relax: node.def.relax,
                params,
            }
        };
        let nodes = pipeline.nodes.iter().map(info).collect();
        let by_scene = ByScene::from_pipeline(&pipeline);
        let graph = graph_of(pipeline.nodes)?.sharing(&listings);
        Ok(Self {
            name,
            source,
            graph,
            store,
            nodes,
            written,
            tree,
            shared: pipeline.shared,
            by_scene,
            scenes: Vec::new(),
            built_in: None,
            listings,
            context: context.clone(),
        })
    }

    /// Returns the session with its nodes for each of these scenes. It is unchanged if nothing is split by place.
    ///
    /// # Errors
    /// A file that was changed meanwhile.
    pub fn for_scenes(self, scenes: &Scenes) -> Result<Self, Error> {
        let Some(by_scene) = &self.by_scene else {
            return Ok(self);
        };
        let names: Vec<String> = scenes.scenes.iter().map(|scene| scene.name.clone()).collect();
        let context = &self.context;
        let (pipeline, folder) = match &self.built_in {
            Some(text) => (built_in(context, text)?, Path::new("")),
            None => {
                let loaded = config::load(&context.file, &context.sets, &context.config)?;
                (loaded.pipeline, context.folder())
            }
        };
        let tree = by_scene.expanded(&pipeline, &names);
        let pipeline = config::check_tree(&tree, &context.config, folder)
            .map_err(|error| Error::usage(format!("the pipeline by scene: {}", error.message)))?;
        let text = self.written;
        let document = PipelineDocument { pipeline, text };
        let session = Self::new(context, document, self.name, self.source, self.store)?;
        Ok(Self {
            graph: session.graph.sharing(&self.listings),
            listings: self.listings,
            scenes: names,
            by_scene: self.by_scene,
            ..session
        })
    }

    /// Returns the session with its nodes for each scene that a run has found, if any.
    ///
    /// # Errors
    /// As [`Session::for_scenes`], or a store that cannot be read.
    pub fn for_scenes_of(self, run: Option<&RunRecord>) -> Result<Self, Error> {
        let split = self.by_scene.as_ref().map(|by_scene| by_scene.split.as_str());
        let node = split.and_then(|split| run?.node(split));
        match node.filter(|node| node.outputs.contains_key(Scenes::OUTPUT)) {
            None => Ok(self),
            Some(node) => {
                let scenes: Scenes = self.document(node)?;
                self.for_scenes(&scenes)
            }
        }
    }

    /// Returns an error if the user wants to stop.
    ///
    /// # Errors
    /// [`Error::Interrupted`].
    pub fn check(&self) -> Result<(), Error> {
        if self.context.cancel.is_set() {
            return Err(Error::Interrupted);
        }
        Ok(())
    }

    /// Reads a document that a node has written.
    ///
    /// # Errors
    /// An output that the node or the store does not have, or that cannot be decoded.
    pub fn document<D: Document>(&self, node: &NodeRun) -> Result<D, Error> {
        let bytes = self.output(node, D::OUTPUT)?;
        D::decode(&bytes).map_err(|error| Error::failed(format!("{} of `{}`: {error}", D::OUTPUT, node.name)))
    }

    /// Reads an output of a node.
    ///
    /// # Errors
    /// An output that the node or the store does not have.
    pub fn output(&self, node: &NodeRun, name: &str) -> Result<Arc<[u8]>, Error> {
        Ok(self.store.get(&digest(node, name)?)?)
    }

    /// Returns the metadata of the run that made a node's result. None if the store has lost it.
    pub fn metadata(&self, node: &NodeRun) -> Option<RunMetadata> {
        let record = self.store.record(&node.key?).ok().flatten();
        record.map(|record| record.metadata)
    }

    /// Reads the verdicts of a node, by shard and id.
    ///
    /// # Errors
    /// Verdicts that the store has lost, or bytes that are none.
    pub fn verdicts(&self, root: &Digest) -> Result<Vec<Verdict>, Error> {
        marf_engine::sets::verdicts(root, |digest| Ok(self.store.get(digest)?))
    }

    /// Returns the subject of the runs of this pipeline.
    pub fn subject(&self) -> Subject {
        Subject::Pipeline {
            source: self.source.clone(),
            name: Some(self.name.clone()),
        }
    }

    /// Returns the last run of this pipeline.
    ///
    /// # Errors
    /// A store that cannot be read.
    pub fn last(&self) -> Result<Option<RunRecord>, Error> {
        Ok(marf_engine::last_run(
            &self.store,
            &self.name,
            &self.source,
            self.context.warnings(),
        )?)
    }

    /// Returns the source of runs that are made from the last run of this pipeline.
    ///
    /// # Errors
    /// A store that cannot be read.
    pub fn derived_source(&self, purpose: Purpose) -> Result<RunSource, Error> {
        let from = self.last()?.and_then(|run| run.root);
        Ok(RunSource::Derived { from, purpose })
    }
}

/// Returns the pipeline that a verb has built.
fn built_in(context: &Context, text: &str) -> Result<config::Pipeline, Error> {
    config::check(text, &context.sets, &context.config, Path::new("")).map_err(|error| {
        let message = error.render(Path::new("(built-in pipeline)"), text);
        Error::Usage(Diagnostic::with_hint(message, error.hint))
    })
}

/// Returns the graph of the nodes of a pipeline.
///
/// # Errors
/// Nodes that form no graph.
pub fn graph_of(nodes: Vec<config::Node>) -> Result<Graph, Error> {
    let decls = nodes.into_iter().map(|node| NodeDecl {
        name: node.name,
        stage: node.def,
        bound: node.stage,
        edges: node.edges,
    });
    Ok(Graph::new(decls.collect(), marf_stages::stages())?)
}

/// Returns the name of a pipeline without a name: that of its file, with eight digits that distinguish it from files of the same name in
/// other folders. Two pipelines that share a store are then never compared with each other.
pub fn unnamed(file: &Path) -> String {
    let whole = std::path::absolute(file).unwrap_or_else(|_| file.to_owned());
    let digits = &Digest::from_content(whole.as_os_str().as_encoded_bytes()).to_string()[..8];
    let stem = file.file_stem().unwrap_or_default().to_string_lossy();
    format!("{stem}-{digits}")
}

/// Returns the node of this name.
///
/// # Errors
/// A run without that node.
pub fn node_named<'r>(record: &'r RunRecord, name: &str) -> Result<&'r NodeRun, Error> {
    let node = record.nodes.iter().find(|node| node.name == name);
    node.ok_or_else(|| Error::failed(format!("the run has no node `{name}`")))
}

/// Returns the bootstraps of a run that retrain the field of a node.
pub fn bootstraps_of<'r>(run: &'r RunRecord, trained: &str) -> impl Iterator<Item = &'r NodeRun> {
    let retrains = move |node: &&NodeRun| {
        let reads = node.edges.iter().any(|edge| edge.upstream == trained);
        reads && node.stage == bootstrap::Metrics::STAGE
    };
    run.nodes.iter().filter(retrains)
}

/// Reads the scene of a node.
///
/// # Errors
/// An output that the node or the store does not have, or that is not a scene.
pub fn read_scene(store: &Store, node: &NodeRun) -> Result<Scene, Error> {
    let scene = Scene::decode(&store.get(&digest(node, SCENE)?)?);
    scene.map_err(|error| Error::failed(format!("{SCENE} of `{}`: {error}", node.name)))
}

/// Returns the digest of an output of a node.
///
/// # Errors
/// Names the output that the node does not have.
pub fn digest(node: &NodeRun, name: &str) -> Result<Digest, Error> {
    let output = node.outputs.get(name);
    let output = output.ok_or_else(|| Error::failed(format!("`{}` has no output `{name}`", node.name)))?;
    Ok(output.digest)
}
