//! The numbers of a reason are those of the verdict: the measure, and the limit that it was compared with.

use crate::common::{Photos, defaults, ground, noise, png, smeared};
use marf_scene::{Image, Srgb};
use marf_stage::Verdict;
use serde_json::{Value, json};

/// Returns the verdict on a photo among eight others, and its measure and limit.
fn judged(filter: &str, params: Value, image: &Image<Srgb>) -> (Verdict, f64, f64) {
    let mut photos = Photos::default();
    for seed in 100..108 {
        photos.add(&format!("place-{seed}"), &png(&ground(seed)));
    }
    photos.add("odd", &png(image));
    let verdict = photos.judge(filter, params).remove("odd").unwrap();
    let (score, limit) = (verdict.score.unwrap(), verdict.threshold.unwrap());
    assert_eq!(verdict.verdict, filter, "{verdict:?}");
    (verdict, score, limit)
}

fn flat(side: u32) -> Image<Srgb> {
    Image::from_fn(side, side, |_, _| [77; 3])
}

#[test]
fn reasons_of_blur_have_the_measure_and_the_limit() {
    let (laplacian, ..) = judged("blur", json!({"rule": "laplacian"}), &flat(64));
    assert_eq!(laplacian.reason, "variance of the Laplacian 0.0, at least 60");
    let (smear, ratio, least) = judged("blur", defaults(), &smeared(&ground(120), 15));
    let part = ["1/1", "1/2", "1/4"]
        .map(|part| format!("reblur ratio {ratio:.1} at {part} of the size along rows, at least {least:.1}"));
    assert!(part.contains(&smear.reason) && ratio < least, "{smear:?}");
    let static_noise = Image::from_fn(320, 240, |x, y| [0, 1, 2].map(|band| noise(x, y, band)));
    let (noisy, ratio, most) = judged("blur", defaults(), &static_noise);
    assert_eq!(
        noisy.reason,
        format!("reblur ratio {ratio:.0}, at most {most:.0}: noise or a raw mosaic")
    );
    assert!(ratio > most, "{noisy:?}");
    let (tiny, ..) = judged("blur", defaults(), &flat(2));
    assert_eq!(tiny.reason, "fewer than 3 pixels a side: nothing can be sharp");
}

#[test]
fn reasons_of_grayscale_and_histogram_have_the_measure_and_the_limit() {
    let params = json!({"keep": "color", "min_spread": 8, "min_share": 0.01});
    let (gray, ..) = judged("grayscale", params, &flat(64));
    assert_eq!(
        gray.reason,
        "0.00 % of pixels with channels more than 8 apart, at least 1.00 %"
    );
    // Two thirds of the photo are black.
    let place = ground(110);
    let lost = Image::from_fn(320, 240, |x, y| if y < 80 { place.at(x, y) } else { [0; 3] });
    let (lost, share, most) = judged("histogram", defaults(), &lost);
    let areas = ["in blocks of one single brightness", "burnt out or black"]
        .map(|what| format!("67 % of the photo {what}, at most {:.0} %", 100.0 * most));
    assert!(
        (share - 2.0 / 3.0).abs() < 0.005 && areas.contains(&lost.reason),
        "{lost:?}"
    );
    let negative = Image::from_fn(320, 240, |x, y| place.at(x, y).map(|value| 255 - value));
    let (far, distance, limit) = judged("histogram", defaults(), &negative);
    let ends = format!(", at most {limit:.0}");
    assert!(
        far.reason.contains(&format!(
            " is {distance:.0} steps from the set's median histogram, usual "
        )) && far.reason.ends_with(&ends)
            && distance > limit,
        "{far:?}"
    );
    // All bins of the others hold 1/256 but for a jitter. The odd one has all its pixels in one bin.
    let mut photos = Photos::default();
    for step in [1, 3, 5, 7] {
        let even = Image::from_fn(256, 16, |x, y| {
            [if y == 0 { (x * step % 256) as u8 } else { x as u8 }; 3]
        });
        photos.add(&format!("even-{step}"), &png(&even));
    }
    photos.add("odd", &png(&flat(64)));
    let paper = &photos.judge("histogram", json!({"rule": "paper", "max_bins": 0.25}))["odd"];
    assert_eq!(paper.reason, "100 % of the bins out of place, at most 25 %");
    for (count, said) in [(2, true), (3, false)] {
        let mut few = Photos::default();
        for seed in 0..count {
            few.add(&format!("place-{seed}"), &png(&ground(seed)));
        }
        for verdict in few.judge("histogram", json!({"rule": "paper"})).values() {
            let is_said = verdict.reason == "fewer than 3 photos have no mean to be far from";
            assert_eq!(is_said, said, "{verdict:?}");
        }
    }
}

#[test]
fn reasons_of_shape_and_of_duplicates_have_the_measure_and_the_limit() {
    for (params, said) in [
        (
            json!({"min_width": 65, "min_height": 1}),
            "64 x 64 pixels, width at least 65",
        ),
        (
            json!({"min_width": 64, "min_height": 65}),
            "64 x 64 pixels, height at least 65",
        ),
    ] {
        assert_eq!(judged("shape", params, &flat(64)).0.reason, said);
    }
    for (params, at_zero) in [
        (defaults(), "gradients correlate 1.000, at least "),
        (
            json!({"rule": "phash", "max_bits": 7}),
            "hashes 0 bits apart, less than 7",
        ),
    ] {
        let mut photos = Photos::default();
        photos.add("a", &png(&ground(0))).add("b", &png(&ground(0)));
        let verdicts = photos.judge("duplicate", params);
        let twin = verdicts.values().find(|verdict| !verdict.keeps()).unwrap();
        let kept = twin.twin.as_deref().unwrap();
        assert!(
            twin.reason.starts_with(&format!("like `{kept}`: {at_zero}")),
            "{twin:?}"
        );
        if at_zero.starts_with("gradients") {
            let ends = format!("at least {}, hashes 0 bits apart", twin.threshold.unwrap());
            assert!(twin.reason.ends_with(&ends), "{twin:?}");
        }
    }
}
