//! What every request is given besides its own arguments.

use std::num::NonZero;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use marf_cache::Store;
use marf_config::GlobalOptions;
use marf_engine::{Cancel, Listener, SilentListener};
use marf_progress::RunProgress;

use crate::error::{Diagnostic, Error};

/// The pipeline and the store that a request is about, how it may compute, and its caller.
#[derive(Clone)]
pub struct Context {
    /// The pipeline file.
    pub file: PathBuf,
    /// Folder of the store, by default `.marf` next to the pipeline.
    pub store: Option<PathBuf>,
    /// Overrides of values of the pipeline, `NODE.KEY=VALUE`.
    pub sets: Vec<String>,
    /// Cores to use, by default all. Results do not depend on it.
    pub threads: Option<NonZero<usize>>,
    /// Options that hold for all nodes and archives.
    pub config: GlobalOptions,
    /// The command as typed, for records.
    pub command: String,
    /// The commit that the program is built from, if it is known.
    pub commit: Option<&'static str>,
    /// The caller's view of the work.
    pub feedback: Arc<dyn Feedback>,
    /// Whether results that are sent to a shared store are signed.
    pub signing: Signing,
    /// Set when the user wants to stop.
    pub cancel: Cancel,
}

/// Whether results that are sent to a shared store are signed.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Signing {
    /// With the key of the environment, or that of the user's configuration folder, if there is one.
    #[default]
    OwnKey,
    /// They are not.
    Off,
}

/// Receives what happens while a request is worked on.
pub trait Feedback: Send + Sync {
    /// Receives a fault that the request survives.
    fn warn(&self, message: &str);

    /// Receives a step of the request, in one line.
    fn note(&self, line: &str);

    /// Returns the receiver of the events of a run. `run` is its name.
    fn follow(&self, run: &str) -> Box<dyn RunFeedback>;

    /// Returns whether a run leaves its events in the store, for `marf view` and `marf status`.
    fn is_public(&self) -> bool {
        true
    }

    /// Receives how much of a transfer is done.
    fn on_transfer(&self, _name: &str, _moved: marf_remote::Progress) {}
}

/// Receives the events of one run.
pub trait RunFeedback: Listener + Send {
    /// Receives the names of the devices that the run computes on.
    fn on_devices(&self, _devices: &str) {}

    /// Receives how far the whole run is.
    fn on_run_progress(&self, _standing: &RunProgress) {}
}

impl RunFeedback for SilentListener {}

impl Context {
    /// Reports a fault that the request survives.
    pub fn warn(&self, message: String) {
        self.feedback.warn(&message);
    }

    /// Returns a function that reports faults.
    pub fn warnings(&self) -> impl Fn(String) + '_ {
        |message| self.warn(message)
    }

    /// Returns the folder of the pipeline, to which paths in it are relative.
    pub fn folder(&self) -> &Path {
        self.file.parent().unwrap_or(Path::new(""))
    }

    /// Returns the folder of the store of a pipeline in `folder`.
    pub fn store_dir(&self, folder: &Path) -> PathBuf {
        self.store.clone().unwrap_or_else(|| folder.join(".marf"))
    }

    /// Opens the store of the pipeline, making it if need be.
    ///
    /// # Errors
    /// A place that cannot be written, or a store that another process holds.
    pub fn open_store(&self) -> Result<Store, Error> {
        open_store(&self.store_dir(self.folder()), &self.cancel)
    }

    /// Opens the store of the pipeline, which must exist: reading requests make none.
    ///
    /// # Errors
    /// Names the place where no store is.
    pub fn existing_store(&self) -> Result<Store, Error> {
        let dir = self.store_dir(self.folder());
        if !dir.is_dir() {
            let diagnostic = Diagnostic::new(format!("there is no store at {}", dir.display()));
            return Err(Error::Failed(
                diagnostic.hint("create one with `marf run`, or name another with --store"),
            ));
        }
        open_store(&dir, &self.cancel)
    }
}

/// Opens a store, making it if need be. Its waits for other programs end with the wish to stop.
///
/// # Errors
/// A place that cannot be written, or a store that another process holds.
pub fn open_store(dir: &Path, cancel: &Cancel) -> Result<Store, Error> {
    let stop = cancel.clone();
    Ok(Store::open_interruptible(dir, move || stop.is_set())?)
}
