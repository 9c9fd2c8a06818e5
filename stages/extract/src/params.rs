//! Parameters of the stage: which archive.

use marf_stage::{ArchiveContext, ParamError};
use schemars::JsonSchema;
use serde::Deserialize;
use serde_json::{Map, Value};

use crate::archive::ArchiveFiles;
use crate::kinds::ARCHIVES;

/// Key of an `[archive.*]` table that names its kind.
const KIND: &str = "kind";

/// Where photos come from.
#[derive(Debug, Clone, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ExtractParams {
    /// Name of an `[archive.*]` table.
    #[schemars(with = "String")]
    pub archive: ArchiveTable,
    /// Memory for the decoded pixels of one photo, in MB. As many photos as threads are decoded at once. A photo of
    /// 8-bit colour takes 3 MB a megapixel, one of 16 bits 6 MB. A larger photo is left out, with the reason.
    #[serde(default = "max_decoded_mb")]
    pub max_decoded_mb: u64,
}

fn max_decoded_mb() -> u64 {
    marf_scene::MAX_DECODED_BYTES / 1_000_000
}

/// The `[archive.*]` table that a pipeline names: `kind` and the keys of that kind.
#[derive(Debug, Clone, Deserialize)]
pub struct ArchiveTable(Map<String, Value>);

impl ArchiveTable {
    /// Checks the table against its kind and returns the archive. Reads no file.
    pub(crate) fn open(mut self, context: ArchiveContext) -> Result<Box<dyn ArchiveFiles>, ParamError> {
        let kind = self.0.remove(KIND).unwrap_or_default();
        let def = ARCHIVES.iter().find(|def| kind == def.kind).ok_or_else(|| {
            let known: Vec<&str> = ARCHIVES.iter().map(|def| def.kind).collect();
            ParamError::new(
                KIND,
                format!(
                    "unknown kind of archive {kind}: known kinds are {}",
                    known.join(", ")
                ),
            )
        })?;
        (def.open)(Value::Object(self.0), context)
    }
}
