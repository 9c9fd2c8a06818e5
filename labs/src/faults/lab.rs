//! A folder in which stores are made and broken, and what undisturbed runs gave.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use marf_cache::Digest;
use marf_run::files;
use marf_stages::{PinnedProduct, pinned_products};

use super::case::{Case, Outputs, Variant, is_success};
use super::injector::{Fault, Outcome, RoundError};
use super::source::Source;
use crate::output::Result;
use crate::process::marf;
use crate::synthetic::random;

/// The folder, the pipeline and what undisturbed runs of it gave.
pub struct Lab {
    /// Holds a folder for each case.
    dir: PathBuf,
    /// The program marf.
    program: PathBuf,
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
    pub fn new(dir: &Path, source: Source) -> Result<Self> {
        let mut lab = Self {
            dir: dir.to_owned(),
            program: marf()?,
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

    fn run_whole(&self, name: &str, variant: Variant) -> Outcome<Outputs> {
        let case = self.case(name);
        self.reset(&case)?;
        case.ends(variant)?;
        case.outputs()
    }

    /// Returns the case of a name. Creates nothing.
    pub fn case(&self, name: &str) -> Case {
        Case {
            program: self.program.clone().into_os_string(),
            dir: self.dir.join(name),
            wrapper: Vec::new(),
        }
    }

    /// Returns the case that the undisturbed run has left.
    pub fn undisturbed(&self) -> Case {
        self.case("undisturbed")
    }

    /// Leaves nothing in the folder of a case but the pipeline.
    ///
    /// # Errors
    /// A folder that cannot be written.
    pub fn reset(&self, case: &Case) -> Outcome {
        if case.dir.exists() {
            std::fs::remove_dir_all(&case.dir)?;
        }
        let file = case.dir.join("pipeline.toml");
        Ok(files::write(&file, self.pipeline().as_bytes())?)
    }

    /// Leaves nothing in the folder of a case but the pipeline and the store of the undisturbed run.
    ///
    /// # Errors
    /// Files that cannot be copied.
    pub fn reset_to_undisturbed(&self, case: &Case) -> Outcome {
        self.reset(case)?;
        let (from, to) = (self.undisturbed().store(), case.store());
        for entry in walkdir::WalkDir::new(&from) {
            let entry = entry?;
            let target = to.join(entry.path().strip_prefix(&from)?);
            if entry.file_type().is_dir() {
                std::fs::create_dir_all(&target)?;
            } else {
                std::fs::copy(entry.path(), &target)?;
            }
        }
        Ok(())
    }

    /// Returns the text of the pipeline.
    pub fn pipeline(&self) -> &str {
        &self.source.pipeline
    }

    /// Returns a random number of a round of a fault.
    pub fn random(&self, fault: Fault, round: u32) -> u64 {
        random(0, (fault as u64) << 32 | u64::from(round))
    }

    /// Runs a case to the end and compares every digest with that of the undisturbed run. Names the first that differs or is
    /// missing. A child whose record was lost is not named when its parent is reused, since it is not needed.
    pub fn ends_equal(&self, case: &Case, variant: Variant) -> Outcome {
        case.ends(variant)?;
        let found = case.outputs()?;
        let expected = match variant {
            Variant::Plain => &self.plain,
            Variant::Changed => &self.changed,
        };
        let bad = |what: String| Err(RoundError::Bad(what));
        for (name, digest) in expected {
            match found.get(name) {
                Some(other) if other != digest => return bad(format!("output {name} differs")),
                None if !name.contains('/') => return bad(format!("output {name} is missing")),
                _ => {}
            }
        }
        match found.keys().find(|name| !expected.contains_key(*name)) {
            Some(name) => bad(format!("output {name} is new")),
            None => Ok(()),
        }
    }

    /// Verifies all of the store of a case, and that the pins next to it name nothing but whole products.
    pub fn is_whole(&self, case: &Case) -> Outcome {
        let pinned = pinned_products(&case.dir.join("marf.lock"));
        let pinned = pinned.map_err(|error| RoundError::Bad(error.to_string()))?;
        let pinned: BTreeSet<Digest> = pinned.iter().flat_map(PinnedProduct::digests).collect();
        if let Some(digest) = pinned.difference(&self.source.products).next() {
            return Err(RoundError::Bad(format!("a pin of {digest}, which nobody serves")));
        }
        let is_visible = case.wrapper.is_empty();
        if is_visible && !case.store().is_dir() {
            return Ok(()); // the run ended before it had begun
        }
        is_success("fsck", &case.command(&["cache", "fsck", "--read-data"]).output()?)
    }
}
