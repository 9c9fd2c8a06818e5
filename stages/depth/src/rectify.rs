//! Rectification of two pinhole cameras, also of different focal lengths, in one resampling.

use rayon::prelude::*;
use thiserror::Error;

use crate::raster::{Picture, Raster};

type Vector = [f64; 3];
type Matrix = [Vector; 3];

/// A pinhole camera. Pixel (0, 0) is the top-left corner of a picture, and its first centre is (0.5, 0.5).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pinhole {
    /// Focal length in pixels of a column, and of a row.
    pub focal_px: [f64; 2],
    /// The principal point, in pixels.
    pub centre_px: [f64; 2],
    /// The axes of the camera in the world: right, down, forward. Orthonormal.
    pub axes: Matrix,
    /// Where the camera is, in metres.
    pub position_m: Vector,
    /// Columns and rows.
    pub size: [usize; 2],
}

/// One eye of a rectified pair.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Eye {
    photo: Pinhole,
    rectified: Pinhole,
}

/// A rectified pair: the same focal length, axes and rows, and a baseline along the rows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rectified {
    /// The left eye.
    pub left: Eye,
    /// The right eye.
    pub right: Eye,
    /// The focal length of both, in pixels.
    pub focal_px: f64,
    /// Metres from the left eye to the right one.
    pub baseline_m: f64,
    /// The disparity of what is infinitely far, in pixels.
    pub far_px: f64,
}

/// Why a pair cannot be rectified.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
pub enum RectifyError {
    /// No distance between the eyes.
    #[error("the cameras are {baseline_m} m apart: a rotation alone shows no depth")]
    Rotation {
        /// Metres between the eyes.
        baseline_m: f64,
    },
    /// The baseline is along the viewing direction.
    #[error(
        "the baseline is {angle_deg:.0} degrees from the viewing direction, and the limit is {LEAST_ANGLE_DEG}"
    )]
    AlongAxis {
        /// Degrees between baseline and viewing direction.
        angle_deg: f64,
    },
    /// The left camera is right of the right one.
    #[error("the left camera is {baseline_m} m right of the right one. Exchange them")]
    Swapped {
        /// Metres between the eyes.
        baseline_m: f64,
    },
}

/// Below this, a row of the rectified picture would run towards a point in or near the picture.
pub const LEAST_ANGLE_DEG: f64 = 45.0;

/// The least baseline that is more than rounding, in metres.
const LEAST_BASELINE_M: f64 = 1e-6;

impl Rectified {
    /// Finds the rectified cameras of two photos.
    ///
    /// Columns run along the baseline, and the axis is the mean of both axes made orthogonal to it (Fusiello, Trucco and
    /// Verri, Machine Vision and Applications 12, 2000). The coarser photo decides the focal length and the size. The
    /// middle of each photo stays in the middle of its columns, so eyes that converge have small disparities.
    ///
    /// # Errors
    /// Returns an error if the cameras are in one place, one behind the other, or exchanged.
    pub fn new(left: Pinhole, right: Pinhole) -> Result<Self, RectifyError> {
        let between = subtract(right.position_m, left.position_m);
        let baseline_m = length(between);
        if baseline_m < LEAST_BASELINE_M {
            return Err(RectifyError::Rotation { baseline_m });
        }
        let x = scaled(between, 1.0 / baseline_m);
        let forward = add(left.axes[2], right.axes[2]);
        let across = subtract(forward, scaled(x, dot(forward, x)));
        let sine = length(across) / length(forward);
        // Axes that are opposite have no mean, and a NaN must not pass.
        if sine.is_nan() || sine < LEAST_ANGLE_DEG.to_radians().sin() {
            return Err(RectifyError::AlongAxis {
                angle_deg: sine.asin().to_degrees(),
            });
        }
        if dot(x, add(left.axes[0], right.axes[0])) < 0.0 {
            return Err(RectifyError::Swapped { baseline_m });
        }
        let z = scaled(across, 1.0 / length(across));
        let axes = [x, cross(z, x), z];
        let coarse = if right.mean_focal_px() < left.mean_focal_px() {
            right
        } else {
            left
        };
        let focal = coarse.mean_focal_px();
        let eye = |photo: Pinhole| {
            let size = coarse.size;
            let rectified = Pinhole {
                focal_px: [focal; 2],
                centre_px: [0.0; 2],
                axes,
                position_m: photo.position_m,
                size,
            };
            let middle = photo.ray(photo.size.map(|side| side as f64 / 2.0));
            let [u, v] = rectified.project(middle).unwrap_or([0.0; 2]);
            let centre_px = [size[0] as f64 / 2.0 - u, size[1] as f64 / 2.0 - v];
            Eye {
                photo,
                rectified: Pinhole {
                    centre_px,
                    ..rectified
                },
            }
        };
        let (mut left, mut right) = (eye(left), eye(right));
        let row = (left.rectified.centre_px[1] + right.rectified.centre_px[1]) / 2.0;
        left.rectified.centre_px[1] = row;
        right.rectified.centre_px[1] = row;
        let far_px = left.rectified.centre_px[0] - right.rectified.centre_px[0];
        Ok(Self {
            left,
            right,
            focal_px: focal,
            baseline_m,
            far_px,
        })
    }

