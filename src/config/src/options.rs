use std::collections::BTreeMap;

use marf_field::Device;
use marf_stage::{Access, RecordedArchive};

/// Options of the command line that hold for all nodes and archives.
#[derive(Debug, Clone)]
pub struct GlobalOptions {
    /// Device of the nodes that can run on several and name none.
    pub device: Option<Device>,
    /// What may be asked of the network.
    pub access: Access,
    /// Whether the bytes of files in folders are read again even if nothing indicates a change.
    pub rehash: bool,
    /// Recorded archives of an earlier run, by the node that reads them. They are read instead of the
    /// archives.
    pub recorded: BTreeMap<String, RecordedArchive>,
}

/// Without options: every node chooses its device, and archives on servers may be asked.
impl Default for GlobalOptions {
    fn default() -> Self {
        Self {
            device: None,
            access: Access::Online,
            rehash: false,
            recorded: BTreeMap::new(),
        }
    }
}
