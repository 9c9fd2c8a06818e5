//! The rover's stops, where its cameras point, and the erroneous poses that labels state.

use std::f64::consts::PI;

use super::{
    ground::OUTCROP,
    lens::{Lens, Quaternion, RoverPose, about, rotate, rotation_columns},
    math::{DEGREE, Rng, V3, sin_cos, v3},
    world::World,
};

/// Eye of the mast camera.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Eye {
    /// `ZL`.
    Left,
    /// `ZR`.
    Right,
}

/// Stereo baseline, metres (Mastcam-Z).
pub const BASELINE_M: f64 = 0.244;
/// Position of the cameras in the rover frame, metres (x forward, y right, z down; from a real Mastcam-Z label).
pub const MAST: V3 = v3(0.8049, 0.5595, -1.9190);
/// Number of stops per sol.
pub const STOPS: u32 = 3;
/// Horizontal field of view, degrees.
const FIELD_DEG: f64 = 52.0;

/// One stop: the true pose of the rover in the site, and the one that labels state.
#[derive(Debug, Clone)]
pub struct Stop {
    pub drive: u32,
    pub site_from_rover: RoverPose,
    pub labelled: RoverPose,
}

/// One direction of the mast at a stop, for both eyes.
#[derive(Debug, Clone, Copy)]
pub struct Pointing {
    pub stop: usize,
    /// Azimuth relative to the direction of the outcrop, degrees to the right.
    pub pan_deg: f64,
    /// Elevation, degrees.
    pub tilt_deg: f64,
    /// Motion counter of the mast.
    pub rsm: u32,
}

/// Returns the stops of a sol, counted from 1 at each site: an arc around the outcrop, which the next sol continues.
pub fn stops(world: &World, seed: u64, sol: u32) -> Vec<Stop> {
    (0..STOPS)
        .map(|k| {
            let step = (sol - 1) * STOPS + k;
            let lap = f64::from(step / 20 % 5);
            let mut rng = Rng::new(seed, 0x73_746f_7000 + u64::from(step));
            let bearing = (205.0 + 18.0 * f64::from(step % 20) + 7.0 * lap + rng.within(-2.0, 2.0)) * DEGREE;
            let radius = 4.9 + 0.45 * lap + rng.within(-0.35, 0.35);
            let (sin, cos) = sin_cos(bearing);
            let at = [OUTCROP[0] + radius * cos, OUTCROP[1] + radius * sin];
            stop(world, &mut rng, 20 + step * 3, at)
        })
        .collect()
}

fn stop(world: &World, rng: &mut Rng, drive: u32, [x, y]: [f64; 2]) -> Stop {
    // The rover points past the outcrop, so that its mast has to turn.
    let (dx, dy) = (OUTCROP[0] - x, OUTCROP[1] - y);
    let facing = angle(dx, dy) + rng.within(-14.0, 14.0) * DEGREE;
    let (slope_x, slope_y) = world.slope(x, y);
    let (sin, cos) = sin_cos(facing);
    let pitch = (slope_x * cos + slope_y * sin) / 1.8;
    let roll = -(slope_y * cos - slope_x * sin) / 1.8;
    let attitude =
        about(v3(0.0, 0.0, 1.0), facing) * about(v3(0.0, 1.0, 0.0), pitch) * about(v3(1.0, 0.0, 0.0), roll);
    let place = v3(x, y, -world.height(x, y));
    let slip = v3(rng.normal() * 0.010, rng.normal() * 0.010, rng.normal() * 0.006);
    let labelled = RoverPose {
        attitude: tilted(rng, 0.06) * attitude,
        place: place + slip,
    };
    Stop {
        drive,
        site_from_rover: RoverPose { attitude, place },
        labelled,
    }
}

/// Returns a rotation of about this many degrees about a random axis.
fn tilted(rng: &mut Rng, degrees: f64) -> Quaternion {
    about(rng.direction(), degrees * DEGREE * rng.within(0.7, 1.3))
}

/// Returns the angle of a direction in the plane: tan(angle / 2) = y / (r + x), and a series below 22.5 degrees.
fn angle(x: f64, y: f64) -> f64 {
    let r = (x * x + y * y).sqrt();
    if x < 0.0 {
        let half = if y < 0.0 { -PI } else { PI };
        return half - angle(-x, y);
    }
    let mut t = y / (r + x);
    let mut scale = 2.0;
    while t.abs() > 0.1 {
        t /= 1.0 + (1.0 + t * t).sqrt();
        scale *= 2.0;
    }
    let t2 = t * t;
    scale * t * (1.0 - t2 * (1.0 / 3.0 - t2 * (0.2 - t2 * (1.0 / 7.0 - t2 * (1.0 / 9.0 - t2 / 11.0)))))
}