    /// Returns the distance along the axis in metres, f b / (d - far), or nothing at infinity and beyond.
    pub fn depth_m(&self, disparity_px: f64) -> Option<f64> {
        let near = disparity_px - self.far_px;
        (near > 0.0).then(|| self.focal_px * self.baseline_m / near)
    }
}

impl Pinhole {
    fn mean_focal_px(&self) -> f64 {
        (self.focal_px[0] + self.focal_px[1]) / 2.0
    }

    /// Returns the direction in the world that a pixel shows, of any length.
    pub fn ray(&self, pixel: [f64; 2]) -> Vector {
        let [u, v] = std::array::from_fn(|i| (pixel[i] - self.centre_px[i]) / self.focal_px[i]);
        add(
            add(scaled(self.axes[0], u), scaled(self.axes[1], v)),
            self.axes[2],
        )
    }

    /// Returns the pixel that shows a direction in the world, or nothing behind the camera.
    pub fn project(&self, direction: Vector) -> Option<[f64; 2]> {
        let [x, y, z] = self.axes.map(|axis| dot(axis, direction));
        let [fx, fy] = self.focal_px;
        (z > 0.0).then(|| [fx * x / z + self.centre_px[0], fy * y / z + self.centre_px[1]])
    }
}

impl Eye {
    /// Returns the rectified camera.
    pub fn camera(&self) -> Pinhole {
        self.rectified
    }

    /// Returns where in the photo a rectified pixel comes from.
    pub fn source(&self, pixel: [f64; 2]) -> Option<[f64; 2]> {
        self.photo.project(self.rectified.ray(pixel))
    }

    /// Resamples the photo once, by Catmull-Rom splines. Pixels that need one outside or masked do not take part.
    ///
    /// A photo of at least twice the focal length is halved first, so that no detail folds back.
    ///
    /// - `photo`: of the size of the photo's camera.
    pub fn resample(&self, photo: &Picture) -> Picture {
        if self.photo.mean_focal_px() >= 2.0 * self.rectified.mean_focal_px() && photo.grey.width > 1 {
            let half = |[a, b]: [f64; 2]| [a / 2.0, b / 2.0];
            let camera = Pinhole {
                focal_px: half(self.photo.focal_px),
                centre_px: half(self.photo.centre_px),
                size: self.photo.size.map(|side| side.div_ceil(2)),
                ..self.photo
            };
            return Self {
                photo: camera,
                ..*self
            }
            .resample(&photo.halved());
        }
        let [width, height] = self.rectified.size;
        let mut out = Picture::new(Raster::filled(width, height, 0));
        let rows = out.grey.values.par_chunks_mut(width.max(1));
        rows.zip(out.usable.values.par_chunks_mut(width.max(1)))
            .enumerate()
            .for_each(|(y, (grey, usable))| {
                for x in 0..width {
                    let sample = self
                        .source([x as f64 + 0.5, y as f64 + 0.5])
                        .and_then(|at| sampled(photo, at));
                    usable[x] = sample.is_some();
                    grey[x] = sample.unwrap_or(0);
                }
            });
        out
    }
}

