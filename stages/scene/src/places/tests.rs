use super::*;

/// Deterministic numbers in [0, 1): the fractional parts of multiples of the golden ratio.
fn spread(index: usize, factor: f64) -> f64 {
    (index as f64 * 0.618_033_988_749_895 * factor).fract()
}

struct Set {
    camera: Camera,
    photos: Vec<(String, Pose)>,
}

impl Set {
    fn new(photos: impl Iterator<Item = (Vector3<f64>, Vector3<f64>)>) -> Self {
        let pose = |(eye, target)| Pose::looking_at(eye, target, Vector3::z());
        let named = photos.enumerate();
        Self {
            camera: Camera::pinhole(64, 48, 60.0),
            photos: named
                .map(|(index, at)| (format!("{index:05}"), pose(at)))
                .collect(),
        }
    }

    /// Stereo pairs, 0.02 apart, on a circle of radius 3 around what they look at.
    fn pairs(count: usize) -> Self {
        Self::new((0..2 * count).map(|index| {
            let turn = (index / 2) as f64 / count as f64 * std::f64::consts::TAU;
            let aside = Vector3::new(-turn.sin(), turn.cos(), 0.0) * (0.01 - 0.02 * (index % 2) as f64);
            let eye = Vector3::new(3.0 * turn.cos(), 3.0 * turn.sin(), -1.0);
            (eye + aside, aside)
        }))
    }

    fn scattered(count: usize) -> Self {
        Self::new((0..count).map(|index| {
            let eye = Vector3::new(spread(index, 1.0), spread(index, 7.3), spread(index, 31.9)) * 20.0;
            let ahead = Vector3::new(spread(index, 3.1) - 0.5, spread(index, 5.7) - 0.5, 0.2);
            (eye, eye + ahead)
        }))
    }

    fn of(&self, order: impl Iterator<Item = usize>) -> Vec<PosedPhoto<'_>> {
        let photo = |index: usize| PosedPhoto {
            id: &self.photos[index].0,
            camera: &self.camera,
            cam_from_world: &self.photos[index].1,
        };
        order.map(photo).collect()
    }

    fn photos(&self) -> Vec<PosedPhoto<'_>> {
        self.of(0..self.photos.len())
    }

    fn held_out(&self, every: u32) -> Vec<bool> {
        hold_out_places(&self.photos(), &[], every)
    }
}

fn count(held_out: &[bool]) -> usize {
    held_out.iter().filter(|held_out| **held_out).count()
}

#[test]
fn stereo_pairs_stay_together_and_an_eighth_is_held_out_all_around() {
    let held_out = Set::pairs(40).held_out(8);
    assert!((8..=12).contains(&count(&held_out)), "{held_out:?}");
    for pair in held_out.chunks(2) {
        assert_eq!(pair[0], pair[1], "{held_out:?}");
    }
    for quarter in held_out.chunks(20) {
        assert!(count(quarter) > 0, "{held_out:?}");
    }
}

#[test]
fn no_group_is_split_and_every_photo_is_in_one() {
    for set in [Set::pairs(3), Set::pairs(50), Set::scattered(200)] {
        for every in [2, 3, 8, 50] {
            let photos = set.photos();
            let groups = places(
                &photos,
                &[],
                most_in_a_place(photos.len(), every),
                &vec![None; photos.len()],
            );
            let held_out = set.held_out(every);
            let mut all: Vec<usize> = groups.iter().flat_map(|group| group.photos.clone()).collect();
            all.sort_unstable();
            assert_eq!(all, (0..photos.len()).collect::<Vec<_>>());
            for group in &groups {
                let of_group: Vec<bool> = group.photos.iter().map(|photo| held_out[*photo]).collect();
                assert!(
                    of_group.iter().all(|one| *one == of_group[0]),
                    "{every}: {of_group:?}"
                );
                assert!(group.extent() <= 1.0, "{every}: {}", group.extent());
            }
        }
    }
}

#[test]
fn about_one_photo_in_so_many_is_held_out() {
    for set in [Set::pairs(60), Set::scattered(120), Set::scattered(2000)] {
        for every in [2, 5, 8, 20] {
            let (held_out, wanted) = (
                count(&set.held_out(every)),
                set.photos.len() as f64 / f64::from(every),
            );
            assert!(
                (held_out as f64 - wanted).abs() <= 4.0 + wanted / 3.0,
                "{held_out} of {wanted}"
            );
        }
    }
}

