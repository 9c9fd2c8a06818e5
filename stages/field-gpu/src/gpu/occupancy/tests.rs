use super::*;
use crate::gpu::testing::gpu;
use marf_field::cpu::math::exp;
use marf_field::occupancy::Probe;
use marf_field::rng::random_numbers;
use marf_shaders::counts;

const SEED: u64 = 0xfedc_ba98_7654_3210;
/// What shows in steps of these is above and below the mean of densities here, about 0.26.
const MIN_STEPS: [f32; 2] = [0.03, 0.3];
/// Thresholds are sums of floats in another order than the CPU's sum in f64, and one exponential more or less exact.
const NEAR: f32 = 1e-5;

/// Densities of all kinds, random bits.
fn grid(side: u32, refill: Refill) -> Occupancy {
    let mut rng = random_numbers(3, Purpose::Rays, 0, u64::from(side));
    let mut bits = Bits::new(side);
    let cells = (0..side.pow(3) as usize).map(|cell| {
        let kind = rng.below(8);
        if kind.is_multiple_of(2) {
            bits.set(cell);
        }
        match kind {
            0 | 1 => -1.0,
            2 => UNKNOWN,
            3 => 0.0,
            _ => 0.5 * rng.unit_f32(),
        }
    });
    let density = cells.collect();
    Occupancy {
        density,
        bits,
        refill,
    }
}

/// Raw densities of a pass, some of them no numbers.
fn raw(capacity: usize, stream: u64) -> Vec<f32> {
    let mut rng = random_numbers(4, Purpose::Rays, 1, stream);
    let mut raw: Vec<f32> = (0..capacity).map(|_| 8.0 * rng.unit_f32() - 4.0).collect();
    let extremes = [
        f32::NAN,
        f32::INFINITY,
        f32::NEG_INFINITY,
        200.0,
        -200.0,
        f32::MAX,
    ];
    for (at, extreme) in extremes.iter().enumerate() {
        raw[at * 7 % capacity] = *extreme;
    }
    raw
}

struct Device {
    state: State,
    xyz: Array<f32>,
    raw: Array<f32>,
    faults: Array<u32>,
    cells: Array<u32>,
    counts: Array<u32>,
    update: Update,
}

fn device(gpu: &Gpu, occupancy: &Occupancy, capacity: usize, min_step: f32) -> Device {
    let state = State::new(gpu, occupancy).unwrap();
    let xyz = gpu.filled("xyz", &vec![-7.0_f32; 3 * capacity]).unwrap();
    let raw = gpu.zeros("raw", capacity).unwrap();
    let faults = gpu.zeros("faults", 8).unwrap();
    let cells = gpu.zeros("cells", capacity).unwrap();
    let counts = gpu.zeros("counts", counts::LEN).unwrap();
    let arrays = ProbeArrays {
        xyz: &xyz,
        raw: &raw,
        faults: &faults,
        cells: &cells,
        counts: &counts,
    };
    let kernels = Kernels::new(gpu).unwrap();
    let update = Update::new(gpu, &kernels, &state, arrays, min_step).unwrap();
    Device {
        state,
        xyz,
        raw,
        faults,
        cells,
        counts,
        update,
    }
}

impl Device {
    /// Runs the probes of a pass and returns how many there are.
    fn probe(&self, gpu: &Gpu, pass: usize) -> usize {
        gpu.write(&self.counts, counts::VISITED as usize, &[0]);
        gpu.submit(|recorder| self.update.probe(recorder, pass));
        gpu.read(&self.counts).unwrap()[counts::VISITED as usize] as usize
    }
}

/// Runs an update whose pass p finds `raw(capacity, p)`: the probes, and the density found at each.
fn run(gpu: &Gpu, device: &Device, due: ProbeSchedule) -> Vec<(Probe, f32)> {
    let capacity = device.raw.len();
    let mut all = Vec::new();
    device.update.begin(gpu, SEED, due);
    for pass in 0..device.update.passes() {
        let probes = device.probe(gpu, pass);
        let (xyz, slots) = (gpu.read(&device.xyz).unwrap(), gpu.read(&device.cells).unwrap());
        let raw = raw(capacity, pass as u64);
        for slot in 0..probes {
            let at = [0, 1, 2].map(|axis| xyz[axis * capacity + slot]);
            let cell = slots[slot];
            let found = if raw[slot].is_finite() {
                exp(raw[slot] + RAW_SHIFT)
            } else {
                f32::NAN
            };
            all.push((Probe { cell, at }, found));
        }
        gpu.write(&device.raw, 0, &raw);
        gpu.submit(|recorder| device.update.found(recorder));
    }
    gpu.submit(|recorder| device.update.finish(recorder));
    // Slots are given in any order, the CPU's probes go by their cells.
    all.sort_by_key(|(probe, _)| probe.cell);
    all
}

