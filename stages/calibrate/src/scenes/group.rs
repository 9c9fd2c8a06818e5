//! A group of photos on its way to a scene.

use std::collections::BTreeSet;

use marf_schema::scenes::{HandMade, PhotoGroup};
use nalgebra::Vector3;

use super::label_position::LabelPosition;
use crate::photos::InputPhoto;
use crate::sfm::Overlap;

/// Distance of two cameras below which there is no parallax, metres. A mast that turns moves its cameras by about 0.15 m, and the eyes of a
/// stereo pair are 0.24 m apart.
const LEAST_SPAN_M: f64 = 0.2;

/// Photos of one place.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Group {
    pub name: String,
    /// What made it.
    pub reason: String,
    /// Indices of the photos.
    pub members: Vec<usize>,
}

/// All photos, and what decides how they are split.
pub(super) struct SplitInput<'a> {
    pub items: &'a [InputPhoto],
    /// Where each was taken by its label.
    pub labels: &'a [Option<LabelPosition>],
    /// Overlaps of these photos. Empty if they were not computed.
    pub overlaps: &'a [Overlap],
}

impl Group {
    /// Returns the group that was made by hand of photos that are free, and takes these.
    pub fn by_hand(name: &str, wanted: &HandMade, items: &[InputPhoto], free: &mut BTreeSet<usize>) -> Self {
        let is_named = |item: &InputPhoto| {
            let mut ids = wanted.ids.iter();
            ids.any(|id| *id == item.id || *id == item.facts.file)
        };
        let is_wanted = |item: &InputPhoto| {
            let of_sol = item.facts.sol.is_some_and(|sol| wanted.sols.contains(&sol));
            of_sol || is_named(item)
        };
        let members: Vec<usize> = free
            .iter()
            .copied()
            .filter(|index| is_wanted(&items[*index]))
            .collect();
        members.iter().for_each(|index| {
            free.remove(index);
        });
        let absent = wanted.ids.iter().filter(|id| {
            let mut all = items.iter();
            !all.any(|item| **id == item.id || **id == item.facts.file)
        });
        let absent: Vec<&str> = absent.map(String::as_str).collect();
        let reason = match absent.as_slice() {
            [] => "made by hand".to_owned(),
            [one] => format!("made by hand (`{one}` names no photo)"),
            [one, rest @ ..] => format!("made by hand (`{one}` and {} others name no photo)", rest.len()),
        };
        Self {
            name: name.to_owned(),
            reason,
            members,
        }
    }

    /// Returns why it can be no scene, if it cannot.
    pub fn fault(&self, known: &SplitInput<'_>, min_photos: usize) -> Option<String> {
        let count = self.members.len();
        if count < min_photos {
            let photos = if count == 1 { "photo" } else { "photos" };
            return Some(format!("{count} {photos}, `min_photos` asks for {min_photos}"));
        }
        let labels: Vec<&LabelPosition> = self.labels(known).collect();
        if labels.len() == count
            && let Some(span_m) = self.span_m(known).filter(|span_m| *span_m < LEAST_SPAN_M)
        {
            return Some(format!(
                "no parallax: by their labels all cameras are within {span_m:.2} m"
            ));
        }
        let inside: BTreeSet<usize> = self.members.iter().copied().collect();
        let mut pairs = known
            .overlaps
            .iter()
            .filter(|overlap| overlap.photos.iter().all(|photo| inside.contains(photo)))
            .peekable();
        let has_pairs = pairs.peek().is_some();
        if labels.is_empty() && has_pairs && pairs.all(|overlap| !overlap.has_depth) {
            return Some("no parallax: all pairs show a plane, or a camera that only turned".to_owned());
        }
        None
    }

    fn labels<'k>(&'k self, known: &'k SplitInput<'_>) -> impl Iterator<Item = &'k LabelPosition> {
        self.members
            .iter()
            .filter_map(|member| known.labels[*member].as_ref())
    }

    /// Returns the largest distance of two cameras of the same site, metres. `None` without two labels.
    fn span_m(&self, known: &SplitInput<'_>) -> Option<f64> {
        let labels: Vec<&LabelPosition> = self.labels(known).collect();
        let distances = labels.iter().enumerate().flat_map(|(index, a)| {
            let others = labels[index + 1..].iter();
            others
                .filter(|b| a.site == b.site)
                .map(|b| (a.centre - b.centre).norm())
        });
        distances.reduce(f64::max)
    }

    /// Returns it as the stage gives it.
    pub fn told(&self, known: &SplitInput<'_>) -> PhotoGroup {
        let mut photos: Vec<String> = self
            .members
            .iter()
            .map(|member| known.items[*member].id.clone())
            .collect();
        photos.sort_unstable();
        let sols = self
            .members
            .iter()
            .filter_map(|member| known.items[*member].facts.sol);
        let sols: BTreeSet<u32> = sols.collect();
        PhotoGroup {
            name: self.name.clone(),
            reason: self.reason.clone(),
            photos,
            sols: sols.into_iter().collect(),
            span_m: self.span_m(known),
        }
    }
}