/// Azimuth and elevation in degrees of the good views, by stop: ten stereo pairs.
const PAIRS: [(usize, f64, f64); 10] = [
    (0, 0.0, -16.0),
    (0, -16.0, -13.0),
    (0, 14.0, -19.0),
    (0, 3.0, -8.0),
    (1, 1.0, -15.0),
    (1, -14.0, -20.0),
    (1, 17.0, -12.0),
    (2, -1.0, -17.0),
    (2, 13.0, -14.0),
    (2, -15.0, -11.0),
];
/// Views that only flawed photos show, so that no sharp colour photo duplicates them.
const SPARE: [(usize, f64, f64); 4] = [
    (0, 26.0, -11.0),
    (1, -27.0, -14.0),
    (2, 25.0, -21.0),
    (2, -27.0, -18.0),
];

/// Returns the directions of the good photos of a sol.
pub fn pairs() -> Vec<Pointing> {
    numbered(&PAIRS, 100)
}

/// Returns the directions that only flawed photos show.
pub fn spare() -> Vec<Pointing> {
    numbered(&SPARE, 400)
}

/// Backwards and down at the deck.
pub const DECK: Pointing = Pointing {
    stop: 1,
    pan_deg: 168.0,
    tilt_deg: -52.0,
    rsm: 700,
};

fn numbered(plan: &[(usize, f64, f64)], first_rsm: u32) -> Vec<Pointing> {
    let rsm = (first_rsm..).step_by(24);
    let pointing = |(&(stop, pan_deg, tilt_deg), rsm)| Pointing {
        stop,
        pan_deg,
        tilt_deg,
        rsm,
    };
    plan.iter().zip(rsm).map(pointing).collect()
}

/// A camera as it was, and as its label states.
#[derive(Debug, Clone, Copy)]
pub struct Capture {
    /// The true lens in the true site frame.
    pub site: Lens,
    /// The true lens in the rover frame.
    pub rover: Lens,
    /// The lens that the label states, in the rover frame.
    pub labelled_rover: Lens,
    /// Rotation of the mast, as the label states it.
    pub mast: Quaternion,
}

/// Returns the camera of one eye after the mast has been pointed.
pub fn take(stop: &Stop, pointing: &Pointing, eye: Eye, size_px: [u32; 2], seed: u64) -> Capture {
    let RoverPose { attitude, place } = stop.site_from_rover;
    let columns = rotation_columns(attitude);
    // The direction from the mast to the outcrop, in the rover frame.
    let head = rotate(&columns, MAST) + place;
    let to = v3(OUTCROP[0], OUTCROP[1], head.z) - head;
    let azimuth = angle(columns[0].dot(&to), columns[1].dot(&to)) + pointing.pan_deg * DEGREE;
    let mast = about(v3(0.0, 0.0, 1.0), azimuth) * about(v3(0.0, 1.0, 0.0), pointing.tilt_deg * DEGREE);
    let [forward, right, down] = rotation_columns(mast);
    let side = if eye == Eye::Left { -0.5 } else { 0.5 };
    let centre = MAST + forward * 0.06 + right * (side * BASELINE_M) + down * 0.02;
    let rover = Lens::new(centre, forward, right, size_px, focal_px(size_px[0]));
    // Backlash of the mast's joints: the same for both eyes.
    let stream = 0x706f_696e_7400 + u64::from(stop.drive) * 65_536 + u64::from(pointing.rsm);
    let mut rng = Rng::new(seed, stream);
    let backlash = rotation_columns(tilted(&mut rng, 0.08));
    let about_head = MAST - rotate(&backlash, MAST);
    Capture {
        site: rover.moved(&columns, place),
        rover,
        labelled_rover: rover.moved(&backlash, about_head),
        mast,
    }
}

/// Returns the focal length of the field of view, pixels.
pub fn focal_px(width: u32) -> f64 {
    let (sin, cos) = sin_cos(FIELD_DEG / 2.0 * DEGREE);
    f64::from(width) / 2.0 * cos / sin
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_own_angle_agrees_with_the_library_all_around() {
        for i in 0..720 {
            let a = (f64::from(i) * 0.5 - 179.9) * DEGREE;
            let (sin, cos) = (a.sin(), a.cos());
            assert!(
                (angle(3.0 * cos, 3.0 * sin) - a).abs() < 1e-10,
                "{i}: {}",
                angle(cos, sin)
            );
        }
    }
}
