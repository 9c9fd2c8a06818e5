//! The tables of stages and of kinds of archives: everything a pipeline can be made of, and nothing else.

use std::sync::LazyLock;

pub use marf_extract::{
    ArchiveDef, Check, CheckState, CheckedArchive, PinnedProduct, UnreadableLock, pinned_products,
};
use marf_stage::{StageDef, define};

/// Every stage, in the order in which a pipeline usually has them.
static STAGES: LazyLock<Vec<StageDef>> = LazyLock::new(|| {
    let mut stages = vec![define::<marf_extract::Extract>()];
    stages.extend_from_slice(marf_filter::STAGES);
    stages.extend([
        define::<marf_calibrate::SplitByPlace>(),
        define::<marf_calibrate::Masks>(),
        define::<marf_calibrate::Calibrate>(),
        define::<marf_calibrate::ExportCameras>(),
        define::<marf_calibrate::TieScenes>(),
        define::<marf_depth::MakeDepth>(),
        define::<marf_train::Tune>(),
        define::<marf_train::Train>(),
        define::<marf_train::Partial>(),
        define::<marf_train::Folds>(),
        define::<marf_train::Evaluate>(),
        define::<marf_train::Render>(),
        define::<marf_train::Bootstrap>(),
        define::<marf_train::Video>(),
        define::<marf_surface::MakeSurface>(),
        define::<marf_surface::FindChanges>(),
    ]);
    stages
});

/// Returns the filters among them, in the order in which `marf filter` runs them.
pub fn filters() -> &'static [StageDef] {
    marf_filter::STAGES
}

/// Returns the table of stages.
pub fn stages() -> &'static [StageDef] {
    &STAGES
}

/// Returns the table of kinds of archives.
pub fn archives() -> &'static [ArchiveDef] {
    marf_extract::ARCHIVES
}
