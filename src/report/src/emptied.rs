//! Filters that reject every photo they are given.

/// Returns the sentence on such a filter, with what keeps the photos: for the terminal and the report alike.
pub fn sentence(node: &str, rejected: u64, relax: &str) -> String {
    let all = match rejected {
        1 => "the only photo that it is given".to_owned(),
        rejected => format!("all {rejected} photos that it is given"),
    };
    format!("`{node}` rejects {all}: {relax} in `[node.{node}]` keeps them")
}
