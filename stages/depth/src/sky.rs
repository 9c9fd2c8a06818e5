//! Sky: what is smooth, above the horizon and above every surface and edge of a photo, and has no depth.

use std::collections::BTreeMap;

use marf_numeric::upper_median;
use marf_scene::Pose;
use nalgebra::{Vector2, Vector3};

use crate::clean;
use crate::disparities::Class;
use crate::merge::PhotoDepth;
use crate::raster::{Picture, Raster};
use crate::winner::NONE;

/// Surfaces hide what is below them in columns of this many pixels.
const COLUMN_PX: f64 = 4.0;
/// Sky is smoother than this share of what the median pixel with a depth shows, or than so many steps of 255: a step of a photo is stretched to
/// 4 at most.
const SMOOTH_SHARE: f32 = 0.5;
const SMOOTH_STEPS: f32 = 5.0;
/// Smaller parts are no sky, shares of the photo.
const LEAST_SHARE: f64 = 0.01;
/// Rough parts of at least so many pixels end the sky. A hot pixel makes nine pixels rough.
const LEAST_ROUGH: usize = 32;

/// Directions of a photo's pixels as a traveller sees them: along its heading, and upwards.
struct Headings {
    cam_heading: Vector3<f64>,
    cam_right: Vector3<f64>,
    cam_up: Vector3<f64>,
    focal_px: f64,
}

/// Where a pixel is above the ground.
#[derive(Clone, Copy)]
struct Bearing {
    column: i64,
    /// Tangent of the angle above the horizon.
    rise: f64,
}

impl Headings {
    /// `None` for a camera that looks straight up or down.
    fn new(cam_from_world: &Pose, up: &Vector3<f64>, focal_px: f64) -> Option<Self> {
        let cam_up = cam_from_world.direction(up);
        let cam_heading = (Vector3::z() - cam_up * cam_up.z).try_normalize(1e-6)?;
        Some(Self {
            cam_right: cam_heading.cross(&cam_up),
            cam_heading,
            cam_up,
            focal_px,
        })
    }

    /// Returns the bearing of a ray of the camera. `None` behind the camera.
    fn bearing(&self, ray: &Vector3<f64>) -> Option<Bearing> {
        let (ahead, aside) = (ray.dot(&self.cam_heading), ray.dot(&self.cam_right));
        (ahead > 0.0).then(|| Bearing {
            column: (aside / ahead * self.focal_px / COLUMN_PX).floor() as i64,
            rise: ray.dot(&self.cam_up) / (ahead * ahead + aside * aside).sqrt(),
        })
    }
}

