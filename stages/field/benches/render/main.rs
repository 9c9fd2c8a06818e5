//! Time of whole pictures on all threads: `cargo bench -p marf-field --bench render`.
//!
//! The field is trained on a ball on chequered ground, 400 steps. Times of real scenes are in
//! `benches/field.md`.
#![allow(
    missing_docs,
    clippy::expect_used,
    reason = "criterion's macros write public functions, and a bench that cannot continue should stop"
)]

mod scene;

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use marf_field::{Config, Field, Trainer};
use marf_scene::Camera;

const STEPS: u64 = 400;

fn trained() -> Field {
    let config = Config {
        steps: Some(STEPS),
        ..Config::default()
    };
    let mut trainer = Trainer::new(scene::views(), &[], &config, 0).expect("the scene is valid");
    while trainer.steps() < STEPS {
        trainer.advance(STEPS - trainer.steps()).expect("finite numbers");
    }
    trainer.field().expect("the CPU is there")
}

fn pictures(criterion: &mut Criterion) {
    let (field, pose) = (trained(), scene::views()[0].cam_from_world);
    let mut group = criterion.benchmark_group("picture");
    group.sample_size(10);
    for (width, height) in [(360, 480), (160, 120)] {
        let camera = Camera::pinhole(width, height, f64::from(width));
        group.bench_function(format!("{width} x {height}"), |bencher| {
            bencher.iter(|| black_box(field.render(&camera, &pose).expect("the CPU renders")));
        });
    }
    group.finish();
}

criterion_group!(benches, pictures);
criterion_main!(benches);
