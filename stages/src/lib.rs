//! The table of stages: everything a pipeline can be made of, and nothing else.

use marf_stage::StageDef;

/// Every stage, in the order in which a pipeline usually has them.
static STAGES: [StageDef; 0] = [];

/// Returns the table of stages.
pub fn stages() -> &'static [StageDef] {
    &STAGES
}
