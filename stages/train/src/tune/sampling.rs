use marf_field::Overrides;
use marf_schema::tune::{Range, Space};
use serde_json::Value;

use crate::random::random_u64;

/// Returns the keys of one trial: a value for every key of the space, drawn by seed, trial and key alone.
///
/// Trial 0 sets no parameter: it is the defaults, with which the others are compared.
pub(crate) fn sample_params(space: &Space, seed: u64, trial: u32) -> Overrides {
    let mut drawn = Overrides::default();
    if trial == 0 {
        return drawn;
    }
    for (key, range) in space {
        match value_at(range, random_u64(&(key.as_str(), seed, u64::from(trial)))) {
            Value::Object(table) => drawn.0.extend(table),
            value => {
                drawn.0.insert(key.clone(), value);
            }
        }
    }
    drawn
}

/// Returns the value at a place in the range. 0 is the low end, the largest u64 the high one.
fn value_at(range: &Range, place: u64) -> Value {
    match range {
        Range::Log([low, high]) => Value::from(log_uniform(*low, *high, place)),
        Range::Int([low, high]) => {
            let count = (i128::from(*high) - i128::from(*low) + 1).max(1) as u128;
            let step = (u128::from(place) * count) >> 64;
            Value::from((i128::from(*low) + step as i128) as i64)
        }
        Range::Choice(values) => {
            let index = (u128::from(place) * values.len() as u128) >> 64;
            values.get(index as usize).cloned().unwrap_or_default()
        }
    }
}

/// Returns low · (high / low)^u, u = place / 2⁶⁴, to three digits.
///
/// The power is a product of repeated square roots, one for every bit of u: sqrt is exact everywhere, pow is not.
fn log_uniform(low: f64, high: f64, place: u64) -> f64 {
    let (mut value, mut factor) = (low, high / low);
    for bit in (0..64).rev() {
        factor = factor.sqrt();
        if place >> bit & 1 == 1 {
            value *= factor;
        }
    }
    // Three digits are printed and read back. An end of the range may be between two such numbers.
    let rounded = format!("{value:.2e}").parse().unwrap_or(value);
    rounded.clamp(low, high)
}

#[cfg(test)]
mod tests {
    use super::*;
    use marf_schema::tune::default_space;
    use serde_json::json;

    const HIGHEST: u64 = u64::MAX;

    #[test]
    fn equal_seeds_draw_equally_and_every_bit_of_a_seed_counts() {
        let space = default_space();
        assert_eq!(sample_params(&space, 7, 3), sample_params(&space, 7, 3));
        for bit in [0, 31, 32, 63] {
            assert_ne!(
                sample_params(&space, 7, 3),
                sample_params(&space, 7 ^ (1 << bit), 3),
                "bit {bit}"
            );
        }
        assert_ne!(sample_params(&space, 7, 3), sample_params(&space, 7, 4));
        assert_eq!(sample_params(&space, 7, 0), Overrides::default());
    }

    #[test]
    fn another_key_leaves_the_draws_of_the_others() {
        let mut space = default_space();
        let before = sample_params(&space, 1, 5);
        space.insert("distortion".to_owned(), Range::Log([1e-4, 1e-2]));
        let after = sample_params(&space, 1, 5);
        for (key, value) in &before.0 {
            assert_eq!(after.0.get(key), Some(value), "{key}");
        }
    }

    #[test]
    fn a_log_uniform_draw_reaches_both_ends_and_halves_the_factor_in_the_middle() {
        assert_eq!(log_uniform(0.003, 0.03, 0), 0.003);
        assert_eq!(log_uniform(0.003, 0.03, HIGHEST), 0.03);
        assert_eq!(log_uniform(0.01, 1.0, 1 << 63), 0.1);
        assert_eq!(log_uniform(2.0, 2.0, 12345), 2.0);
        assert_eq!(log_uniform(1e-100, 1e100, 1 << 63), 1.0);
        assert_eq!(log_uniform(0.012345, 0.012346, 1 << 63), 0.012345);
    }

    #[test]
    fn whole_numbers_and_choices_reach_both_ends() {
        let int = Range::Int([14, 17]);
        assert_eq!(
            (value_at(&int, 0), value_at(&int, HIGHEST)),
            (json!(14), json!(17))
        );
        let widest = Range::Int([i64::MIN, i64::MAX]);
        assert_eq!(
            (value_at(&widest, 0), value_at(&widest, HIGHEST)),
            (json!(i64::MIN), json!(i64::MAX))
        );
        let choice = Range::Choice(vec![json!("a"), json!("b"), json!("c")]);
        assert_eq!(
            (value_at(&choice, 0), value_at(&choice, HIGHEST)),
            (json!("a"), json!("c"))
        );
    }

    #[test]
    fn many_draws_cover_the_ranges_evenly() {
        let space = default_space();
        let drawn: Vec<Overrides> = (1..=2000).map(|trial| sample_params(&space, 0, trial)).collect();
        let share = |test: &dyn Fn(&Overrides) -> bool| drawn.iter().filter(|set| test(set)).count();
        for shift in -1..=1 {
            let count = share(&|set| set.0["log2_table_shift"] == json!(shift));
            // 667 expected, standard deviation 21.
            assert!((580..=750).contains(&count), "{shift}: {count}");
        }
        let low_half = share(&|set| set.0["learning_rate"].as_f64().unwrap() < 0.015_81);
        assert!(
            (910..=1090).contains(&low_half),
            "{low_half} of 2000 below the geometric mean"
        );
        let narrow = share(&|set| set.0["features"] == json!(2));
        assert!((910..=1090).contains(&narrow), "{narrow}");
    }
}
