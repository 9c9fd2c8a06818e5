//! Lens equations of other programs.

use nalgebra::Vector2;

/// How a lens bends the ideal picture, in the plane z = 1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Distortion {
    /// k1, k2, p1, p2 of OpenCV, which [`marf_scene::Camera`] has itself.
    Brown([f64; 4]),
    /// More radial terms.
    Rational(Rational),
    /// k1, k2, k3, k4 of OpenCV's fisheye.
    Fisheye([f64; 4]),
}

/// Radial terms as a fraction of polynomials in r², and tangential ones.
///
/// x″ = x N/D + 2 p1 x y + p2 (r² + 2 x²)
///
/// y″ = y N/D + p1 (r² + 2 y²) + 2 p2 x y
///
/// Here N = 1 + n1 r² + n2 r⁴ + n3 r⁶ + n4 r⁸ and D = 1 + d1 r² + d2 r⁴ + d3 r⁶.
///
/// OpenCV (calib3d) and COLMAP's `FULL_OPENCV` call these k1, k2, k3 and k4, k5, k6 and have no n4. It is the k4 of nerfstudio
/// (`camera_utils.py`), of Metashape and of RealityScan.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Rational {
    /// n1 to n4.
    pub numerator: [f64; 4],
    /// d1 to d3.
    pub denominator: [f64; 3],
    /// p1 and p2.
    pub tangential: [f64; 2],
}

impl Rational {
    /// Returns the simplest form of the lens: terms that are 0 do not count.
    pub fn simplest(self) -> Distortion {
        let [k1, k2, n3, n4] = self.numerator;
        if [n3, n4] == [0.0; 2] && self.denominator == [0.0; 3] {
            let [p1, p2] = self.tangential;
            return Distortion::Brown([k1, k2, p1, p2]);
        }
        Distortion::Rational(self)
    }

    /// Returns the radial factor N/D at r², and the derivative of r N/D.
    fn radial(&self, r2: f64) -> (f64, f64) {
        let (n, dn) = polynomial(&self.numerator, r2);
        let (d, dd) = polynomial(&self.denominator, r2);
        (n / d, n / d + 2.0 * r2 * (dn * d - n * dd) / (d * d))
    }
}

impl Distortion {
    /// Largest undistorted radius (fisheye: angle, radians) up to which a greater one is always seen farther out, limited to `most`.
    ///
    /// Beyond it one place of the picture would show two directions.
    pub(super) fn reach(&self, most: f64) -> f64 {
        const STEPS: u32 = 4096;
        let is_good = |step: &u32| {
            let (factor, slope) = self.radial(most * f64::from(*step) / f64::from(STEPS));
            factor > 0.0 && slope > 0.0
        };
        let good = (1..=STEPS).take_while(is_good).count();
        most * good as f64 / f64::from(STEPS)
    }

    /// Returns the distorted radius over the undistorted one, and the derivative of the distorted one. Fisheye: of the angle.
    pub(super) fn radial(&self, radius: f64) -> (f64, f64) {
        let r2 = radius * radius;
        match self {
            Self::Brown([k1, k2, ..]) => {
                let numerator = [*k1, *k2, 0.0, 0.0];
                Rational {
                    numerator,
                    ..Rational::default()
                }
                .radial(r2)
            }
            Self::Rational(rational) => rational.radial(r2),
            Self::Fisheye(k) => {
                let (factor, slope) = polynomial(k, r2);
                (factor, factor + 2.0 * r2 * slope)
            }
        }
    }

    /// Returns the distorted position of a point in the plane z = 1.
    ///
    /// Fisheye (`cv::fisheye` in OpenCV, `OPENCV_FISHEYE` in COLMAP): x″ = x θd/r with θ = atan r and θd = θ (1 + k1 θ² + k2 θ⁴ + k3 θ⁶ +
    /// k4 θ⁸).
    ///
    /// # Extremes
    /// At r = 0 the factor of a fisheye is 1. Near a zero of D the result is not finite.
    pub(super) fn distort(&self, plane: &Vector2<f64>) -> Vector2<f64> {
        let r = plane.norm();
        let [p1, p2] = match self {
            Self::Fisheye(_) => {
                let angle = r.atan();
                let factor = if r > 0.0 {
                    self.radial(angle).0 * angle / r
                } else {
                    1.0
                };
                return plane * factor;
            }
            Self::Brown([_, _, p1, p2]) => [*p1, *p2],
            Self::Rational(rational) => rational.tangential,
        };
        let (x, y, r2) = (plane.x, plane.y, r * r);
        let factor = self.radial(r).0;
        Vector2::new(
            x * factor + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
            y * factor + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
        )
    }
}

