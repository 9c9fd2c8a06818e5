use marf_cache::Digest;
use marf_stage::{Ctx, Document, Outputs, StageError};

use crate::TrainError;

/// The outputs of a finished child node, with its name for errors.
#[derive(Debug, Clone)]
pub(crate) struct Child<'a> {
    pub name: String,
    pub outputs: &'a Outputs,
}

impl<'a> Child<'a> {
    /// Returns finished child nodes in their order, named `kind 00`, `kind 01` and so on.
    pub fn numbered(kind: &str, outputs: &'a [Outputs]) -> Vec<Self> {
        let children = outputs.iter().enumerate().map(|(index, outputs)| Self {
            name: format!("{kind} {index:02}"),
            outputs,
        });
        children.collect()
    }

    /// Returns the digest of an output that must be there.
    pub fn digest(&self, output: &str) -> Result<&Digest, TrainError> {
        self.outputs.get(output).ok_or_else(|| TrainError::MissingOutput {
            node: self.name.clone(),
            output: output.to_owned(),
        })
    }

    /// Reads a document that must be there.
    pub fn read<D: Document>(&self, ctx: &Ctx<'_>) -> Result<D, StageError> {
        let bytes = ctx.get(self.digest(D::OUTPUT)?)?;
        Ok(D::decode(&bytes).map_err(|error| self.malformed(D::OUTPUT, &error))?)
    }

    /// Returns the error of an output that cannot be read.
    pub fn malformed(&self, output: &str, cause: &dyn std::fmt::Display) -> TrainError {
        TrainError::MalformedOutput {
            node: self.name.clone(),
            output: output.to_owned(),
            cause: cause.to_string(),
        }
    }
}
