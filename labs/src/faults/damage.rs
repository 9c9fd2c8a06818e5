//! A bit flipped in a file of the store, a cut or an emptying, before a run that reads most of it.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use super::case::{Case, Variant, files_of};
use super::injector::{Fault, Injector, Outcome, RoundError};
use super::lab::Lab;

/// Damages copies of the undisturbed store.
pub struct Damage<'a> {
    lab: &'a Lab,
    case: Case,
    files: Vec<PathBuf>,
    kinds: BTreeMap<&'static str, u32>,
    /// Damage of the round, in words.
    done: String,
}

impl<'a> Damage<'a> {
    /// Lists the files of the undisturbed store.
    pub fn new(lab: &'a Lab, case: Case) -> Self {
        Self {
            lab,
            case,
            files: files_of(&lab.undisturbed().store()),
            kinds: BTreeMap::new(),
            done: String::new(),
        }
    }
}

impl Injector for Damage<'_> {
    fn prepare(&mut self, _round: u32) -> Outcome {
        self.lab.reset_to_undisturbed(&self.case)
    }

    fn inject(&mut self, round: u32) -> Outcome {
        let random = self.lab.random(Fault::Damage, round);
        // Every file once before any twice.
        let file = &self.files[round as usize % self.files.len()];
        let what = damage(&self.case.store().join(file), random)?;
        *self.kinds.entry(what).or_default() += 1;
        self.done = format!("{what} {}", file.display());
        Ok(())
    }

    fn judge(&mut self, _round: u32) -> Outcome {
        let outcome = self.lab.ends_equal(&self.case, Variant::Changed);
        outcome.map_err(|error| match error {
            RoundError::Bad(what) => RoundError::Bad(format!("{}: {what}", self.done)),
            impossible => impossible,
        })
    }

    fn detail(&self) -> String {
        let kinds = self.kinds.iter().map(|(what, count)| format!("{count} {what}"));
        let kinds: Vec<String> = kinds.collect();
        format!("{}; {} files in the store", kinds.join(", "), self.files.len())
    }
}

/// Damages a file in one of three ways. Returns the way.
fn damage(path: &Path, random: u64) -> Outcome<&'static str> {
    let mut bytes = std::fs::read(path)?;
    let at = random / 8;
    let what = match (random % 4, bytes.len() as u64) {
        (_, 0) => "an empty file left as it is",
        (0, len) => {
            bytes.truncate((at % len) as usize);
            "cut"
        }
        (1, _) => {
            bytes.clear();
            "emptied"
        }
        (_, len) => {
            bytes[(at % len) as usize] ^= 1 << (random % 8);
            "one bit flipped"
        }
    };
    std::fs::remove_file(path)?;
    std::fs::write(path, bytes)?;
    Ok(what)
}
