//! What a device can do at most, by its own clock: for `cargo bench` alone.

use std::time::{Duration, Instant};

use marf_shaders::{COPY, Chains, MULTIPLY_ADD};

use super::Gpu;
use super::array::Array;
use super::kernel::one_each;
use super::record::{Work, dispatch};
use marf_field::GpuError;

/// Bytes that are copied: more than the caches of most devices hold.
const BYTES: usize = 64 << 20;
/// Threads of the chains, and links of a chain in fours.
const THREADS: usize = 1 << 20;
const ROUNDS: u32 = 64;
/// Operations of a thread in a round: 4 vectors of 4 chains, 4 links each, a product and a sum.
const OPERATIONS: usize = 4 * 4 * 4 * 2;
/// Runs of a measurement. The fastest counts.
const RUNS: usize = 10;
/// Time for which the device works before the runs.
const WARM: Duration = Duration::from_secs(1);

/// The most that a device gives.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ceilings {
    /// Bytes a second of a copy of 64 MB, read and written ones both counted.
    pub bytes_per_s: f64,
    /// Operations a second of fused multiply-adds in f32, two each.
    pub operations_per_s: f64,
}

/// Measures them.
///
/// # Errors
/// A device without timestamps, or with less than 128 MB.
pub fn ceilings(gpu: &Gpu) -> Result<Ceilings, GpuError> {
    let copy = copy(gpu, &vec![1; BYTES / size_of::<u32>()])?.0;
    let (chains, _) = chains(gpu, ROUNDS, THREADS)?;
    Ok(Ceilings {
        bytes_per_s: 2.0 * BYTES as f64 / fastest(gpu, &copy)?,
        operations_per_s: (THREADS * OPERATIONS) as f64 * f64::from(ROUNDS) / fastest(gpu, &chains)?,
    })
}

/// Returns the seconds of the fastest of some runs.
fn fastest(gpu: &Gpu, work: &Work) -> Result<f64, GpuError> {
    let mut least = f64::INFINITY;
    // A card that has slept runs at a sixth of its clock at first.
    let began = Instant::now();
    while began.elapsed() < WARM {
        gpu.submit_timed(|recorder| work.record(recorder))?;
    }
    for _ in 0..RUNS {
        let times = gpu.submit_timed(|recorder| work.record(recorder))?;
        least = least.min(times.iter().map(|(_, seconds)| seconds).sum());
    }
    Ok(least)
}

/// A dispatch, and what it writes.
type Bound<T> = (Work, Array<T>);

fn copy(gpu: &Gpu, numbers: &[u32]) -> Result<Bound<u32>, GpuError> {
    let source = gpu.filled("source", numbers)?;
    let copied = gpu.zeros("copy", numbers.len())?;
    let parts = [(&source).into(), (&copied).into()];
    let groups = one_each(numbers.len() / 4);
    let work = dispatch(gpu, &gpu.kernel(&COPY, "")?, &parts, groups);
    Ok((work, copied))
}

fn chains(gpu: &Gpu, rounds: u32, threads: usize) -> Result<Bound<[f32; 4]>, GpuError> {
    let run = Chains {
        rounds,
        factor: 0.999,
        addend: 0.001,
        pad: 0,
    };
    let run = gpu.uniform("chains", run)?;
    let sums = gpu.zeros("sums", threads)?;
    let parts = [(&run).into(), (&sums).into()];
    let work = dispatch(gpu, &gpu.kernel(&MULTIPLY_ADD, "")?, &parts, one_each(threads));
    Ok((work, sums))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gpu::testing::{gpu, own_gpu};

    #[test]
    fn a_copy_has_the_bits_of_its_source() {
        let Some(gpu) = gpu("a_copy_has_the_bits_of_its_source") else {
            return;
        };
        let numbers: Vec<u32> = (0..1028_u32)
            .map(|index| index.wrapping_mul(0x9e37_79b9))
            .collect();
        let (work, copied) = copy(&gpu, &numbers).unwrap();
        gpu.submit(|recorder| work.record(recorder));
        assert_eq!(gpu.read(&copied), Ok(numbers));
    }

    /// Every link rounds once, to half of 6e-8. There are 12 links of a sum of four.
    const TOLERANCE: f32 = 2e-6;

    #[test]
    fn chains_have_as_many_links_as_are_counted() {
        let Some(gpu) = gpu("chains_have_as_many_links_as_are_counted") else {
            return;
        };
        let threads = 70;
        let (work, sums) = chains(&gpu, 3, threads).unwrap();
        gpu.submit(|recorder| work.record(recorder));
        for (thread, found) in gpu.read(&sums).unwrap().into_iter().enumerate() {
            let chain = |offset: f32| {
                let begin = thread as f32 / threads as f32 + offset;
                (0..4 * 3).fold(begin, |x: f32, _| x.mul_add(0.999, 0.001))
            };
            let expected: f32 = [0.0, 0.25, 0.5, 0.75].map(chain).iter().sum();
            for sum in found {
                assert!(
                    (sum - expected).abs() < TOLERANCE,
                    "thread {thread}: {sum}, {expected}"
                );
            }
        }
    }

    #[test]
    fn dispatches_are_timed_by_name_in_their_order_and_do_their_work() {
        let Some(mut gpu) = own_gpu("dispatches_are_timed_by_name_in_their_order_and_do_their_work") else {
            return;
        };
        let numbers = vec![7; 1 << 16];
        let ((copy, copied), (chains, _)) = (copy(&gpu, &numbers).unwrap(), chains(&gpu, 3, 64).unwrap());
        let record = |recorder: &mut crate::gpu::record::Recorder<'_>| {
            copy.record(recorder);
            chains.record(recorder);
        };
        let times = gpu.submit_timed(record).unwrap();
        let names: Vec<&str> = times.iter().map(|(name, _)| *name).collect();
        assert_eq!(names, ["copy", "multiply_add"]);
        assert!(times.iter().all(|(_, s)| (0.0..10.0).contains(s)), "{times:?}");
        assert_eq!(gpu.read(&copied), Ok(numbers));
        gpu.features = wgpu::Features::empty();
        let refused = gpu.submit_timed(record);
        assert!(
            matches!(refused, Err(GpuError::NoTimestamps { .. })),
            "{refused:?}"
        );
    }
}
