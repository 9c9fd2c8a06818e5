//! The lens of CAHVOR and CAHVORE: radial terms, and an entrance pupil that moves with the angle.

use serde::{Deserialize, Serialize};

/// The E of CAHVORE: how the entrance pupil moves with the angle, and the kind of lens.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct EntrancePupil {
    /// e0, e1, e2, metres.
    pub terms: [f64; 3],
    /// Linearity L: 1 perspective, 0 fish-eye, other values general.
    pub linearity: f64,
}

/// Newton steps of the pupil angle. They converge quadratically from a start within 1e-2.
const NEWTON_STEPS: usize = 30;

/// The radial terms: chi' = chi (1 + mu), mu = r0 + r1 chi² + r2 chi⁴: from the true to the apparent distance off axis.
pub(super) struct Radial(pub(super) [f64; 3]);

impl Radial {
    /// Returns mu at chi.
    pub(super) fn mu(&self, chi: f64) -> f64 {
        let [r0, r1, r2] = self.0;
        let t = chi * chi;
        r0 + t * (r1 + t * r2)
    }

    /// Returns the slope of the map at t = chi².
    fn slope(&self, t: f64) -> f64 {
        let [r0, r1, r2] = self.0;
        1.0 + r0 + t * (3.0 * r1 + t * 5.0 * r2)
    }

    /// Returns whether the map rises all the way from the axis to `chi`.
    pub(super) fn rises(&self, chi: f64) -> bool {
        let [_, r1, r2] = self.0;
        let t = chi * chi;
        // The slope is a parabola in t and may be negative on the way.
        let vertex = if r2 > 0.0 {
            (-0.3 * r1 / r2).clamp(0.0, t)
        } else {
            0.0
        };
        t.is_finite() && [0.0, vertex, t].into_iter().all(|t| self.slope(t) > 0.0)
    }

    /// Returns the chi at which the map first stops rising, and its chi'. `None` if it always rises.
    ///
    /// Root of 1 + r0 + 3 r1 t + 5 r2 t² in t = chi².
    pub(super) fn turn(&self) -> Option<(f64, f64)> {
        let [r0, r1, r2] = self.0;
        let (a, b, c) = (5.0 * r2, 3.0 * r1, 1.0 + r0);
        if c <= 0.0 {
            return Some((0.0, 0.0));
        }
        let discriminant = b * b - 4.0 * a * c;
        // c > 0: each branch is the smallest positive root in the form that does not cancel.
        let root = match discriminant {
            negative if negative < 0.0 => return None,
            _ if b <= 0.0 => 2.0 * c / (discriminant.sqrt() - b),
            _ if a < 0.0 => (b + discriminant.sqrt()) / (-2.0 * a),
            _ => return None,
        };
        if !root.is_finite() {
            return None;
        }
        let chi = root.sqrt();
        Some((chi, chi * (1.0 + self.mu(chi))))
    }

    /// Returns the chi of an apparent chi', or `None` if the map turns over before.
    ///
    /// Newton steps inside a bracket: where r2 is near -1 plain Newton steps pass the turning point.
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

impl EntrancePupil {
    /// Returns E(angle) = e0 + e1 angle² + e2 angle⁴, metres.
    fn pupil(&self, angle: f64) -> f64 {
        let [e0, e1, e2] = self.terms;
        let t = angle * angle;
        e0 + t * (e1 + t * e2)
    }

    /// Returns how far the pupil has moved along O, metres: (angle / sin angle - 1) E.
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

    /// Returns the angle off O, in [0, π), at which a point `along` and `offset` metres off C is seen.
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

    /// Returns chi of an angle: tan(L angle) / L, angle or sin(L angle) / L. `None` beyond a quarter turn.
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

    /// Returns the angle of a chi, the inverse of [`EntrancePupil::chi`].
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

#[cfg(test)]
mod tests {
    use nalgebra::Vector2;

    use super::super::tests::{cahvor, cahvore, mastcam_z, navcam_tile, near};
    use super::Radial;
    use crate::{Cahvor, EntrancePupil};

