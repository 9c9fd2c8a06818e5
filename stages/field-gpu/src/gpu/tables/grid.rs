//! The places of the levels of the tables in one array, and the cut of their dispatches to the bindings of a
//! device.

use std::ops::Range;

use bytemuck::Pod;
use marf_shaders::{GridLevel, GridPart};

use crate::gpu::Gpu;
use crate::gpu::array::{Array, Part};
use crate::gpu::device::BINDING;
use crate::gpu::kernel::{GROUP, Kernel, fold};
use crate::gpu::record::{Groups, Work};
use marf_field::GpuError;
use marf_field::cpu::encode::Shape;

/// Levels begin at a multiple of this many entries: at 4 bytes and more an entry, of 256 bytes, as bindings
/// must.
const ALIGNED: usize = 64;

/// Returns where every level begins in the array of all, and the entries of that array. Gaps belong to no
/// level.
pub fn layout(shapes: &[Shape]) -> (Vec<GridLevel>, usize) {
    let mut first = 0;
    let levels = shapes.iter().map(|shape| {
        let level = GridLevel {
            resolution: shape.resolution,
            entries: shape.entries,
            first: first as u32,
            dense: u32::from(shape.dense),
        };
        first += (shape.entries as usize).next_multiple_of(ALIGNED);
        level
    });
    (levels.collect(), first)
}

/// The levels of a field on a device.
pub struct Grid {
    pub(super) levels: Vec<GridLevel>,
    /// As `levels`.
    pub(super) device: Array<GridLevel>,
    pub(super) features: usize,
    pub(super) entries: usize,
    /// Levels that one dispatch takes: their tables fit one binding.
    pub(super) parts: Vec<Range<usize>>,
}

/// Columns of samples that a kernel works on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Slots {
    /// Slots of a column.
    pub capacity: usize,
    /// Place in `counts` of how many are in use: see `marf_shaders::counts`.
    pub slot: u32,
}

impl Slots {
    /// No samples: for kernels over entries.
    pub const NONE: Self = Self { capacity: 0, slot: 0 };
}

impl Grid {
    /// Lays the levels out, `features` = 2 or 4 numbers an entry.
    ///
    /// # Errors
    /// [`GpuError::Limit`] where one level's table exceeds a binding.
    pub fn new(gpu: &Gpu, shapes: &[Shape], features: usize) -> Result<Self, GpuError> {
        Self::with_binding(gpu, shapes, features, gpu.binding())
    }

    pub(super) fn with_binding(
        gpu: &Gpu,
        shapes: &[Shape],
        features: usize,
        most_bytes: u64,
    ) -> Result<Self, GpuError> {
        let (levels, entries) = layout(shapes);
        let entry_bytes = (features * size_of::<f32>()) as u64;
        let parts = parts(&levels, most_bytes / entry_bytes)
            .map_err(|needed| gpu.limit(BINDING, most_bytes, needed * entry_bytes, "lower `log2_table`"))?;
        Ok(Self {
            device: gpu.filled("levels", &levels)?,
            levels,
            features,
            entries,
            parts,
        })
    }

    /// Returns the numbers of all entries: the length of tables, gradient and moments.
    pub fn numbers(&self) -> usize {
        self.entries * self.features
    }

    /// Returns the numbers of an entry.
    pub fn features(&self) -> usize {
        self.features
    }

    /// Puts levels of `row` numbers an entry in one array. Gaps are 0.
    pub fn join<T: Copy + Default>(&self, levels: &[Vec<T>], row: usize) -> Vec<T> {
        let mut all = vec![T::default(); self.entries * row];
        for (level, values) in self.levels.iter().zip(levels) {
            all[level.first as usize * row..][..values.len()].copy_from_slice(values);
        }
        all
    }

    /// Takes levels of `row` numbers an entry out of one array.
    pub fn split<T: Copy>(&self, all: &[T], row: usize) -> Vec<Vec<T>> {
        let levels = self.levels.iter();
        let values = levels.map(|level| &all[level.first as usize * row..][..level.entries as usize * row]);
        values.map(<[T]>::to_vec).collect()
    }

