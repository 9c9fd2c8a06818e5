use marf_shaders::{ADAM_TABLE, LevelScale, Rates, row_head, rows_head};

use super::grid::{Grid, ROWS, Slots, threads};
use super::scatter::Sums;
use crate::gpu::Gpu;
use crate::gpu::array::{Array, Part};
use crate::gpu::kernel::Kernel;
use crate::gpu::record::Work;
use marf_field::GpuError;
use marf_field::cpu::adam::{BETA1, BETA2};

/// Returns the uniform of a step of Adam.
///
/// `epsilon`: of the CPU. A quantum is added to it. `decay`: pull to zero, times the weight. `keep`: share of
/// itself that the running average keeps. 1 leaves it unchanged.
pub fn rates(rate: f32, epsilon: f32, decay: f32, keep: f32) -> Rates {
    Rates {
        rate,
        epsilon,
        decay,
        beta1: BETA1,
        beta2: BETA2,
        keep,
        pad: [0.0; 2],
    }
}

/// One step of Adam over all tables, and their running average: twin of `cpu::adam::Adam` and `learn::blend`.
pub struct AdamTable(Kernel);

/// Arrays of [`AdamTable`].
#[derive(Clone, Copy)]
pub struct AdamArrays<'a> {
    /// Uniform, see [`rates`].
    pub rates: &'a Array<Rates>,
    /// `[L]`, after `Scales`.
    pub scales: &'a Array<LevelScale>,
    /// `cpu::adam::Bias::corrections`.
    pub bias: &'a Array<[f32; 2]>,
    /// `[8]`.
    pub faults: &'a Array<u32>,
    /// `[entries, F]`, as left by `Scatter`. 0 afterwards.
    pub gradient: &'a Array<i32>,
    /// Tables, `[entries, F]`.
    pub tables: &'a Array<f32>,
    /// First moment, `[entries, F]`.
    pub mean: &'a Array<f32>,
    /// Second moment, `[entries, F]`.
    pub square: &'a Array<f32>,
    /// Steps of every entry, `[entries]`.
    pub count: &'a Array<u32>,
    /// Running average of the tables, `[entries, F]`.
    pub average: &'a Array<f32>,
}

impl AdamTable {
    /// Compiles it for entries of `features` numbers.
    ///
    /// # Errors
    /// A driver that does not compile it.
    pub fn new(gpu: &Gpu, features: usize, sums: Sums) -> Result<Self, GpuError> {
        let head = row_head(features as u32) + &sums.head(features) + &rows_head(ROWS);
        Ok(Self(gpu.kernel(&ADAM_TABLE, &head)?))
    }

    /// Binds it.
    ///
    /// # Errors
    /// Memory that was refused.
    pub fn bind(&self, gpu: &Gpu, grid: &Grid, arrays: AdamArrays) -> Result<Work, GpuError> {
        let bound = |levels: &_| {
            vec![
                Part::from(arrays.rates),
                arrays.scales.into(),
                arrays.bias.into(),
                arrays.faults.into(),
                grid.bound(arrays.gradient, grid.features, levels),
                grid.bound(arrays.tables, grid.features, levels),
                grid.bound(arrays.mean, grid.features, levels),
                grid.bound(arrays.square, grid.features, levels),
                grid.bound(arrays.count, 1, levels),
                grid.bound(arrays.average, grid.features, levels),
            ]
        };
        grid.bind(gpu, &self.0, Slots::NONE, bound, threads)
    }
}

#[cfg(test)]
mod tests {
    use super::super::fixture::Case;
    use super::super::scales::start_scales;
    use super::*;
    use crate::gpu::testing::{gpu, numbers};
    use marf_field::cpu::adam::{Adam, Bias, Moments};
    use marf_field::cpu::simd::{InstructionSet, Run};

    const RATE: f32 = 1e-2;
    const EPSILON: f32 = 1e-12;
    const DECAY: f32 = 1e-3;
    const STEPS: usize = 5;
    /// For a weight: five roundings in five steps. For a step: root, quotient and products, whose errors WGSL
    /// bounds by 2.5 units in the last place each.
    const TOLERANCE: [f32; 2] = [1e-6, 1e-5];

    /// Quanta of one step: every third row has none, some have just one.
    fn quanta(numbers: &[f32], features: usize) -> Vec<i32> {
        let rows = numbers.chunks(features).enumerate();
        let rows = rows.flat_map(|(row, values)| {
            values.iter().map(move |value| match row % 3 {
                0 => 0,
                1 => (value * 3e7) as i32,
                _ => value.signum() as i32,
            })
        });
        rows.collect()
    }

    /// The same as words of the device.
    fn words(quanta: &[i32], sums: Sums) -> Vec<i32> {
        let mut words = quanta.to_vec();
        if sums == Sums::Packed {
            for pair in words.as_chunks_mut::<2>().0 {
                pair[1] -= i32::from(pair[0] < 0);
            }
        }
        words
    }

