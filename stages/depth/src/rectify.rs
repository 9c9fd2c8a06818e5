//! Rectification of two photos, also of different focal lengths and with lens distortion, in one resampling.

use marf_scene::{Camera, Pose};
use marf_schema::depth::RowOffset;
use nalgebra::{Matrix3, Vector2, Vector3};
use rayon::prelude::*;
use thiserror::Error;

use crate::raster::{Picture, Raster};
use crate::spline::sampled;

/// A camera and its pose. Lengths are in units of the world.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PosedCamera {
    /// The camera.
    pub camera: Camera,
    /// Its pose: x right, y down, z forward.
    pub cam_from_world: Pose,
}

/// One eye of a rectified pair. Photo and rectified picture share their place.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Eye {
    photo: Camera,
    /// The rectified camera, without distortion.
    pub camera: Camera,
    /// The rotation from the axes of the rectified camera to those of the photo.
    pub photo_from_rectified: Matrix3<f64>,
    /// How far its rows were moved because the cameras do not say where they are.
    pub rows: RowOffset,
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
    /// The distance from the left eye to the right one, in units of the world.
    pub baseline: f64,
    /// The disparity of what is infinitely far, in pixels.
    pub far_px: f64,
}

/// Why a pair cannot be rectified.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
pub enum RectifyError {
    /// No distance between the eyes.
    #[error("both photos were taken from one place: a rotation alone shows no depth")]
    Rotation,
    /// The baseline is along the viewing direction.
    #[error(
        "the baseline is {angle_deg:.0} degrees from the viewing direction, and the limit is {LEAST_ANGLE_DEG}"
    )]
    AlongAxis {
        /// Degrees between baseline and viewing direction.
        angle_deg: f64,
    },
    /// The left camera is right of the right one.
    #[error("the left camera is right of the right one. Exchange them")]
    Swapped,
    /// The rectified pictures have no row in common.
    #[error("no row of the rectified photos shows the same")]
    NoCommonRow,
}

/// Below this, a row of the rectified picture would run towards a point in or near the picture.
pub const LEAST_ANGLE_DEG: f64 = 45.0;

/// The least baseline that is more than rounding, in units of the world.
const LEAST_BASELINE: f64 = 1e-6;

/// Rectified pictures end this far from the axis, in focal lengths: 63 degrees. Beyond, a pixel of a photo is stretched over more than ten.
const WIDEST: f64 = 2.0;

/// Places on each side of a photo at which its borders are looked up.
const BORDER_PLACES: u32 = 8;

impl Rectified {
    /// Finds the rectified cameras of two photos.
    ///
    /// Columns run along the baseline, and the axis is the mean of both axes made orthogonal to it (Fusiello, Trucco and
    /// Verri, Machine Vision and Applications 12, 2000). The coarser photo decides the focal length. The pictures have the
    /// rows that both photos show, and as many columns as the wider of them. The middle of each photo is in the middle of
    /// its columns, so eyes that converge have small disparities.
    ///
    /// # Errors
    /// Returns an error if the cameras are in one place, one behind the other, exchanged, or show no row in common.
    pub fn new(left: &PosedCamera, right: &PosedCamera) -> Result<Self, RectifyError> {
        let between = right.cam_from_world.centre() - left.cam_from_world.centre();
        let baseline = between.norm();
        if baseline.is_nan() || baseline < LEAST_BASELINE {
            return Err(RectifyError::Rotation);
        }
        let x = between / baseline;
        let axis = |row: usize| -> Vector3<f64> {
            let of = |one: &PosedCamera| one.cam_from_world.rotation.row(row).transpose();
            of(left) + of(right)
        };
        let forward = axis(2);
        let across = forward - x * forward.dot(&x);
        let sine = across.norm() / forward.norm();
        // Axes that are opposite have no mean, and a NaN must not pass.
        if sine.is_nan() || sine < std::f64::consts::FRAC_1_SQRT_2 {
            return Err(RectifyError::AlongAxis {
                angle_deg: libm::asin(sine).to_degrees(),
            });
        }
        if x.dot(&axis(0)) < 0.0 {
            return Err(RectifyError::Swapped);
        }
        let z = across.normalize();
        let rectified_from_world =
            Matrix3::from_rows(&[x.transpose(), z.cross(&x).transpose(), z.transpose()]);
        let focal_px = mean_focal_px(&left.camera).min(mean_focal_px(&right.camera));
        let eyes = [left, right].map(|photo| Eye {
            photo: photo.camera,
            camera: Camera::pinhole(1, 1, focal_px),
            photo_from_rectified: photo.cam_from_world.rotation * rectified_from_world.transpose(),
            rows: RowOffset::default(),
        });
        let [Some(of_left), Some(of_right)] = eyes.map(|eye| eye.extent()) else {
            return Err(RectifyError::NoCommonRow);
        };
        let top = of_left.low.y.max(of_right.low.y);
        let bottom = of_left.high.y.min(of_right.high.y);
        if top >= bottom {
            return Err(RectifyError::NoCommonRow);
        }
        // Rounding must not add a column or a row.
        let pixels = |length: f64| (length * focal_px - 1e-6).ceil().max(1.0);
        let width = pixels((of_left.high.x - of_left.low.x).max(of_right.high.x - of_right.low.x));
        let height = pixels(bottom - top);
        let placed = |eye: Eye, extent: Extent| Eye {
            camera: Camera {
                width: width as u32,
                height: height as u32,
                cx_px: width / 2.0 - focal_px * (extent.low.x + extent.high.x) / 2.0,
                cy_px: height / 2.0 - focal_px * (top + bottom) / 2.0,
                ..eye.camera
            },
            ..eye
        };
        let [left, right] = eyes;
        let (left, right) = (placed(left, of_left), placed(right, of_right));
        Ok(Self {
            left,
            right,
            focal_px,
            baseline,
            far_px: left.camera.cx_px - right.camera.cx_px,
        })
    }

