//! Where the time of a training step on the CPU goes: for `cargo bench` alone. Nothing of it reaches a result.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

/// A part of a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// Drawing the rays.
    Draw,
    /// Walks through occupied cells.
    March,
    /// Looking up the features.
    Lookup,
    /// Density network, forward.
    Density,
    /// Opacities, transmittances, choice of the samples that count.
    Opacity,
    /// Colour network, forward.
    Colour,
    /// Compositing, losses and their gradients.
    Losses,
    /// Colour network, backward.
    ColourBackward,
    /// Density network, backward.
    DensityBackward,
    /// Gradients of the features into those of the tables.
    Scatter,
    /// Adam on the tables.
    Adam,
    /// Running average of the tables.
    Average,
    /// Adam on the networks and the background.
    Networks,
    /// Updates of the occupancy.
    Occupancy,
}

/// The parts in order.
pub const PARTS: [Part; 14] = [
    Part::Draw,
    Part::March,
    Part::Lookup,
    Part::Density,
    Part::Opacity,
    Part::Colour,
    Part::Losses,
    Part::ColourBackward,
    Part::DensityBackward,
    Part::Scatter,
    Part::Adam,
    Part::Average,
    Part::Networks,
    Part::Occupancy,
];

/// Time by part, summed over threads.
#[derive(Debug, Default)]
pub struct Watch {
    nanoseconds: [AtomicU64; PARTS.len()],
}

impl Watch {
    /// Returns the seconds of every part since the last call, in the order of [`PARTS`].
    pub fn take(&self) -> [f64; PARTS.len()] {
        std::array::from_fn(|part| self.nanoseconds[part].swap(0, Ordering::Relaxed) as f64 * 1e-9)
    }
}

/// Does a part of a step. Its time is taken if someone watches.
pub fn timed<T>(watch: Option<&Watch>, part: Part, work: impl FnOnce() -> T) -> T {
    let Some(watch) = watch else {
        return work();
    };
    let begin = Instant::now();
    let done = work();
    let elapsed = begin.elapsed().as_nanos() as u64;
    watch.nanoseconds[part as usize].fetch_add(elapsed, Ordering::Relaxed);
    done
}
