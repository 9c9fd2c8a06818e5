use marf_shaders::{HASH_ENCODE, grid_head};

use super::grid::{Grid, Slots};
use crate::gpu::Gpu;
use crate::gpu::array::{Array, Part};
use crate::gpu::kernel::Kernel;
use crate::gpu::record::Work;
use marf_field::GpuError;
use marf_field::cpu::encode::PRIMES;

/// Looks samples up in all tables: twin of `cpu::encode::Lookup`.
pub struct Encode(Kernel);

/// Arrays of [`Encode`].
#[derive(Clone, Copy)]
pub struct EncodeArrays<'a> {
    /// `[3][capacity]`, positions in the unit box.
    pub xyz: &'a Array<f32>,
    /// Samples in use.
    pub counts: &'a Array<u32>,
    /// Tables, `[entries, F]`.
    pub tables: &'a Array<f32>,
    /// Receives the features, `[L * F][capacity]`.
    pub features: &'a Array<f32>,
}

impl Encode {
    /// Compiles it for entries of `features` numbers.
    ///
    /// # Errors
    /// A driver that does not compile it.
    pub fn new(gpu: &Gpu, features: usize) -> Result<Self, GpuError> {
        gpu.kernel(&HASH_ENCODE, &grid_head(features as u32, PRIMES))
            .map(Self)
    }

    /// Binds it.
    ///
    /// # Errors
    /// Memory that was refused.
    pub fn bind(&self, gpu: &Gpu, grid: &Grid, slots: Slots, arrays: EncodeArrays) -> Result<Work, GpuError> {
        let bound = |levels: &_| {
            vec![
                Part::from(&grid.device),
                arrays.counts.into(),
                arrays.xyz.into(),
                grid.bound(arrays.tables, grid.features, levels),
                arrays.features.into(),
            ]
        };
        grid.bind(gpu, &self.0, slots, bound, |_| slots.capacity)
    }
}

#[cfg(test)]
mod tests {
    use super::super::fixture::{CAPACITY, Case};
    use super::*;
    use crate::gpu::testing::{gpu, worst};

    /// Of the largest entry: products and sums are those of the CPU, which lavapipe neither contracts nor reorders.
    /// Where a GPU does, a weight moves by its level's resolution * 2^-24, at most 4e-6 here, twice an axis.
    const TOLERANCE: f32 = 3e-5;

    fn agrees(features: usize, most_bytes: u64, used: usize) {
        let Some(gpu) = gpu("the_lookup_agrees_with_the_cpu") else {
            return;
        };
        let case = Case::new(features);
        let grid = Grid::with_binding(&gpu, &case.shapes, features, most_bytes).unwrap();
        let columns = case.shapes.len() * features * CAPACITY;
        let arrays = EncodeArrays {
            xyz: &gpu.filled("xyz", &case.xyz).unwrap(),
            counts: &gpu.filled("counts", &[0, used as u32, 0, 0]).unwrap(),
            tables: &gpu.filled("tables", &grid.join(&case.tables, features)).unwrap(),
            features: &gpu.filled("features", &vec![-7.0_f32; columns]).unwrap(),
        };
        let slots = Slots {
            capacity: CAPACITY,
            slot: marf_shaders::counts::KEPT,
        };
        let work = Encode::new(&gpu, features)
            .unwrap()
            .bind(&gpu, &grid, slots, arrays)
            .unwrap();
        gpu.submit(|recorder| work.record(recorder));
        let (found, mut expected) = (gpu.read(arrays.features).unwrap(), case.features());
        let unused = expected.chunks_mut(CAPACITY);
        unused.for_each(|column| column[used.min(CAPACITY)..].fill(-7.0));
        let (error, at) = worst(&found, &expected);
        println!(
            "encode, F = {features}, {} parts, {used} used: {error:e}",
            grid.parts.len()
        );
        assert!(
            error <= TOLERANCE,
            "{features}, {most_bytes}: {error} at {at}: {} against {}",
            found[at],
            expected[at]
        );
    }

    #[test]
    fn the_lookup_agrees_with_the_cpu() {
        agrees(2, 1 << 27, CAPACITY);
        agrees(4, 1 << 27, CAPACITY - 100);
    }

    #[test]
    fn the_lookup_is_the_same_where_tables_take_several_bindings() {
        agrees(2, 5041 * 8, CAPACITY - 100);
        agrees(4, 4913 * 16, 0);
    }

    #[test]
    fn more_samples_than_slots_are_as_many_as_slots() {
        agrees(2, 1 << 27, CAPACITY + 1000);
    }
}
