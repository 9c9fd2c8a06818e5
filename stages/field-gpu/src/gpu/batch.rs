//! What all kernels of a batch share.

use marf_shaders::{Extent, counts};

use super::Gpu;
use super::array::Array;

/// Slots of a batch.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BatchSize {
    /// Samples a column, a multiple of 256.
    pub samples: usize,
    /// Rays a column, a multiple of 64.
    pub rays: usize,
}

impl BatchSize {
    /// Returns the sizes of columns of samples and of rays for kernels. `most` is the samples of a ray that
    /// `opacity` keeps, about, 0 where it keeps all that show.
    pub fn extent(self, most: u32) -> Extent {
        Extent {
            slot: counts::RAYS,
            capacity: self.samples as u32,
            rays: self.rays as u32,
            most,
        }
    }

    /// Returns the numbers of `shown`, which `opacity` writes.
    pub fn shown_words(self) -> usize {
        2 * self.rays + self.samples
    }
}

/// What all kernels of a batch share.
#[derive(Clone, Copy)]
pub struct Batch<'a> {
    /// The device.
    pub gpu: &'a Gpu,
    /// u32 `[counts::LEN]`.
    pub counts: &'a Array<u32>,
    /// u32 `[faults::LEN]`.
    pub faults: &'a Array<u32>,
    /// Samples a column, a multiple of 256.
    pub capacity: usize,
    /// Rays a column, a multiple of 64.
    pub rays: usize,
}

impl Batch<'_> {
    /// Returns the slots.
    pub fn size(self) -> BatchSize {
        BatchSize {
            samples: self.capacity,
            rays: self.rays,
        }
    }
}
