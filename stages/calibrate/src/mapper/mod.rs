//! Policy: which photos start a model, which come next, what is kept.