    /// Returns the inverse of the distance along the axis, (d - far) / (f b), in units of the world. At infinity it is 0, and beyond
    /// it is negative.
    pub fn inverse_depth(&self, disparity_px: f64) -> f64 {
        (disparity_px - self.far_px) / (self.focal_px * self.baseline)
    }
}

fn mean_focal_px(camera: &Camera) -> f64 {
    (camera.fx_px + camera.fy_px) / 2.0
}

/// The part of the plane z = 1 that a photo covers.
#[derive(Clone, Copy)]
struct Extent {
    low: Vector2<f64>,
    high: Vector2<f64>,
}

impl Eye {
    /// Returns what the photo covers of the plane z = 1 of the rectified camera, or nothing if its borders are behind it.
    fn extent(&self) -> Option<Extent> {
        let mut extent: Option<Extent> = None;
        let [width, height] = [self.photo.width, self.photo.height].map(f64::from);
        for i in 0..=BORDER_PLACES {
            let share = f64::from(i) / f64::from(BORDER_PLACES);
            let border = [[share, 0.0], [share, 1.0], [0.0, share], [1.0, share]];
            for [u, v] in border {
                let Some(ray) = self.photo.unproject(&Vector2::new(u * width, v * height)) else {
                    continue;
                };
                let ray = self.photo_from_rectified.transpose() * ray;
                if ray.z <= 0.0 {
                    continue;
                }
                let at = (ray.xy() / ray.z).map(|place| place.clamp(-WIDEST, WIDEST));
                let known = extent.get_or_insert(Extent { low: at, high: at });
                *known = Extent {
                    low: known.low.inf(&at),
                    high: known.high.sup(&at),
                };
            }
        }
        extent
    }

    /// Returns the eye with its rows moved.
    pub(crate) fn with_rows(self, rows: RowOffset) -> Self {
        Self { rows, ..self }
    }

    /// Returns where in the photo a rectified pixel comes from.
    pub fn source(&self, pixel: Vector2<f64>) -> Option<Vector2<f64>> {
        let Camera {
            cx_px, cy_px, fx_px, ..
        } = self.camera;
        let row = pixel.y + self.row_offset(pixel);
        let ray = Vector3::new((pixel.x - cx_px) / fx_px, (row - cy_px) / fx_px, 1.0);
        self.photo.project(&(self.photo_from_rectified * ray))
    }

    /// Returns how many rows below a rectified pixel the cameras put what it shows.
    fn row_offset(&self, pixel: Vector2<f64>) -> f64 {
        let middle = Vector2::new(f64::from(self.camera.width), f64::from(self.camera.height)) / 2.0;
        let from_middle = pixel - middle;
        self.rows.offset_px + self.rows.slope_x * from_middle.x + self.rows.slope_y * from_middle.y
    }

