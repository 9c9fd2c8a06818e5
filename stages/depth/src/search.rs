//! Which disparities are tried.

use crate::cost::BLOCK;

/// Disparities to be tried.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Search {
    /// The smallest disparity, in pixels. It may be negative.
    pub first: i32,
    /// How many, in steps of one pixel. One alone is never found: nothing tells it from another.
    pub count: usize,
}

impl Search {
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