    struct Device {
        gradient: Array<i32>,
        tables: Array<f32>,
        mean: Array<f32>,
        square: Array<f32>,
        count: Array<u32>,
        average: Array<f32>,
        rates: Array<Rates>,
        faults: Array<u32>,
        scales: Array<LevelScale>,
        work: Work,
    }

    /// Counts of rows before the first step: none, more than the table of corrections, the greatest.
    const COUNTS: [u32; 4] = [0, 5000, u32::MAX, 7];

    fn device(gpu: &Gpu, grid: &Grid, tables: &[f32], sums: Sums) -> Device {
        let zeros = || gpu.zeros::<f32>("moments", grid.numbers()).unwrap();
        let counts: Vec<Vec<u32>> = grid
            .levels
            .iter()
            .map(|level| counts(level.entries as usize))
            .collect();
        let mut device = Device {
            gradient: gpu.zeros("gradient", grid.numbers()).unwrap(),
            tables: gpu.filled("tables", tables).unwrap(),
            mean: zeros(),
            square: zeros(),
            count: gpu.filled("counts", &grid.join(&counts, 1)).unwrap(),
            average: zeros(),
            rates: gpu.uniform("rates", rates(RATE, EPSILON, DECAY, 1.0)).unwrap(),
            faults: gpu.zeros("faults", 8).unwrap(),
            scales: gpu.filled("scales", &start_scales(grid)).unwrap(),
            work: Work::default(),
        };
        let arrays = AdamArrays {
            rates: &device.rates,
            bias: &gpu.filled("bias", Bias::default().corrections()).unwrap(),
            scales: &device.scales,
            faults: &device.faults,
            gradient: &device.gradient,
            tables: &device.tables,
            mean: &device.mean,
            square: &device.square,
            count: &device.count,
            average: &device.average,
        };
        let kernel = AdamTable::new(gpu, grid.features(), sums).unwrap();
        device.work = kernel.bind(gpu, grid, arrays).unwrap();
        device
    }

    fn counts(rows: usize) -> Vec<u32> {
        COUNTS.into_iter().cycle().take(rows).collect()
    }

    /// What the CPU makes of one level: weights and moments.
    fn expected<const F: usize>(table: &[f32], steps: &[Vec<i32>], quantum: f32) -> (Vec<f32>, Moments) {
        let (mut weights, mut moments) = (table.to_vec(), Moments::new(table.len(), F));
        moments.count = counts(table.len() / F);
        let bias = Bias::default();
        for quanta in steps {
            let mut gradient: Vec<f32> = quanta.iter().map(|q| *q as f32 * quantum).collect();
            InstructionSet::best().run(Adam::<F> {
                weights: &mut weights,
                gradient: &mut gradient,
                moments: &mut moments,
                rate: RATE,
                epsilon: EPSILON + quantum,
                decay: DECAY,
                bias: &bias,
            });
        }
        (weights, moments)
    }

    fn agrees<const F: usize>(sums: Sums) {
        let Some(gpu) = gpu("tables_learn_as_on_the_cpu") else {
            return;
        };
        let case = Case::new(F);
        let grid = Grid::with_binding(&gpu, &case.shapes, F, 5041 * 4 * F as u64).unwrap();
        let device = device(&gpu, &grid, &grid.join(&case.tables, F), sums);
        let quantum = 2_f32.powi(-34);
        let mut scales = start_scales(&grid);
        scales.iter_mut().for_each(|level| level.quantum = quantum);
        scales[1].skip = 1;
        gpu.write(&device.scales, 0, &scales);
        let steps: Vec<Vec<Vec<i32>>> = case
            .tables
            .iter()
            .zip(0..)
            .map(|(table, level)| {
                let step = |step| quanta(&numbers(table.len(), 50 + 10 * level + step), F);
                (0..STEPS as u64).map(step).collect()
            })
            .collect();
        for step in 0..STEPS {
            let levels: Vec<Vec<i32>> = steps.iter().map(|level| words(&level[step], sums)).collect();
            gpu.write(&device.gradient, 0, &grid.join(&levels, F));
            gpu.submit(|recorder| device.work.record(recorder));
            assert!(gpu.read(&device.gradient).unwrap().iter().all(|q| *q == 0));
        }
        let [tables, mean, square] = [&device.tables, &device.mean, &device.square]
            .map(|array| grid.split(&gpu.read(array).unwrap(), F));
        let count = grid.split(&gpu.read(&device.count).unwrap(), 1);
        let mut most = [0.0_f32; 3];
        for (level, table) in case.tables.iter().enumerate() {
            let steps = if level == 1 { &[] } else { steps[level].as_slice() };
            let (weights, moments) = expected::<F>(table, steps, quantum);
            assert_eq!(count[level], moments.count, "level {level}");
            for at in 0..table.len() {
                let error = (tables[level][at] - weights[at]).abs();
                let allowed = TOLERANCE[0] * weights[at].abs() + TOLERANCE[1] * RATE * STEPS as f32;
                assert!(
                    error <= allowed,
                    "level {level}, {at}: {error} of {}",
                    weights[at]
                );
                most[0] = most[0].max(error);
                // Moments are sums of five terms that may cancel: within 1e-6 of the largest gradients, 2e-3, and
                // their squares.
                for (k, (found, expected, size)) in [
                    (mean[level][at], moments.first[at], 1e-3),
                    (square[level][at], moments.second[at], 1e-6),
                ]
                .into_iter()
                .enumerate()
                {
                    let error = (found - expected).abs() / size;
                    assert!(error <= 1e-6, "level {level}, {at}: {found} against {expected}");
                    most[k + 1] = most[k + 1].max(error);
                }
            }
        }
        println!(
            "adam, F = {F}, {sums:?}: weights {:e}, moments {:e} {:e}",
            most[0], most[1], most[2]
        );
    }

