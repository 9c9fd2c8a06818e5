//! Photos grouped by what their labels say of the rover's place.

use std::collections::BTreeMap;

use nalgebra::Vector3;

use super::group::{Group, mean};
use super::label_position::LabelPosition;

/// Photos taken from one place: of one site and drive, or a part of them if there are too many for one scene.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Place {
    pub site: i64,
    pub drive: Option<i64>,
    /// Mean of the cameras in the site's frame, metres: north, east, down.
    pub centre: Vector3<f64>,
    /// Indices of the photos.
    pub members: Vec<usize>,
}

/// Site, and drive if a label has it.
pub(super) type Stop = (i64, Option<i64>);

/// Returns the places of photos `(index, label)`, which come in the order in which they were taken, by site and drive.
pub(super) fn places(photos: &[(usize, LabelPosition)], max_photos: usize) -> Vec<Place> {
    let mut by_stop: BTreeMap<Stop, Vec<(usize, Vector3<f64>)>> = BTreeMap::new();
    for (index, label) in photos {
        let stop = by_stop.entry((label.site, label.drive)).or_default();
        stop.push((*index, label.centre));
    }
    let place = |(site, drive): Stop, photos: &[(usize, Vector3<f64>)]| Place {
        site,
        drive,
        centre: mean(photos.iter().map(|(_, centre)| centre)),
        members: photos.iter().map(|(index, _)| *index).collect(),
    };
    let places = by_stop.iter().flat_map(|(stop, photos)| {
        let parts = photos.chunks(max_photos.max(1));
        parts.map(move |part| place(*stop, part))
    });
    places.collect()
}

/// Returns groups of places. Each place joins the nearest group of its site that then stays within the limits, or begins a new one.
///
/// Places come by drive, so that a new sol changes no group but those it joins.
pub(super) fn joined(places: &[Place], max_span_m: f64, max_photos: usize) -> Vec<Vec<&Place>> {
    let mut groups: Vec<Vec<&Place>> = Vec::new();
    for place in places {
        let distances = |group: &[&Place]| -> (f64, f64) {
            let each = group.iter().map(|other| (other.centre - place.centre).norm());
            each.fold((f64::INFINITY, 0.0), |(least, most), one| {
                (least.min(one), most.max(one))
            })
        };
        let nearest = groups
            .iter()
            .enumerate()
            .filter(|(_, group)| group[0].site == place.site)
            .filter(|(_, group)| count(group) + place.members.len() <= max_photos)
            .map(|(index, group)| (index, distances(group)))
            .filter(|(_, (_, farthest))| *farthest <= max_span_m)
            .min_by(|a, b| a.1.0.total_cmp(&b.1.0));
        match nearest {
            Some((index, _)) => groups[index].push(place),
            None => groups.push(vec![place]),
        }
    }
    groups
}

fn count(places: &[&Place]) -> usize {
    places.iter().map(|place| place.members.len()).sum()
}

/// Returns the group that places make, named by the site and the first drive.
pub(super) fn group(places: &[&Place]) -> Group {
    let (first, last) = (places[0], places[places.len() - 1]);
    let name = match first.drive {
        Some(drive) => format!("site{}-{drive}", first.site),
        None => format!("site{}", first.site),
    };
    let where_ = match (first.drive, last.drive) {
        (Some(from), Some(to)) if from != to => format!("site {}, drives {from} to {to}", first.site),
        (Some(drive), _) => format!("site {}, drive {drive}", first.site),
        (None, _) => format!("site {}", first.site),
    };
    Group {
        name,
        reason: format!("by labels: {where_}"),
        members: places
            .iter()
            .flat_map(|place| place.members.iter().copied())
            .collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn place(site: i64, drive: i64, north: f64, photos: usize) -> Place {
        Place {
            site,
            drive: Some(drive),
            centre: Vector3::new(north, 0.0, 0.0),
            members: (0..photos).collect(),
        }
    }

    fn drives(places: &[Place], span: f64, photos: usize) -> Vec<Vec<i64>> {
        let groups = joined(places, span, photos);
        let drive = |place: &&Place| place.drive.unwrap();
        groups
            .iter()
            .map(|group| group.iter().map(drive).collect())
            .collect()
    }

    #[test]
    fn places_within_the_span_are_one_scene_and_sites_are_never_mixed() {
        let places = [
            place(1, 0, 0.0, 10),
            place(1, 5, 8.0, 10),
            place(1, 9, 40.0, 10),
            place(1, 12, 12.0, 10),
            place(2, 0, 0.0, 10),
        ];
        assert_eq!(drives(&places, 20.0, 100), [vec![0, 5, 12], vec![9], vec![0]]);
        // 40 m apart. The place between joins the nearer one.
        assert_eq!(
            drives(
                &[place(1, 0, 0.0, 1), place(1, 1, 40.0, 1), place(1, 2, 25.0, 1)],
                30.0,
                9
            ),
            [vec![0], vec![1, 2]]
        );
    }

    #[test]
    fn a_scene_is_named_by_its_first_drive_and_says_its_last() {
        let of = |first: i64, last: i64| group(&[&place(3, first, 0.0, 1), &place(3, last, 1.0, 1)]);
        let found = of(5, 12);
        assert_eq!(
            (found.name.as_str(), found.reason.as_str()),
            ("site3-5", "by labels: site 3, drives 5 to 12")
        );
        assert_eq!(of(5, 5).reason, "by labels: site 3, drive 5");
    }

    #[test]
    fn a_full_scene_takes_no_further_place() {
        let places = [place(1, 0, 0.0, 6), place(1, 1, 1.0, 6), place(1, 2, 2.0, 4)];
        assert_eq!(drives(&places, 20.0, 10), [vec![0], vec![1, 2]]);
    }

    /// What a traverse adds at its end leaves the groups before it as they are, but for the one it may join.
    #[test]
    fn a_new_drive_changes_no_other_group() {
        let all: Vec<Place> = (0..40)
            .map(|drive| place(1, drive, drive as f64 * 4.0, 7))
            .collect();
        for known in 1..all.len() {
            let (before, after) = (drives(&all[..known], 30.0, 50), drives(&all[..=known], 30.0, 50));
            let changed = before.iter().filter(|group| !after.contains(group)).count();
            assert!(changed <= 1, "{known}: {before:?} {after:?}");
        }
    }

    #[test]
    fn photos_of_one_stop_are_one_place_and_too_many_are_several() {
        let at = |drive: i64, north: f64| LabelPosition {
            site: 3,
            drive: Some(drive),
            centre: Vector3::new(north, 0.0, 0.0),
        };
        let photos = [(0, at(4, 1.0)), (1, at(2, 5.0)), (2, at(4, 3.0)), (3, at(4, 8.0))];
        let found = places(&photos, 10);
        assert_eq!(found.len(), 2);
        assert_eq!((found[0].drive, found[0].members.as_slice()), (Some(2), &[1][..]));
        assert_eq!(
            (found[1].centre.x, found[1].members.as_slice()),
            (4.0, &[0, 2, 3][..])
        );
        let parts: Vec<usize> = places(&photos, 2)
            .iter()
            .map(|place| place.members.len())
            .collect();
        assert_eq!(parts, [1, 2, 1]);
        assert_eq!(places(&[], 2), []);
    }
}