#[test]
fn the_order_of_the_photos_does_not_matter() {
    for set in [Set::pairs(33), Set::scattered(101)] {
        let size = set.photos.len();
        let straight = set.held_out(8);
        // 7 has no factor in common with 66 and 101.
        for step in [size - 1, 7] {
            let order: Vec<usize> = (0..size).map(|index| (index * step + 5) % size).collect();
            let turned = hold_out_places(&set.of(order.iter().copied()), &[], 8);
            for (index, photo) in order.iter().enumerate() {
                assert_eq!(turned[index], straight[*photo], "step {step}, photo {photo}");
            }
        }
    }
}

#[test]
fn the_extremes_hold_one_out_and_train_on_one() {
    let same = |count: usize| Set::new((0..count).map(|_| (Vector3::zeros(), Vector3::x())));
    assert_eq!(same(0).held_out(8), [] as [bool; 0]);
    assert_eq!(same(1).held_out(8), [false]);
    for size in 2..40 {
        for every in [2, 3, 8, u32::MAX] {
            for set in [same(size), Set::scattered(size)] {
                let held_out = count(&set.held_out(every));
                assert!(
                    held_out > 0 && held_out < size,
                    "{held_out} of {size}, every {every}"
                );
            }
        }
    }
    assert_eq!(count(&same(30).held_out(0)), 0);
    let many = same(400).held_out(8);
    assert!((40..=66).contains(&count(&many)), "{}", count(&many));
}

#[test]
fn ten_thousand_cameras_are_split() {
    let held_out = count(&Set::scattered(10_000).held_out(8));
    assert!((1_200..=1_300).contains(&held_out), "{held_out}");
}

/// Points nearer than the cameras' own spread show that photos a step apart see different things.
#[test]
fn sparse_points_decide_what_is_near() {
    let walk = Set::new((0..64).map(|index| {
        let eye = Vector3::new(f64::from(index) * 0.05, 0.0, 0.0);
        (eye, eye + Vector3::y())
    }));
    let points = |away: f64| -> Vec<Point> {
        let point = |index: u32| Point {
            position: [f64::from(index) * 0.05, away, 0.0],
            color: None,
            views: 2,
        };
        (0..64).map(point).collect()
    };
    let groups = |away: f64| {
        let most = most_in_a_place(walk.photos().len(), 2);
        places(&walk.photos(), &points(away), most, &[None; 64]).len()
    };
    assert!(
        groups(0.2) == 64 && groups(20.0) < 16,
        "{} {}",
        groups(0.2),
        groups(20.0)
    );
}

#[test]
fn photos_of_one_place_have_its_number_and_others_another() {
    let set = Set::pairs(6);
    let places = places_of(&set.photos(), &[]);
    let twins: Vec<usize> = places.chunks(2).map(|pair| pair[0]).collect();
    assert!(places.chunks(2).all(|pair| pair[0] == pair[1]), "{places:?}");
    assert_eq!(twins, [0, 1, 2, 3, 4, 5]);
    assert!(places_of(&[], &[]).is_empty());
}

#[test]
fn folds_hold_out_whole_places_each_about_as_many_and_in_any_order() {
    let set = Set::pairs(12);
    let fold_of = folds(&set.photos(), &[], 4);
    for pair in fold_of.chunks(2) {
        assert_eq!(
            pair[0], pair[1],
            "a stereo pair is held out together: {fold_of:?}"
        );
    }
    for fold in 0..4 {
        assert_eq!(fold_of.iter().filter(|of| **of == fold).count(), 6);
    }
    // Neighbours on the circle are not all in one fold.
    assert!(fold_of.chunks(6).all(|part| part.iter().any(|of| *of != part[0])));
    let reversed = folds(&set.of((0..24).rev()), &[], 4);
    assert!(fold_of.iter().rev().eq(&reversed));
}

