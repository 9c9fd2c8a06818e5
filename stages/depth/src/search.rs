//! Which disparities are tried.

use crate::cost::BLOCK;

/// The most disparities of a search, and the largest first disparity.
pub const MAX_DISPARITIES: usize = 8192;

/// Disparities to be tried.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Search {
    /// The smallest disparity, in pixels. It may be negative.
    pub first: i32,
    /// How many, in steps of one pixel. One alone is never found: nothing tells it from another.
    pub count: usize,
}

impl Search {
    /// Whether there is a disparity to try, and no more than fit.
    pub(crate) fn is_within_limits(self) -> bool {
        (1..=MAX_DISPARITIES).contains(&self.count) && self.first.unsigned_abs() as usize <= MAX_DISPARITIES
    }

    pub(crate) fn last(self) -> i32 {
        self.first + self.count as i32 - 1
    }

    /// Candidates of a pixel, in whole blocks.
    pub(crate) fn candidates(self) -> usize {
        self.count.next_multiple_of(BLOCK)
    }

    /// Returns what covers this search in pictures of half the size.
    pub(crate) fn halved(self) -> Self {
        let first = self.first.div_euclid(2);
        let last = (self.last() + 1).div_euclid(2);
        Self {
            first,
            count: (last - first + 1) as usize,
        }
    }
}
