use marf_shaders::{LevelScale, PEAK, RESCALE, Rescaling, row_head, rows_head};

use super::grid::{Grid, ROWS, Slots, threads};
use super::scatter::Sums;
use crate::gpu::Gpu;
use crate::gpu::array::{Array, Part};
use crate::gpu::kernel::{Kernel, fold};
use crate::gpu::record::{Groups, Work};
use marf_field::GpuError;

/// log2 of the first scale: gradients of a mean over the batch stay below 1, hence below `MOST`.
const START_BITS: u32 = 28;
/// log2 of the peak that scales aim at: 16 times less than what overflows, 2^25 times more than a quantum.
const TARGET_BITS: i32 = 25;
/// Largest peak that counts. A sum wraps at four times that.
const MOST: u32 = 1 << 29;
/// log2 of what a scale falls by after an overflow.
const BACK_OFF: i32 = 4;
/// log2 of the smallest and the largest scale.
const RANGE: [i32; 2] = [-40, 60];

/// How far a scale may rise in one step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rise {
    /// To the right scale at once: from the first guess.
    Free,
    /// By a factor of up to four, of the 16 between the aim and an overflow. Even two steps whose gradient is
    /// small by chance do not make the next one overflow.
    Slow,
}

impl Rise {
    fn bits(self) -> i32 {
        match self {
            Self::Free => RANGE[1] - RANGE[0],
            Self::Slow => 2,
        }
    }
}

/// Returns the uniform with which the scales of the levels follow the gradients.
pub fn rescaling(grid: &Grid, rise: Rise) -> Rescaling {
    Rescaling {
        levels: grid.levels.len() as u32,
        target_bits: TARGET_BITS,
        most: MOST,
        back_off: BACK_OFF,
        lowest: RANGE[0],
        highest: RANGE[1],
        rise: rise.bits(),
        pad: 0,
    }
}

/// Returns the levels' fixed point before the first step.
pub fn start_scales(grid: &Grid) -> Vec<LevelScale> {
    let levels = grid.levels.iter().map(|level| LevelScale {
        scale: (1_u64 << START_BITS) as f32,
        quantum: 1.0 / (1_u64 << START_BITS) as f32,
        peak: 0,
        clamped: 0,
        skip: 0,
        overflows: 0,
        first: level.first,
        entries: level.entries,
    });
    levels.collect()
}

/// Arrays of [`Scales`].
#[derive(Clone, Copy)]
pub struct ScaleArrays<'a> {
    /// `[entries, F]`.
    pub gradient: &'a Array<i32>,
    /// `[L]`.
    pub scales: &'a Array<LevelScale>,
    /// Of [`rescaling`].
    pub rescaling: &'a Array<Rescaling>,
    /// `[8]`.
    pub faults: &'a Array<u32>,
}

/// Finds the peak of every level, decides whether its gradient counts, and sets the scale of the next step.
pub struct Scales {
    peak: Kernel,
    rescale: Kernel,
}

impl Scales {
    /// Compiles it for entries of `features` numbers.
    ///
    /// # Errors
    /// A driver that does not compile it.
    pub fn new(gpu: &Gpu, features: usize, sums: Sums) -> Result<Self, GpuError> {
        let head = row_head(features as u32) + &sums.head(features) + &rows_head(ROWS);
        Ok(Self {
            peak: gpu.kernel(&PEAK, &head)?,
            rescale: gpu.kernel(&RESCALE, "")?,
        })
    }

    /// Binds it: runs after all `Scatter` and before `AdamTable` of a step.
    ///
    /// # Errors
    /// Memory that was refused.
    pub fn bind(&self, gpu: &Gpu, grid: &Grid, arrays: ScaleArrays<'_>) -> Result<Work, GpuError> {
        let scales = arrays.scales;
        let bound = |levels: &_| vec![grid.bound(arrays.gradient, grid.features, levels), scales.into()];
        let mut work = grid.bind(gpu, &self.peak, Slots::NONE, bound, threads)?;
        let parts = [Part::from(arrays.rescaling), scales.into(), arrays.faults.into()];
        let rescale = gpu.bind(&self.rescale, &parts);
        work.add(rescale, Groups::All(fold(1)));
        Ok(work)
    }
}

