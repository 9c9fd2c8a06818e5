//! The occupancy grid on the GPU: twin of `marf_field::occupancy`.
//!
//! An update: [`Update::begin`]. For every pass a count of 0, [`Update::probe`], the density of the points in
//! `xyz` into `raw`, [`Update::found`]. Then [`Update::finish`].

use marf_shaders::{BITS, DENSITY_SUM, Filling, OCCUPANCY, PROBE, Probing, THRESHOLDS, Tally, counts};

use super::Gpu;
use super::array::{Array, Part, halves};
use super::kernel::{Bound, GROUP, Kernel, fold};
use super::march::bit_words;
use super::nets::limits;
use super::record::Recorder;
use marf_field::GpuError;
use marf_field::cpu::composite::RAW_SHIFT;
use marf_field::cpu::space::Bits;
use marf_field::occupancy::{DECAY, OCCUPIED, OCCUPIED_EVERY, Occupancy, Refill, SPREAD, UNKNOWN};
use marf_field::rng::Purpose;

/// Cells that a thread of `density_sum` adds up.
const EACH: usize = 32;

/// The compiled kernels.
pub struct Kernels {
    probe: Kernel,
    occupancy: Kernel,
    sum: Kernel,
    thresholds: Kernel,
    bits: Kernel,
}

impl Kernels {
    /// Compiles them.
    ///
    /// # Errors
    /// A driver that does not compile one.
    pub fn new(gpu: &Gpu) -> Result<Self, GpuError> {
        Ok(Self {
            probe: gpu.kernel(&PROBE, "")?,
            occupancy: gpu.kernel(&OCCUPANCY, &limits())?,
            sum: gpu.kernel(&DENSITY_SUM, &format!("const EACH: u32 = {EACH}u;\n"))?,
            thresholds: gpu.kernel(&THRESHOLDS, "")?,
            bits: gpu.kernel(&BITS, "")?,
        })
    }
}

/// The grid on a device.
pub struct State {
    /// `[side^3]`, x fastest. -1 where no camera looks.
    pub density: Array<f32>,
    /// `[side^3 / 64 * 2]`, lower half of a word first: cell c is bit `c & 31` of word `c >> 5`.
    pub bits: Array<u32>,
    side: u32,
    refill: Refill,
}

impl State {
    /// Copies a grid to a device.
    ///
    /// # Errors
    /// Memory that was refused.
    pub fn new(gpu: &Gpu, occupancy: &Occupancy) -> Result<Self, GpuError> {
        Ok(Self {
            density: gpu.filled("densities of the grid", &occupancy.density)?,
            bits: gpu.filled("occupied cells", &bit_words(&occupancy.bits))?,
            side: occupancy.bits.side,
            refill: occupancy.refill,
        })
    }

    /// Overwrites it with another grid of the same side that fills in the same way.
    pub fn write(&self, gpu: &Gpu, occupancy: &Occupancy) {
        gpu.write(&self.density, 0, &occupancy.density);
        gpu.write(&self.bits, 0, &bit_words(&occupancy.bits));
    }

    /// Copies it back.
    ///
    /// # Errors
    /// A lost device.
    pub fn read(&self, gpu: &Gpu) -> Result<Occupancy, GpuError> {
        let bits = gpu.read(&self.bits)?;
        let pairs = bits.as_chunks::<2>().0.iter();
        Ok(Occupancy {
            density: gpu.read(&self.density)?,
            bits: Bits {
                side: self.side,
                words: pairs
                    .map(|[low, high]| u64::from(*low) | u64::from(*high) << 32)
                    .collect(),
            },
            refill: self.refill,
        })
    }

    fn cells(&self) -> usize {
        (self.side as usize).pow(3)
    }
}

/// Arrays that probes share with the samples of a batch.
#[derive(Clone, Copy)]
pub struct ProbeArrays<'a> {
    /// `[3][capacity]`: receives the points.
    pub xyz: &'a Array<f32>,
    /// Raw density of the points. Its first `capacity` numbers are read.
    pub raw: &'a Array<f32>,
    /// `[8]`.
    pub faults: &'a Array<u32>,
    /// `[capacity]`: receives the cells of the probes.
    pub cells: &'a Array<u32>,
    /// u32 `[counts::LEN]`: `VISITED` is the number of probes. It must be 0 before every pass.
    pub counts: &'a Array<u32>,
}

/// When cells are looked at: of occupied cells one in `occupied`, of empty ones one in `empty`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ProbeSchedule {
    /// Number of the update.
    pub round: u64,
    /// A power of two.
    pub occupied: u32,
    /// A multiple of `occupied`.
    pub empty: u32,
}

impl ProbeSchedule {
    /// Returns the number of the first cell that is due if occupied. Then each `occupied` further on.
    fn offset(&self) -> u32 {
        let every = u64::from(self.occupied.max(1));
        let is_due = |cell: &u64| (cell * SPREAD + self.round % every).is_multiple_of(every);
        (0..every).find(is_due).unwrap_or(0) as u32
    }
}

