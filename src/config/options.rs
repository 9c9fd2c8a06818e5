use marf_field::Device;
use marf_stage::Access;

/// Options of the command line that hold for all nodes and archives.
#[derive(Debug, Clone)]
pub struct GlobalOptions {
    /// Device of the nodes that can run on several and name none.
    pub device: Option<Device>,
    /// What may be asked of the network.
    pub access: Access,
    /// Whether the bytes of files in folders are read though nothing tells of a change.
    pub rehash: bool,
}

/// Without options: every node chooses its device, and archives on servers may be asked.
impl Default for GlobalOptions {
    fn default() -> Self {
        Self {
            device: None,
            access: Access::Online,
            rehash: false,
        }
    }
}
