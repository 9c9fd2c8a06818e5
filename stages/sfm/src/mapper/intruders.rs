//! Photos that something hides which their neighbours do not show: a heat shield in one photo of a descent.
//!
//! A photo shows 0.2 to 0.9 of the points that two neighbours show from like directions, with gaps of single cells. On 340 photos of nine
//! sets, real and drawn, at most 0.2 of the compared cells of a photo show none. A disc over 0.6 of a photo empties 0.97 of them.

use nalgebra::Vector3;

use super::input::MapperInput;
use super::model::Model;
use super::register::neighbours;

/// Cells a side of the grid on which a photo is compared with its neighbours.
const GRID: usize = 10;
/// Neighbours that must show a point from a like place for the photo to be expected to show it.
const WITNESSES: usize = 2;
/// Cosine of the largest angle at the point between both places: 30 degrees.
const LIKE_DIRECTION: f64 = 0.866_025_403_784_438_6;
/// Largest factor between both distances of the point.
const LIKE_DISTANCE: f64 = 2.0;
/// Expected points from which a cell is compared. By chance, a photo that shows 0.4 of them shows none of six in one cell of 21.
const COMPARED: usize = 6;
/// A cell is hidden if the photo shows at most this share of as many points as are expected there.
const SHOWN_SHARE: f64 = 0.05;
/// A photo is hidden if at least this share of its compared cells is, with this many expected points.
const HIDDEN_SHARE: f64 = 1.0 / 3.0;
const HIDDEN_POINTS: usize = 100;
/// If a larger share of the photos differs from its neighbours, it is open which of them are hidden.
const MOST_PHOTOS: f64 = 0.25;

/// A photo of which something hides a part.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HiddenPhoto {
    /// Its index.
    pub photo: usize,
    /// Share of the compared area that is hidden, in [0, 1].
    pub share: f64,
    /// Points that its neighbours show in that area, and those of them that it shows.
    pub expected: usize,
    /// See there.
    pub shown: usize,
}

/// Removes the photos of a model that something hides in part, and returns them. The others stay where they are: what such a photo shows
/// agrees with them.
pub fn remove_hidden(input: &MapperInput<'_>, model: &mut Model) -> Vec<HiddenPhoto> {
    let photos: Vec<usize> = model.photos().collect();
    let found = photos.iter().filter_map(|&photo| hidden(input, model, photo));
    let found: Vec<HiddenPhoto> = found.collect();
    if found.is_empty() || found.len() as f64 > MOST_PHOTOS * photos.len() as f64 {
        return Vec::new();
    }
    for one in &found {
        model.remove(input, one.photo);
    }
    let removed: Vec<usize> = found.iter().map(|one| one.photo).collect();
    model.filter(input, input.tracks.of_photos(&removed));
    model.move_anchor();
    found
}

/// Points of a cell of a photo.
#[derive(Debug, Clone, Copy, Default)]
struct Cell {
    /// Those that enough neighbours show from like places.
    expected: usize,
    /// Those of them that the photo shows.
    shown: usize,
    /// All that the photo shows.
    own: usize,
}

impl Cell {
    fn is_hidden(&self) -> bool {
        self.expected >= COMPARED && self.own as f64 <= SHOWN_SHARE * self.expected as f64
    }
}

/// Returns the photo if something hides a part of it.
fn hidden(input: &MapperInput<'_>, model: &Model, photo: usize) -> Option<HiddenPhoto> {
    let cells = cells(input, model, photo)?;
    let compared = cells.iter().filter(|cell| cell.expected >= COMPARED).count();
    let hidden: Vec<&Cell> = cells.iter().filter(|cell| cell.is_hidden()).collect();
    let found = HiddenPhoto {
        photo,
        share: hidden.len() as f64 / compared.max(1) as f64,
        expected: hidden.iter().map(|cell| cell.expected).sum(),
        shown: hidden.iter().map(|cell| cell.shown).sum(),
    };
    (found.share >= HIDDEN_SHARE && found.expected >= HIDDEN_POINTS).then_some(found)
}

/// Returns the points that a placed photo and its neighbours show, by the cell of the photo in which they are.
fn cells(input: &MapperInput<'_>, model: &Model, photo: usize) -> Option<Vec<Cell>> {
    let (pose, camera) = (model.poses[photo]?, &model.cameras[input.views[photo].camera]);
    let own = pose.centre();
    let cell_of = |point: &Vector3<f64>| {
        let pixel = camera.project(&pose.point(point))?;
        let place = |at: f64, side: u32| {
            let place = (at / f64::from(side) * GRID as f64).floor();
            (0.0..GRID as f64).contains(&place).then_some(place as usize)
        };
        Some(place(pixel.y, camera.height)? * GRID + place(pixel.x, camera.width)?)
    };
    let mut cells = vec![Cell::default(); GRID * GRID];
    for track in input.tracks.of_photos(&neighbours(input, model, photo)) {
        let Some(point) = model.points[track] else {
            continue;
        };
        let Some(cell) = cell_of(&point).map(|index| &mut cells[index]) else {
            continue;
        };
        let active = input.tracks.range(track).filter(|&index| model.active[index]);
        let observers = active.map(|index| input.tracks.observations[index].photo as usize);
        let (mut is_shown, mut witnesses) = (false, 0);
        for other in observers {
            is_shown |= other == photo;
            let is_like = |pose: marf_scene::Pose| is_like(&own, &pose.centre(), &point);
            witnesses += usize::from(other != photo && model.poses[other].is_some_and(is_like));
        }
        cell.own += usize::from(is_shown);
        if witnesses >= WITNESSES {
            cell.expected += 1;
            cell.shown += usize::from(is_shown);
        }
    }
    Some(cells)
}

/// Returns whether a point is seen from both places in like directions from like distances.
fn is_like(one: &Vector3<f64>, other: &Vector3<f64>, point: &Vector3<f64>) -> bool {
    let (one, other) = (point - one, point - other);
    let (near, far) = (one.norm().min(other.norm()), one.norm().max(other.norm()));
    far <= LIKE_DISTANCE * near && one.dot(&other) >= LIKE_DIRECTION * near * far
}
