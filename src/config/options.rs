use marf_field::Device;

/// What the command line says for all nodes and archives.
#[derive(Debug, Clone, Default)]
pub struct GlobalOptions {
    /// What nodes run on that can run on several devices and name none.
    pub device: Option<Device>,
    /// What may be asked of the network.
    pub access: Access,
}

/// What may be asked of the network.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Access {
    /// Everything.
    #[default]
    Online,
    /// Products that the lock file names.
    Locked,
    /// Nothing.
    Offline,
}

impl Access {
    /// Returns the word that archives know it by.
    pub fn word(self) -> &'static str {
        match self {
            Self::Online => "online",
            Self::Locked => "locked",
            Self::Offline => "offline",
        }
    }
}
