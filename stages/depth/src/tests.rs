//! Whole pairs: known surfaces, extremes, equal bytes.

use marf_numeric::{InstructionSet, mix};
use proptest::prelude::*;

use crate::disparities::match_pair_on;
use crate::{Class, Disparities, MAX_DISPARITIES, Picture, Raster, Search, Swapped, match_pair};

/// Smooth brightness that no row or column repeats, in [0, 255].
fn brightness(x: f64, y: f64) -> f64 {
    let (column, row) = (x.floor(), y.floor());
    let corner = |dx: f64, dy: f64| {
        let seed = ((column + dx) as i64 as u64).wrapping_mul(0x9e37) ^ ((row + dy) as i64 as u64) << 32;
        (mix(seed) >> 56) as f64
    };
    let ease = |t: f64| t * t * (3.0 - 2.0 * t);
    let (u, v) = (ease(x - column), ease(y - row));
    let top = corner(0.0, 0.0) * (1.0 - u) + corner(1.0, 0.0) * u;
    let bottom = corner(0.0, 1.0) * (1.0 - u) + corner(1.0, 1.0) * u;
    top * (1.0 - v) + bottom * v
}

fn picture(width: usize, height: usize, value: impl Fn(f64, f64) -> f64) -> Picture {
    let values = (0..width * height).map(|i| value((i % width) as f64, (i / width) as f64).round() as u8);
    Picture::new(Raster {
        width,
        height,
        values: values.collect(),
    })
}

/// A wall whose disparity is `base` + `slope` x: its right picture shows at x - d what the left shows at x.
fn slanted(width: usize, height: usize, base: f64, slope: f64) -> [Picture; 2] {
    let left = picture(width, height, |x, y| brightness(x / 3.0, y / 3.0));
    let right = picture(width, height, |x, y| {
        brightness((x + base) / (1.0 - slope) / 3.0, y / 3.0)
    });
    [left, right]
}

fn search(count: usize) -> Search {
    Search { first: 0, count }
}

fn matched(pair: &[Picture; 2], search: Search) -> Disparities {
    match_pair(&pair[0], &pair[1], search).unwrap()
}

fn median_error(found: &Disparities, truth: impl Fn(usize, usize) -> f64) -> f64 {
    let width = found.disparity.width;
    let known = (0..found.class.values.len()).filter(|i| found.class.values[*i] != Class::None);
    let mut errors: Vec<f64> = known
        .map(|i| (f64::from(found.disparity.values[i]) - truth(i % width, i / width)).abs())
        .collect();
    errors.sort_by(f64::total_cmp);
    errors[errors.len() / 2]
}

/// Fractions of eight bits of brightness: the best that a window of 9 x 9 pixels does on this texture is about .01 px.
const SURFACE_TOLERANCE_PX: f64 = 0.05;

#[test]
fn a_slanted_wall_is_found_to_a_fraction_of_a_pixel() {
    for (base, slope) in [(7.3, 0.0), (5.5, 0.08), (20.25, -0.1)] {
        let found = matched(&slanted(160, 60, base, slope), search(32));
        assert!(found.share() > 0.7, "{base} {slope}: share {}", found.share());
        let error = median_error(&found, |x, _| base + slope * x as f64);
        assert!(
            error < SURFACE_TOLERANCE_PX,
            "{base} {slope}: median error {error} px"
        );
        let middle = 30 * 160 + 90;
        let found_slope = f64::from(found.slope_x.values[middle]);
        assert!((found_slope - slope).abs() < 0.02, "{slope}: slope {found_slope}");
    }
}

#[test]
fn negative_disparities_are_found() {
    let found = matched(
        &slanted(120, 40, -6.4, 0.0),
        Search {
            first: -16,
            count: 32,
        },
    );
    let error = median_error(&found, |_, _| -6.4);
    assert!(
        found.share() > 0.7 && error < SURFACE_TOLERANCE_PX,
        "{} {error}",
        found.share()
    );
}

#[test]
fn a_pair_taken_for_itself_has_disparity_zero() {
    let [left, _] = slanted(100, 40, 5.0, 0.0);
    let found = matched(&[left.clone(), left], Search { first: -8, count: 32 });
    assert!(found.share() > 0.9, "{}", found.share());
    assert!(median_error(&found, |_, _| 0.0) < 1e-3);
}

#[test]
fn a_darker_right_picture_gives_the_same_surface() {
    let [left, mut right] = slanted(120, 40, 9.3, 0.0);
    right
        .grey
        .values
        .iter_mut()
        .for_each(|value| *value = *value / 2 + 40);
    let found = matched(&[left, right], search(32));
    let error = median_error(&found, |_, _| 9.3);
    assert!(
        found.share() > 0.7 && error < 2.0 * SURFACE_TOLERANCE_PX,
        "{} {error}",
        found.share()
    );
}

