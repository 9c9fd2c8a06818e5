//! Scatter, scales and Adam in one submit, step after step.

use super::fixture::{CAPACITY, Case};
use super::*;
use crate::gpu::testing::gpu;
use marf_field::cpu::adam::Bias;

const RATE: f32 = 1e-2;
const STEPS: u32 = 6;
/// Gradients below are near the quantum of some step. Those above are 1,000 times more than 2^-20, the
/// largest quantum of a step that counts. Epsilon, which is one quantum more, takes as little of a step.
const LEAST: f32 = 1e-3;
const TOLERANCE: f32 = 2e-3 * RATE;

/// The same gradient in every step moves a weight by one rate a step that counts, whatever the scale was. A
/// gradient read with another scale than it was written with would not. The slopes are so large that the
/// first steps overflow.
fn chained(features: usize, sums: Sums) {
    let Some(gpu) = gpu("steps_that_overflow_are_left_out_and_all_others_count") else {
        return;
    };
    let case = Case::new(features);
    let grid = Grid::with_binding(&gpu, &case.shapes, features, 5041 * 4 * features as u64).unwrap();
    let floats = |what| gpu.zeros::<f32>(what, grid.numbers()).unwrap();
    let (tables, mean, square) = (floats("tables"), floats("mean"), floats("square"));
    let gradient = gpu.zeros("gradient", grid.numbers()).unwrap();
    let count = gpu.zeros("count", grid.entries).unwrap();
    let scales = gpu.filled("scales", &start_scales(&grid)).unwrap();
    let faults = gpu.zeros("faults", 8).unwrap();
    let scattered = ScatterArrays {
        xyz: &gpu.filled("xyz", &case.xyz).unwrap(),
        origin: &gpu.filled("origin", &case.origin()).unwrap(),
        counts: &gpu.filled("counts", &[CAPACITY as u32; 4]).unwrap(),
        slopes: &gpu.filled("slopes", &case.slopes).unwrap(),
        gradient: &gradient,
        scales: &scales,
    };
    let trained = AdamArrays {
        rates: &gpu.uniform("rates", rates(RATE, 1e-12, 0.0, 1.0)).unwrap(),
        bias: &gpu.filled("bias", Bias::default().corrections()).unwrap(),
        scales: &scales,
        faults: &faults,
        gradient: &gradient,
        tables: &tables,
        mean: &mean,
        square: &square,
        count: &count,
        average: &floats("average"),
    };
    let slots = Slots {
        capacity: CAPACITY,
        slot: 0,
    };
    let scatter = Scatter::new(&gpu, features, sums).unwrap();
    let work = scatter.bind(&gpu, &grid, slots, scattered).unwrap();
    let follow = Scales::new(&gpu, features, sums).unwrap();
    let rescaling = gpu.uniform("rescaling", rescaling(&grid, Rise::Slow)).unwrap();
    let followed = ScaleArrays {
        gradient: &gradient,
        scales: &scales,
        rescaling: &rescaling,
        faults: &faults,
    };
    let followed = follow.bind(&gpu, &grid, followed);
    let work = work.then(followed.unwrap());
    let adam = AdamTable::new(&gpu, features, sums).unwrap();
    let work = work.then(adam.bind(&gpu, &grid, trained).unwrap());
    for _ in 0..STEPS {
        gpu.submit(|recorder| work.record(recorder));
    }
    let (slopes, _) = case.gradient(CAPACITY);
    let moved = grid.split(&gpu.read(&tables).unwrap(), features);
    let count = grid.split(&gpu.read(&count).unwrap(), 1);
    let levels = gpu.read(&scales).unwrap();
    let mut slopes = slopes.chunks(features);
    let mut compared = 0;
    for (level, (moved, count)) in moved.iter().zip(&count).enumerate() {
        let left_out = levels[level].overflows;
        assert!((1..4).contains(&left_out), "level {level}: {left_out} overflows");
        for (row, moved) in moved.chunks(features).enumerate() {
            let slope = slopes.next().unwrap();
            let steps = if moved == vec![0.0; features] {
                0
            } else {
                STEPS - left_out
            };
            assert_eq!(count[row], steps, "level {level}, row {row}");
            for (moved, slope) in moved.iter().zip(slope).filter(|(_, slope)| slope.abs() > LEAST) {
                let error = moved + RATE * (STEPS - left_out) as f32 * slope.signum();
                assert!(
                    error.abs() <= TOLERANCE * STEPS as f32,
                    "level {level}, row {row}: {moved}, gradient {slope}"
                );
                compared += 1;
            }
        }
    }
    assert!(compared > 1000, "{compared}");
    assert!(gpu.read(&gradient).unwrap().iter().all(|word| *word == 0));
}

#[test]
fn steps_that_overflow_are_left_out_and_all_others_count() {
    chained(2, Sums::Plain);
    chained(4, Sums::Packed);
}
