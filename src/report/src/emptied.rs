//! Filters that reject every photo they are given.

/// Returns the sentence on such a filter, with what keeps the photos: for the terminal and the report alike.
pub fn sentence(node: &str, rejected: u64, relax: &str) -> String {
    format!("`{node}` rejects all {rejected} photos that it is given: {relax} in `[node.{node}]` keeps them")
}
