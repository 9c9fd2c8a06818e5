//! Which photos were taken from nearly one place in nearly one direction, and which of such places are held out.

use nalgebra::{SVector, Vector3};

use crate::reach::{Posed, reach};
use crate::{Camera, Frame, Point, Pose};

/// Photos are near if they were taken from within this share of the distance to what they show: parallax of 9 degrees. A
/// stereo pair with 0.42 m between its eyes is near from 2.8 m on.
const NEAR_SHARE: f64 = 0.15;
/// ... in directions whose unit vectors are at most this far apart: 15 degrees, 2 sin 7.5°.
const NEAR_CHORD: f64 = 0.261_052_384_440_103_1;
/// A place has at most this share of the photos to be held out, so that several are, ...
const PLACES: usize = 3;
/// ... but may have two versions of a stereo pair. With few photos it may have as many as are to be held out, but at least a pair.
const VERSIONS: usize = 4;
/// Nearest photos that one is compared with.
const NEIGHBOURS: usize = 8;

/// A photo: its id, which settles ties, its camera and its pose.
#[derive(Debug, Clone, Copy)]
pub struct PosedPhoto<'a> {
    /// Id, unique in the set.
    pub id: &'a str,
    /// Its camera.
    pub camera: &'a Camera,
    /// Its pose.
    pub cam_from_world: &'a Pose,
}

impl<'a> From<&'a Frame> for PosedPhoto<'a> {
    fn from(frame: &'a Frame) -> Self {
        Self {
            id: &frame.id,
            camera: &frame.camera,
            cam_from_world: &frame.cam_from_world,
        }
    }
}

impl<'a> PosedPhoto<'a> {
    pub(crate) fn posed(&self) -> Posed<'a> {
        (self.camera, self.cam_from_world)
    }
}

/// Position and optical axis, such that two photos are near where their distance is at most 1.
pub(crate) type Place = SVector<f64, 6>;

