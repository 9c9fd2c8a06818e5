//! Things that hide the scene: in one photo (a heat shield below a lander), or in all photos of a camera (the rover's deck, dirt).
//!
//! A photo shows 0.2 to 0.9 of the points that two neighbours show from like directions, with gaps of single cells. On 390 photos of nine
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
/// Photos of a camera from which a part of its pictures can be called fixed, and points that are expected in a cell of that part, over all
/// photos: with 60 of them the least share of any cell of the same sets is 0.31, and 0.00 where a deck is.
const FIXED_PHOTOS: usize = 8;
const FIXED_POINTS: usize = 60;
/// Points that are expected in a cell next to such a part to add it.
const RIM_POINTS: usize = 12;
/// If a larger share of the photos differs from its neighbours, it is open which of them are hidden.
const MOST_PHOTOS: f64 = 0.25;

/// A photo of which something hides a part.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HiddenPhoto {
    /// Its index.
    pub photo: usize,
    /// Cells that are compared, each a hundredth of the photo.
    pub compared_cells: usize,
    /// Those of them that something hides.
    pub hidden_cells: usize,
    /// Points that its neighbours show in hidden cells, and those of them that it shows.
    pub expected: usize,
    /// See there.
    pub shown: usize,
}

/// A part of the pictures of a camera that shows nothing of the scene: the rover's deck, dirt on the lens.
#[derive(Debug, Clone, PartialEq)]
pub struct FixedPart {
    /// Index of the camera.
    pub camera: usize,
    /// Points that are expected there, summed over the photos of the camera.
    pub expected: usize,
    /// Those of them that the photos show.
    pub shown: usize,
    is_in: Vec<bool>,
}

impl FixedPart {
    /// Returns whether it covers a place of a picture, as shares of width and height in [0, 1).
    pub fn covers(&self, x: f64, y: f64) -> bool {
        let index = |share: f64| ((share * GRID as f64) as usize).min(GRID - 1);
        self.is_in[index(y) * GRID + index(x)]
    }
}

/// What hides the scene in photos of a model.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Intruders {
    /// Photos that were removed.
    pub hidden: Vec<HiddenPhoto>,
    /// Parts of the pictures of cameras, each camera at most once.
    pub fixed: Vec<FixedPart>,
}

/// Finds what hides the scene, and removes photos of which something hides a large part that is not fixed to the camera. The other photos
/// stay where they are: what such a photo shows agrees with them.
pub fn remove_intruders(input: &MapperInput<'_>, model: &mut Model) -> Intruders {
    let compared = model.photos().filter_map(|photo| {
        Some(ComparedPhoto {
            photo,
            cells: cells(input, model, photo)?,
        })
    });
    let compared: Vec<ComparedPhoto> = compared.collect();
    let fixed = (0..input.cameras.len()).filter_map(|camera| fixed_part(input, &compared, camera));
    let fixed: Vec<FixedPart> = fixed.collect();
    let hidden = compared.iter().filter_map(|one| {
        let camera = input.views[one.photo].camera;
        one.hidden(fixed.iter().find(|part| part.camera == camera))
    });
    let mut hidden: Vec<HiddenPhoto> = hidden.collect();
    if hidden.len() as f64 > MOST_PHOTOS * compared.len() as f64 {
        hidden.clear();
    }
    let removed: Vec<usize> = hidden.iter().map(|one| one.photo).collect();
    for photo in &removed {
        model.remove(input, *photo);
    }
    model.filter(input, input.tracks.of_photos(&removed));
    model.move_anchor();
    Intruders { hidden, fixed }
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
    /// Returns whether enough points are expected, and hardly any is shown.
    fn is_hidden(&self, enough: usize) -> bool {
        self.expected >= enough && self.own as f64 <= SHOWN_SHARE * self.expected as f64
    }
}

/// A photo with its cells, `[GRID * GRID]`.
struct ComparedPhoto {
    photo: usize,
    cells: Vec<Cell>,
}

impl ComparedPhoto {
    /// Returns the photo if something hides a large part of it, apart from what is fixed to its camera.
    fn hidden(&self, fixed: Option<&FixedPart>) -> Option<HiddenPhoto> {
        let is_open = |index: &usize| fixed.is_none_or(|part| !part.is_in[*index]);
        let cells = || {
            (0..self.cells.len())
                .filter(is_open)
                .map(|index| self.cells[index])
        };
        let compared = cells().filter(|cell| cell.expected >= COMPARED).count();
        let hidden: Vec<Cell> = cells().filter(|cell| cell.is_hidden(COMPARED)).collect();
        let found = HiddenPhoto {
            photo: self.photo,
            compared_cells: compared,
            hidden_cells: hidden.len(),
            expected: hidden.iter().map(|cell| cell.expected).sum(),
            shown: hidden.iter().map(|cell| cell.shown).sum(),
        };
        let is_large = found.hidden_cells as f64 >= HIDDEN_SHARE * compared as f64;
        (is_large && found.expected >= HIDDEN_POINTS).then_some(found)
    }
}

/// Returns the part of the pictures of a camera in which no photo shows the scene. `None` without such a part, or with too few photos.
fn fixed_part(input: &MapperInput<'_>, compared: &[ComparedPhoto], camera: usize) -> Option<FixedPart> {
    let own = || {
        compared
            .iter()
            .filter(|one| input.views[one.photo].camera == camera)
    };
    if own().count() < FIXED_PHOTOS {
        return None;
    }
    let mut sums = vec![Cell::default(); GRID * GRID];
    for one in own() {
        for (sum, cell) in sums.iter_mut().zip(&one.cells) {
            sum.expected += cell.expected;
            sum.shown += cell.shown;
            sum.own += cell.own;
        }
    }
    let mut is_in: Vec<bool> = sums.iter().map(|sum| sum.is_hidden(FIXED_POINTS)).collect();
    // It has cells at its rim for which fewer points are expected.
    loop {
        let joins =
            |index: usize| !is_in[index] && sums[index].is_hidden(RIM_POINTS) && touches(&is_in, index);
        let more: Vec<usize> = (0..is_in.len()).filter(|index| joins(*index)).collect();
        if more.is_empty() {
            break;
        }
        more.into_iter().for_each(|index| is_in[index] = true);
    }
    let within = || {
        sums.iter()
            .zip(&is_in)
            .filter(|(_, is_in)| **is_in)
            .map(|(sum, _)| sum)
    };
    let part = FixedPart {
        camera,
        expected: within().map(|sum| sum.expected).sum(),
        shown: within().map(|sum| sum.shown).sum(),
        is_in: is_in.clone(),
    };
    is_in.contains(&true).then_some(part)
}

/// Returns whether a cell has a side in common with one that is in.
fn touches(is_in: &[bool], index: usize) -> bool {
    let (column, row) = (index % GRID, index / GRID);
    (column > 0 && is_in[index - 1])
        || (column + 1 < GRID && is_in[index + 1])
        || (row > 0 && is_in[index - GRID])
        || (row + 1 < GRID && is_in[index + GRID])
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
