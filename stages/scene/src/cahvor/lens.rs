//! The lens of CAHVOR and CAHVORE: radial terms, and an entrance pupil that moves with the angle.

use super::Entrance;

/// Newton steps of the pupil angle; it converges quadratically from a start within 1e-2.
const NEWTON_STEPS: usize = 30;

/// chi' = chi (1 + mu), mu = r0 + r1 chi² + r2 chi⁴: from the true to the apparent distance off axis.
pub(super) struct Radial(pub(super) [f64; 3]);

impl Radial {
    pub(super) fn mu(&self, chi: f64) -> f64 {
        let [r0, r1, r2] = self.0;
        let t = chi * chi;
        r0 + t * (r1 + t * r2)
    }

    /// Slope of the map at t = chi².
    fn slope(&self, t: f64) -> f64 {
        let [r0, r1, r2] = self.0;
        1.0 + r0 + t * (3.0 * r1 + t * 5.0 * r2)
    }

    /// Tells whether the map rises all the way from the axis to `chi`.
    pub(super) fn rises(&self, chi: f64) -> bool {
        let [_, r1, r2] = self.0;
        let t = chi * chi;
        // The slope is a parabola in t: it may dip below zero on the way.
        let dip = if r2 > 0.0 {
            (-0.3 * r1 / r2).clamp(0.0, t)
        } else {
            0.0
        };
        t.is_finite() && [0.0, dip, t].into_iter().all(|t| self.slope(t) > 0.0)
    }

    /// Finds chi of chi'; `None` where the map turns over before it gets there.
    ///
    /// Newton held inside a bracket: where r2 is near -1 plain Newton runs over the turning point.
    pub(super) fn solve(&self, apparent: f64) -> Option<f64> {
        let mut high = apparent;
        for _ in 0..64 {
            if high * (1.0 + self.mu(high)) >= apparent || !self.rises(high) {
                break;
            }
            high *= 2.0;
        }
        let (mut low, mut chi) = (0.0, apparent);
        for _ in 0..200 {
            let error = chi * (1.0 + self.mu(chi)) - apparent;
            if error > 0.0 || !self.rises(chi) {
                high = chi;
            } else {
                low = chi;
            }
            let newton = chi - error / self.slope(chi * chi);
            let next = if newton >= low && newton <= high {
                newton
            } else {
                (low + high) / 2.0
            };
            let step = (next - chi).abs();
            chi = next;
            if step <= 4e-16 * apparent {
                break;
            }
        }
        let closed = (chi * (1.0 + self.mu(chi)) - apparent).abs() <= 1e-12 * (1.0 + apparent);
        (closed && self.rises(chi)).then_some(chi)
    }
}

impl Entrance {
    /// E(angle) = e0 + e1 angle² + e2 angle⁴, metres.
    fn pupil(&self, angle: f64) -> f64 {
        let [e0, e1, e2] = self.terms;
        let t = angle * angle;
        e0 + t * (e1 + t * e2)
    }

    /// How far the pupil has moved along O, metres: (angle / sin angle - 1) E.
    pub(super) fn shift(&self, angle: f64) -> f64 {
        // The quotient cancels below 1e-3, where two terms of its series are exact.
        let t = angle * angle;
        let stretch = if angle < 1e-3 {
            t * (1.0 / 6.0 + t * 7.0 / 360.0)
        } else {
            angle / angle.sin() - 1.0
        };
        stretch * self.pupil(angle)
    }

    /// Finds the angle off O, in [0, π), at which a point `along` and `offset` metres off C is seen.
    pub(super) fn angle(&self, along: f64, offset: f64) -> Option<f64> {
        let [_, e1, e2] = self.terms;
        let mut angle = offset.atan2(along);
        let range = along.hypot(offset);
        for _ in 0..NEWTON_STEPS {
            let (sin, cos) = angle.sin_cos();
            let pupil = self.pupil(angle);
            let error = along * sin - offset * cos - (angle - sin) * pupil;
            let slope = along * cos + offset * sin
                - (1.0 - cos) * pupil
                - (angle - sin) * angle * (2.0 * e1 + 4.0 * e2 * angle * angle);
            if slope.is_nan() || slope <= 0.0 {
                return None;
            }
            angle -= error / slope;
            if (error / slope).abs() < 1e-15 {
                break;
            }
        }
        let (sin, cos) = angle.sin_cos();
        let error = along * sin - offset * cos - (angle - sin) * self.pupil(angle);
        let found = error.abs() <= 1e-12 * range && (0.0..std::f64::consts::PI).contains(&angle);
        found.then_some(angle)
    }

    /// Returns chi of an angle: tan(L angle) / L, angle or sin(L angle) / L; `None` beyond a quarter turn.
    pub(super) fn chi(&self, angle: f64) -> Option<f64> {
        let l = self.linearity;
        if (l * angle).abs() >= std::f64::consts::FRAC_PI_2 {
            return None;
        }
        Some(match l {
            l if l > 0.0 => (l * angle).tan() / l,
            l if l < 0.0 => (l * angle).sin() / l,
            _ => angle,
        })
    }

    /// Undoes [`Entrance::chi`].
    pub(super) fn angle_of_chi(&self, chi: f64) -> Option<f64> {
        let l = self.linearity;
        let angle = match l {
            l if l > 0.0 => (l * chi).atan() / l,
            l if l < 0.0 => (l * chi).asin() / l,
            _ => chi,
        };
        // asin of more than 1 is NaN and fails this too.
        (0.0..std::f64::consts::PI).contains(&angle).then_some(angle)
    }
}
