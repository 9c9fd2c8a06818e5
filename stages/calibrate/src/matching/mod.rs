//! Which photos to compare, and which of their features are the same point.
