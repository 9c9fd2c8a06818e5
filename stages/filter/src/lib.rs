//! Photos to verdicts: the six filters.