#[cfg(test)]
mod tests {
    use super::super::fixture::Case;
    use super::*;
    use crate::gpu::scan_tests::make_dirty;
    use crate::gpu::testing::gpu;

    /// The twin of `rescale`, in f64.
    fn rescaled(level: LevelScale, rise: Rise) -> LevelScale {
        let over = level.peak > MOST || level.clamped != 0;
        let mut next = f64::from(level.scale);
        if over {
            next /= 2_f64.powi(BACK_OFF);
        } else if level.peak > 0 {
            let target = 2_f64.powi(TARGET_BITS);
            let bits = (target / f64::from(level.peak)).log2().floor() as i32;
            next *= 2_f64.powi(bits.min(rise.bits()));
        }
        let range = RANGE.map(|bits| 2_f64.powi(bits));
        LevelScale {
            scale: next.clamp(range[0], range[1]) as f32,
            quantum: 1.0 / level.scale,
            peak: 0,
            clamped: 0,
            skip: u32::from(over),
            overflows: level.overflows + u32::from(over),
            ..level
        }
    }

    /// How gradients are added up, and how far scales rise.
    #[derive(Clone, Copy, Debug)]
    struct Way(Sums, Rise);

    /// One step on gradients whose largest quanta are these, from these scales.
    fn step(gpu: &Gpu, way: Way, quanta: [i32; 4], before: &[LevelScale], fault: u32) -> Vec<LevelScale> {
        let Way(sums, rise) = way;
        let case = Case::new(2);
        let grid = Grid::with_binding(gpu, &case.shapes, 2, 5041 * 8).unwrap();
        let mut words = vec![0; grid.numbers()];
        for (level, quantum) in grid.levels.iter().zip(quanta) {
            let first = 2 * level.first as usize;
            // The last entry's second feature. The first entry holds something less.
            words[first + 2 * level.entries as usize - 1] = quantum;
            words[first] = quantum / 2;
            if sums == Sums::Packed && quantum / 2 < 0 {
                words[first + 1] = -1;
            }
        }
        let gradient = gpu.filled("gradient", &words).unwrap();
        let scales = gpu.filled("scales", before).unwrap();
        let faults = gpu.filled("faults", &[0, 0, 0, 0, 0, fault, 0, 0]).unwrap();
        let kernels = Scales::new(gpu, 2, sums).unwrap();
        let rescaling = gpu.uniform("rescaling", rescaling(&grid, rise)).unwrap();
        let arrays = ScaleArrays {
            gradient: &gradient,
            scales: &scales,
            rescaling: &rescaling,
            faults: &faults,
        };
        let work = kernels.bind(gpu, &grid, arrays);
        let work = work.unwrap();
        gpu.submit(|recorder| work.record(recorder));
        assert_eq!(gpu.read(&gradient).unwrap(), words, "the gradient is only read");
        gpu.read(&scales).unwrap()
    }

    const SLOWLY: Way = Way(Sums::Plain, Rise::Slow);

    fn start(gpu: &Gpu) -> Vec<LevelScale> {
        start_scales(&Grid::new(gpu, &Case::new(2).shapes, 2).unwrap())
    }

