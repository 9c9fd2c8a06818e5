//! Where the samples of every ray begin, against a running sum.

use marf_shaders::Shader;

use super::Gpu;
use super::march::{SampleArrays, Scan, ScanArrays, kept_walk, whole_walk};
use super::testing::gpu;
use marf_field::cpu::march::Steps;
use marf_field::rng::{Purpose, random_numbers};

/// Scans amounts into a capacity and returns spans and counts, which held 7s.
fn scanned(
    gpu: &Gpu,
    scan: &Scan,
    amounts: &[u32],
    capacity: usize,
    again: Option<u32>,
) -> (Vec<u32>, Vec<u32>) {
    let slots = amounts.len().max(1);
    let steps = Steps::new(1.0, 2.0, 0.5, 0.0);
    let walk = whole_walk(amounts.len(), slots, capacity, &steps, 16);
    let told = gpu
        .uniform("walk", again.map_or(walk, |_| kept_walk(walk)))
        .unwrap();
    let amounts = gpu.filled("amounts", amounts).unwrap();
    let spans = gpu.filled("spans", &vec![7; 2 * slots]).unwrap();
    let counts = gpu.filled("counts", &[7, 7, again.unwrap_or(7), 7]).unwrap();
    let samples = SampleArrays::new(gpu, 256).unwrap();
    let arrays = ScanArrays {
        walk: &told,
        amounts: &amounts,
        spans: (&spans).into(),
        counts: &counts,
        samples: &samples,
    };
    let bound = scan.bind(gpu, arrays);
    gpu.submit(|recorder| recorder.groups(&bound, Scan::groups(slots)));
    (gpu.read(&spans).unwrap(), gpu.read(&counts).unwrap())
}

#[test]
fn a_scan_of_any_number_of_rays_is_a_running_sum() {
    let Some(gpu) = gpu("a_scan_of_any_number_of_rays_is_a_running_sum") else {
        return;
    };
    let scan = Scan::new(&gpu).unwrap();
    let mut rng = random_numbers(4, Purpose::Rays, 0, 0);
    for count in [0, 1, 2, 255, 256, 257, 5000, 100_000] {
        let amounts: Vec<u32> = (0..count).map(|_| rng.below(40) as u32).collect();
        let total: u32 = amounts.iter().sum();
        for capacity in [total, total / 2, 0] {
            let (spans, counts) = scanned(&gpu, &scan, &amounts, capacity as usize, None);
            let (mut next, mut fits) = (0, 0);
            for (ray, amount) in amounts.iter().enumerate() {
                let is_next = fits == ray && next + amount <= capacity;
                let expected = if is_next { [next, *amount] } else { [u32::MAX, 0] };
                assert_eq!(
                    [spans[ray], spans[count + ray]],
                    expected,
                    "{count} {capacity} {ray}"
                );
                fits += usize::from(is_next);
                next += if is_next { *amount } else { 0 };
            }
            assert_eq!(counts, [next, 7, fits as u32, 0], "{count} {capacity}");
        }
    }
    assert_eq!(scanned(&gpu, &scan, &[], 256, None).0, [7, 7]);
}

#[test]
fn sums_beyond_32_bits_clip_and_a_second_scan_keeps_the_rays_of_the_first() {
    let Some(gpu) = gpu("sums_beyond_32_bits_clip_and_a_second_scan_keeps_the_rays_of_the_first") else {
        return;
    };
    let scan = Scan::new(&gpu).unwrap();
    let huge = [3, u32::MAX, 1, u32::MAX, 2];
    let (spans, counts) = scanned(&gpu, &scan, &huge, 256, None);
    assert_eq!(spans[..5], [0, u32::MAX, u32::MAX, u32::MAX, u32::MAX]);
    assert_eq!((&spans[5..], counts), (&[3, 0, 0, 0, 0][..], vec![3, 7, 1, 0]));
    // Three rays are in use: the rest is not looked at, and neither RAYS nor ALIVE change.
    let (spans, counts) = scanned(&gpu, &scan, &[2, 0, 5, 9, 9], 256, Some(3));
    assert_eq!(spans, [0, 2, 2, 7, 7, 2, 0, 5, 7, 7]);
    assert_eq!(counts, [7, 7, 3, 7]);
}

/// Leaves ones in all workgroup memory that core WebGPU grants, in more workgroups than there are places to run one.
const DIRTY: Shader = Shader {
    name: "dirty",
    shared: &[],
    text: "
@group(0) @binding(0) var<storage, read_write> seen: array<u32>;
var<workgroup> ones: array<u32, 4096>;
@compute @workgroup_size(256)
fn main(@builtin(local_invocation_index) me: u32, @builtin(workgroup_id) group: vec3<u32>) {
    for (var at = me; at < 4096u; at += 256u) { ones[at] = 0xffffffffu; }
    workgroupBarrier();
    if me == 0u { seen[group.x] = ones[group.x]; }
}",
    heads: &[],
};

/// Fills workgroup memory with ones.
pub fn make_dirty(gpu: &Gpu) {
    let seen = gpu.zeros::<u32>("seen", 4096).unwrap();
    let dirty = gpu.bind(&gpu.kernel(&DIRTY, "").unwrap(), &[(&seen).into()]);
    gpu.submit(|recorder| recorder.groups(&dirty, [4096, 1, 1]));
    assert!(gpu.read(&seen).unwrap().iter().all(|word| *word == u32::MAX));
}

#[test]
fn a_scan_does_not_rely_on_what_workgroup_memory_holds_before() {
    let Some(gpu) = gpu("a_scan_does_not_rely_on_what_workgroup_memory_holds_before") else {
        return;
    };
    let scan = Scan::new(&gpu).unwrap();
    let amounts = [3, 0, 4];
    let clean = scanned(&gpu, &scan, &amounts, 256, None);
    for _ in 0..4 {
        make_dirty(&gpu);
        assert_eq!(scanned(&gpu, &scan, &amounts, 256, None), clean);
    }
    assert_eq!(clean.1, [7, 7, 3, 0]);
}
