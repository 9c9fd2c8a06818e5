use marf_field::Device;
use marf_stage::Access;

/// What the command line says for all nodes and archives.
#[derive(Debug, Clone)]
pub struct GlobalOptions {
    /// What nodes run on that can run on several devices and name none.
    pub device: Option<Device>,
    /// What may be asked of the network.
    pub access: Access,
}

impl Default for GlobalOptions {
    /// Nodes choose their device, and archives may be asked.
    fn default() -> Self {
        Self {
            device: None,
            access: Access::Online,
        }
    }
}