/// Returns the brightness at a place in a photo, or nothing where one of the 4 x 4 pixels around is missing.
fn sampled(photo: &Picture, at: [f64; 2]) -> Option<u8> {
    let [x, y] = at.map(|at| at - 0.5);
    let (column, row) = (x.floor(), y.floor());
    let inside = column >= 1.0
        && row >= 1.0
        && column + 2.0 < photo.grey.width as f64
        && row + 2.0 < photo.grey.height as f64;
    if !inside {
        return None;
    }
    let (weights_x, weights_y) = (catmull_rom(x - column), catmull_rom(y - row));
    let mut sum = 0.0;
    for (v, weight_y) in weights_y.iter().enumerate() {
        for (u, weight_x) in weights_x.iter().enumerate() {
            let (px, py) = (column as usize + u - 1, row as usize + v - 1);
            if !photo.usable.at(px, py) {
                return None;
            }
            sum += weight_y * weight_x * f64::from(photo.grey.at(px, py));
        }
    }
    Some(sum.round().clamp(0.0, 255.0) as u8)
}

/// Returns the weights of four samples at -1, 0, 1 and 2 for a place in [0, 1).
fn catmull_rom(t: f64) -> [f64; 4] {
    let (t2, t3) = (t * t, t * t * t);
    [
        0.5 * (2.0 * t2 - t - t3),
        0.5 * (3.0 * t3 - 5.0 * t2 + 2.0),
        0.5 * (4.0 * t2 + t - 3.0 * t3),
        0.5 * (t3 - t2),
    ]
}

fn dot(a: Vector, b: Vector) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn length(a: Vector) -> f64 {
    dot(a, a).sqrt()
}

fn scaled(a: Vector, factor: f64) -> Vector {
    a.map(|value| value * factor)
}

fn add(a: Vector, b: Vector) -> Vector {
    std::array::from_fn(|i| a[i] + b[i])
}

fn subtract(a: Vector, b: Vector) -> Vector {
    std::array::from_fn(|i| a[i] - b[i])
}

