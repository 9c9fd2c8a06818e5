//! A folder in which stores are made and broken, and what undisturbed runs gave.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use marf_cache::Digest;
use marf_stages::{PinnedProduct, pinned_products};

use super::super::child::random;
use super::args::Fault;
use super::case::Case;
use super::source::Source;
use super::{Outcome, RoundError};
use marf_run::Error;
use marf_run::files;

/// The outputs of all nodes: name of node and output to digest.
pub type Outputs = BTreeMap<String, String>;

/// Which of two pipelines is run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Variant {
    /// As it is written.
    Plain,
    /// With another threshold early on: its run reads most of what a run before has stored.
    Changed,
}

impl Variant {
    /// Returns the arguments of its run.
    pub fn arguments(self) -> &'static [&'static str] {
        match self {
            Self::Plain => &[],
            Self::Changed => &["--set", "size.min_bytes=1"],
        }
    }
}

/// The folder, the pipeline and what undisturbed runs of it gave.
pub struct Lab {
    /// Holds a folder for each case.
    pub dir: PathBuf,
    /// This program.
    pub program: PathBuf,
    seed: u64,
    source: Source,
    plain: Outputs,
    changed: Outputs,
    /// Wall time of the undisturbed run.
    pub wall: Duration,
}

impl Lab {
    /// Runs both variants without a fault.
    ///
    /// # Errors
    /// A folder that cannot be written, a run that fails.
    pub fn new(dir: &Path, seed: u64, source: Source) -> Result<Self, Error> {
        let program = std::env::current_exe().map_err(|error| Error::failed(error.to_string()))?;
        let mut lab = Self {
            dir: dir.to_owned(),
            program,
            seed,
            source,
            plain: Outputs::new(),
            changed: Outputs::new(),
            wall: Duration::ZERO,
        };
        let began = Instant::now();
        lab.plain = lab.run_whole("undisturbed", Variant::Plain)?;
        lab.wall = began.elapsed();
        lab.changed = lab.run_whole("undisturbed-changed", Variant::Changed)?;
        Ok(lab)
    }

    fn run_whole(&self, name: &str, variant: Variant) -> Result<Outputs, Error> {
        let case = self.case(name)?;
        let outputs = case.ends(variant).and_then(|()| case.outputs());
        outputs.map_err(|error| match error {
            RoundError::Bad(what) => Error::failed(format!("the undisturbed run: {what}")),
            RoundError::Impossible(error) => error,
        })
    }

    /// Returns the case that the undisturbed run has left.
    pub fn undisturbed(&self) -> Case<'_> {
        Case::at(self, self.dir.join("undisturbed"))
    }

    /// Returns a case in a new folder with the pipeline alone; an older one of that name is removed.
    ///
    /// # Errors
    /// A folder that cannot be written.
    pub fn case(&self, name: &str) -> Result<Case<'_>, Error> {
        let case = Case::at(self, self.dir.join(name));
        case.remove()?;
        files::write(&case.dir.join("pipeline.toml"), self.source.pipeline.as_bytes())?;
        Ok(case)
    }

    /// Returns the text of the pipeline.
    pub fn pipeline(&self) -> &str {
        &self.source.pipeline
    }

    /// Returns a random number of a round of a fault.
    pub fn random(&self, fault: Fault, round: u32) -> u64 {
        random(self.seed, (fault as u64) << 32 | u64::from(round))
    }

    /// Compares outputs with those of the undisturbed run; names the first that differs or is not there. A child whose
    /// record was lost is not told of when its parent is reused, since nobody needs it.
    pub fn compare(&self, variant: Variant, found: &Outputs) -> Outcome {
        let expected = match variant {
            Variant::Plain => &self.plain,
            Variant::Changed => &self.changed,
        };
        let bad = |what: String| Err(RoundError::Bad(what));
        for (name, digest) in expected {
            match found.get(name) {
                Some(other) if other != digest => return bad(format!("output {name} differs")),
                None if !name.contains('/') => return bad(format!("output {name} is not there")),
                _ => {}
            }
        }
        match found.keys().find(|name| !expected.contains_key(*name)) {
            Some(name) => bad(format!("output {name} is new")),
            None => Ok(()),
        }
    }

    /// Checks that a lock pins nothing but whole products.
    pub fn compare_pins(&self, lock: &Path) -> Outcome {
        let pinned = pinned_products(lock).map_err(|error| RoundError::Bad(error.to_string()))?;
        let pinned: BTreeSet<Digest> = pinned.iter().flat_map(PinnedProduct::digests).collect();
        match pinned.difference(&self.source.products).next() {
            Some(digest) => Err(RoundError::Bad(format!("a pin of {digest}, which nobody serves"))),
            None => Ok(()),
        }
    }
}