/// Returns 1 + Σ cᵢ xⁱ, i from 1, and its derivative.
fn polynomial(coefficients: &[f64], x: f64) -> (f64, f64) {
    let step = |(value, slope): (f64, f64), c: &f64| (value * x + c, slope * x + value);
    let (rest, slope) = coefficients.iter().rev().fold((0.0, 0.0), step);
    (1.0 + rest * x, rest + slope * x)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn full() -> Distortion {
        Distortion::Rational(Rational {
            numerator: [0.1, 0.02, 0.003, 0.0],
            denominator: [0.05, 0.01, 0.002],
            tangential: [0.001, 0.002],
        })
    }

    #[test]
    fn lenses_bend_as_computed_by_hand() {
        // r² = 1/4: N = 1.026296875, D = 1.01315625, 2 p1 x y = 0, p2 (r² + 2 x²) = 0.0015, p1 (r² + 2 y²) = 0.00025.
        let at = full().distort(&Vector2::new(0.5, 0.0));
        assert!(
            (at - Vector2::new(0.507_984_994_293_821_8, 0.000_25)).norm() < 1e-15,
            "{at}"
        );
        let fourth = Rational {
            numerator: [0.1, 0.02, 0.003, 0.5],
            ..Rational::default()
        };
        let at = fourth.simplest().distort(&Vector2::new(0.5, 0.0));
        assert!((at.x - 0.514_125).abs() < 1e-15, "{at}");
        // r = 1, θ = π/4: θd = 0.82830784…
        let fisheye = Distortion::Fisheye([0.1, -0.02, 0.003, -0.001]);
        let half = std::f64::consts::FRAC_1_SQRT_2;
        let at = fisheye.distort(&Vector2::new(half, half));
        assert!(
            (at - Vector2::repeat(0.585_702_092_878_775_7)).norm() < 1e-15,
            "{at}"
        );
        assert_eq!(fisheye.distort(&Vector2::zeros()), Vector2::zeros());
    }

    #[test]
    fn terms_of_zero_do_not_count() {
        let plain = Rational {
            numerator: [0.1, -0.2, 0.0, 0.0],
            tangential: [0.01, 0.02],
            ..Rational::default()
        };
        assert_eq!(plain.simplest(), Distortion::Brown([0.1, -0.2, 0.01, 0.02]));
        let at = Vector2::new(0.3, -0.2);
        let difference = plain.simplest().distort(&at) - Distortion::Rational(plain).distort(&at);
        assert_eq!(difference, Vector2::zeros());
    }

    #[test]
    fn the_slope_is_that_of_central_differences_and_ends_the_reach() {
        let lenses = [
            full(),
            Distortion::Fisheye([0.1, -0.02, 0.003, -0.001]),
            Distortion::Brown([0.1, -0.3, 0.0, 0.0]),
        ];
        for lens in lenses {
            for r in [1e-3, 0.3, 0.9] {
                let at = |r: f64| r * lens.radial(r).0;
                let difference = (at(r + 1e-6) - at(r - 1e-6)) / 2e-6;
                assert!(
                    (lens.radial(r).1 - difference).abs() < 1e-8,
                    "{lens:?} {r}: {difference}"
                );
            }
        }
        // 1 - 3 r² = 0 at 0.57735.
        let folds = Distortion::Brown([-1.0, 0.0, 0.0, 0.0]).reach(20.0);
        assert!((0.57..0.5774).contains(&folds), "{folds}");
        assert_eq!(Distortion::Fisheye([0.0; 4]).reach(1.5), 1.5);
    }
}