#[test]
fn a_swapped_pair_is_an_error_that_says_so() {
    let [left, right] = slanted(200, 60, 14.0, 0.05);
    let error = match_pair(&right, &left, search(64)).unwrap_err();
    let Swapped { given, exchanged } = error;
    // What the exchanged pair gives by itself is the larger share.
    let share = matched(&[left, right], search(64)).share();
    assert!(
        given < 0.3 && (exchanged - share).abs() < 0.2,
        "{given} {exchanged} {share}"
    );
    let said = format!(
        "{:.1} % of the pixels match as given and {:.1} % with",
        100.0 * given,
        100.0 * exchanged
    );
    assert!(error.to_string().starts_with(&said), "{error}");
    assert!(error.to_string().contains("Exchange the pictures"), "{error}");
}

#[test]
fn pictures_without_texture_have_no_disparity() {
    let flat = picture(70, 50, |_, _| 128.0);
    let found = matched(&[flat.clone(), flat], search(40));
    assert_eq!(found.share(), 0.0);
}

#[test]
fn masked_pixels_have_no_disparity() {
    let [mut left, right] = slanted(100, 40, 4.0, 0.0);
    left.usable
        .values
        .iter_mut()
        .enumerate()
        .for_each(|(i, usable)| *usable = i % 100 < 50);
    let found = matched(&[left, right], search(32));
    let masked = (0..found.class.values.len()).filter(|i| i % 100 >= 50);
    assert!(masked.clone().all(|i| found.class.values[i] == Class::None));
    assert!(found.share() > 0.3, "{}", found.share());
}

#[test]
fn one_pixel_and_one_disparity_have_no_match() {
    let one = picture(1, 1, |_, _| 7.0);
    assert_eq!(matched(&[one.clone(), one.clone()], search(300)).share(), 0.0);
    let pair = slanted(60, 30, 0.0, 0.0);
    assert_eq!(matched(&pair, search(1)).share(), 0.0);
    assert!(match_pair(&one, &one, search(MAX_DISPARITIES)).is_ok());
}

#[test]
fn a_search_tries_something_and_not_more_than_fits() {
    let most = MAX_DISPARITIES as i32;
    for (first, count, expected) in [
        (0, 0, false),
        (0, 1, true),
        (-most, MAX_DISPARITIES, true),
        (0, MAX_DISPARITIES + 1, false),
        (most + 1, 1, false),
        (i32::MIN, 1, false),
    ] {
        let search = Search { first, count };
        assert_eq!(search.is_within_limits(), expected, "{search:?}");
    }
}

#[test]
#[should_panic(expected = "pictures that differ in size")]
fn pictures_that_differ_in_size_are_a_mistake_of_the_caller() {
    let [left, _] = slanted(60, 30, 0.0, 0.0);
    let _ = match_pair(&left, &picture(1, 1, |_, _| 7.0), search(8));
}

#[test]
fn threads_and_instruction_sets_do_not_change_a_byte() {
    let pair = slanted(150, 70, 11.2, 0.04);
    let first = matched(&pair, search(40));
    for threads in [1, 2, 3, 16] {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        assert!(
            pool.install(|| matched(&pair, search(40))) == first,
            "{threads} threads"
        );
    }
    for set in InstructionSet::all() {
        let found = match_pair_on(set, &pair[0], &pair[1], search(40)).unwrap();
        assert!(found == first, "{set:?}");
    }
}

fn any_picture(width: usize, height: usize) -> impl Strategy<Value = Picture> {
    let grey = prop::collection::vec(any::<u8>(), width * height);
    let usable = prop::collection::vec(prop::bool::weighted(0.9), width * height);
    (grey, usable).prop_map(move |(grey, usable)| Picture {
        grey: Raster {
            width,
            height,
            values: grey,
        },
        usable: Raster {
            width,
            height,
            values: usable,
        },
    })
}

fn any_pair() -> impl Strategy<Value = [Picture; 2]> {
    (1usize..40, 1usize..20).prop_flat_map(|(w, h)| [any_picture(w, h), any_picture(w, h)])
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn every_result_is_finite_within_the_search_and_empty_without_class(
        pair in any_pair(), first in -20i32..20, count in 1usize..70,
    ) {
        let Ok(found) = match_pair(&pair[0], &pair[1], Search { first, count }) else { return Ok(()) };
        for i in 0..found.class.values.len() {
            let (d, s) = (found.disparity.values[i], found.sigma.values[i]);
            prop_assert!(d.is_finite() && s.is_finite() && s >= 0.0, "{d} {s}");
            if found.class.values[i] == Class::None {
                prop_assert_eq!((d, s), (0.0, 0.0));
            } else {
                let last = first + count as i32 - 1;
                prop_assert!(d >= first as f32 - 2.0 && d <= last as f32 + 2.0, "{}", d);
            }
        }
    }
}
