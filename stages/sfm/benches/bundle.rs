//! Time of a whole adjustment: a global one of 92 and of 300 photos, and a local one of 7 photos.

#[path = "../tests/common/bundle_scene.rs"]
mod bundle_scene;

use criterion::{Criterion, criterion_group, criterion_main};
use marf_numeric::Rng;
use marf_sfm::bundle::{BundleOptions, Loss, PoseFreedom, Problem, Solver, adjust};

use bundle_scene::{RingSize, add_noise, perturb, ring};

/// Returns a perturbed problem whose first `free` poses are free.
fn problem(poses: usize, points: usize, free: usize) -> Problem {
    let size = RingSize {
        poses,
        points,
        longest_track: 17,
        seed: 1,
    };
    let mut problem = ring(&size);
    let mut rng = Rng::new(2);
    problem.pose_freedom[free..].fill(PoseFreedom::Fixed);
    add_noise(&mut problem, 0.5, &mut rng);
    perturb(&mut problem, 0.003, 0.01, &mut rng);
    problem.cameras[0].fx_px *= 1.02;
    problem.cameras[0].fy_px *= 1.02;
    problem
}

fn bundle(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("bundle");
    group.sample_size(10);
    for (name, poses, points, free, solver) in [
        ("global, 92 photos, dense", 92, 11_500, 92, Solver::Dense),
        (
            "global, 92 photos, conjugate gradients",
            92,
            11_500,
            92,
            Solver::ConjugateGradients,
        ),
        ("local, 7 of 24 photos", 24, 1_500, 7, Solver::Dense),
        ("global, 300 photos, dense", 300, 40_000, 300, Solver::Dense),
        (
            "global, 300 photos, conjugate gradients",
            300,
            40_000,
            300,
            Solver::ConjugateGradients,
        ),
    ] {
        let problem = problem(poses, points, free);
        let options = BundleOptions {
            loss: Loss::Cauchy(1.0),
            prior_loss: Loss::Squared,
            max_iterations: 15,
            tolerance: 0.0,
            solver,
        };
        let name = format!("{name}, {} observations, 15 steps", problem.observations.len());
        group.bench_function(name, |bencher| {
            bencher.iter(|| adjust(&mut problem.clone(), &options, &|| false));
        });
    }
    group.finish();
}

criterion_group!(benches, bundle);
criterion_main!(benches);
