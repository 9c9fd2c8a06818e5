//! Photos grouped by what they show.

use std::collections::{BTreeMap, BTreeSet};

use marf_numeric::lowest_joined;

use super::group::Group;
use crate::photos::{InputPhoto, without_extension};
use crate::sfm::Overlap;

/// Joins photos without a group to the group they share most verified matches with. Linked photos join together. Photos that share no
/// matches with any group become new groups. `order` has these photos in the order in which they were taken.
pub(super) fn join(
    groups: &mut Vec<Group>,
    order: &[usize],
    overlaps: &[Overlap],
    items: &[InputPhoto],
    max_photos: usize,
) {
    let group_of: BTreeMap<usize, usize> = groups
        .iter()
        .enumerate()
        .flat_map(|(index, group)| group.members.iter().map(move |member| (*member, index)))
        .collect();
    for part in connected(order, overlaps) {
        let is_of = |photo: usize| part.binary_search(&photo).is_ok();
        let mut shared: BTreeMap<usize, u64> = BTreeMap::new();
        for overlap in overlaps {
            let [a, b] = overlap.photos;
            let outside = match (is_of(a), is_of(b)) {
                (true, false) => b,
                (false, true) => a,
                _ => continue,
            };
            if let Some(group) = group_of.get(&outside) {
                *shared.entry(*group).or_default() += u64::from(overlap.matches);
            }
        }
        let has_room = |group: usize| groups[group].members.len() + part.len() <= max_photos;
        let best = shared
            .into_iter()
            .filter(|(group, _)| has_room(*group))
            .max_by_key(|(group, matches)| (*matches, std::cmp::Reverse(*group)));
        let ordered = order.iter().copied().filter(|photo| is_of(*photo));
        let ordered: Vec<usize> = ordered.collect();
        match best {
            Some((group, matches)) => {
                let count = ordered.len();
                groups[group].members.extend(ordered);
                groups[group].reason.push_str(&format!(
                    ", and {count} without a usable label by what they show ({matches} matches)"
                ));
            }
            None => groups.extend(ordered.chunks(max_photos.max(1)).map(|members| Group {
                name: format!("from-{}", name(&items[members[0]])),
                reason: match members {
                    [_] => "it shows nothing that another photo shows".to_owned(),
                    _ => "by what the photos show".to_owned(),
                },
                members: members.to_vec(),
            })),
        }
    }
}

/// Returns photos that overlaps among them link, directly or through others. Each part is sorted, parts by their first photo in `order`.
fn connected(order: &[usize], overlaps: &[Overlap]) -> Vec<Vec<usize>> {
    let count = order.iter().max().map_or(0, |last| last + 1);
    let open: BTreeSet<&usize> = order.iter().collect();
    let pairs = overlaps.iter().map(|overlap| overlap.photos);
    let pairs = pairs.filter(|pair| pair.iter().all(|photo| open.contains(photo)));
    let part_of = lowest_joined(count, pairs);
    let mut parts: Vec<(usize, Vec<usize>)> = Vec::new();
    for photo in order {
        let first = part_of[*photo];
        match parts.iter_mut().find(|(of, _)| *of == first) {
            Some((_, members)) => members.push(*photo),
            None => parts.push((first, vec![*photo])),
        }
    }
    parts
        .into_iter()
        .map(|(_, mut members)| {
            members.sort_unstable();
            members
        })
        .collect()
}

/// Returns the name of a photo's file with what no scene's name may have replaced.
fn name(item: &InputPhoto) -> String {
    let file = item.facts.file.rsplit('/').next().unwrap_or_default();
    let allowed = |c: char| match c {
        c if c.is_ascii_alphanumeric() || c == '_' => c,
        _ => '-',
    };
    without_extension(file).chars().map(allowed).take(48).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use marf_cache::Digest;
    use marf_scene::PhotoFacts;

    fn overlap(a: usize, b: usize, matches: u32) -> Overlap {
        Overlap {
            photos: [a, b],
            matches,
            has_depth: true,
        }
    }

    fn items(count: usize) -> Vec<InputPhoto> {
        let item = |index: usize| InputPhoto {
            id: format!("p{index}"),
            image: Digest::from_content(&[]),
            labelled: false,
            developed: false,
            mask: None,
            facts: PhotoFacts {
                file: format!("a/IMG {index}.jpg"),
                ..PhotoFacts::default()
            },
        };
        (0..count).map(item).collect()
    }

    fn group(name: &str, members: &[usize]) -> Group {
        Group {
            name: name.to_owned(),
            reason: "by labels".to_owned(),
            members: members.to_vec(),
        }
    }

    #[test]
    fn photos_that_hang_together_are_one_group_in_the_order_they_were_taken() {
        let overlaps = [
            overlap(0, 4, 20),
            overlap(1, 2, 20),
            overlap(2, 4, 20),
            overlap(3, 5, 20),
        ];
        let mut groups = Vec::new();
        join(&mut groups, &[5, 4, 3, 2, 1, 0], &overlaps, &items(7), 9);
        let members: Vec<&[usize]> = groups.iter().map(|group| group.members.as_slice()).collect();
        assert_eq!(members, [&[5, 3][..], &[4, 2, 1, 0]]);
        assert_eq!(groups[0].name, "from-IMG-5");
        // More than a scene may have are cut in this order.
        let mut groups = Vec::new();
        join(&mut groups, &[5, 4, 3, 2, 1, 0], &overlaps, &items(7), 3);
        let members: Vec<&[usize]> = groups.iter().map(|group| group.members.as_slice()).collect();
        assert_eq!(members, [&[5, 3][..], &[4, 2, 1], &[0]]);
    }

    #[test]
    fn photos_without_a_label_go_where_most_matches_lead_unless_it_is_full() {
        let overlaps = [
            overlap(0, 4, 20),
            overlap(1, 4, 90),
            overlap(4, 5, 30),
            overlap(2, 6, 50),
        ];
        let mut groups = vec![group("a", &[0]), group("b", &[1]), group("c", &[2, 3])];
        join(&mut groups, &[4, 5, 6], &overlaps, &items(7), 3);
        assert_eq!(groups[0].members, [0]);
        assert_eq!(groups[1].members, [1, 4, 5]);
        assert!(groups[1].reason.ends_with("(90 matches)"), "{}", groups[1].reason);
        assert_eq!(groups[2].members, [2, 3, 6]);
        let mut groups = vec![group("c", &[2, 3])];
        join(&mut groups, &[6], &overlaps, &items(7), 2);
        assert_eq!(groups[1].members, [6]);
        assert!(
            groups[1].reason.contains("nothing that another"),
            "{}",
            groups[1].reason
        );
    }
}
