//! CPU time of finding features and of comparing two photos, on one thread.
#![allow(missing_docs, reason = "criterion's macros write public functions")]

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use marf_scene::Image;
use marf_sfm_features::features::{FeatureOptions, Features, Gray, Mask, extract};
use marf_sfm_features::matching::match_pair;

/// A photo of 1440 x 1920 with about as many features as a real one: value noise of several sizes.
fn photo(shift: u32) -> Image<marf_scene::Srgb> {
    let hash = |x: u32, y: u32| {
        let mixed = (x.wrapping_mul(0x9e37_79b9) ^ y.wrapping_mul(0x85eb_ca6b)).wrapping_mul(0xc2b2_ae35);
        ((mixed ^ (mixed >> 15)).wrapping_mul(0x27d4_eb2f) >> 24) as f32
    };
    let smooth = |x: u32, y: u32, size: u32| {
        let (column, row) = (x / size, y / size);
        let (across, down) = ((x % size) as f32 / size as f32, (y % size) as f32 / size as f32);
        let top = hash(column, row) * (1.0 - across) + hash(column + 1, row) * across;
        let bottom = hash(column, row + 1) * (1.0 - across) + hash(column + 1, row + 1) * across;
        top * (1.0 - down) + bottom * down
    };
    Image::from_fn(1440, 1920, |x, y| {
        let value = [(24, 0.3), (60, 0.4), (170, 0.3)]
            .iter()
            .map(|&(size, weight)| weight * smooth(x + shift, y, size));
        [value.sum::<f32>() as u8; 3]
    })
}

/// A photo shrunk to half its size.
fn working(photo: &Image<marf_scene::Srgb>) -> (Gray, Mask) {
    (Gray::from_photo(photo, 2), Mask::from_photo(photo, 2, None))
}

fn features(working: &(Gray, Mask)) -> Features {
    extract(&working.0, &working.1, &FeatureOptions::default(), &|| false).unwrap_or_default()
}

fn benches(criterion: &mut Criterion) {
    let (first, second) = (photo(0), photo(40));
    criterion.bench_function("gray and mask, 1440 x 1920 to 720 x 960", |bench| {
        bench.iter(|| working(black_box(&first)));
    });
    let shrunk = working(&first);
    let (a, b) = (features(&shrunk), features(&working(&second)));
    let (found, others) = (a.keypoints.len(), b.keypoints.len());
    criterion.bench_function(&format!("{found} features of 720 x 960"), |bench| {
        bench.iter(|| features(black_box(&shrunk)));
    });
    criterion.bench_function(&format!("match {found} x {others}"), |bench| {
        bench.iter(|| match_pair(black_box(&a), &b));
    });
}

criterion_group!(all, benches);
criterion_main!(all);
