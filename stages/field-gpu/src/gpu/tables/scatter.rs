use marf_shaders::{LevelScale, SCATTER, SCATTER_PACKED, grid_head, quanta_head};

use super::grid::{Grid, Slots};
use crate::gpu::Gpu;
use crate::gpu::array::{Array, Part};
use crate::gpu::kernel::Kernel;
use crate::gpu::record::Work;
use marf_field::GpuError;
use marf_field::cpu::encode::PRIMES;

/// Most quanta of a single contribution. With peaks of 2^25 a larger one is far from the gradients that the
/// scale was made for, and 31 of them do not wrap a sum.
const MOST_QUANTA: i32 = 1 << 26;

/// Samples of a thread, as `shared/spread.wgsl` has them: what they add to one entry is added as one.
pub const EACH: usize = 8;

/// How gradients in fixed point are added up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sums {
    /// A 32-bit word a feature.
    Plain,
    /// A 64-bit word a pair of features.
    Packed,
}

impl Sums {
    /// Returns the better way of those that a device offers.
    pub fn from_gpu(gpu: &Gpu) -> Self {
        let wide = wgpu::Features::SHADER_INT64 | wgpu::Features::SHADER_INT64_ATOMIC_ALL_OPS;
        if gpu.features.contains(wide) {
            Self::Packed
        } else {
            Self::Plain
        }
    }

    /// Returns the head of kernels that read or write gradients.
    pub(super) fn head(self, features: usize) -> String {
        quanta_head(features as u32, self == Self::Packed, MOST_QUANTA)
    }
}

/// Adds gradients of features to those of entries: twin of `cpu::encode::Scatter`.
pub struct Scatter(Kernel);

/// Arrays of [`Scatter`].
#[derive(Clone, Copy)]
pub struct ScatterArrays<'a> {
    /// `[3][capacity]`, positions of visited samples in the unit box.
    pub xyz: &'a Array<f32>,
    /// `[capacity]`: which of them a sample was.
    pub origin: &'a Array<u32>,
    /// Samples in use.
    pub counts: &'a Array<u32>,
    /// Gradients of the features, `[L * F][capacity]`.
    pub slopes: &'a Array<f32>,
    /// Added to, `[entries, F]`. 0 before the first.
    pub gradient: &'a Array<i32>,
    /// Fixed point of every level.
    pub scales: &'a Array<LevelScale>,
}

impl Scatter {
    /// Compiles it for entries of `features` numbers.
    ///
    /// # Errors
    /// A driver that does not compile it.
    pub fn new(gpu: &Gpu, features: usize, sums: Sums) -> Result<Self, GpuError> {
        let shader = match sums {
            Sums::Plain => &SCATTER,
            Sums::Packed => &SCATTER_PACKED,
        };
        let head = grid_head(features as u32, PRIMES) + &sums.head(features);
        gpu.kernel(shader, &head).map(Self)
    }

    /// Binds it.
    ///
    /// # Errors
    /// Memory that was refused.
    pub fn bind(
        &self,
        gpu: &Gpu,
        grid: &Grid,
        slots: Slots,
        arrays: ScatterArrays,
    ) -> Result<Work, GpuError> {
        let bound = |levels: &_| {
            vec![
                Part::from(&grid.device),
                arrays.counts.into(),
                arrays.xyz.into(),
                arrays.slopes.into(),
                arrays.scales.into(),
                grid.bound(arrays.gradient, grid.features, levels),
                arrays.origin.into(),
            ]
        };
        grid.bind(gpu, &self.0, slots, bound, |_| slots.capacity.div_ceil(EACH))
    }
}

/// Takes words of a gradient apart, as `shared/quanta.wgsl` does.
#[cfg(test)]
pub(super) fn quanta_of(words: &[i32], sums: Sums) -> Vec<i32> {
    let mut quanta = words.to_vec();
    if sums == Sums::Packed {
        for pair in quanta.as_chunks_mut::<2>().0 {
            pair[1] += i32::from(pair[0] < 0);
        }
    }
    quanta
}

#[cfg(test)]
mod tests {
    use super::super::fixture::{CAPACITY, Case};
    use super::super::scales::start_scales;
    use super::*;
    use crate::gpu::testing::gpu;

    /// Runs it with one scale for all levels: quanta and the marks of the levels.
    fn run(gpu: &Gpu, case: &Case, sums: Sums, scale: f32, used: usize) -> (Vec<i32>, Vec<LevelScale>) {
        let features = case.features;
        let grid = Grid::with_binding(gpu, &case.shapes, features, 5041 * 4 * features as u64).unwrap();
        let mut scales = start_scales(&grid);
        scales.iter_mut().for_each(|level| level.scale = scale);
        let arrays = ScatterArrays {
            xyz: &gpu.filled("xyz", &case.xyz).unwrap(),
            origin: &gpu.filled("origin", &case.origin()).unwrap(),
            counts: &gpu.filled("counts", &[used as u32, 0, 0, 0]).unwrap(),
            slopes: &gpu.filled("slopes", &case.slopes).unwrap(),
            gradient: &gpu.zeros("gradient", grid.numbers()).unwrap(),
            scales: &gpu.filled("scales", &scales).unwrap(),
        };
        let slots = Slots {
            capacity: CAPACITY,
            slot: marf_shaders::counts::VISITED,
        };
        let work = Scatter::new(gpu, features, sums)
            .unwrap()
            .bind(gpu, &grid, slots, arrays)
            .unwrap();
        gpu.submit(|recorder| work.record(recorder));
        let words = gpu.read(arrays.gradient).unwrap();
        let kept = grid.join(&grid.split(&words, features), features);
        assert_eq!(words, kept, "gaps stay 0");
        (
            grid.split(&quanta_of(&words, sums), features).concat(),
            gpu.read(arrays.scales).unwrap(),
        )
    }