    /// Roots of 1 + r0 + 3 r1 t + 5 r2 t² = 0 by hand:
    ///
    /// - r1 = -1 gives t = 1/3.
    /// - r2 = -0.2 gives t = 1.
    /// - r1 = -2, r2 = 1 gives 1 - 6 t + 5 t², roots 0.2 and 1.
    /// - r1 = 1, r2 = -0.4 gives 1 + 3 t - 2 t², root (3 + √17) / 4.
    #[test]
    fn the_turning_point_of_a_lens_is_found() {
        let turn = |r: [f64; 3]| Radial(r).turn();
        let at = |r: [f64; 3], t: f64| {
            let (chi, apparent) = turn(r).unwrap();
            near(&[chi * chi], &[t], 1e-14, "chi²");
            near(
                &[apparent],
                &[chi * (1.0 + r[0] + r[1] * t + r[2] * t * t)],
                1e-14,
                "chi'",
            );
            assert!(
                Radial(r).rises(chi * (1.0 - 1e-9)) && !Radial(r).rises(chi * (1.0 + 1e-9)),
                "{r:?}"
            );
        };
        at([0.0, -1.0, 0.0], 1.0 / 3.0);
        at([0.0, 0.0, -0.2], 1.0);
        at([0.0, -2.0, 1.0], 0.2);
        at([0.0, 1.0, -0.4], (3.0 + 17_f64.sqrt()) / 4.0);
        at([-0.5, -1.0, 0.0], 0.5 / 3.0);
        for rising in [[0.0; 3], [0.0, 1.0, 1.0], [0.0, -1.0, 5.0], [0.0002, 0.39, 0.035]] {
            assert_eq!(turn(rising), None, "{rising:?}");
        }
        assert_eq!(turn([-1.0, 0.0, 0.0]), Some((0.0, 0.0)));
        // The wide lens of a Navcam turns over at 2.1 (120 degrees).
        near(
            &[turn([1.736e-6, 0.050_139_6, -0.017_125_4]).unwrap().0],
            &[2.1],
            0.05,
            "Navcam",
        );
    }

    #[test]
    fn a_lens_that_turns_over_inside_the_photo_is_refused_with_its_numbers() {
        mastcam_z().normalised().unwrap().check_lens(1648, 1200).unwrap();
        navcam_tile().normalised().unwrap().check_lens(1288, 976).unwrap();
        for linearity in [0.0, 0.6, 1.0, -0.4] {
            cahvore(linearity).check_lens(1280, 960).unwrap();
        }
        // chi' = 0.385 at the turning point: 0.385 x 14,800 px = 5,697 px off axis.
        let folding = Cahvor {
            o: Some([1.0, 0.0, 0.0]),
            r: Some([0.0, -1.0, 0.0]),
            ..cahvor()
        };
        folding.check_lens(6000, 1200).unwrap();
        let error = folding.check_lens(7000, 1200).unwrap_err().to_string();
        assert!(
            error.contains("[0.0, -1.0, 0.0] turn over at chi = 0.5774, which is seen at 0.3849")
                && error.contains("corner (6999, 0) lies at 0.4192"),
            "{error}"
        );
        // A photo whose corner would be seen from behind.
        let error = cahvore(0.0).check_lens(10_000_000, 960);
        assert!(error.is_err(), "{error:?}");
        let plain = Cahvor { o: None, ..folding };
        plain.check_lens(7000, 1200).unwrap();
    }

    /// θ / sin θ - 1 by its series, θ²/6 + 7 θ⁴/360, whose third term is 31 θ⁶/15120: by hand 1.6666668611e-7 at 1e-3.
    #[test]
    fn the_pupil_moves_smoothly_where_the_quotient_would_cancel() {
        let entrance = EntrancePupil {
            terms: [1.0, 0.0, 0.0],
            linearity: 0.0,
        };
        for angle in [1e-12, 1e-8, 1e-6, 1e-4, 0.999e-3, 1e-3, 1.001e-3, 1e-2] {
            let t: f64 = angle * angle;
            let series = t / 6.0 + 7.0 * t * t / 360.0 + 31.0 * t * t * t / 15_120.0;
            // Above 1e-3 the quotient has an ulp of 1, 2e-16, in 1.7e-7.
            let off = (entrance.shift(angle) / series - 1.0).abs();
            assert!(off < 3e-9, "{angle}: {off}");
        }
        near(
            &[entrance.shift(0.999_999_999e-3)],
            &[1.666_666_858e-7],
            1e-15,
            "at 1e-3",
        );
        assert_eq!(entrance.shift(0.0), 0.0);
    }

    /// O along the rows: the left half of the photo is seen from behind the lens, chi' is negative.
    #[test]
    fn a_negative_apparent_distance_has_no_ray() {
        for model in [cahvor(), cahvore(0.0), cahvore(0.6), cahvore(1.0)] {
            let sideways = Cahvor {
                o: Some([0.0, 1.0, 0.0]),
                r: Some([0.0; 3]),
                e: model.e.map(|e| EntrancePupil {
                    terms: [1e-3, 0.0, 0.0],
                    ..e
                }),
                ..model
            };
            // Without terms a CAHVOR is linear and sees the whole plane.
            let bent = Cahvor {
                r: Some([0.0, 0.0, 1e-12]),
                ..sideways
            };
            assert_eq!(bent.unproject(&Vector2::new(100.0, 500.0)), None, "{bent:?}");
            assert!(bent.check_lens(1648, 1200).is_err());
        }
    }
}