    #[test]
    fn tables_learn_as_on_the_cpu() {
        agrees::<2>(Sums::Plain);
        agrees::<2>(Sums::Packed);
        agrees::<4>(Sums::Plain);
        agrees::<4>(Sums::Packed);
    }

    #[test]
    fn a_fault_leaves_all_tables_and_the_gradient() {
        let Some(gpu) = gpu("a_fault_leaves_all_tables_and_the_gradient") else {
            return;
        };
        let case = Case::new(2);
        let grid = Grid::new(&gpu, &case.shapes, 2).unwrap();
        let tables = grid.join(&case.tables, 2);
        let device = device(&gpu, &grid, &tables, Sums::Plain);
        let quanta = vec![5; grid.numbers()];
        gpu.write(&device.gradient, 0, &quanta);
        for fault in 0..8 {
            let mut faults = [0_u32; 8];
            faults[fault] = 1;
            gpu.write(&device.faults, 0, &faults);
            gpu.submit(|recorder| device.work.record(recorder));
            assert_eq!(gpu.read(&device.tables).unwrap(), tables, "fault {fault}");
            assert_eq!(gpu.read(&device.gradient).unwrap(), quanta, "fault {fault}");
        }
    }

    #[test]
    fn the_least_gradient_moves_a_weight_by_half_a_rate() {
        let Some(gpu) = gpu("the_least_gradient_moves_a_weight_by_half_a_rate") else {
            return;
        };
        let grid = Grid::new(&gpu, &Case::new(2).shapes, 2).unwrap();
        let device = device(&gpu, &grid, &vec![0.0; grid.numbers()], Sums::Plain);
        gpu.write(&device.gradient, 0, &[1]);
        gpu.submit(|recorder| device.work.record(recorder));
        let found = gpu.read(&device.tables).unwrap();
        assert!((found[0] + 0.5 * RATE).abs() < 1e-3 * RATE, "{}", found[0]);
        assert!(found[1..].iter().all(|weight| *weight == 0.0));
    }

    #[test]
    fn the_average_moves_as_on_the_cpu_whether_a_row_learns_or_not() {
        let Some(gpu) = gpu("the_average_moves_as_on_the_cpu_whether_a_row_learns_or_not") else {
            return;
        };
        let grid = Grid::with_binding(&gpu, &Case::new(2).shapes, 2, 5041 * 8).unwrap();
        let len = grid.numbers();
        let (start, values) = (numbers(len, 30), numbers(len, 31));
        for (keep, fault) in [(0.9, 0), (0.3, 0), (1.0, 0), (0.0, 0), (0.5, 1)] {
            let device = device(&gpu, &grid, &values, Sums::Plain);
            gpu.write(&device.rates, 0, &[rates(RATE, EPSILON, DECAY, keep)]);
            gpu.write(&device.average, 0, &start);
            gpu.write(&device.faults, 0, &[0, 0, 0, fault]);
            gpu.write(&device.gradient, 0, &quanta(&numbers(len, 32), 2));
            let mut scales = start_scales(&grid);
            scales[1].skip = 1;
            gpu.write(&device.scales, 0, &scales);
            gpu.submit(|recorder| device.work.record(recorder));
            let moved = gpu.read(&device.tables).unwrap();
            assert_eq!(moved == values, fault == 1);
            let mut expected = start.clone();
            if fault == 0 {
                marf_field::learn::blend(&mut expected, &moved, Some(keep));
            }
            let found = grid.split(&gpu.read(&device.average).unwrap(), 2).concat();
            let expected = grid.split(&expected, 2).concat();
            let (error, at) = crate::gpu::testing::worst(&found, &expected);
            println!("average, keep {keep}: {error:e}");
            // One rounding of numbers up to 1.
            assert!(error <= f32::EPSILON / 2.0, "keep {keep}: {error} at {at}");
        }
    }
}