fn cross(a: Vector, b: Vector) -> Vector {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const STRAIGHT: Matrix = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

    fn camera(focal: f64, position_m: Vector) -> Pinhole {
        Pinhole {
            focal_px: [focal; 2],
            centre_px: [40.0, 30.0],
            axes: STRAIGHT,
            position_m,
            size: [80, 60],
        }
    }

    /// Rounding of f64 in a few products of numbers below 1,000.
    const ROUNDING: f64 = 1e-9;

    #[test]
    fn cameras_side_by_side_stay_as_they_are() {
        let pair = Rectified::new(camera(100.0, [0.0; 3]), camera(100.0, [0.5, 0.0, 0.0])).unwrap();
        assert_eq!((pair.focal_px, pair.baseline_m, pair.far_px), (100.0, 0.5, 0.0));
        let [u, v] = pair.right.source([12.5, 7.25]).unwrap();
        assert!(
            (u - 12.5).abs() < ROUNDING && (v - 7.25).abs() < ROUNDING,
            "{u} {v}"
        );
        // 100 px x 0.5 m / 10 m = 5 px.
        assert_eq!(pair.depth_m(5.0), Some(10.0));
        assert_eq!(pair.depth_m(0.0), None);
    }

    #[test]
    fn the_coarser_photo_decides_and_the_finer_is_scaled_about_its_middle() {
        let pair = Rectified::new(camera(100.0, [0.0; 3]), camera(300.0, [0.5, 0.0, 0.0])).unwrap();
        assert_eq!(pair.focal_px, 100.0);
        // 10 px from the middle at 100 px are 30 px at 300 px.
        let [u, v] = pair.right.source([50.0, 30.0]).unwrap();
        assert!(
            (u - 70.0).abs() < ROUNDING && (v - 30.0).abs() < ROUNDING,
            "{u} {v}"
        );
    }

    #[test]
    fn converging_eyes_have_the_disparity_of_their_middles_where_the_axes_meet() {
        // Both look at a point 2 m ahead, 0.5 m apart. Rectified, that point is in the middle of both.
        let turned = |x: f64| {
            let n = (x * x + 4.0).sqrt();
            [[2.0 / n, 0.0, -x / n], [0.0, 1.0, 0.0], [x / n, 0.0, 2.0 / n]]
        };
        let left = Pinhole {
            axes: turned(0.25),
            ..camera(100.0, [-0.25, 0.0, 0.0])
        };
        let right = Pinhole {
            axes: turned(-0.25),
            ..camera(100.0, [0.25, 0.0, 0.0])
        };
        let pair = Rectified::new(left, right).unwrap();
        // 100 px x 0.25 / 2 to each side.
        assert!((pair.far_px - -25.0).abs() < ROUNDING, "{}", pair.far_px);
        let depth = pair.depth_m(0.0).unwrap();
        assert!((depth - 2.0).abs() < ROUNDING, "{depth}");
    }

    #[test]
    fn one_place_one_behind_the_other_and_exchanged_are_errors() {
        let left = camera(100.0, [0.0; 3]);
        let error = |position| Rectified::new(left, camera(100.0, position)).unwrap_err();
        assert_eq!(error([0.0; 3]), RectifyError::Rotation { baseline_m: 0.0 });
        assert_eq!(error([0.0, 0.0, 2.0]), RectifyError::AlongAxis { angle_deg: 0.0 });
        assert_eq!(error([-0.5, 0.0, 0.0]), RectifyError::Swapped { baseline_m: 0.5 });
    }

    #[test]
    fn resampling_keeps_a_ramp_and_leaves_out_the_border() {
        let ramp = |x: usize| 2 * x as u8 + 20;
        let values = (0..80 * 60).map(|i| ramp(i % 80)).collect();
        let photo = Picture::new(Raster {
            width: 80,
            height: 60,
            values,
        });
        let eye = Rectified::new(camera(100.0, [0.0; 3]), camera(100.0, [0.5, 0.0, 0.0]))
            .unwrap()
            .left;
        let out = eye.resample(&photo);
        assert_eq!((out.grey.at(33, 20), out.usable.at(33, 20)), (ramp(33), true));
        assert!(!out.usable.at(0, 20) && !out.usable.at(79, 20) && out.usable.at(1, 1));
    }

    #[test]
    fn the_weights_of_a_place_add_up_to_one_and_hit_the_samples() {
        assert_eq!(catmull_rom(0.0), [0.0, 1.0, 0.0, 0.0]);
        assert_eq!(catmull_rom(0.5), [-0.0625, 0.5625, 0.5625, -0.0625]);
    }

    /// Axes turned by small angles about the three axes in turn, in radians.
    fn turned([a, b, c]: Vector) -> Matrix {
        let about = |i: usize, angle: f64, axes: Matrix| {
            let (j, k) = ((i + 1) % 3, (i + 2) % 3);
            let mut out = axes;
            out[j] = add(scaled(axes[j], angle.cos()), scaled(axes[k], angle.sin()));
            out[k] = subtract(scaled(axes[k], angle.cos()), scaled(axes[j], angle.sin()));
            out
        };
        about(2, c, about(1, b, about(0, a, STRAIGHT)))
    }

    proptest! {
        #[test]
        fn a_point_has_one_row_its_depth_and_its_place_in_both_photos(
            angles in prop::array::uniform6(-0.15f64..0.15),
            focal in prop::array::uniform2(80.0f64..400.0),
            place in prop::array::uniform3(-0.2f64..0.2),
            point in prop::array::uniform3(-1.0f64..1.0),
        ) {
            let [a, b, c, d, e, f] = angles;
            let left = Pinhole { axes: turned([a, b, c]), ..camera(focal[0], place) };
            let right = Pinhole { axes: turned([d, e, f]), ..camera(focal[1], [place[0] + 0.6, -place[1], place[2]]) };
            let pair = Rectified::new(left, right).unwrap();
            let point = [point[0], point[1], 6.0 + point[2]];
            let [l, r] = [pair.left, pair.right].map(|eye| {
                let direction = subtract(point, eye.photo.position_m);
                let pixel = eye.camera().project(direction).unwrap();
                let found = eye.source(pixel).unwrap();
                let expected = eye.photo.project(direction).unwrap();
                assert!((found[0] - expected[0]).abs() + (found[1] - expected[1]).abs() < 1e-7, "{found:?} {expected:?}");
                pixel
            });
            prop_assert!((l[1] - r[1]).abs() < 1e-7, "rows {} {}", l[1], r[1]);
            let depth = dot(pair.left.camera().axes[2], subtract(point, left.position_m));
            let found = pair.depth_m(l[0] - r[0]).unwrap();
            prop_assert!((found - depth).abs() < 1e-6, "{} {}", found, depth);
        }
    }
}
