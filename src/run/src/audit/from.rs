//! The runs and nodes that a product went into.

use marf_model::{Run, unless_lost};
use marf_provenance::taint::{Tainted, product_of, tainted};
use serde::Serialize;

use crate::context::Context;
use crate::error::{Answer, Diagnostic, Error};

/// The runs and nodes that a product went into.
#[derive(Debug, Serialize)]
pub struct ProductUses {
    /// The product as the user names it.
    pub product: String,
    /// Whole, incomplete, or not ours.
    pub answer: Answer,
    /// The runs, the newest first.
    pub runs: Vec<Tainted>,
    /// Runs with a lost object.
    pub lost_runs: Vec<u64>,
}

/// Finds every run and node that a product went into.
///
/// # Errors
/// A store that cannot be read.
pub fn uses(context: &Context, product: &str) -> Result<ProductUses, Error> {
    let store = context.existing_store()?;
    let mut found = ProductUses {
        product: product.to_owned(),
        answer: Answer::Whole,
        runs: Vec::new(),
        lost_runs: Vec::new(),
    };
    for run in marf_engine::runs(&store, context.warnings())?.into_iter().rev() {
        let number = run.number;
        let lineage = Run::new(&store, run)?;
        let answer = || match product_of(&lineage, product)? {
            Some(product) => tainted(&lineage, &product),
            None => Ok(None),
        };
        match unless_lost(answer())? {
            Some(tainted) => found.runs.extend(tainted),
            None => found.lost_runs.push(number),
        }
    }
    if !found.lost_runs.is_empty() {
        found.answer = Answer::Incomplete;
    } else if found.runs.is_empty() {
        found.answer = Answer::NotOurs;
    }
    Ok(found)
}

impl ProductUses {
    /// Returns an error unless all runs could be read and one has the product.
    ///
    /// # Errors
    /// [`Error::Answered`]: incomplete, or not ours.
    pub fn is_whole(&self) -> Result<(), Error> {
        let message = match self.answer {
            Answer::Incomplete => {
                let runs: Vec<String> = self.lost_runs.iter().map(ToString::to_string).collect();
                format!(
                    "objects of runs {} are not in the store any more",
                    runs.join(", ")
                )
            }
            Answer::NotOurs => format!("no run of this store read a product `{}`", self.product),
            _ => return Ok(()),
        };
        Err(Error::Answered(self.answer, Diagnostic::new(message)))
    }
}