    /// Returns the part of an array of `row` numbers an entry that holds these levels.
    pub(super) fn bound<'a, T: Pod>(
        &self,
        array: &'a Array<T>,
        row: usize,
        levels: &Range<usize>,
    ) -> Part<'a> {
        let entries = extent(&self.levels[levels.clone()]);
        array.part(entries.start * row, entries.len() * row)
    }

    /// Binds a kernel once a part and counts the workgroups of its dispatch.
    ///
    /// `threads`: how many the levels of a part need each. `arrays`: the arrays bound behind the part.
    pub(super) fn bind<'a>(
        &self,
        gpu: &Gpu,
        kernel: &Kernel,
        slots: Slots,
        arrays: impl Fn(&Range<usize>) -> Vec<Part<'a>>,
        threads: impl Fn(&[GridLevel]) -> usize,
    ) -> Result<Work, GpuError> {
        let mut work = Work::default();
        for levels in &self.parts {
            let part = gpu.uniform(
                "levels of a dispatch",
                GridPart {
                    capacity: slots.capacity as u32,
                    slot: slots.slot,
                    level: levels.start as u32,
                    base: self.levels[levels.start].first,
                },
            )?;
            let mut bindings = vec![Part::from(&part)];
            bindings.extend(arrays(levels));
            let [x, y, _] = fold(threads(&self.levels[levels.clone()]).div_ceil(GROUP));
            work.add(gpu.bind(kernel, &bindings), Groups::All([x, y, levels.len()]));
        }
        Ok(work)
    }
}

/// Returns the entries from the first level's first to the last level's last.
fn extent(levels: &[GridLevel]) -> Range<usize> {
    let first = levels.first().map_or(0, |level| level.first as usize);
    let end = levels
        .last()
        .map_or(0, |level| (level.first + level.entries) as usize);
    first..end
}

/// Entries of a thread of kernels that go over all.
pub const ROWS: usize = 8;

/// Returns the entries of the largest level.
pub fn largest(levels: &[GridLevel]) -> usize {
    levels
        .iter()
        .map(|level| level.entries as usize)
        .max()
        .unwrap_or(0)
}

/// Returns the threads that go over the largest level, in whole workgroups.
pub fn threads(levels: &[GridLevel]) -> usize {
    largest(levels).div_ceil(ROWS * GROUP) * GROUP
}

/// Cuts levels into the fewest runs whose extents are at most `most` entries. Refuses a level that has more.
fn parts(levels: &[GridLevel], most: u64) -> Result<Vec<Range<usize>>, u64> {
    let needed = largest(levels) as u64;
    if needed > most {
        return Err(needed);
    }
    let (mut parts, mut start) = (Vec::new(), 0);
    for level in 0..levels.len() {
        if extent(&levels[start..=level]).len() as u64 > most {
            parts.push(start..level);
            start = level;
        }
    }
    if start < levels.len() {
        parts.push(start..levels.len());
    }
    Ok(parts)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gpu::testing::gpu;

    fn shapes() -> Vec<Shape> {
        [(4, 14), (16, 14), (32, 12), (60, 11)]
            .map(|(side, log2_table)| Shape::new(side, log2_table))
            .to_vec()
    }

    #[test]
    fn levels_begin_at_multiples_of_256_bytes_and_do_not_overlap() {
        let (levels, entries) = layout(&shapes());
        let first: Vec<u32> = levels.iter().map(|level| level.first).collect();
        // 125 and 4913 entries are rounded up to 128 and 4928.
        assert_eq!(first, [0, 128, 5056, 9152]);
        assert_eq!(entries, 11_200);
        assert_eq!(layout(&[]), (Vec::new(), 0));
    }

    #[test]
    fn parts_fit_a_binding_and_a_level_that_does_not_is_refused() {
        let (levels, entries) = layout(&shapes());
        let whole = parts(&levels, entries as u64).map(|parts| (parts.len(), parts[0].clone()));
        assert_eq!(whole, Ok((1, 0..4)));
        assert_eq!(parts(&levels, 5041), Ok(vec![0..2, 2..3, 3..4]));
        assert_eq!(parts(&levels, 5040), Ok(vec![0..1, 1..2, 2..3, 3..4]));
        assert_eq!(parts(&levels, 4912), Err(4913));
        assert_eq!(parts(&[], 0), Ok(vec![]));
    }

    #[test]
    fn a_level_beyond_a_binding_is_a_limit_with_both_numbers() {
        let Some(gpu) = gpu("a_level_beyond_a_binding_is_a_limit_with_both_numbers") else {
            return;
        };
        let refused = Grid::with_binding(&gpu, &shapes(), 4, 1000).err();
        assert!(
            matches!(refused, Some(GpuError::Limit { offered: 1000, needed, .. }) if needed == 4913 * 16),
            "{refused:?}"
        );
    }

    #[test]
    fn what_is_joined_is_split_again() {
        let Some(gpu) = gpu("what_is_joined_is_split_again") else {
            return;
        };
        let grid = Grid::new(&gpu, &shapes(), 2).unwrap();
        let levels: Vec<Vec<u32>> = shapes()
            .iter()
            .map(|shape| (1..=2 * shape.entries).collect())
            .collect();
        let joined = grid.join(&levels, 2);
        assert_eq!(joined.len(), grid.numbers());
        assert_eq!((joined[249], joined[250], joined[256]), (250, 0, 1));
        assert_eq!(grid.split(&joined, 2), levels);
    }
}
