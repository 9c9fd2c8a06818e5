//! Tests of the whole adjustment on scenes of known truth.
