//! The pipeline whose time is traded for quality.

use std::cell::RefCell;
use std::path::{Path, PathBuf};

use marf_engine::Purpose;
use marf_report::trade::Point;
use marf_schema::calibrate::CalibrateParams;
use marf_schema::train::{Metrics, TrainParams};
use marf_stage::Params;
use serde_json::Value;

use crate::context::Context;
use crate::error::{Diagnostic, Error};
use crate::folder::PhotoFolder;
use crate::scenes;
use crate::session::Session;

/// The unchanged pipeline that all points share.
pub struct Base {
    /// The context of the request.
    context: Context,
    /// The folder that is traded instead of the pipeline.
    dir: Option<PathBuf>,
    /// Settings in addition to those of the command line.
    pub sets: Vec<String>,
    /// Name of the training.
    pub train: String,
    /// Name of the calibration, if there is one.
    pub calibrate: Option<String>,
    /// Metrics of the first training.
    pub first: RefCell<Option<Metrics>>,
}

impl Base {
    /// Finds the nodes whose time and quality are traded, with settings besides those of the context.
    ///
    /// # Errors
    /// A pipeline without a training, or of many scenes.
    pub fn new(context: &Context, dir: Option<PathBuf>, sets: Vec<String>) -> Result<Self, Error> {
        let session = open(context, dir.as_deref(), &sets)?;
        scenes::one(&session)?;
        Ok(Self {
            train: training(&session)?,
            calibrate: node_of::<CalibrateParams>(&session),
            context: context.clone(),
            dir,
            sets,
            first: RefCell::default(),
        })
    }

    /// Opens the pipeline with settings besides those of the command line.
    ///
    /// # Errors
    /// Settings that the pipeline does not have.
    pub fn open(&self, sets: &[String]) -> Result<Session, Error> {
        open(&self.context, self.dir.as_deref(), sets)
    }

    /// Returns the metrics of the pipeline as it is.
    ///
    /// # Errors
    /// None was trained yet.
    pub fn metrics(&self) -> Result<Metrics, Error> {
        let first = self.first.borrow().clone();
        first.ok_or_else(|| Error::failed("the pipeline as it is was not trained"))
    }

    /// Returns the settings that judge a point at the photo size of the unchanged pipeline, if the point may change the size.
    pub fn judged_as_first(&self, point: &Point) -> Vec<String> {
        let sizes = ["scale", "quality"].map(|key| format!("{}.{key}=", self.train));
        let first = self.first.borrow();
        let first = first.as_ref().filter(|_| {
            let mut sets = point.sets.iter();
            sets.any(|set| sizes.iter().any(|size| set.starts_with(size)))
        });
        let judged = first.map(|first| first.judged_scale.unwrap_or(first.scale));
        judged
            .map(|judged| format!("{}.judged_scale={judged}", self.train))
            .into_iter()
            .collect()
    }
}

/// Opens a pipeline, or that of a folder, with settings.
fn open(context: &Context, dir: Option<&Path>, sets: &[String]) -> Result<Session, Error> {
    let context = Context {
        sets: [&context.sets, sets].concat(),
        ..context.clone()
    };
    let mut session = match dir {
        Some(dir) => Session::implicit(&context, &PhotoFolder::new(dir)?.training("trade"), "trade", dir)?,
        None => Session::open(&context)?,
    };
    session.source = session.derived_source(Purpose::Trade)?;
    Ok(session)
}

/// Returns the name of the node that is named as a stage, or else of the first one of that stage.
fn node_of<P: Params>(session: &Session) -> Option<String> {
    let nodes = session.tree.get("node")?.as_object()?;
    let is_of = |(name, table): &(&String, &Value)| {
        let uses = table.get("uses").and_then(Value::as_str);
        uses.unwrap_or(name) == P::STAGE
    };
    let named = nodes.get_key_value(P::STAGE).filter(is_of);
    let found = named.or_else(|| nodes.iter().find(is_of));
    found.map(|(name, _)| name.clone())
}

/// Returns the name of the training.
///
/// # Errors
/// A pipeline without one, with a time to train for, or with one that starts from the last.
fn training(session: &Session) -> Result<String, Error> {
    let none = || {
        Error::Usage(
            Diagnostic::new("the pipeline has no node `train`, whose quality would be traded".to_owned())
                .hint("add one, or give a folder with images/ and transforms.json"),
        )
    };
    let name = node_of::<TrainParams>(session).ok_or_else(none)?;
    let info = session.nodes.iter().find(|info| info.name == name);
    let timed = ["budget", "within"]
        .into_iter()
        .find(|key| info.is_some_and(|info| info.params.get(*key).is_some()));
    if info.is_some_and(|info| info.params.get("warm_start").is_some()) {
        return Err(Error::Usage(
            Diagnostic::new(format!(
                "`{name}.warm_start` would start each training from the one before, and none could be compared"
            ))
            .hint(format!("add `--set {name}.warm_start=false`")),
        ));
    }
    match timed {
        Some(key) => Err(Error::Usage(
            Diagnostic::new(format!("`{name}.{key}` fixes the time, which is to be traded"))
                .hint("leave it out, or set `steps` in its place"),
        )),
        None => Ok(name),
    }
}
