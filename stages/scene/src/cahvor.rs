//! The camera models of NASA's labels: CAHV, CAHVOR and CAHVORE.

use nalgebra::{Vector2, Vector3};
use serde::{Deserialize, Serialize};

use crate::Pose;
pub use lens::EntrancePupil;
use lens::Radial;
pub use linear::Pinhole;

mod lens;
mod linear;

/// A CAHV, CAHVOR or CAHVORE camera model. Integer pixel coordinates are pixel centres, 0-based.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Cahvor {
    /// Centre of projection, metres.
    pub c: [f64; 3],
    /// Axis: normal of the image plane.
    pub a: [f64; 3],
    /// Horizontal vector, pixels.
    pub h: [f64; 3],
    /// Vertical vector, pixels.
    pub v: [f64; 3],
    /// Optical axis of the lens, for the radial terms.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub o: Option<[f64; 3]>,
    /// Radial terms r0, r1, r2.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub r: Option<[f64; 3]>,
    /// Entrance pupil terms.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub e: Option<EntrancePupil>,
}

/// The ray of sight of a pixel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ray {
    /// Where it starts, metres: C, or for CAHVORE the entrance pupil at this angle.
    pub origin: Vector3<f64>,
    /// Unit vector away from the camera.
    pub direction: Vector3<f64>,
}

/// The intrinsics and the pose of the linear part of a model.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Intrinsics {
    /// Horizontal focal length |A x H|, pixels.
    pub hs: f64,
    /// Vertical focal length |A x V|, pixels.
    pub vs: f64,
    /// Column of A (0-based, integer = pixel centre), possibly outside the image.
    pub hc: f64,
    /// Row of A (0-based, integer = pixel centre), possibly outside the image.
    pub vc: f64,
    /// Cosine of the angle between the image's axes, 0 if they are orthogonal.
    pub skew: f64,
    /// R and t = -R C of x = K (R X + t), with K = [[hs √(1-skew²), hs skew, hc], [0, vs, vc], [0, 0, 1]]:
    /// x right, y down, z forward.
    pub cam_from_frame: Pose,
}

/// A camera model that cannot be used.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum CahvorError {
    /// A number is NaN or infinite.
    #[error("the camera model has a number that is not finite: {vector} = {value:?}")]
    NotFinite {
        /// Letter of the vector.
        vector: char,
        /// Its components.
        value: [f64; 3],
    },
    /// A or O is not a unit vector, beyond what the rounding of labels explains.
    #[error("the camera model's |{vector}| is {length}, not 1 within {UNIT_TOLERANCE}")]
    NotUnit {
        /// Letter of the vector.
        vector: char,
        /// Its length.
        length: f64,
    },
    /// A, H and V are nearly dependent, or the image is mirrored.
    #[error(
        "the camera model's A · (H x V) is {share:.3e} of the product of its focal lengths: flat or mirrored"
    )]
    Degenerate {
        /// A · (H x V) / (|A x H| |A x V|).
        share: f64,
    },
    /// The horizontal and the vertical focal length are no camera's: detectors average up to 8 pixels.
    #[error(
        "the camera model's focal lengths are {hs} and {vs} px: below 1 px, or further apart than a factor of 8"
    )]
    Anamorphic {
        /// Horizontal focal length, pixels.
        hs: f64,
        /// Vertical focal length, pixels.
        vs: f64,
    },
    /// The radial terms turn over inside the image, or a pixel of the border has no ray.
    #[error("the camera model has no line of sight for pixel ({x}, {y})")]
    Blind {
        /// Column, 0-based.
        x: f64,
        /// Row, 0-based.
        y: f64,
    },
    /// The radial terms turn over before the photo's farthest corner: some of its pixels would have two lines of sight.
    #[error(
        "the camera model's radial terms {radial:?} turn over at chi = {chi:.4}, which is seen at {turn:.4}; the photo's \
         corner ({x}, {y}) lies at {corner:.4}"
    )]
    Folds {
        /// r0, r1, r2.
        radial: [f64; 3],
        /// Tangent off O (for CAHVORE chi) where the slope 1 + r0 + 3 r1 chi² + 5 r2 chi⁴ becomes 0.
        chi: f64,
        /// Where the lens shows it: chi (1 + r0 + r1 chi² + r2 chi⁴).
        turn: f64,
        /// Tangent off O at which the photo shows the corner.
        corner: f64,
        /// Column of the corner, 0-based.
        x: f64,
        /// Row of the corner, 0-based.
        y: f64,
    },
    /// The ideal pinhole of this model would be empty or far larger than the photo.
    #[error("an ideal pinhole of this camera model would be {width} x {height} px for a photo of {} x {} px", .photo.0, .photo.1)]
    Stretched {
        /// Width it would have, pixels.
        width: f64,
        /// Height it would have, pixels.
        height: f64,
        /// Width and height of the photo, pixels.
        photo: (u32, u32),
    },
}