/// Updates of a grid, bound to their arrays.
pub struct Update {
    passes: Vec<Pass>,
    found: Bound,
    sum: Bound,
    thresholds: Bound,
    bits: Bound,
    cells: usize,
    capacity: usize,
    parts: usize,
    side: u32,
}

/// One pass over as many candidates as there are slots.
struct Pass {
    uniform: Array<Probing>,
    probe: Bound,
}

impl Update {
    /// Binds the kernels.
    ///
    /// A pass has as many slots as there are `cells`. [`ProbeSchedule::occupied`] is [`OCCUPIED_EVERY`] or
    /// more. `min_step`: the shortest step, contracted.
    ///
    /// # Errors
    /// Memory that was refused.
    pub fn new(
        gpu: &Gpu,
        kernels: &Kernels,
        state: &State,
        arrays: ProbeArrays,
        min_step: f32,
    ) -> Result<Self, GpuError> {
        let (capacity, occupied) = (arrays.cells.len(), OCCUPIED_EVERY as usize);
        let cells = state.cells();
        let parts = cells.div_ceil(GROUP * EACH);
        let filling = gpu.uniform(
            "filling",
            Filling {
                cells: cells as u32,
                parts: parts as u32,
                capacity: capacity as u32,
                at_mean: u32::from(state.refill == Refill::AtMean),
                decay: DECAY,
                unknown: UNKNOWN,
                shows: OCCUPIED / min_step,
                shift: RAW_SHIFT,
                slot: counts::VISITED,
            },
        )?;
        let tallies = gpu.zeros::<Tally>("tallies", parts)?;
        let least = gpu.zeros::<f32>("thresholds", 2)?;
        let (density, bits, filling) = (
            || Part::from(&state.density),
            || Part::from(&state.bits),
            || Part::from(&filling),
        );
        let faults = || Part::from(arrays.faults);
        let passes = (0..cells.div_ceil(capacity.max(1) * occupied.max(1))).map(|_| {
            let uniform = gpu.uniform("probing", bytemuck::Zeroable::zeroed())?;
            let parts = [
                (&uniform).into(),
                density(),
                bits(),
                arrays.cells.into(),
                arrays.xyz.into(),
                arrays.counts.into(),
            ];
            let probe = gpu.bind(&kernels.probe, &parts);
            Ok(Pass { uniform, probe })
        });
        Ok(Self {
            passes: passes.collect::<Result<_, GpuError>>()?,
            found: gpu.bind(
                &kernels.occupancy,
                &[
                    filling(),
                    faults(),
                    arrays.cells.into(),
                    arrays.raw.into(),
                    density(),
                    arrays.counts.into(),
                ],
            ),
            sum: gpu.bind(&kernels.sum, &[filling(), density(), (&tallies).into()]),
            thresholds: gpu.bind(
                &kernels.thresholds,
                &[filling(), (&tallies).into(), (&least).into()],
            ),
            bits: gpu.bind(
                &kernels.bits,
                &[filling(), faults(), density(), (&least).into(), bits()],
            ),
            cells,
            capacity,
            parts,
            side: state.side,
        })
    }

    /// Returns the number of passes of an update.
    pub fn passes(&self) -> usize {
        self.passes.len()
    }

    /// Writes what the passes of the next update look at.
    pub fn begin(&self, gpu: &Gpu, seed: u64, due: ProbeSchedule) {
        for (number, pass) in self.passes.iter().enumerate() {
            let probing = Probing {
                seed: halves(seed),
                round: halves(due.round),
                purpose: Purpose::Occupancy as u32,
                capacity: self.capacity as u32,
                first: (number * self.capacity) as u32,
                side: self.side,
                every: due.occupied,
                offset: due.offset(),
                empty: due.empty,
                factor: SPREAD as u32,
                phase: (due.round % u64::from(due.empty.max(1))) as u32,
                slot: counts::VISITED,
                pad: [0; 2],
            };
            gpu.write(&pass.uniform, 0, &[probing]);
        }
    }

    /// Writes the points of a pass into `xyz`, and their cells, and counts them.
    pub fn probe(&self, recorder: &mut Recorder<'_>, pass: usize) {
        if let Some(pass) = self.passes.get(pass) {
            recorder.threads(&pass.probe, self.capacity);
        }
    }

    /// Takes over the densities of the last pass from `raw`.
    pub fn found(&self, recorder: &mut Recorder<'_>) {
        recorder.threads(&self.found, self.capacity);
    }

    /// Decides all bits again, after the last pass.
    pub fn finish(&self, recorder: &mut Recorder<'_>) {
        recorder.groups(&self.sum, fold(self.parts));
        recorder.groups(&self.thresholds, fold(1));
        recorder.threads(&self.bits, self.cells.div_ceil(32));
    }
}

#[cfg(test)]
mod tests;