/// Gives groups of one name different ones: `a`, `a-2`, `a-3`.
pub(super) fn name_apart(groups: &mut [Group]) {
    let mut taken: BTreeSet<String> = BTreeSet::new();
    for group in groups {
        let numbered = (2..).map(|number: u32| format!("{}-{number}", group.name));
        let mut names = std::iter::once(group.name.clone()).chain(numbered);
        if let Some(name) = names.find(|name| !taken.contains(name)) {
            taken.insert(name.clone());
            group.name = name;
        }
    }
}

/// Returns the mean of positions. Without positions it is zero.
pub(super) fn mean<'p>(positions: impl Iterator<Item = &'p Vector3<f64>>) -> Vector3<f64> {
    let (count, sum) = positions.fold((0, Vector3::zeros()), |(count, sum), one| (count + 1, sum + one));
    sum / f64::from(count.max(1))
}

#[cfg(test)]
mod tests {
    use super::*;
    use marf_cache::Digest;
    use marf_scene::PhotoFacts;

    fn items(count: u32) -> Vec<InputPhoto> {
        let item = |index: u32| InputPhoto {
            id: format!("p{index}"),
            image: Digest::from_content(&[]),
            labelled: true,
            developed: false,
            mask: None,
            facts: PhotoFacts {
                file: format!("{index}.png"),
                sol: Some(index / 2),
                ..PhotoFacts::default()
            },
        };
        (0..count).map(item).collect()
    }

    fn at(north: f64) -> Option<LabelPosition> {
        Some(LabelPosition {
            site: 1,
            drive: Some(0),
            centre: Vector3::new(north, 0.0, 0.0),
        })
    }

    fn group(members: &[usize]) -> Group {
        Group {
            name: "g".to_owned(),
            reason: "r".to_owned(),
            members: members.to_vec(),
        }
    }

    #[test]
    fn what_is_too_small_or_has_no_parallax_says_so_with_its_number() {
        let items = items(4);
        let labels = [at(0.0), at(0.12), at(0.24), None];
        let known = SplitInput {
            items: &items,
            labels: &labels,
            overlaps: &[],
        };
        let fault = |members: &[usize], min: usize| group(members).fault(&known, min);
        assert_eq!(fault(&[0], 3).unwrap(), "1 photo, `min_photos` asks for 3");
        assert!(fault(&[0, 1], 2).unwrap().ends_with("within 0.12 m"));
        assert_eq!(fault(&[0, 2], 2), None);
        // A photo without a label may be anywhere.
        assert_eq!(fault(&[0, 1, 3], 2), None);
        let turned = [Overlap {
            photos: [0, 1],
            matches: 90,
            has_depth: false,
        }];
        let known = SplitInput {
            items: &items,
            labels: &[None; 4],
            overlaps: &turned,
        };
        assert!(group(&[0, 1]).fault(&known, 2).unwrap().contains("only turned"));
        assert_eq!(group(&[2, 3]).fault(&known, 2), None);
    }

    #[test]
    fn a_group_by_hand_takes_its_sols_and_its_ids_and_names_those_that_are_not_there() {
        let items = items(6);
        let mut free: BTreeSet<usize> = (0..6).collect();
        let wanted = HandMade {
            sols: vec![1],
            ids: vec!["p0".to_owned(), "5.png".to_owned(), "p9".to_owned()],
        };
        let found = Group::by_hand("delta", &wanted, &items, &mut free);
        assert_eq!(found.members, [0, 2, 3, 5]);
        assert_eq!(free, BTreeSet::from([1, 4]));
        assert_eq!(found.reason, "made by hand (`p9` names no photo)");
        let wanted = HandMade {
            sols: Vec::new(),
            ids: ["p9", "p1", "p8", "p7"].map(str::to_owned).to_vec(),
        };
        let found = Group::by_hand("delta", &wanted, &items, &mut (0..6).collect());
        assert_eq!(found.reason, "made by hand (`p9` and 2 others name no photo)");
    }

    #[test]
    fn equal_names_are_told_apart() {
        let mut groups = vec![group(&[0]), group(&[1]), group(&[2])];
        groups[2].name = "g-2".to_owned();
        name_apart(&mut groups);
        let names: Vec<&str> = groups.iter().map(|group| group.name.as_str()).collect();
        assert_eq!(names, ["g", "g-2", "g-2-2"]);
    }
}