/// Most that |A| and |O| may differ from 1: labels round to 6 digits, which makes 1e-5.
const UNIT_TOLERANCE: f64 = 1e-3;
/// Largest ratio of the horizontal and the vertical focal length.
const MAX_ASPECT: f64 = 8.0;
/// Distance that represents infinity, metres. The pupil of 4 mm turns such a point by 4e-12 rad.
const FAR_M: f64 = 1e9;

impl Cahvor {
    /// Checks the model and returns it with A, H, V divided by |A| and O by |O|.
    ///
    /// Dividing A alone would move pixels by 0.01. Labels of 6 digits leave |A| - 1 near 8e-6.
    ///
    /// # Errors
    /// Numbers that are not finite, |A| or |O| off 1 by more than 0.001, focal lengths below 1 px or further apart than a
    /// factor of 8, a nearly flat or mirrored image plane.
    pub fn normalised(&self) -> Result<Self, CahvorError> {
        self.check_finite()?;
        let length_a = unit_length('A', self.a)?;
        let divide = |vector: [f64; 3], length: f64| vector.map(|value| value / length);
        let o = match self.o {
            Some(o) => Some(divide(o, unit_length('O', o)?)),
            None => None,
        };
        let model = Self {
            a: divide(self.a, length_a),
            h: divide(self.h, length_a),
            v: divide(self.v, length_a),
            o,
            ..*self
        };
        model.check_shape()?;
        Ok(model)
    }

    /// Checks that every pixel of a photo of `width` x `height` pixels has one line of sight.
    ///
    /// The map from the true to the apparent distance off axis must rise, 1 + r0 + 3 r1 chi² + 5 r2 chi⁴ > 0, up to the farthest corner.
    /// Call [`Cahvor::normalised`] first.
    ///
    /// # Errors
    /// [`CahvorError::Folds`] with the numbers, or [`CahvorError::Blind`] for a corner beyond the range of the lens.
    pub fn check_lens(&self, width: u32, height: u32) -> Result<(), CahvorError> {
        let Some(o) = self.o.filter(|_| !self.is_linear()).map(vector) else {
            return Ok(());
        };
        let (right, bottom) = (f64::from(width) - 1.0, f64::from(height) - 1.0);
        let radial = Radial(self.r.unwrap_or_default());
        for (x, y) in [(0.0, 0.0), (right, 0.0), (0.0, bottom), (right, bottom)] {
            let blind = CahvorError::Blind { x, y };
            let apparent = self.apparent(&Vector2::new(x, y)).ok_or_else(|| blind.clone())?;
            let along = apparent.dot(&o);
            let corner = (apparent - o * along).norm() / along;
            if let Some((chi, turn)) = radial.turn().filter(|(_, turn)| along > 0.0 && corner >= *turn) {
                return Err(CahvorError::Folds {
                    radial: radial.0,
                    chi,
                    turn,
                    corner,
                    x,
                    y,
                });
            }
            self.unproject(&Vector2::new(x, y)).ok_or(blind)?;
        }
        Ok(())
    }

    /// Checks that every number is finite.
    fn check_finite(&self) -> Result<(), CahvorError> {
        let entrance = self.e.map(|e| [e.terms, [e.linearity; 3]]).unwrap_or_default();
        let vectors = [
            ('C', self.c),
            ('A', self.a),
            ('H', self.h),
            ('V', self.v),
            ('O', self.o.unwrap_or_default()),
            ('R', self.r.unwrap_or_default()),
            ('E', entrance[0]),
            ('L', entrance[1]),
        ];
        let bad = vectors
            .into_iter()
            .find(|(_, value)| value.iter().any(|number| !number.is_finite()));
        match bad {
            Some((vector, value)) => Err(CahvorError::NotFinite { vector, value }),
            None => Ok(()),
        }
    }

