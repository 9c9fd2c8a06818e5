//! Samples on rays: counting, finding where those of every ray begin, writing them, and finding which rays
//! continue.

use marf_shaders::{ALIVE, MARCH, SCAN, Shader, Walk, counts};

use super::Gpu;
use super::array::{Array, Part, halves};
use super::kernel::{Bound, Kernel, fold, one_each};
use super::rays::{Progress, RayArrays};
use super::record::Recorder;
use marf_field::GpuError;
use marf_field::cpu::composite::OPAQUE;
use marf_field::cpu::march::Steps;
use marf_field::cpu::simd::LANES;
use marf_field::cpu::space::Bits;

/// Threads that a ray is walked by. The longest table of steps, `MOST_STEPS`, leaves 64 blocks of 16 to each.
pub const RAY_LANES: usize = 32;
/// Rows of `walked`, one a ray each: first sample and number of visited samples, then of kept ones, then samples of the ray
/// in front of each lane's steps.
pub const WALKED: usize = 4 + RAY_LANES;
/// Rays a workgroup of the kernel `scan`.
const SCANNED: usize = 256;

/// Samples on the device, by columns.
pub struct SampleArrays {
    /// `xyz`, then `along`: rendering has 8 storage buffers a kernel, and its walk needs one for both.
    pub places: Array<f32>,
    /// Position in the unit box, `[3, capacity]`.
    pub xyz: Array<f32>,
    /// Distance (half sides), contracted length and place, `[3, capacity]`.
    pub along: Array<f32>,
    /// Number of the ray, `[capacity]`.
    pub ray_of: Array<u32>,
}

impl SampleArrays {
    /// Allocates the arrays of samples, `capacity` a multiple of 64.
    ///
    /// # Errors
    /// More than the device holds.
    pub fn new(gpu: &Gpu, capacity: usize) -> Result<Self, GpuError> {
        let places = gpu.zeros("places of samples", 6 * capacity)?;
        Ok(Self {
            xyz: places.share(0, 3 * capacity),
            along: places.share(3 * capacity, 3 * capacity),
            places,
            ray_of: gpu.zeros("ray_of", capacity)?,
        })
    }
}

/// Returns begin and length of every step, padded to a multiple of 16.
pub fn step_table(steps: &Steps) -> Vec<[f32; 2]> {
    let pairs = steps.begin.iter().zip(&steps.length);
    pairs.map(|(begin, length)| [*begin, *length]).collect()
}

/// Returns one bit a cell, x fastest, in words of 32.
pub fn bit_words(bits: &Bits) -> Vec<u32> {
    bits.words.iter().copied().flat_map(halves).collect()
}

/// Returns the walk of a training step: every ray at once from its first step to its last.
pub fn whole_walk(rays: usize, slots: usize, capacity: usize, steps: &Steps, side: u32) -> Walk {
    Walk {
        rays: rays as u32,
        ray_slots: slots as u32,
        capacity: capacity as u32,
        limit: u32::MAX,
        steps: steps.count as u32,
        padded: steps.begin.len() as u32,
        side,
        resumes: 0,
        slot: counts::VISITED,
        again: 0,
    }
}

/// Returns the walk of a round of a picture: every ray continues until it has found `limit` samples.
///
/// The limit is cut so that the samples of one ray always fit: every round advances.
pub fn round(whole: Walk, limit: u32) -> Walk {
    Walk {
        resumes: 1,
        limit: limit.min(whole.capacity.saturating_sub(LANES as u32)).max(1),
        ..whole
    }
}

/// Returns the walk for the scan of samples that are kept of those visited, whose number goes to `counts[KEPT]`.
pub fn kept_walk(whole: Walk) -> Walk {
    Walk {
        slot: counts::KEPT,
        again: 1,
        ..whole
    }
}

/// What a walk reads and writes.
#[derive(Clone, Copy)]
pub struct MarchArrays<'a> {
    /// Sizes and limits of the walk.
    pub walk: &'a Array<Walk>,
    /// The rays.
    pub rays: &'a RayArrays,
    /// Of [`step_table`].
    pub steps: &'a Array<[f32; 2]>,
    /// As [`bit_words`].
    pub bits: &'a Array<u32>,
    /// How far the rays have come.
    pub progress: &'a Progress,
    /// Samples of every ray, `[rays]`.
    pub amounts: &'a Array<u32>,
    /// First sample and number of samples, `[2, rays]`, two more rows, and `[rays, RAY_LANES]` for the walk itself: [`WALKED`].
    pub walked: &'a Array<u32>,
    /// Of [`counts::LEN`] numbers.
    pub counts: &'a Array<u32>,
    /// The samples.
    pub samples: &'a SampleArrays,
}

/// Returns the head of kernels in which [`RAY_LANES`] threads share a ray.
pub fn lanes_head() -> String {
    format!("const LANES: u32 = {RAY_LANES}u;\n")
}

/// Returns their workgroups for `rays` rays.
pub fn lanes_each(rays: usize) -> [usize; 3] {
    one_each(RAY_LANES * rays)
}

/// The kernels of a walk.
pub struct March {
    count: Kernel,
    scan: Scan,
    write: Kernel,
}

