//! The table of stages.