/// Gives the pixels of a photo that show sky their class.
///
/// Sky is smooth: the brightness of the pixels around varies by at most half of what it does around the median pixel with a depth, or by 5
/// steps of 255. It has no depth, and is above the horizon and above every depth and every rough part of its column, such as the outline of a
/// hill. Parts smaller than 1 % of the photo do not count.
///
/// # Extremes
/// A photo without depths has no sky: nothing says how smooth ground is. Hills whose outline is lost in haze pass for sky, and so would a plain
/// wall.
pub(crate) fn mark(depth: &mut PhotoDepth, picture: &Picture, cam_from_world: &Pose, up: &Vector3<f64>) {
    let Some(headings) = Headings::new(cam_from_world, up, depth.camera.fx_px) else {
        return;
    };
    let (width, pixels) = (picture.grey.width, depth.class.len());
    let bearings: Vec<Option<Bearing>> = (0..pixels)
        .map(|index| {
            let at = Vector2::new((index % width) as f64 + 0.5, (index / width) as f64 + 0.5);
            let bearing = headings.bearing(&depth.camera.unproject(&at)?);
            bearing.filter(|bearing| bearing.rise > 0.0)
        })
        .collect();
    let known = || (0..pixels).filter(|index| depth.inverse[*index] > 0.0);
    let Some(texture) = upper_median(known().map(|index| f64::from(contrast(&picture.grey, index)))) else {
        return;
    };
    let smooth = SMOOTH_STEPS.max(SMOOTH_SHARE * texture as f32);
    let mut open = Raster::like(&picture.grey, NONE);
    let mut rough = open.clone();
    for index in (0..pixels).filter(|index| bearings[*index].is_some() && picture.usable.values[*index]) {
        if f32::from(contrast(&picture.grey, index)) > smooth {
            rough.values[index] = 0.0;
        } else if depth.class[index] == Class::None {
            open.values[index] = 0.0;
        }
    }
    clean::remove_islands(&mut rough, LEAST_ROUGH);
    let mut skyline: BTreeMap<i64, f64> = BTreeMap::new();
    for (index, bearing) in bearings.iter().enumerate() {
        let Some(Bearing { column, rise }) = *bearing else {
            continue;
        };
        if depth.inverse[index] > 0.0 || rough.values[index] != NONE {
            let highest = skyline.entry(column).or_default();
            *highest = highest.max(rise);
        }
    }
    for (open, bearing) in open.values.iter_mut().zip(&bearings) {
        let is_hidden =
            |Bearing { column, rise }: &Bearing| skyline.get(column).is_some_and(|line| rise < line);
        if bearing.as_ref().is_some_and(is_hidden) {
            *open = NONE;
        }
    }
    clean::remove_islands(&mut open, (LEAST_SHARE * pixels as f64).ceil() as usize);
    for (class, open) in depth.class.iter_mut().zip(open.values) {
        if open != NONE {
            *class = Class::Sky;
        }
    }
}

/// Returns the difference of the brightest and the darkest of the pixels around one.
fn contrast(grey: &Raster<u8>, index: usize) -> u8 {
    let (x, y) = ((index % grey.width) as isize, (index / grey.width) as isize);
    let around = (y - 1..=y + 1).flat_map(|y| (x - 1..=x + 1).map(move |x| grey.clamped(x, y)));
    let (least, most) = around.fold((u8::MAX, 0), |(least, most), value| {
        (least.min(value), most.max(value))
    });
    most - least
}

#[cfg(test)]
mod tests {
    use super::*;
    use marf_scene::Camera;

    const WIDTH: usize = 160;
    const HORIZON: usize = 60;

    /// A camera with a level axis over rough ground with depths from the horizon down, and a plain sky.
    fn level() -> (PhotoDepth, Picture) {
        let camera = Camera::pinhole(WIDTH as u32, 2 * HORIZON as u32, 150.0);
        let pixels = WIDTH * 2 * HORIZON;
        let is_ground = |index: usize| index / WIDTH >= HORIZON;
        let depth = PhotoDepth {
            camera,
            inverse: (0..pixels)
                .map(|index| f32::from(u8::from(is_ground(index))))
                .collect(),
            sigma: vec![0.0; pixels],
            normal: vec![[0.0; 3]; pixels],
            class: (0..pixels)
                .map(|index| {
                    if is_ground(index) {
                        Class::Pair
                    } else {
                        Class::None
                    }
                })
                .collect(),
        };
        let rough = |index: usize| 60 + 40 * ((index + index / WIDTH) % 2) as u8;
        let grey = (0..pixels).map(|index| if is_ground(index) { rough(index) } else { 180 });
        let picture = Picture {
            grey: Raster {
                width: WIDTH,
                height: 2 * HORIZON,
                values: grey.collect(),
            },
            usable: Raster::filled(WIDTH, 2 * HORIZON, true),
        };
        (depth, picture)
    }

    /// Returns how many pixels of each row become sky.
    fn sky_by_row(mut depth: PhotoDepth, picture: &Picture, up: [f64; 3]) -> Vec<usize> {
        mark(&mut depth, picture, &Pose::identity(), &Vector3::from(up));
        let rows = depth.class.chunks(WIDTH);
        rows.map(|row| row.iter().filter(|class| **class == Class::Sky).count())
            .collect()
    }

    const UP: [f64; 3] = [0.0, -1.0, 0.0];