/// A walk, ready to run.
pub struct MarchPasses {
    /// Counts samples, [`RAY_LANES`] threads a ray.
    pub count: Bound,
    /// Finds where they begin, one thread a ray.
    pub scan: Bound,
    /// Writes them, [`RAY_LANES`] threads a ray.
    pub write: Bound,
}

impl March {
    /// Compiles the kernels.
    ///
    /// # Errors
    /// A driver that does not.
    pub fn new(gpu: &Gpu) -> Result<Self, GpuError> {
        Self::from_shader(gpu, &MARCH)
    }

    /// As [`March::new`], of another text.
    pub(super) fn from_shader(gpu: &Gpu, shader: &Shader) -> Result<Self, GpuError> {
        let head = lanes_head();
        Ok(Self {
            count: gpu.entry(shader, &head, "count")?,
            scan: Scan::new(gpu)?,
            write: gpu.entry(shader, &head, "write")?,
        })
    }

    /// Binds them.
    pub fn bind(&self, gpu: &Gpu, arrays: MarchArrays<'_>) -> MarchPasses {
        let MarchArrays {
            walk,
            rays,
            progress,
            walked,
            samples,
            ..
        } = arrays;
        let slots = rays.slots;
        let shared = [
            walk.into(),
            (&rays.origins).into(),
            (&rays.directions).into(),
            arrays.steps.into(),
            arrays.bits.into(),
            (&progress.next_step).into(),
        ];
        let count = [
            (&progress.done).into(),
            arrays.amounts.into(),
            walked.part(4 * slots, RAY_LANES * slots),
        ];
        let write = [walked.into(), (&samples.places).into(), (&samples.ray_of).into()];
        let scan = ScanArrays {
            walk,
            amounts: arrays.amounts,
            spans: walked.part(0, 2 * slots),
            counts: arrays.counts,
            samples,
        };
        MarchPasses {
            count: gpu.bind(&self.count, &[&shared[..], &count].concat()),
            scan: self.scan.bind(gpu, scan),
            write: gpu.bind(&self.write, &[&shared[..], &write].concat()),
        }
    }
}

impl MarchPasses {
    /// Records a walk of `rays` rays.
    pub fn record(&self, recorder: &mut Recorder<'_>, rays: usize) {
        self.record_count(recorder, rays);
        self.record_write(recorder, rays);
    }

    /// Records the first half: how many samples there are, and where they begin.
    pub fn record_count(&self, recorder: &mut Recorder<'_>, rays: usize) {
        recorder.groups(&self.count, lanes_each(rays));
        recorder.groups(&self.scan, Scan::groups(rays));
    }

    /// Records the second half.
    pub fn record_write(&self, recorder: &mut Recorder<'_>, rays: usize) {
        recorder.groups(&self.write, lanes_each(rays));
    }
}

/// What a scan reads and writes.
#[derive(Clone)]
pub struct ScanArrays<'a> {
    /// Sizes of the walk.
    pub walk: &'a Array<Walk>,
    /// Samples of every ray. The first `rays` numbers are read.
    pub amounts: &'a Array<u32>,
    /// Receives first sample and number of samples, u32 `[2][rays]`.
    pub spans: Part<'a>,
    /// Of [`counts::LEN`] numbers.
    pub counts: &'a Array<u32>,
    /// The samples.
    pub samples: &'a SampleArrays,
}

/// From the number of samples of every ray to where they begin.
pub struct Scan(Kernel);

impl Scan {
    /// Compiles the kernel.
    ///
    /// # Errors
    /// A driver that does not.
    pub fn new(gpu: &Gpu) -> Result<Self, GpuError> {
        Ok(Self(gpu.kernel(&SCAN, "")?))
    }

    /// Returns its workgroups for `rays` rays.
    pub fn groups(rays: usize) -> [usize; 3] {
        fold(rays.div_ceil(SCANNED))
    }

    /// Binds it, one thread a ray.
    pub fn bind(&self, gpu: &Gpu, arrays: ScanArrays<'_>) -> Bound {
        let parts = [
            arrays.walk.into(),
            arrays.amounts.into(),
            arrays.spans,
            arrays.counts.into(),
            (&arrays.samples.xyz).into(),
            (&arrays.samples.along).into(),
            (&arrays.samples.ray_of).into(),
        ];
        gpu.bind(&self.0, &parts)
    }
}

/// Finds which rays of a picture continue.
pub struct Alive(Kernel);

impl Alive {
    /// Compiles the kernel.
    ///
    /// # Errors
    /// A driver that does not.
    pub fn new(gpu: &Gpu) -> Result<Self, GpuError> {
        let head = format!("const OPAQUE: f32 = {OPAQUE:?};\n");
        Ok(Self(gpu.kernel(&ALIVE, &head)?))
    }

    /// Binds it, one thread a ray. `state`: `[6, ray slots]`, row 5 is the transmittance of a ray.
    pub fn bind(
        &self,
        gpu: &Gpu,
        walk: &Array<Walk>,
        state: &Array<f32>,
        progress: &Progress,
        counts: &Array<u32>,
    ) -> Bound {
        let parts = [
            walk.into(),
            state.into(),
            (&progress.next_step).into(),
            (&progress.done).into(),
            counts.into(),
        ];
        gpu.bind(&self.0, &parts)
    }
}
