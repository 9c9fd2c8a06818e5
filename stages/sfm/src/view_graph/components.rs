//! Connected components.

use std::collections::BTreeMap;

use super::view::Link;

/// Returns the rank of each photo's connected component: 0 is the largest, ties by first photo.
pub fn components(count: usize, links: &[Link]) -> Vec<usize> {
    let mut root: Vec<usize> = (0..count).collect();
    fn find(root: &[usize], mut photo: usize) -> usize {
        while root[photo] != photo {
            photo = root[photo];
        }
        photo
    }
    for link in links {
        let [a, b] = link.photos.map(|photo| find(&root, photo));
        root[a.max(b)] = a.min(b);
    }
    let roots: Vec<usize> = (0..count).map(|photo| find(&root, photo)).collect();
    let mut sizes: BTreeMap<usize, usize> = BTreeMap::new();
    roots
        .iter()
        .for_each(|root| *sizes.entry(*root).or_default() += 1);
    let mut order: Vec<(usize, usize)> = sizes.into_iter().collect();
    order.sort_by_key(|&(root, size)| (std::cmp::Reverse(size), root));
    let rank = |root: &usize| order.iter().position(|(other, _)| other == root).unwrap_or(0);
    roots.iter().map(rank).collect()
}
