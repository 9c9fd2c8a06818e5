//! Real roots of small polynomials.

/// Bisections or Newton steps that suffice for 53 bits from a bracket in [-1, 1].
const STEPS: usize = 70;

/// Largest degree plus one: five points give degree 10.
const TERMS: usize = 11;

/// Returns the real roots of c0 + c1 x + ... , rising. A double root comes once or twice.
///
/// The roots of each derivative bracket those of the one before it. Roots outside [-1, 1] come from the polynomial
/// with its coefficients reversed, in 1/x, so that no root is lost to a bound. A minimum within rounding of zero is a
/// root. At most 11 coefficients. No roots if a coefficient is not finite or all are zero.
pub(crate) fn real_roots(coefficients: &[f64]) -> Vec<f64> {
    let size = coefficients
        .iter()
        .fold(0.0_f64, |most, value| most.max(value.abs()));
    if size == 0.0 || !coefficients.iter().all(|value| value.is_finite()) || coefficients.len() > TERMS {
        return Vec::new();
    }
    let (mut low, mut high) = ([0.0; TERMS], [0.0; TERMS]);
    for (i, value) in coefficients.iter().enumerate() {
        low[i] = value / size;
        high[coefficients.len() - 1 - i] = value / size;
    }
    let degree = coefficients.len() - 1;
    let far = within_one(&high, degree)
        .into_iter()
        .filter(|x| x.abs() > 1e-14 && x.abs() < 1.0);
    let mut roots: Vec<f64> = within_one(&low, degree)
        .into_iter()
        .chain(far.map(f64::recip))
        .collect();
    roots.sort_by(f64::total_cmp);
    roots
}

/// Returns the roots in [-1, 1], rising.
fn within_one(coefficients: &[f64; TERMS], degree: usize) -> Vec<f64> {
    let mut derivatives = [*coefficients; TERMS];
    for order in 1..degree {
        for i in 0..=degree - order {
            derivatives[order][i] = derivatives[order - 1][i + 1] * (i + 1) as f64;
        }
        derivatives[order][degree - order + 1..].fill(0.0);
    }
    let (mut extrema, mut roots) = (Vec::with_capacity(TERMS), Vec::with_capacity(TERMS));
    for order in (0..degree).rev() {
        roots.clear();
        let terms = &derivatives[order][..=degree - order];
        let mut left = -1.0;
        let mut at_left = value_and_slope(terms, left).0;
        for right in extrema.iter().copied().chain([1.0]) {
            let at_right = value_and_slope(terms, right).0;
            if at_left == 0.0 || at_left * at_right < 0.0 {
                // Newton squares the error: a last step of 1e-6 leaves 1e-12, enough for a bracket or a
                // double root.
                let tolerance = if order == 0 { 1e-10 } else { 1e-6 };
                roots.push(root_between(terms, [left, right], at_left, tolerance));
            } else if touches(terms, right, at_right) {
                roots.push(right);
            }
            (left, at_left) = (right, at_right);
        }
        std::mem::swap(&mut extrema, &mut roots);
    }
    extrema
}

/// Whether a value is zero within the rounding of its own terms.
fn touches(terms: &[f64], x: f64, value: f64) -> bool {
    let size = terms
        .iter()
        .rev()
        .fold(0.0, |sum, term| sum * x.abs() + term.abs());
    value.abs() <= 1e-14 * size
}

/// Returns a polynomial and its derivative at x.
fn value_and_slope(terms: &[f64], x: f64) -> (f64, f64) {
    terms.iter().rev().fold((0.0, 0.0), |(value, slope), term| {
        (value * x + term, slope * x + value)
    })
}

/// Returns the root in a bracket, by Newton steps with bisection where one leaves the bracket. The last step is a
/// Newton step below `tolerance`, relative.
fn root_between(terms: &[f64], [mut left, mut right]: [f64; 2], at_left: f64, tolerance: f64) -> f64 {
    if at_left == 0.0 {
        return left;
    }
    let mut x = 0.5 * (left + right);
    for _ in 0..STEPS {
        let (value, slope) = value_and_slope(terms, x);
        if (value < 0.0) == (at_left < 0.0) {
            left = x;
        } else {
            right = x;
        }
        let newton = x - value / slope;
        if value == 0.0 || (newton - x).abs() <= tolerance * x.abs() {
            return if newton > left && newton < right {
                newton
            } else {
                x
            };
        }
        x = if newton > left && newton < right {
            newton
        } else {
            0.5 * (left + right)
        };
    }
    x
}

#[cfg(test)]
mod tests {
    use super::*;
    use marf_numeric::Rng;

    /// The coefficients of the product of (x - root).
    fn from_roots(roots: &[f64]) -> Vec<f64> {
        roots.iter().fold(vec![1.0], |terms, root| {
            let mut next = vec![0.0; terms.len() + 1];
            for (i, term) in terms.iter().enumerate() {
                next[i + 1] += term;
                next[i] -= root * term;
            }
            next
        })
    }

    #[test]
    fn a_hand_worked_quadratic() {
        // (x - 2)(x + 3) = x² + x - 6.
        assert_eq!(real_roots(&[-6.0, 1.0, 1.0]), [-3.0, 2.0]);
        assert!(real_roots(&[1.0, 0.0, 1.0]).is_empty());
    }

    #[test]
    fn all_ten_roots_come_back_over_six_orders() {
        let mut rng = Rng::new(3);
        for trial in 0..200 {
            let mut roots: Vec<f64> = (0..10)
                .map(|i| (rng.unit_f64() + i as f64 - 4.5) * [1e-3, 0.1, 1.0, 1e3][trial % 4])
                .collect();
            roots.sort_by(f64::total_cmp);
            let got = real_roots(&from_roots(&roots));
            let complete = got.len() == 10
                || roots
                    .windows(2)
                    .any(|pair| pair[1] - pair[0] < 1e-2 * pair[1].abs());
            assert!(complete, "trial {trial}: {got:?} {roots:?}");
        }
    }

    #[test]
    fn repeated_roots_are_found_and_nothing_is_nan() {
        for root in [0.5, -0.9, 1.0, 7.0, -1e4] {
            let got = real_roots(&from_roots(&[root, root, root * 3.0]));
            let near = |value: f64| got.iter().any(|x| (x - value).abs() < 1e-6 * value.abs());
            assert!(near(root) && near(root * 3.0), "{root}: {got:?}");
        }
        for hopeless in [
            &[0.0, 0.0][..],
            &[f64::NAN, 1.0],
            &[1.0, f64::INFINITY],
            &[3.0],
            &[],
        ] {
            assert!(real_roots(hopeless).is_empty(), "{hopeless:?}");
        }
        // A leading coefficient of zero lowers the degree.
        assert_eq!(real_roots(&[-1.0, 2.0, 0.0, 0.0]), [0.5]);
    }
}