    fn kinds(gpu: &Gpu) -> Vec<Sums> {
        let mut kinds = vec![Sums::Plain, Sums::from_gpu(gpu)];
        kinds.dedup();
        kinds
    }

    #[test]
    fn the_transpose_agrees_with_the_cpu_within_half_a_quantum_a_contribution() {
        let Some(gpu) = gpu("the_transpose_agrees_with_the_cpu_within_half_a_quantum_a_contribution") else {
            return;
        };
        for features in [2, 4] {
            let case = Case::new(features);
            let used = CAPACITY - 100;
            let (expected, contributions) = case.gradient(used);
            let scale = 16_777_216.0;
            let mut before: Option<Vec<i32>> = None;
            for sums in kinds(&gpu) {
                let (found, scales) = run(&gpu, &case, sums, scale, used);
                let mut most = 0.0_f32;
                for (at, (q, expected)) in found.iter().zip(&expected).enumerate() {
                    let count = contributions[at / features];
                    // The CPU's sum of floats is off by 2^-24 of every partial sum, of at most `count`. Where
                    // a GPU contracts, weights move by resolution * 2^-24.
                    let allowed = count * (0.5 / scale + (count + 60.0) / 16_777_216.0);
                    let error = (*q as f32 / scale - expected).abs();
                    assert!(
                        error <= allowed,
                        "{sums:?} {at}: {error} of {expected}, {allowed}"
                    );
                    most = most.max(error);
                }
                println!("scatter, F = {features}, {sums:?}: {most:e}");
                assert!(scales.iter().all(|level| level.clamped == 0));
                assert_eq!(before.get_or_insert_with(|| found.clone()), &found, "{sums:?}");
            }
        }
    }

    #[test]
    fn sums_of_numbers_without_rounding_are_exact() {
        let Some(gpu) = gpu("sums_of_numbers_without_rounding_are_exact") else {
            return;
        };
        let case = Case::exact();
        let (expected, _) = case.gradient(CAPACITY);
        for sums in kinds(&gpu) {
            let (found, _) = run(&gpu, &case, sums, 16_777_216.0, CAPACITY);
            let found: Vec<f32> = found.iter().map(|q| *q as f32 / 16_777_216.0).collect();
            assert_eq!(found, expected, "{sums:?}");
        }
    }

    #[test]
    fn what_is_too_large_or_no_number_is_clamped_and_marks_its_level() {
        let Some(gpu) = gpu("what_is_too_large_or_no_number_is_clamped_and_marks_its_level") else {
            return;
        };
        let most = MOST_QUANTA;
        for (slope, expected) in [
            (1e30, most),
            (-1e30, -most),
            (f32::INFINITY, most),
            (f32::NEG_INFINITY, -most),
        ] {
            for sums in kinds(&gpu) {
                let mut case = Case::new(2);
                case.xyz.fill(0.0);
                case.slopes.fill(0.0);
                // The second feature of level 1: all weight is on its first entry, the others get nothing.
                case.slopes[3 * CAPACITY] = slope;
                case.slopes[2 * CAPACITY] = -3.0;
                let (found, scales) = run(&gpu, &case, sums, 1.0, 1);
                let marked: Vec<u32> = scales.iter().map(|level| level.clamped).collect();
                assert_eq!(marked, [0, 1, 0, 0], "{sums:?} {slope}");
                let first = 2 * case.shapes[0].entries as usize;
                assert_eq!(found[first..first + 2], [-3, expected], "{sums:?} {slope}");
            }
        }
        let mut case = Case::new(2);
        case.slopes.fill(f32::NAN);
        let (_, scales) = run(&gpu, &case, Sums::Plain, 1.0, 1);
        assert!(scales.iter().all(|level| level.clamped == 1));
    }

    #[test]
    fn no_samples_and_no_slopes_leave_the_gradient_zero() {
        let Some(gpu) = gpu("no_samples_and_no_slopes_leave_the_gradient_zero") else {
            return;
        };
        let mut case = Case::new(4);
        for sums in kinds(&gpu) {
            assert!(run(&gpu, &case, sums, 1e6, 0).0.iter().all(|q| *q == 0));
        }
        case.slopes.fill(-0.0);
        assert!(
            run(&gpu, &case, Sums::from_gpu(&gpu), 1e6, CAPACITY)
                .0
                .iter()
                .all(|q| *q == 0)
        );
    }
}
