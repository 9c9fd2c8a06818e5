//! Cells that changed alike, side by side.

use marf_numeric::upper_median;
use marf_schema::changes::Change;

use super::cells::{Extent, around};

/// Cells of nine that must have changed alike, else one that did is noise.
const ALIKE: usize = 4;
/// One cell in this many of a patch must be beyond the limit, else the patch is noise that grew together.
const STRONG: usize = 3;
/// Share of its median change of colour at which a patch of colour ends. Photos and fields blur the edge of a
/// flat object, and half of the change remains there.
const HALF: f64 = 0.5;

/// The patches of a map.
pub(super) struct Patches {
    /// The largest first.
    pub list: Vec<PatchCells>,
    /// The change in each cell. `None` if nothing changed or nothing is known.
    pub of_cell: Vec<Option<Change>>,
}

/// The cells of a patch.
pub(super) struct PatchCells {
    pub change: Change,
    /// Places, rising.
    pub cells: Vec<usize>,
    /// Number of cells that differ by the requested limit.
    pub strong: usize,
    /// Number of cells with one more all around.
    pub widened: usize,
}

/// State of a cell.
pub(super) struct CellChange {
    /// Its change by the requested limit.
    pub strong: Option<Change>,
    /// Its change by the weaker limit.
    pub weak: Option<Change>,
    /// By how much its colour differs: the root of the squares of both logarithms.
    pub colour: f64,
}

/// Returns the patches: cells beyond the limit with their neighbours beyond two thirds of it, without single
/// ones. `least`: fewest cells beyond the limit. `found`: `None` for unknown cells.
pub(super) fn patches(extent: &Extent, found: &[Option<CellChange>], least: usize) -> Patches {
    let grown = grown(extent, found);
    let kept: Vec<Option<Change>> = (0..grown.len())
        .map(|place| {
            let alike = |near: &usize| grown[*near] == grown[place];
            let count = around(extent, place, 1).filter(alike).count();
            grown[place].filter(|_| count >= ALIKE)
        })
        .collect();
    let mut of_cell = vec![None; kept.len()];
    let mut list = Vec::new();
    let mut is_seen = vec![false; kept.len()];
    for start in 0..kept.len() {
        let Some(change) = kept[start].filter(|_| !is_seen[start]) else {
            continue;
        };
        is_seen[start] = true;
        let mut cells = vec![start];
        let mut next = 0;
        while let Some(place) = cells.get(next).copied() {
            next += 1;
            for near in around(extent, place, 1) {
                if !is_seen[near] && kept[near] == Some(change) {
                    is_seen[near] = true;
                    cells.push(near);
                }
            }
        }
        if change == Change::Colour {
            cells = without_rim(&cells, found);
        }
        cells.sort_unstable();
        let strong_change = |place: usize| found[place].as_ref().and_then(|found| found.strong);
        let is_strong = |place: &&usize| strong_change(**place) == Some(change);
        let strong = cells.iter().filter(is_strong).count();
        if strong < least || STRONG * strong < cells.len() {
            continue;
        }
        cells.iter().for_each(|place| of_cell[*place] = Some(change));
        let mut widened: Vec<usize> = cells.iter().flat_map(|place| around(extent, *place, 1)).collect();
        widened.sort_unstable();
        widened.dedup();
        list.push(PatchCells {
            change,
            strong,
            widened: widened
                .into_iter()
                .filter(|place| found[*place].is_some())
                .count(),
            cells,
        });
    }
    list.sort_by_key(|patch| (std::cmp::Reverse(patch.cells.len()), patch.cells[0]));
    Patches { list, of_cell }
}

/// Returns the cells of a patch that have at least half of its change of colour.
fn without_rim(cells: &[usize], found: &[Option<CellChange>]) -> Vec<usize> {
    let colour = |place: &usize| found[*place].as_ref().map_or(0.0, |found| found.colour);
    let least = HALF * upper_median(cells.iter().map(colour)).unwrap_or(0.0);
    let is_within = |place: &usize| colour(place) >= least;
    cells.iter().copied().filter(is_within).collect()
}

/// Returns the cells beyond the limit, and those that hang together with them beyond the lower one.
fn grown(extent: &Extent, found: &[Option<CellChange>]) -> Vec<Option<Change>> {
    let mut grown: Vec<Option<Change>> = found
        .iter()
        .map(|found| found.as_ref().and_then(|found| found.strong))
        .collect();
    let mut front: Vec<usize> = (0..grown.len()).filter(|place| grown[*place].is_some()).collect();
    while let Some(place) = front.pop() {
        for near in around(extent, place, 1) {
            let weak = found[near].as_ref().and_then(|found| found.weak);
            if grown[near].is_none() && weak.is_some() && weak == grown[place] {
                grown[near] = weak;
                front.push(near);
            }
        }
    }
    grown
}