    /// Returns how many rows above where the cameras put a pixel it is: the inverse of [`Self::row_offset`].
    pub(crate) fn rows_above(&self, pixel: Vector2<f64>) -> f64 {
        self.row_offset(pixel) / (1.0 + self.rows.slope_y)
    }

    /// Resamples the photo once, by Catmull-Rom splines. Pixels that need one outside or masked do not take part.
    ///
    /// A photo of at least twice the focal length is halved first, so that no detail folds back.
    ///
    /// - `photo`: of the size of the photo's camera.
    pub fn resample(&self, photo: &Picture) -> Picture {
        if mean_focal_px(&self.photo) >= 2.0 * mean_focal_px(&self.camera) && photo.grey.width > 1 {
            let Camera {
                fx_px,
                fy_px,
                cx_px,
                cy_px,
                ..
            } = self.photo;
            let half = Camera {
                width: self.photo.width.div_ceil(2),
                height: self.photo.height.div_ceil(2),
                fx_px: fx_px / 2.0,
                fy_px: fy_px / 2.0,
                cx_px: cx_px / 2.0,
                cy_px: cy_px / 2.0,
                ..self.photo
            };
            return Self { photo: half, ..*self }.resample(&photo.halved());
        }
        let [width, height] = [self.camera.width, self.camera.height].map(|side| side as usize);
        let mut out = Picture::new(Raster::filled(width, height, 0));
        let rows = out.grey.values.par_chunks_mut(width.max(1));
        rows.zip(out.usable.values.par_chunks_mut(width.max(1)))
            .enumerate()
            .for_each(|(y, (grey, usable))| {
                for x in 0..width {
                    let sample = self
                        .source(Vector2::new(x as f64 + 0.5, y as f64 + 0.5))
                        .and_then(|at| sampled(photo, at));
                    usable[x] = sample.is_some();
                    grey[x] = sample.unwrap_or(0);
                }
            });
        out
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn posed(focal_px: f64, centre: [f64; 3], angles: [f64; 3]) -> PosedCamera {
        let rotation = nalgebra::Rotation3::from_euler_angles(angles[0], angles[1], angles[2]).into_inner();
        PosedCamera {
            camera: Camera::pinhole(80, 60, focal_px),
            cam_from_world: Pose {
                rotation,
                translation: -(rotation * Vector3::from(centre)),
            },
        }
    }

    fn straight(focal_px: f64, centre: [f64; 3]) -> PosedCamera {
        posed(focal_px, centre, [0.0; 3])
    }

    fn pair(left: PosedCamera, right: PosedCamera) -> Rectified {
        Rectified::new(&left, &right).unwrap()
    }

    /// Rounding of f64 in a few products of numbers below 1,000.
    const ROUNDING: f64 = 1e-9;

    #[test]
    fn cameras_side_by_side_stay_as_they_are() {
        let pair = pair(straight(100.0, [0.0; 3]), straight(100.0, [0.5, 0.0, 0.0]));
        assert_eq!((pair.focal_px, pair.baseline), (100.0, 0.5));
        assert!(pair.far_px.abs() < ROUNDING, "{}", pair.far_px);
        assert_eq!((pair.left.camera.width, pair.left.camera.height), (80, 60));
        let at = Vector2::new(12.5, 7.25);
        let found = pair.right.source(at).unwrap();
        assert!((found - at).norm() < ROUNDING, "{found}");
        // 5 px / (100 px x 0.5) is one tenth.
        assert!(
            (pair.inverse_depth(5.0) - 0.1).abs() < ROUNDING,
            "{}",
            pair.inverse_depth(5.0)
        );
    }

    #[test]
    fn the_coarser_photo_decides_and_the_finer_is_scaled_about_its_middle() {
        let pair = pair(straight(100.0, [0.0; 3]), straight(300.0, [0.5, 0.0, 0.0]));
        assert_eq!(pair.focal_px, 100.0);
        // The finer photo shows a third of the rows. 10 px from the middle at 100 px are 30 px at 300 px.
        assert_eq!((pair.left.camera.width, pair.left.camera.height), (80, 20));
        let found = pair.right.source(Vector2::new(50.0, 10.0)).unwrap();
        assert!((found - Vector2::new(70.0, 30.0)).norm() < ROUNDING, "{found}");
    }

    #[test]
    fn moved_rows_come_from_where_the_offset_says_and_go_back() {
        let eye = Eye {
            rows: RowOffset {
                offset_px: 3.0,
                slope_x: 0.1,
                slope_y: 0.05,
                ..RowOffset::default()
            },
            ..pair(straight(100.0, [0.0; 3]), straight(100.0, [0.5, 0.0, 0.0])).right
        };
        // 20 px right of the middle and 10 px below it: 3 + 2 + 0.5.
        let (at, row) = (Vector2::new(60.0, 40.0), 45.5);
        let found = eye.source(at).unwrap();
        assert!((found - Vector2::new(60.0, row)).norm() < ROUNDING, "{found}");
        let above = eye.rows_above(Vector2::new(60.0, row));
        assert!((row - above - 40.0).abs() < ROUNDING, "{above}");
    }

    #[test]
    fn a_vertical_baseline_turns_the_picture_and_keeps_all_of_it() {
        let pair = pair(straight(100.0, [0.0; 3]), straight(100.0, [0.0, 0.5, 0.0]));
        assert_eq!((pair.left.camera.width, pair.left.camera.height), (60, 80));
    }

    #[test]
    fn what_has_no_depth_is_refused() {
        let error = |centre: [f64; 3]| {
            Rectified::new(&straight(100.0, [0.0; 3]), &straight(100.0, centre)).unwrap_err()
        };
        assert_eq!(error([0.0; 3]), RectifyError::Rotation);
        assert_eq!(error([f64::NAN, 0.0, 0.0]), RectifyError::Rotation);
        assert_eq!(error([-0.5, 0.0, 0.0]), RectifyError::Swapped);
        // atan(0.5 / 1) is 26.565 degrees.
        assert_eq!(
            error([0.5, 0.0, 1.0]).to_string(),
            "the baseline is 27 degrees from the viewing direction, and the limit is 45"
        );
        let up = posed(100.0, [0.5, 0.0, 0.0], [0.8, 0.0, 0.0]);
        assert_eq!(
            Rectified::new(&straight(100.0, [0.0; 3]), &up).unwrap_err(),
            RectifyError::NoCommonRow
        );
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
        let eye = pair(straight(100.0, [0.0; 3]), straight(100.0, [0.5, 0.0, 0.0])).left;
        let out = eye.resample(&photo);
        assert_eq!((out.grey.at(33, 20), out.usable.at(33, 20)), (ramp(33), true));
        assert!(!out.usable.at(0, 20) && !out.usable.at(79, 20) && out.usable.at(2, 2));
    }

    proptest! {
        #[test]
        fn a_point_has_one_row_its_depth_and_its_place_in_both_photos(
            angles in prop::array::uniform6(-0.1f64..0.1),
            focal in prop::array::uniform2(80.0f64..160.0),
            k1 in -0.2f64..0.2,
            place in prop::array::uniform3(-0.2f64..0.2),
            point in prop::array::uniform3(-0.5f64..0.5),
        ) {
            let [a, b, c, d, e, f] = angles;
            let mut left = posed(focal[0], place, [a, b, c]);
            left.camera.k1 = k1;
            let right = posed(focal[1], [place[0] + 0.6, -place[1], place[2]], [d, e, f]);
            let pair = Rectified::new(&left, &right).unwrap();
            let point = Vector3::new(point[0], point[1], 6.0 + point[2]);
            let pixels = [(pair.left, left), (pair.right, right)].map(|(eye, photo)| {
                let seen = photo.cam_from_world.point(&point);
                let rectified = eye.photo_from_rectified.transpose() * seen;
                let pixel = eye.camera.project(&rectified).unwrap();
                let (found, expected) = (eye.source(pixel).unwrap(), photo.camera.project(&seen).unwrap());
                assert!((found - expected).norm() < 1e-7, "{found} {expected}");
                (pixel, rectified.z)
            });
            let [(l, depth), (r, _)] = pixels;
            prop_assert!((l.y - r.y).abs() < 1e-7, "rows {} {}", l.y, r.y);
            let found = 1.0 / pair.inverse_depth(l.x - r.x);
            prop_assert!((found - depth).abs() < 1e-6, "{} {}", found, depth);
        }
    }
}