#[test]
fn there_are_as_many_folds_as_places_and_none_is_empty() {
    let set = Set::scattered(5);
    for (count, expected) in [(0, 1), (1, 1), (2, 2), (5, 5), (9, 5), (u32::MAX, 5)] {
        let fold_of = folds(&set.photos(), &[], count);
        let mut found = fold_of.clone();
        found.sort_unstable();
        found.dedup();
        assert_eq!(found, (0..expected).collect::<Vec<u32>>(), "{count}: {fold_of:?}");
    }
    assert!(folds(&[], &[], 4).is_empty());
}

/// Returns what is known of each photo if the first ones were in an earlier set.
fn known(before: &[bool], photos: usize) -> Vec<Option<bool>> {
    let known = before.iter().copied().map(Some);
    known.chain(std::iter::repeat(None)).take(photos).collect()
}

/// A set that grows by a tenth, a third or as much again, in steps: no flag changes, and the share holds after each.
#[test]
fn photos_that_were_held_out_stay_so_as_the_set_grows_and_the_share_holds() {
    for set in [Set::scattered(400), Set::pairs(200)] {
        for (first, step) in [(200, 20), (150, 50), (100, 100), (31, 1)] {
            for every in [3, 8] {
                let photos = set.photos();
                let mut held_out = hold_out_places(&photos[..first], &[], every);
                for size in (first + step..=photos.len().min(first + 8 * step)).step_by(step) {
                    let known = known(&held_out, size);
                    let grown = hold_out_more_places(&photos[..size], &[], every, &known);
                    assert_eq!(
                        grown[..held_out.len()],
                        held_out,
                        "{first} to {size}, every {every}"
                    );
                    let (found, wanted) = (count(&grown), size as f64 / f64::from(every));
                    assert!(
                        (found as f64 - wanted).abs() <= 4.0 + wanted / 3.0,
                        "{found} of {size}, every {every}"
                    );
                    held_out = grown;
                }
            }
        }
    }
}

/// The second eye of each stereo pair comes later: it is held out with the first, or trained on with it.
#[test]
fn a_new_photo_beside_a_known_one_is_held_out_with_it() {
    let set = Set::pairs(40);
    let firsts = set.of((0..80).step_by(2));
    let before = hold_out_places(&firsts, &[], 8);
    assert!(count(&before) >= 4);
    let both = set.of((0..80).step_by(2).chain((1..80).step_by(2)));
    let after = hold_out_more_places(&both, &[], 8, &known(&before, 80));
    assert_eq!(after[..40], before);
    assert_eq!(after[40..], before, "each second eye is as its first");
}

/// Without known photos the result is that of a new set. A share of 0 holds no photo out, whatever was before.
#[test]
fn without_known_photos_nothing_is_other_than_before() {
    let set = Set::scattered(60);
    let photos = set.photos();
    let alone = hold_out_more_places(&photos, &[], 8, &[None; 60]);
    assert_eq!(alone, set.held_out(8));
    assert_eq!(
        count(&hold_out_more_places(&photos, &[], 0, &[Some(true); 60])),
        0
    );
}

/// A raised share holds out some of the new photos, not all. A lowered share holds out no more.
#[test]
fn another_share_than_before_changes_only_what_is_new() {
    let set = Set::scattered(240);
    let photos = set.photos();
    let before = hold_out_places(&photos[..200], &[], 8);
    let more = hold_out_more_places(&photos, &[], 3, &known(&before, 240));
    assert_eq!(more[..200], before);
    let new = count(&more[200..]);
    assert!((10..=30).contains(&new), "{new} of 40");
    let fewer = hold_out_more_places(&photos, &[], 50, &known(&before, 240));
    assert_eq!((&fewer[..200], count(&fewer[200..])), (before.as_slice(), 0));
}

/// Whatever the earlier set was, at least one photo is held out and one is not. The exception is that all new ones are at known places, as
/// the last two of 12 are.
#[test]
fn a_set_whose_known_photos_are_of_one_kind_has_both_kinds() {
    let set = Set::scattered(12);
    let photos = set.photos();
    for kind in [false, true] {
        for size in 1..12 {
            let held_out = hold_out_more_places(&photos, &[], 8, &known(&vec![kind; size], 12));
            assert!(held_out[..size].iter().all(|one| *one == kind));
            let found = count(&held_out);
            assert_eq!(found > 0, kind || size < 10, "{kind} {size}: {found}");
            assert_eq!(found < 12, !kind || size < 10, "{kind} {size}: {found}");
        }
    }
}