/// Compares one update with the CPU's and prints how far densities and bits are apart.
fn agrees(gpu: &Gpu, mut expected: Occupancy, capacity: usize, due: ProbeSchedule, min_step: f32) {
    let (side, refill) = (expected.bits.side, expected.refill);
    let device = device(gpu, &expected, capacity, min_step);
    let probes = expected.probes(SEED, due.round, u64::from(due.occupied), u64::from(due.empty));
    let found = run(gpu, &device, due);
    let chosen: Vec<Probe> = found.iter().map(|(probe, _)| *probe).collect();
    assert_eq!(chosen, probes, "{side} {due:?}");
    let densities: Vec<f32> = found.iter().map(|(_, density)| *density).collect();
    let before = expected.bits.clone();
    expected.update(&probes, &densities, min_step);
    let after = device.state.read(gpu).unwrap();
    let mut most = 0.0_f32;
    for (cell, (found, expected)) in after.density.iter().zip(&expected.density).enumerate() {
        let error = (found - expected).abs() / expected.abs().max(1e-30);
        assert!(error <= 3e-7, "cell {cell}: {found} against {expected}");
        most = most.max(error);
    }
    let known = expected
        .density
        .iter()
        .filter(|density| (0.0..UNKNOWN).contains(*density));
    let (sum, count) = known.fold((0.0, 0), |(sum, count), density| {
        (sum + f64::from(*density), count + 1)
    });
    let shows = OCCUPIED / min_step;
    let least = shows.min((sum / f64::from(count.max(1))) as f32);
    let mut apart = 0;
    for (cell, density) in expected.density.iter().enumerate() {
        let number = cell as u32;
        if after.bits.holds(number) != expected.bits.holds(number) {
            let empty = !before.holds(number) && refill == Refill::WhereItShows;
            let threshold = if empty { shows } else { least };
            let near = (density - threshold).abs() <= NEAR * threshold;
            assert!(near, "cell {cell}: {density}, threshold {threshold}");
            apart += 1;
        }
    }
    println!("occupancy, side {side}, {refill:?}, {capacity} slots: {most:e}, {apart} bits, mean {least}");
}

const EARLY: ProbeSchedule = ProbeSchedule {
    round: 3,
    occupied: 4,
    empty: 4,
};
const LATE: ProbeSchedule = ProbeSchedule {
    round: (1 << 40) + 18,
    occupied: 4,
    empty: 16,
};

#[test]
fn an_update_agrees_with_the_cpu() {
    let Some(gpu) = gpu("an_update_agrees_with_the_cpu") else {
        return;
    };
    // One pass that just fits, several, and more slots than candidates.
    for min_step in MIN_STEPS {
        agrees(&gpu, grid(32, Refill::AtMean), 8192, EARLY, min_step);
        agrees(&gpu, grid(32, Refill::WhereItShows), 3072, LATE, min_step);
        agrees(&gpu, grid(16, Refill::WhereItShows), 4096, EARLY, min_step);
    }
}

#[test]
fn all_cells_are_due_once_in_sixteen_updates() {
    let Some(gpu) = gpu("all_cells_are_due_once_in_sixteen_updates") else {
        return;
    };
    let mut empty = grid(16, Refill::AtMean);
    empty.bits = Bits::new(16);
    empty.density.fill(0.5);
    let device = device(&gpu, &empty, 1024, MIN_STEPS[0]);
    let mut times = vec![0; 4096];
    for round in 0..16 {
        device.update.begin(&gpu, SEED, ProbeSchedule { round, ..LATE });
        let probes = device.probe(&gpu, 0);
        let cells = gpu.read(&device.cells).unwrap();
        cells[..probes].iter().for_each(|cell| times[*cell as usize] += 1);
    }
    assert!(times.iter().all(|times| *times == 1));
}

#[test]
fn a_fault_leaves_densities_and_bits() {
    let Some(gpu) = gpu("a_fault_leaves_densities_and_bits") else {
        return;
    };
    let before = grid(16, Refill::AtMean);
    let device = device(&gpu, &before, 1024, MIN_STEPS[0]);
    gpu.write(&device.faults, 7, &[1]);
    run(&gpu, &device, EARLY);
    assert_eq!(device.state.read(&gpu), Ok(before));
}

#[test]
fn a_grid_that_nobody_looked_at_or_sees_stays_as_it_is() {
    let Some(gpu) = gpu("a_grid_that_nobody_looked_at_or_sees_stays_as_it_is") else {
        return;
    };
    for (density, occupied) in [(UNKNOWN, true), (-1.0, false), (0.0, true)] {
        let mut before = grid(16, Refill::AtMean);
        before.density.fill(density);
        let device = device(&gpu, &before, 1024, MIN_STEPS[0]);
        gpu.submit(|recorder| device.update.finish(recorder));
        let after = device.state.read(&gpu).unwrap();
        assert_eq!(after.bits.share(), f64::from(u8::from(occupied)), "{density}");
        assert_eq!(after.density, before.density);
    }
}

#[test]
fn a_grid_is_read_back_as_it_was_written() {
    let Some(gpu) = gpu("a_grid_is_read_back_as_it_was_written") else {
        return;
    };
    let (first, second) = (grid(16, Refill::AtMean), grid(16, Refill::AtMean));
    let state = State::new(&gpu, &first).unwrap();
    assert_eq!(state.read(&gpu).as_ref(), Ok(&first));
    let mut other = second;
    other.density.reverse();
    state.write(&gpu, &other);
    assert_eq!(state.read(&gpu), Ok(other));
}
