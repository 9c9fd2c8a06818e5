//! Connected components.

use std::collections::BTreeMap;

use marf_numeric::lowest_joined;

use super::view::Link;

/// Returns the rank of each photo's connected component: 0 is the largest, ties by first photo.
pub fn components(count: usize, links: &[Link]) -> Vec<usize> {
    let roots = lowest_joined(count, links.iter().map(|link| link.photos));
    let mut sizes: BTreeMap<usize, usize> = BTreeMap::new();
    roots
        .iter()
        .for_each(|root| *sizes.entry(*root).or_default() += 1);
    let mut order: Vec<(usize, usize)> = sizes.into_iter().collect();
    order.sort_by_key(|&(root, size)| (std::cmp::Reverse(size), root));
    let rank = |root: &usize| order.iter().position(|(other, _)| other == root).unwrap_or(0);
    roots.iter().map(rank).collect()
}