    /// Checks that the focal lengths are those of one camera, and the image plane is neither flat nor mirrored.
    fn check_shape(&self) -> Result<(), CahvorError> {
        let (a, h, v) = (vector(self.a), vector(self.h), vector(self.v));
        let (hs, vs) = (a.cross(&h).norm(), a.cross(&v).norm());
        let (less, more) = (hs.min(vs), hs.max(vs));
        if !(less >= 1.0 && more <= MAX_ASPECT * less) {
            return Err(CahvorError::Anamorphic { hs, vs });
        }
        let share = a.dot(&h.cross(&v)) / (hs * vs);
        if share > 0.5 {
            Ok(())
        } else {
            Err(CahvorError::Degenerate { share })
        }
    }

    /// Returns whether the model is in effect a CAHV: no lens terms, or all of them zero.
    pub fn is_linear(&self) -> bool {
        let straight = self.r.is_none_or(|r| r == [0.0; 3]);
        let perspective = self.e.is_none_or(|e| e.linearity == 1.0 && e.terms == [0.0; 3]);
        self.o.is_none() || (straight && perspective)
    }

    /// Projects a point of the model's frame, in metres, to a pixel (0-based, integer = pixel centre).
    ///
    /// Equations: Yakimovsky and Cunningham 1978 (CAHV), Gennery 2001 and 2006 (OR, E). The length of A, O does
    /// not matter. CAHVORE uses sine, cosine, tangent and arc tangent of the standard library, whose last bit
    /// may differ between machines: round values that are kept.
    ///
    /// Returns `None` behind the camera, beyond the range of the lens, where the radial terms turn over, and
    /// nearer than the entrance pupil can resolve.
    pub fn project(&self, point: &Vector3<f64>) -> Option<Vector2<f64>> {
        self.project_offset(&(point - vector(self.c)))
    }

    /// Projects a direction (any length), that is a point infinitely far away, to a pixel. See [`Cahvor::project`].
    pub fn project_direction(&self, direction: &Vector3<f64>) -> Option<Vector2<f64>> {
        self.project_offset(&(direction.try_normalize(1e-300)? * FAR_M))
    }

    /// Projects a point given from C. See [`Cahvor::project`].
    fn project_offset(&self, p: &Vector3<f64>) -> Option<Vector2<f64>> {
        let distorted = match self.o {
            Some(o) if !self.is_linear() => self.distort(p, &vector(o).try_normalize(1e-300)?)?,
            _ => *p,
        };
        let depth = distorted.dot(&vector(self.a));
        let pixel = Vector2::new(distorted.dot(&vector(self.h)), distorted.dot(&vector(self.v))) / depth;
        (depth > 0.0 && pixel.iter().all(|value| value.is_finite())).then_some(pixel)
    }

    /// Returns the point with the distortion of the lens applied, so that the linear part projects it to the pixel.
    fn distort(&self, p: &Vector3<f64>, o: &Vector3<f64>) -> Option<Vector3<f64>> {
        let along = p.dot(o);
        let across = p - o * along;
        let radial = Radial(self.r.unwrap_or_default());
        let Some(entrance) = self.e else {
            // w² in tau loses the sign: a point behind the camera would be projected into the image.
            let chi = across.norm() / along;
            return (along > 0.0 && radial.rises(chi)).then(|| p + across * radial.mu(chi));
        };
        let offset = across.norm();
        let angle = entrance.angle(along, offset)?;
        if angle < 1e-8 {
            return Some(*p);
        }
        let chi = entrance.chi(angle)?;
        radial
            .rises(chi)
            .then(|| o * (offset / chi) + across * (1.0 + radial.mu(chi)))
    }

    /// Returns the line of sight of a pixel (0-based, integer = pixel centre) in the model's frame.
    ///
    /// The inverse of [`Cahvor::project`], with the same remark on the standard library.
    ///
    /// Returns `None` where the lens has no such ray: beyond its range, or where the radial terms turn over.
    pub fn unproject(&self, pixel: &Vector2<f64>) -> Option<Ray> {
        let apparent = self.apparent(pixel)?;
        let straight = Ray {
            origin: vector(self.c),
            direction: apparent,
        };
        match self.o {
            Some(o) if !self.is_linear() => self.undistort(&apparent, &vector(o).try_normalize(1e-300)?),
            _ => apparent.iter().all(|value| value.is_finite()).then_some(straight),
        }
    }