    #[test]
    fn scales_follow_the_largest_quantum_of_their_level() {
        let Some(gpu) = gpu("scales_follow_the_largest_quantum_of_their_level") else {
            return;
        };
        let before = start(&gpu);
        for quanta in [
            [0, 1, -2, 3],
            [1 << 25, -(1 << 25) - 1, 1 << 24, 33_554_431],
            [1 << 29, (1 << 29) + 1, i32::MIN, i32::MAX],
        ] {
            for way in [
                Way(Sums::Plain, Rise::Free),
                Way(Sums::Packed, Rise::Free),
                Way(Sums::Plain, Rise::Slow),
            ] {
                let found = step(&gpu, way, quanta, &before, 0);
                for ((found, before), quantum) in found.iter().zip(&before).zip(quanta) {
                    let peak = quantum.unsigned_abs();
                    let expected = rescaled(LevelScale { peak, ..*before }, way.1);
                    assert_eq!(*found, expected, "{way:?} {quantum}");
                    let ratio = f64::from(found.scale) / f64::from(before.scale);
                    let next = f64::from(peak) * ratio;
                    assert!(found.skip == 1 || next <= 33_554_432.0, "{quantum}: {next}");
                }
            }
        }
    }

    #[test]
    fn a_level_with_a_clamped_contribution_is_left_out_and_backs_off() {
        let Some(gpu) = gpu("a_level_with_a_clamped_contribution_is_left_out_and_backs_off") else {
            return;
        };
        let mut before = start(&gpu);
        before[1].clamped = 1;
        before[1].overflows = 6;
        before[2].skip = 1;
        let found = step(&gpu, SLOWLY, [1 << 25; 4], &before, 0);
        let skipped: Vec<_> = found.iter().map(|level| (level.skip, level.overflows)).collect();
        assert_eq!(skipped, [(0, 0), (1, 7), (0, 0), (0, 0)]);
        assert_eq!(
            (found[1].scale, found[2].scale),
            (before[1].scale / 16.0, before[2].scale)
        );
    }

    #[test]
    fn a_quiet_step_or_two_do_not_make_the_next_overflow() {
        let Some(gpu) = gpu("a_quiet_step_or_two_do_not_make_the_next_overflow") else {
            return;
        };
        let before = start(&gpu);
        let mut after = before.clone();
        for quanta in [[1, 0, -1, 1 << 25], [1, 1 << 24, 1 << 23, 1]] {
            after = step(&gpu, SLOWLY, quanta, &after, 0);
        }
        let rises = after
            .iter()
            .zip(&before)
            .map(|(after, before)| after.scale / before.scale);
        assert_eq!(rises.collect::<Vec<_>>(), [16.0, 2.0, 16.0, 4.0]);
        // The gradient from before the quiet steps, whose peak was what scales aim at: it still counts.
        let found = step(&gpu, SLOWLY, [16 << TARGET_BITS; 4], &after, 0);
        assert!(found.iter().all(|level| level.skip == 0));
    }

    #[test]
    fn scales_stay_within_their_range_and_a_fault_leaves_them() {
        let Some(gpu) = gpu("scales_stay_within_their_range_and_a_fault_leaves_them") else {
            return;
        };
        let mut before = start(&gpu);
        for (level, bits) in before.iter_mut().zip([60, 59, -40, -38]) {
            level.scale = 2_f32.powi(bits);
        }
        let quanta = [1, 1, i32::MAX, i32::MAX];
        let found = step(&gpu, Way(Sums::Plain, Rise::Free), quanta, &before, 0);
        let scales: Vec<f32> = found.iter().map(|level| level.scale.log2()).collect();
        assert_eq!(scales, [60.0, 60.0, -40.0, -40.0]);
        assert_eq!(found[2].quantum, 2_f32.powi(40));
        let left = step(&gpu, SLOWLY, quanta, &before, 1);
        for (left, before) in left.iter().zip(&before) {
            assert_eq!(LevelScale { peak: 0, ..*left }, *before);
        }
    }

    #[test]
    fn a_peak_does_not_rely_on_what_workgroup_memory_holds_before() {
        let Some(gpu) = gpu("a_peak_does_not_rely_on_what_workgroup_memory_holds_before") else {
            return;
        };
        let before = start(&gpu);
        let clean = step(&gpu, SLOWLY, [5; 4], &before, 0);
        make_dirty(&gpu);
        assert_eq!(step(&gpu, SLOWLY, [5; 4], &before, 0), clean);
    }
}
