//! Time of a whole adjustment: the last global one of a walk of 92 photos, and a local one of 7 of them.

use criterion::{Criterion, criterion_group, criterion_main};
use marf_calibrate::bench_api::adjustment;

fn bundle(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("bundle");
    group.sample_size(10);
    for (name, poses, points, free, dense) in [
        ("global, 92 photos, dense", 92, 11_500, 92, 1),
        ("global, 92 photos, conjugate gradients", 92, 11_500, 92, 0),
        ("local, 7 of 24 photos", 24, 1_500, 7, 1),
        ("global, 300 photos, dense", 300, 40_000, 300, 1),
        ("global, 300 photos, conjugate gradients", 300, 40_000, 300, 0),
    ] {
        let task = adjustment(poses, points, free, dense);
        let name = format!("{name}, {} observations, 15 steps", task.observations());
        group.bench_function(name, |bencher| bencher.iter(|| task.run()));
    }
    group.finish();
}

criterion_group!(benches, bundle);
criterion_main!(benches);
