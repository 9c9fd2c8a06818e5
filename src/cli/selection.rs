use clap::Args;
use marf_run::scenes::Selection;

/// Which nodes.
#[derive(Debug, Clone, Default, Args)]
pub struct SelectionArgs {
    /// Only what leads to this node
    #[arg(long, value_name = "NODE")]
    pub to: Option<String>,
    /// Only this node and what follows from it
    #[arg(long, value_name = "NODE")]
    pub from: Option<String>,
    /// Only this scene, where the photos are split by place
    #[arg(long, value_name = "NAME")]
    pub scene: Option<String>,
}

impl SelectionArgs {
    /// Returns the nodes as a request names them.
    pub fn request(self) -> Selection {
        Selection {
            to: self.to,
            from: self.from,
            scene: self.scene,
        }
    }
}
