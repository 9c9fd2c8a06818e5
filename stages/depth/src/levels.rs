//! From coarse pictures to fine ones: all disparities are tried once, then only those near the coarser result.

use marf_numeric::InstructionSet;
use rayon::prelude::*;

use crate::clean::{filled, remove_islands};
use crate::cost::{BLOCK, Volume};
use crate::paths::{Penalties, path_costs};
use crate::raster::{Picture, Raster};
use crate::search::Search;
use crate::tuning::{
    EDGE_BRIGHTNESS, EDGE_PENALTY, FINE_CANDIDATES, FULL_CELLS, ISLAND, JUMP_PENALTY, STEP_PENALTY,
};
use crate::winner::winners;

/// Returns disparities of the left picture, or [`NONE`](crate::winner::NONE) where nothing is sure.
pub(crate) fn coarse_to_fine(set: InstructionSet, pair: [&Picture; 2], search: Search) -> Raster<f32> {
    let (width, height) = (pair[0].grey.width, pair[0].grey.height);
    if is_coarsest(width, height, search) {
        let first = Raster::filled(width, height, search.first);
        return match_level(
            set,
            pair,
            Candidates {
                first,
                count: search.candidates(),
                last: search.last(),
            },
        );
    }
    let halves = pair.map(Picture::halved);
    let half = search.halved();
    let coarse = coarse_to_fine(set, [&halves[0], &halves[1]], half);
    drop(halves);
    let prior = filled(&coarse, half.first as f32);
    let count = FINE_CANDIDATES.min(search.candidates());
    let first = around(&prior, [width, height], search, count);
    match_level(
        set,
        pair,
        Candidates {
            first,
            count,
            last: search.last(),
        },
    )
}

/// Returns whether all disparities of all pixels fit the memory.
fn is_coarsest(width: usize, height: usize, search: Search) -> bool {
    width * height * search.candidates() <= FULL_CELLS || search.candidates() <= BLOCK
}

/// The disparities to be tried at each pixel.
struct Candidates {
    first: Raster<i32>,
    count: usize,
    last: i32,
}

fn match_level(set: InstructionSet, pair: [&Picture; 2], candidates: Candidates) -> Raster<f32> {
    let Candidates { first, count, last } = candidates;
    let penalties = Penalties::new(STEP_PENALTY, JUMP_PENALTY, EDGE_PENALTY, EDGE_BRIGHTNESS);
    let volume = Volume::new(set, pair, first, count);
    let costs = path_costs(set, &volume, &pair[0].grey, &penalties);
    let mut disparity = winners(set, &volume, &costs, last);
    remove_islands(&mut disparity, ISLAND);
    disparity
}

/// Returns the first of `count` candidates around twice the coarser disparity.
fn around(prior: &Raster<f32>, size: [usize; 2], search: Search, count: usize) -> Raster<i32> {
    let [width, height] = size;
    let mut first = Raster::filled(width, height, search.first);
    let highest = (search.last() + 1 - count as i32).max(search.first);
    first
        .values
        .par_chunks_mut(width)
        .enumerate()
        .for_each(|(y, row)| {
            for (x, first) in row.iter_mut().enumerate() {
                let (cx, cy) = ((x / 2) as isize, (y / 2) as isize);
                let centre = prior.clamped(cx, cy);
                let (mut low, mut high) = (centre, centre);
                for dy in -1..=1 {
                    for dx in -1..=1 {
                        let value = prior.clamped(cx + dx, cy + dy);
                        low = low.min(value);
                        high = high.max(value);
                    }
                }
                let twice = if 2.0 * (high - low) <= count as f32 / 2.0 {
                    low + high
                } else {
                    2.0 * centre
                };
                *first = (twice.round() as i32 - count as i32 / 2).clamp(search.first, highest);
            }
        });
    first
}