    #[test]
    fn plain_pixels_above_the_horizon_are_sky_and_those_at_the_rough_edge_are_not() {
        let (depth, picture) = level();
        let found = sky_by_row(depth, &picture, UP);
        // The row above the ground has the ground around it.
        let expected = (0..2 * HORIZON).map(|row| if row < HORIZON - 1 { WIDTH } else { 0 });
        assert_eq!(found, expected.collect::<Vec<_>>());
    }

    #[test]
    fn neither_ground_without_depth_nor_what_is_below_a_hill_is_sky() {
        let (mut depth, mut picture) = level();
        for row in 0..2 * HORIZON {
            for column in 0..WIDTH {
                let index = row * WIDTH + column;
                // Plain sand without depth, below the horizon.
                if row >= HORIZON && column < 40 {
                    (depth.inverse[index], depth.class[index]) = (0.0, Class::None);
                    picture.grey.values[index] = 180;
                }
                // The crest of a hill. Its shaded side below is plain and has no depth.
                if (20..24).contains(&row) && column >= 80 {
                    (depth.inverse[index], depth.class[index]) = (1.0, Class::Pair);
                }
            }
        }
        let found = sky_by_row(depth, &picture, UP);
        assert_eq!(found[10], WIDTH);
        let left = found[40];
        // Columns of 4 pixels, which the crest may share with the open sky.
        assert!((76..=80).contains(&left), "{left}");
        assert!(found[HORIZON..].iter().all(|count| *count == 0), "{found:?}");
    }

    #[test]
    fn what_an_outline_hides_is_not_sky_and_a_hot_pixel_hides_nothing() {
        let (depth, mut picture) = level();
        // The outline of a plain hill without depth.
        for column in 80..WIDTH {
            picture.grey.values[20 * WIDTH + column] = 120;
        }
        picture.grey.values[10 * WIDTH + 40] = 255;
        let found = sky_by_row(depth, &picture, UP);
        assert_eq!(found[5], WIDTH);
        // The hot pixel and the two beside it.
        assert_eq!(found[10], WIDTH - 3);
        let left = found[40];
        assert!((76..=80).contains(&left), "{left}");
    }

    #[test]
    fn what_is_masked_rough_or_small_is_not_sky() {
        let (depth, mut picture) = level();
        picture.usable.values[..20 * WIDTH].fill(false);
        let found = sky_by_row(depth.clone(), &picture, UP);
        assert!(found[..20].iter().all(|count| *count == 0), "{found:?}");
        assert_eq!(found[45], WIDTH);
        // A row is 0.8 % of the photo, two are 1.7 %.
        for (rows, expected) in [(1, 0), (2, WIDTH)] {
            picture.usable.values[..HORIZON * WIDTH].fill(false);
            picture.usable.values[30 * WIDTH..(30 + rows) * WIDTH].fill(true);
            assert_eq!(
                sky_by_row(depth.clone(), &picture, UP)[30],
                expected,
                "{rows} rows"
            );
        }
        let (depth, mut picture) = level();
        for (index, grey) in picture.grey.values[..40 * WIDTH].iter_mut().enumerate() {
            *grey = 80 + 70 * ((index + index / WIDTH) % 2) as u8;
        }
        assert_eq!(sky_by_row(depth, &picture, UP), vec![0; 2 * HORIZON]);
    }

    #[test]
    fn up_is_that_of_the_world() {
        let (depth, picture) = level();
        // Upside down, everything plain is below the horizon.
        assert_eq!(
            sky_by_row(depth.clone(), &picture, [0.0, 1.0, 0.0]),
            vec![0; 2 * HORIZON]
        );
        // Straight down there is no horizon.
        assert_eq!(
            sky_by_row(depth.clone(), &picture, [0.0, 0.0, -1.0]),
            vec![0; 2 * HORIZON]
        );
        let empty = PhotoDepth {
            inverse: vec![0.0; depth.inverse.len()],
            class: vec![Class::None; depth.class.len()],
            ..depth
        };
        assert_eq!(sky_by_row(empty, &picture, UP), vec![0; 2 * HORIZON]);
    }
}
