//! Kinds of archives: the declaration of a kind, and its row in the table.

use marf_stage::{ArchiveContext, ParamError, from_json, schema_of};
use schemars::{JsonSchema, Schema};
use serde::de::DeserializeOwned;
use serde_json::Value;

use super::ArchiveFiles;
use super::access::{Location, sealed};

/// A kind of archive as a type.
pub(crate) trait ArchiveKind {
    /// The keys of its `[archive.*]` table except `kind`. Doc comments of its fields become the help text. Needs
    /// `#[serde(deny_unknown_fields)]`.
    type Params: DeserializeOwned + JsonSchema;
    /// [`Local`](super::access::Local) or [`Remote`](super::access::Remote): decides whether [`ArchiveKind::open`]
    /// gets access to the network.
    type Location: Location;
    /// The value of `kind` in pipeline.toml.
    const KIND: &'static str;
    /// One line for people.
    const ABOUT: &'static str;

    /// Checks the parameters and returns the archive. Reads no file and sends no request.
    ///
    /// # Errors
    /// Names the key whose value cannot be used.
    fn open(
        params: Self::Params,
        context: <Self::Location as sealed::Sealed>::Context,
    ) -> Result<Box<dyn ArchiveFiles>, ParamError>;
}

/// A row of the table of kinds.
#[derive(Clone, Copy)]
pub struct ArchiveDef {
    /// The value of `kind` in pipeline.toml.
    pub kind: &'static str,
    /// One line for people.
    pub about: &'static str,
    /// Whether its files lie on servers: such an archive obeys `--locked` and `--offline`.
    pub remote: bool,
    /// JSON schema of its keys except `kind`.
    pub schema: fn() -> Schema,
    /// Checks the keys except `kind` and returns the archive.
    pub(crate) open: fn(Value, ArchiveContext) -> Result<Box<dyn ArchiveFiles>, ParamError>,
}

/// Returns the table row of a kind.
pub(crate) const fn define<K: ArchiveKind>() -> ArchiveDef {
    ArchiveDef {
        kind: K::KIND,
        about: K::ABOUT,
        remote: <K::Location as sealed::Sealed>::REMOTE,
        schema: schema_of::<K::Params>,
        open: |params, context| {
            let params = from_json(params)?;
            K::open(params, <K::Location as sealed::Sealed>::context(context)?)
        },
    }
}
