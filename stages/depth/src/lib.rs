//! Dense disparities of a rectified pair.
#![allow(dead_code, missing_docs)]
mod clean;
mod cost;
mod kernel;
mod levels;
mod paths;
mod raster;
mod refine;
mod tuning;
mod winner;

use marf_numeric::InstructionSet;
pub use raster::{Picture, Raster};
pub const NONE: f32 = winner::NONE;

/// Disparities to be tried, in pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Search {
    /// The smallest disparity.
    pub first: i32,
    /// How many, in steps of one pixel.
    pub count: usize,
}

impl Search {
    fn last(self) -> i32 {
        self.first + self.count as i32 - 1
    }
    fn blocks(self) -> usize {
        self.count.next_multiple_of(cost::BLOCK)
    }
    fn halved(self) -> Self {
        let first = self.first.div_euclid(2);
        let last = (self.last() + 1).div_euclid(2);
        Self {
            first,
            count: (last - first + 1) as usize,
        }
    }
}

pub struct Depth {
    pub raw: Raster<f32>,
    pub disparity: Raster<f32>,
    pub sigma: Raster<f32>,
}

pub fn match_pair(left: &Picture, right: &Picture, search: Search) -> Depth {
    let set = InstructionSet::best();
    let t = std::time::Instant::now();
    let raw = levels::coarse_to_fine(set, [left, right], search);
    eprintln!("sgm {:?}", t.elapsed());
    let planes = refine::refine(set, [left, right], raw.clone());
    eprintln!("all {:?}", t.elapsed());
    Depth {
        raw,
        disparity: planes.disparity,
        sigma: planes.sigma,
    }
}