/// Returns for each photo whether it is held out: whole places, about one photo in `every`, spread over the scene.
///
/// A place is a group of photos with near positions and near directions, such as stereo pairs, versions of an exposure and neighbours on a
/// path. Positions are near within 0.15 of the typical distance to what the photos show, directions within 15 degrees. That distance
/// follows from the sparse `points`, or from the cameras without them.
///
/// Of the photos to be held out, a place has at most a third, or two to four if a third is fewer. It never has more than half of all
/// photos. The answer depends on ids and poses, not on the order of the photos. 0 holds no photo out. Of two photos and more at least one
/// is held out and one is not. O(n²) time, O(n) memory.
pub fn hold_out_places(photos: &[PosedPhoto<'_>], points: &[Point], every: u32) -> Vec<bool> {
    hold_out_more_places(photos, points, every, &vec![None; photos.len()])
}

/// As [`hold_out_places`] for a set that has grown. `known` says whether each photo was held out before, and is `None` for a new photo.
///
/// Known photos stay as they were. A new photo at a known place is held out if that place is. New places fill up the share. With `every` =
/// 0 no photo is held out, known or not.
pub fn hold_out_more_places(
    photos: &[PosedPhoto<'_>],
    points: &[Point],
    every: u32,
    known: &[Option<bool>],
) -> Vec<bool> {
    let mut held_out = vec![false; photos.len()];
    if every == 0 {
        return held_out;
    }
    let most = most_in_a_place(photos.len(), every);
    let (known, new): (Vec<_>, Vec<_>) = places(photos, points, most, known)
        .into_iter()
        .partition(|group| group.known.is_some());
    let before = known.iter().filter(|group| group.known == Some(true));
    let before: Vec<usize> = before.flat_map(|group| group.photos.clone()).collect();
    let all = known.iter().map(|group| group.photos.len()).sum::<usize>();
    // However much is owed from before, at most about half of the new photos are held out.
    let (share, new_photos) = (1.0 / f64::from(every), (photos.len() - all) as f64);
    let owed = (all as f64 * share - before.len() as f64).min(new_photos * (0.5 - share).max(0.0));
    let needs_one = before.is_empty() && known.len() + new.len() > 1;
    let mut after = chosen(&new, every, owed);
    if needs_one && after.is_empty() {
        after = nearest_in_size(&new, every);
    }
    for photo in before.into_iter().chain(after) {
        held_out[photo] = true;
    }
    held_out
}

/// Returns for each photo the fold in which it is held out. Whole places are dealt out such that folds have about as many photos and each
/// is spread over the scene.
///
/// Places are as in [`hold_out_places`] with `every` = `folds`. The folds are numbered from 0 without gaps. There are `folds` of them, or
/// as many as there are places. The answer depends on ids and poses, not on the order of the photos.
pub fn folds(photos: &[PosedPhoto<'_>], points: &[Point], folds: u32) -> Vec<u32> {
    let most = most_in_a_place(photos.len(), folds.max(1));
    let groups = places(photos, points, most, &vec![None; photos.len()]);
    let mut walk: Vec<&Group> = groups.iter().collect();
    walk_through(&mut walk);
    let mut sizes = vec![0; (folds.max(1) as usize).min(walk.len())];
    let mut fold_of = vec![0; photos.len()];
    for group in walk {
        let Some(fold) = (0..sizes.len()).min_by_key(|fold| sizes[*fold]) else {
            break;
        };
        sizes[fold] += group.photos.len();
        group
            .photos
            .iter()
            .for_each(|photo| fold_of[*photo] = fold as u32);
    }
    fold_of
}

/// Returns the number of the place of each photo, in the order of the smallest id in each. Places are as in [`hold_out_places`], of any
/// number of photos.
pub fn places_of(photos: &[PosedPhoto<'_>], points: &[Point]) -> Vec<usize> {
    let mut place_of = vec![0; photos.len()];
    let groups = places(photos, points, photos.len(), &vec![None; photos.len()]);
    for (number, group) in groups.iter().enumerate() {
        group.photos.iter().for_each(|photo| place_of[*photo] = number);
    }
    place_of
}

/// Returns how many of `photos` a place may have if one in `every` is held out.
fn most_in_a_place(photos: usize, every: u32) -> usize {
    let third = photos / (PLACES * every as usize);
    let wanted = photos.div_ceil(every as usize).clamp(2, VERSIONS);
    third.max(wanted).min(photos / 2).max(1)
}

/// A group of photos.
#[derive(Debug, Clone)]
struct Group {
    /// Indices of its photos.
    photos: Vec<usize>,
    low: Place,
    high: Place,
    /// Whether its known photos were held out before. `None` if all are new.
    known: Option<bool>,
}

impl Group {
    fn single(photo: usize, place: Place, known: Option<bool>) -> Self {
        Self {
            photos: vec![photo],
            low: place,
            high: place,
            known,
        }
    }

    /// Returns whether both can be one group: a photo held out before and one trained on cannot.
    fn may_join(&self, other: &Self) -> bool {
        self.known.is_none() || other.known.is_none() || self.known == other.known
    }

    fn with(&self, other: &Self) -> Self {
        Self {
            photos: [self.photos.as_slice(), &other.photos].concat(),
            low: self.low.inf(&other.low),
            high: self.high.sup(&other.high),
            known: self.known.or(other.known),
        }
    }

    /// Returns the diagonal of its bounds: no two of its photos are farther apart.
    fn extent(&self) -> f64 {
        (self.high - self.low).norm()
    }

    fn middle(&self) -> Place {
        (self.low + self.high) / 2.0
    }
}

/// Returns groups of at most `most` photos, in the order of the smallest id in each. Every photo is in one group. No group mixes photos
/// `known` to be held out with photos known not to be.
fn places(photos: &[PosedPhoto<'_>], points: &[Point], most: usize, known: &[Option<bool>]) -> Vec<Group> {
    let mut order: Vec<usize> = (0..photos.len()).collect();
    order.sort_by_key(|photo| photos[*photo].id);
    let cameras: Vec<Posed<'_>> = order.iter().map(|photo| photos[*photo].posed()).collect();
    let reach = reach(&cameras, points);
    let places: Vec<Place> = cameras.iter().map(|(_, pose)| place(pose, reach)).collect();
    let known: Vec<Option<bool>> = order.iter().map(|photo| known[*photo]).collect();
    let groups = merged(&places, most, &known);
    let named = groups.into_iter().map(|group| Group {
        photos: group.photos.iter().map(|index| order[*index]).collect(),
        ..group
    });
    named.collect()
}

/// Returns where a photo was taken and in which direction. `reach` is the typical distance to what photos show.
pub(crate) fn place(cam_from_world: &Pose, reach: f64) -> Place {
    let at = cam_from_world.centre() / (NEAR_SHARE * reach);
    let along: Vector3<f64> = cam_from_world.rotation.row(2).transpose() / NEAR_CHORD;
    Place::from_column_slice(&[at.x, at.y, at.z, along.x, along.y, along.z])
}

/// Merges photos with their neighbours, the nearest first, as long as a group stays near and has at most `most` photos.
fn merged(places: &[Place], most: usize, known: &[Option<bool>]) -> Vec<Group> {
    let mut group_of: Vec<usize> = (0..places.len()).collect();
    let singles = places.iter().zip(known).enumerate();
    let mut groups: Vec<Group> = singles
        .map(|(photo, (place, known))| Group::single(photo, *place, *known))
        .collect();
    for (one, other) in near_pairs(places) {
        let (one, other) = (group_of[one], group_of[other]);
        let (one, other) = (one.min(other), one.max(other));
        let photos = groups[one].photos.len() + groups[other].photos.len();
        if one == other || photos > most || !groups[one].may_join(&groups[other]) {
            continue;
        }
        let both = groups[one].with(&groups[other]);
        if both.extent() <= 1.0 {
            both.photos.iter().for_each(|photo| group_of[*photo] = one);
            groups[one] = both;
            groups[other].photos.clear();
        }
    }
    groups.retain(|group| !group.photos.is_empty());
    groups
}

/// Returns the pairs of photos that are near, each photo with its nearest ones, nearest first. Ties are in the order of photos.
fn near_pairs(places: &[Place]) -> Vec<(usize, usize)> {
    let mut pairs = Vec::new();
    for (one, place) in places.iter().enumerate() {
        let mut nearest: Vec<(f64, usize, usize)> = Vec::with_capacity(NEIGHBOURS + 1);
        for (other, at) in places.iter().enumerate().filter(|(other, _)| *other != one) {
            let apart = (at - place).norm_squared();
            let last = nearest.get(NEIGHBOURS - 1).map_or(1.0, |last| last.0);
            if apart <= last {
                // Of photos in one place each is paired with its neighbours in the order.
                let found = (apart, one.abs_diff(other), other);
                let before =
                    |known: &(f64, usize, usize)| (known.0, known.1, known.2) < (found.0, found.1, found.2);
                nearest.insert(nearest.partition_point(before), found);
                nearest.truncate(NEIGHBOURS);
            }
        }
        let found = nearest.into_iter();
        pairs.extend(found.map(|(apart, _, other)| (apart, one.min(other), one.max(other))));
    }
    pairs.sort_by(|a, b| a.0.total_cmp(&b.0).then((a.1, a.2).cmp(&(b.1, b.2))));
    pairs.dedup();
    pairs.into_iter().map(|(_, one, other)| (one, other)).collect()
}

/// Returns the photos of the groups that are held out.
///
/// Groups are visited in an order in which neighbours follow each other. Each adds its share to the photos owed, and one that is taken pays
/// with its photos. `owed` is the number owed before.
fn chosen(groups: &[Group], every: u32, mut owed: f64) -> Vec<usize> {
    let photos: usize = groups.iter().map(|group| group.photos.len()).sum();
    let mut walk: Vec<&Group> = groups.iter().collect();
    walk_through(&mut walk);
    let share = 1.0 / f64::from(every);
    let half_a_group = photos as f64 / groups.len().max(1) as f64 / 2.0;
    let is_taken = |group: &&Group| {
        let size = group.photos.len() as f64;
        owed += size * share;
        let is_due = owed >= half_a_group;
        owed -= if is_due { size } else { 0.0 };
        is_due
    };
    let taken = walk.into_iter().filter(is_taken);
    taken.flat_map(|group| group.photos.iter().copied()).collect()
}

/// Returns the photos of the group that has most nearly one photo in `every`. Empty without groups.
fn nearest_in_size(groups: &[Group], every: u32) -> Vec<usize> {
    let photos: usize = groups.iter().map(|group| group.photos.len()).sum();
    let mut walk: Vec<&Group> = groups.iter().collect();
    walk_through(&mut walk);
    let share = 1.0 / f64::from(every);
    let off = |group: &&Group| (group.photos.len() as f64 - photos as f64 * share).abs();
    let best = walk.into_iter().min_by(|a, b| off(a).total_cmp(&off(b)));
    best.map_or_else(Vec::new, |group| group.photos.clone())
}

/// Sorts groups so that neighbours follow each other: halves along the widest axis, then each half likewise.
fn walk_through(groups: &mut [&Group]) {
    if groups.len() < 3 {
        return;
    }
    let low = groups
        .iter()
        .fold(Place::repeat(f64::MAX), |low, group| low.inf(&group.middle()));
    let high = groups
        .iter()
        .fold(Place::repeat(f64::MIN), |high, group| high.sup(&group.middle()));
    let axis = (high - low).imax();
    // A stable sort: ties keep the order of ids.
    groups.sort_by(|a, b| a.middle()[axis].total_cmp(&b.middle()[axis]));
    let (left, right) = groups.split_at_mut(groups.len() / 2);
    walk_through(left);
    walk_through(right);
}

#[cfg(test)]
mod tests;