    /// Returns the unit vector to a pixel by the linear part alone.
    fn apparent(&self, pixel: &Vector2<f64>) -> Option<Vector3<f64>> {
        let (a, h, v) = (vector(self.a), vector(self.h), vector(self.v));
        let apparent = (v - a * pixel.y).cross(&(h - a * pixel.x)) * a.dot(&v.cross(&h)).signum();
        apparent.try_normalize(1e-300)
    }

    /// Returns the ray whose distorted direction is `apparent`, the inverse of [`Cahvor::distort`].
    fn undistort(&self, apparent: &Vector3<f64>, o: &Vector3<f64>) -> Option<Ray> {
        let along = apparent.dot(o);
        let across = apparent - o * along;
        let radial = Radial(self.r.unwrap_or_default());
        let offset = across.norm();
        // A negative chi' would be an apparent ray beyond 90 degrees.
        let chi = (along > 0.0).then(|| radial.solve(offset / along))??;
        let origin = vector(self.c);
        let Some(entrance) = self.e else {
            let direction = (o * along + across / (1.0 + radial.mu(chi))).normalize();
            return Some(Ray { origin, direction });
        };
        let angle = entrance.angle_of_chi(chi)?;
        let sideways = across.try_normalize(1e-300).unwrap_or_default();
        Some(Ray {
            origin: origin + o * entrance.shift(angle),
            direction: sideways * angle.sin() + o * angle.cos(),
        })
    }

    /// Returns the intrinsics and the pose of the linear part. Call [`Cahvor::normalised`] first.
    ///
    /// # Errors
    /// Focal lengths that are not those of one camera, a flat or mirrored image plane.
    pub fn intrinsics(&self) -> Result<Intrinsics, CahvorError> {
        self.check_shape()?;
        let (a, h, v) = (vector(self.a), vector(self.h), vector(self.v));
        let (hs, vs) = (a.cross(&h).norm(), a.cross(&v).norm());
        let (hc, vc) = (a.dot(&h), a.dot(&v));
        let right = (h - a * hc) / hs;
        let down = (v - a * vc) / vs;
        let skew = right.dot(&down);
        let right = (right - down * skew) / (1.0 - skew * skew).sqrt();
        Ok(Intrinsics {
            hs,
            vs,
            hc,
            vc,
            skew,
            cam_from_frame: pose(&right, &down, &a, &vector(self.c)),
        })
    }

    /// Returns the model for a photo scaled by `scale`. Integer coordinates stay pixel centres.
    ///
    /// The pixel corner x + 0.5 scales, hence x' = s (x + 0.5) - 0.5, and H' = s H + (s - 1)/2 A.
    #[must_use]
    pub fn rescaled(&self, scale: f64) -> Self {
        let shift = (scale - 1.0) / 2.0;
        let carry = |rows: [f64; 3]| [0, 1, 2].map(|axis| scale * rows[axis] + shift * self.a[axis]);
        Self {
            h: carry(self.h),
            v: carry(self.v),
            ..*self
        }
    }

    /// Returns the same camera in another frame: C moves, A, H, V, O turn, R and E stay.
    #[must_use]
    pub fn transformed(&self, b_from_a: &Pose) -> Self {
        let turn = |direction: [f64; 3]| b_from_a.direction(&vector(direction)).into();
        Self {
            c: b_from_a.point(&vector(self.c)).into(),
            a: turn(self.a),
            h: turn(self.h),
            v: turn(self.v),
            o: self.o.map(turn),
            ..*self
        }
    }
}

/// Returns the length of a vector that should be 1.
///
/// # Errors
/// A length further off than [`UNIT_TOLERANCE`].
fn unit_length(name: char, value: [f64; 3]) -> Result<f64, CahvorError> {
    let length = vector(value).norm();
    if (length - 1.0).abs() > UNIT_TOLERANCE {
        return Err(CahvorError::NotUnit { vector: name, length });
    }
    Ok(length)
}

/// Returns components as a vector.
fn vector(value: [f64; 3]) -> Vector3<f64> {
    Vector3::from(value)
}

/// Returns the pose of a camera at `centre` whose axes are these unit vectors.
fn pose(right: &Vector3<f64>, down: &Vector3<f64>, forward: &Vector3<f64>, centre: &Vector3<f64>) -> Pose {
    let rotation = nalgebra::Matrix3::from_rows(&[right.transpose(), down.transpose(), forward.transpose()]);
    Pose {
        rotation,
        translation: -(rotation * centre),
    }
}

#[cfg(test)]
mod tests;
