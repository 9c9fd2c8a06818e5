//! Up without labels: from the cameras' axes where headings differ, and from the ground where cameras look down on it.
//!
//! A camera that is not rolled has its x axis level, so up is the direction that is orthogonal to the x axes of all cameras. That direction
//! is known as well as the headings differ. Where they do not, the plane of the points decides: it is the ground if its normal is near the
//! cameras' own up, if the cameras do not move along the width of their pictures, as in a descent or a flight, or if pictures are upside
//! down to each other. A plane in front of cameras that move sideways with one heading is a wall or the ground: nothing tells.
//! A camera that swings below a parachute has axes like one that turns its heading before a wall. Its pitch varies, too.

mod plane;

use marf_scene::{Point, Pose};
use marf_schema::calibrate::{Up, UpSource};
use nalgebra::Vector3;

use plane::{Plane, scatter, sorted};

/// Up in the world, a unit vector, and how it was found.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct FoundUp {
    pub direction: [f64; 3],
    pub up: Up,
}

/// Largest standard deviation of an up that is reported, degrees.
const MOST_SIGMA_DEG: f64 = 8.0;
/// Least standard deviation, degrees: roll of a camera on a mast or in a hand, and slope of the ground.
const LEAST_SIGMA_DEG: f64 = 1.0;
/// Mean square of the x axes across their main direction from which headings differ: 6 degrees.
const LEAST_HEADINGS: f64 = 0.01;
/// The same from which no swing of a lander or a helicopter explains it: 18 degrees.
const MOST_SWINGS: f64 = 0.1;
/// Share of the mean square of the x axes from which pitch varies like heading, as of what swings and not of what turns.
const BOTH_WAYS: f64 = 0.15;
/// Roll at which a camera has half its weight, as the sine: 6 degrees.
const ROLL: f64 = 0.1;
/// Rounds of weights and directions.
const ROUNDS: usize = 10;
/// Cosine from which cameras look along the normal of a plane: 45 degrees.
const LOOKS_DOWN: f64 = 0.7;
/// Cosine from which a normal is near the cameras' own up: 40 degrees.
const NEAR_UP: f64 = 0.766;
/// Cosine from which a motion is along the width of the pictures: 32 degrees. Before a wall no one climbs more.
const SIDEWAYS: f64 = 0.85;
/// Length of the mean of the cameras' own up below which pictures are turned or upside down to each other.
const ONE_WAY_UP: f64 = 0.5;

/// Finds up, or `None` where nothing shows it within [`MOST_SIGMA_DEG`].
pub(crate) fn find_up(poses: &[&Pose], points: &[Point]) -> Option<FoundUp> {
    let cameras = Cameras::new(poses);
    if cameras.centres.is_empty() {
        return None;
    }
    let plane = Plane::fit(&cameras.centres, points);
    let found = cameras
        .by_axes(plane.as_ref())
        .or_else(|| by_plane(&cameras, &plane?))?;
    (found.up.sigma_deg? <= MOST_SIGMA_DEG).then_some(found)
}

impl FoundUp {
    /// Up of the site frame of labels, whose z axis points down.
    pub fn labels() -> Self {
        Self::certain([0.0, 0.0, -1.0], UpSource::Labels)
    }

    /// Up of the scene that was extended.
    pub fn extended(direction: [f64; 3]) -> Self {
        Self::certain(direction, UpSource::Extended)
    }

    fn certain(direction: [f64; 3], source: UpSource) -> Self {
        let sigma_deg = None;
        let up = Up { source, sigma_deg };
        Self { direction, up }
    }
}

fn found(direction: Vector3<f64>, source: UpSource, sigma_deg: f64) -> Option<FoundUp> {
    let direction = direction.try_normalize(1e-9)?;
    let up = Up {
        source,
        sigma_deg: Some(sigma_deg.max(LEAST_SIGMA_DEG)),
    };
    Some(FoundUp {
        direction: direction.into(),
        up,
    })
}

/// Axes and centres of cameras in the world.
struct Cameras {
    right: Vec<Vector3<f64>>,
    own_up: Vec<Vector3<f64>>,
    ahead: Vec<Vector3<f64>>,
    centres: Vec<Vector3<f64>>,
}

impl Cameras {
    /// Takes the cameras whose numbers are finite.
    fn new(poses: &[&Pose]) -> Self {
        let finite = |pose: &&&Pose| {
            pose.rotation
                .iter()
                .chain(&pose.translation)
                .all(|one| one.is_finite())
        };
        let poses: Vec<&Pose> = poses.iter().filter(finite).copied().collect();
        let axis = |row: usize, sign: f64| {
            let of = |pose: &&Pose| pose.rotation.row(row).transpose() * sign;
            poses.iter().map(of).collect()
        };
        Self {
            right: axis(0, 1.0),
            own_up: axis(1, -1.0),
            ahead: axis(2, 1.0),
            centres: poses.iter().map(|pose| pose.centre()).collect(),
        }
    }

    /// Returns the direction orthogonal to the x axes where these differ. Cameras that are rolled weigh little.
    fn by_axes(&self, plane: Option<&Plane>) -> Option<FoundUp> {
        let mut weights = vec![1.0; self.right.len()];
        let mut eigen = sorted(scatter(&self.right, &weights));
        for _ in 0..ROUNDS {
            let level = eigen.direction[2];
            let weigh = |axis: &Vector3<f64>| 1.0 / (1.0 + (axis.dot(&level) / ROLL).powi(2));
            weights = self.right.iter().map(weigh).collect();
            eigen = sorted(scatter(&self.right, &weights));
        }
        let count: f64 = weights.iter().sum();
        if eigen.value[1] < LEAST_HEADINGS {
            return None;
        }
        let level = eigen.direction[2];
        let (upright, down) = (mean_dot(&self.own_up, &level), -mean_dot(&self.ahead, &level));
        // Pictures show which way is up. Where they are turned all ways, the cameras look down.
        let sign = if upright.abs() > 0.3 { upright } else { down };
        if sign.abs() < 0.3 {
            return None;
        }
        let direction = level * sign.signum();
        let looks_down = -mean_dot(&self.ahead, &direction) > LOOKS_DOWN;
        let on_ground = plane.filter(|plane| looks_down && plane.normal.dot(&direction) > NEAR_UP);
        if let Some(ground) = on_ground {
            return found(ground.normal, UpSource::Ground, ground.sigma_deg);
        }
        let may_swing = eigen.value[1] < MOST_SWINGS && self.pitches(&direction) > BOTH_WAYS * eigen.value[1];
        let is_across = |plane: &Plane| plane.normal.dot(&direction) < NEAR_UP && self.fly_over(plane);
        if may_swing && plane.is_some_and(is_across) {
            return None;
        }
        let roll = (eigen.value[2].max(0.0) / (count * eigen.value[1])).sqrt();
        found(direction, UpSource::CameraAxes, roll.to_degrees())
    }

    /// Returns whether the cameras look along the normal of a plane and fly over it, as no one moves before a wall.
    fn fly_over(&self, plane: &Plane) -> bool {
        if -mean_dot(&self.ahead, &plane.normal) < LOOKS_DOWN {
            return false;
        }
        let right = self.main_right();
        self.own_up().norm() < ONE_WAY_UP
            || self
                .motion(plane.distance)
                .is_some_and(|motion| motion.dot(&right).abs() < SIDEWAYS)
    }

    /// Returns the variance of the sine by which the cameras look up.
    fn pitches(&self, up: &Vector3<f64>) -> f64 {
        let mean = mean_dot(&self.ahead, up);
        let squares = self.ahead.iter().map(|ahead| (ahead.dot(up) - mean).powi(2));
        squares.sum::<f64>() / self.ahead.len() as f64
    }

    /// Returns the mean of the cameras' own up.
    fn own_up(&self) -> Vector3<f64> {
        self.own_up.iter().sum::<Vector3<f64>>() / self.own_up.len() as f64
    }

    /// Returns the main direction of the x axes.
    fn main_right(&self) -> Vector3<f64> {
        sorted(scatter(&self.right, &vec![1.0; self.right.len()])).direction[0]
    }

    /// Returns the main direction in which the cameras moved. `None` where they are at one place in distances from the plane.
    fn motion(&self, distance: f64) -> Option<Vector3<f64>> {
        let count = self.centres.len() as f64;
        let mean = self.centres.iter().sum::<Vector3<f64>>() / count;
        let moves: Vec<Vector3<f64>> = self.centres.iter().map(|centre| centre - mean).collect();
        let eigen = sorted(scatter(&moves, &vec![1.0; moves.len()]));
        (eigen.value[0].max(0.0).sqrt() > 0.05 * distance).then_some(eigen.direction[0])
    }
}

/// Returns up where all cameras have one heading and a plane is in front of them.
fn by_plane(cameras: &Cameras, plane: &Plane) -> Option<FoundUp> {
    if plane.normal.dot(&cameras.own_up()) > NEAR_UP {
        let right = cameras.main_right();
        let level = plane.normal - right * plane.normal.dot(&right);
        return found(level, UpSource::Ground, plane.sigma_deg);
    }
    let ground = cameras.fly_over(plane).then_some(plane.normal)?;
    found(ground, UpSource::Ground, plane.sigma_deg)
}

fn mean_dot(vectors: &[Vector3<f64>], direction: &Vector3<f64>) -> f64 {
    vectors.iter().map(|one| one.dot(direction)).sum::<f64>() / vectors.len().max(1) as f64
}

#[cfg(test)]
mod tests {
    use marf_numeric::Rng;
    use nalgebra::Matrix3;

    use super::*;

    /// A camera at `eye` that looks along `ahead` with `up` in its picture.
    fn camera(eye: [f64; 3], ahead: [f64; 3], up: [f64; 3]) -> Pose {
        let ahead = Vector3::from(ahead).normalize();
        let right = ahead.cross(&Vector3::from(up)).normalize();
        let down = ahead.cross(&right);
        let rotation = Matrix3::from_rows(&[right.transpose(), down.transpose(), ahead.transpose()]);
        Pose {
            rotation,
            translation: -rotation * Vector3::from(eye),
        }
    }

    /// Points of rough ground at z = 0, with stones, 10 m across.
    fn ground() -> Vec<Point> {
        let mut rng = Rng::new(3);
        let point = |index: usize| {
            let height = if index.is_multiple_of(5) { 0.8 } else { 0.05 };
            let [x, y, z] = [(); 3].map(|()| rng.unit_f64());
            Point {
                position: [10.0 * x - 5.0, 10.0 * y - 5.0, height * z],
                color: None,
                views: 3,
            }
        };
        (0..600).map(point).collect()
    }

    fn found(poses: &[Pose], points: &[Point]) -> Option<(f64, UpSource)> {
        let found = find_up(&poses.iter().collect::<Vec<_>>(), points)?;
        let cos = Vector3::from(found.direction).z.clamp(-1.0, 1.0);
        assert!(found.up.sigma_deg.unwrap() >= LEAST_SIGMA_DEG);
        Some((cos.acos().to_degrees(), found.up.source))
    }

    fn is_up(poses: &[Pose], points: &[Point], source: UpSource) {
        let (off_deg, of) = found(poses, points).unwrap();
        assert!(off_deg < 3.0 && of == source, "{off_deg} degrees off, {of:?}");
    }

    /// Headings over 120 degrees, 15 degrees down, rolled by up to 1.2 degrees: a mast. The mean of the cameras' own up is 15 degrees off.
    #[test]
    fn level_axes_of_different_headings_are_orthogonal_to_up() {
        let mast = |index: i32| {
            let heading = f64::from(index) * 0.2;
            let roll = 0.02 * f64::from(index % 3 - 1);
            camera(
                [0.0, 0.0, 2.0],
                [heading.cos(), heading.sin(), -0.27],
                [0.0, roll, 1.0],
            )
        };
        let poses: Vec<Pose> = (-5..=5).map(mast).collect();
        is_up(&poses, &[], UpSource::CameraAxes);
        let around = |index: i32| {
            let (sin, cos) = f64::from(index).sin_cos();
            camera([4.0 * cos, 4.0 * sin, 1.5], [-cos, -sin, -0.35], [0.0, 0.0, 1.0])
        };
        is_up(
            &(0..12).map(around).collect::<Vec<_>>(),
            &[],
            UpSource::CameraAxes,
        );
    }

    #[test]
    fn a_photo_on_its_side_weighs_little() {
        let mast = |index: i32| {
            let heading = f64::from(index) * 0.2;
            let up = if index == 2 {
                [heading.sin(), -heading.cos(), 0.0]
            } else {
                [0.0, 0.0, 1.0]
            };
            camera([0.0, 0.0, 2.0], [heading.cos(), heading.sin(), -0.3], up)
        };
        is_up(&(-5..=5).map(mast).collect::<Vec<_>>(), &[], UpSource::CameraAxes);
    }

    /// Descents straight down and flights with one heading: the cameras' own up is 90 degrees off.
    #[test]
    fn cameras_that_look_down_take_the_normal_of_the_ground() {
        let down = [0.02, 0.01, -1.0];
        let descent: Vec<Pose> = (0..8)
            .map(|step| camera([0.1, 0.0, 12.0 - f64::from(step)], down, [0.0, 1.0, 0.0]))
            .collect();
        is_up(&descent, &ground(), UpSource::Ground);
        let flight: Vec<Pose> = (0..8)
            .map(|step| camera([0.0, f64::from(step) - 4.0, 6.0], down, [0.0, 1.0, 0.0]))
            .collect();
        is_up(&flight, &ground(), UpSource::Ground);
        let diagonal: Vec<Pose> = (0..8)
            .map(|step| f64::from(step) - 4.0)
            .map(|step| camera([step, step, 6.0], down, [0.0, 1.0, 0.0]))
            .collect();
        is_up(&diagonal, &ground(), UpSource::Ground);
        let turning = |step: i32| {
            let (sin, cos) = f64::from(step).sin_cos();
            camera(
                [f64::from(step) - 4.0, cos, 6.0],
                [0.05 * sin, 0.0, -1.0],
                [sin, cos, 0.0],
            )
        };
        is_up(
            &(0..8).map(turning).collect::<Vec<_>>(),
            &ground(),
            UpSource::Ground,
        );
    }

    #[test]
    fn one_heading_takes_the_ground_ahead() {
        let pair = [-0.2, 0.2].map(|x| camera([x, -7.0, 2.0], [0.0, 1.0, -0.35], [0.0, 0.0, 1.0]));
        is_up(&pair, &ground(), UpSource::Ground);
    }

    /// The points of the ground turned upright are a wall at y = 0 in front of cameras that move sideways.
    #[test]
    fn a_wall_is_not_the_ground() {
        let wall: Vec<Point> = ground()
            .into_iter()
            .map(|mut point| {
                let [x, y, z] = point.position;
                point.position = [x, -z, y];
                point
            })
            .collect();
        let along = |turn: f64| -> Vec<Pose> {
            let place = |step: i32| {
                let x = f64::from(step) - 3.0;
                camera([x, -6.0, 0.0], [-turn * x, 1.0, 0.1], [0.0, 0.0, 1.0])
            };
            (0..7).map(place).collect()
        };
        is_up(&along(0.15), &wall, UpSource::CameraAxes);
        assert_eq!(
            found(&along(0.0), &wall),
            None,
            "it may be the ground below a flight"
        );
        let towards = |step: i32| {
            let turn = 0.2 * (1.3 * f64::from(step)).sin();
            camera(
                [0.0, f64::from(step) - 12.0, 0.0],
                [turn, 1.0, 0.03],
                [0.0, 0.0, 1.0],
            )
        };
        is_up(
            &(0..8).map(towards).collect::<Vec<_>>(),
            &wall,
            UpSource::CameraAxes,
        );
    }

    /// Below a parachute, and as a survey of a field is flown.
    #[test]
    fn swings_and_turned_pictures_show_the_ground() {
        let swinging = |step: i32| {
            let (sin, cos) = (1.3 * f64::from(step)).sin_cos();
            let ahead = [0.15 * cos, 0.3 * sin, -1.0];
            camera([0.1, 0.0, 12.0 - f64::from(step)], ahead, [1.0, 0.0, 0.0])
        };
        is_up(
            &(0..8).map(swinging).collect::<Vec<_>>(),
            &ground(),
            UpSource::Ground,
        );
        let survey = |step: i32| {
            let (way, x) = (f64::from(1 - 2 * (step % 2)), f64::from(step / 2) - 2.0);
            camera([x, way, 6.0], [0.02, 0.01 * way, -1.0], [way, 0.0, 0.0])
        };
        is_up(
            &(0..8).map(survey).collect::<Vec<_>>(),
            &ground(),
            UpSource::Ground,
        );
    }

    /// Most points are on stones 3 to 8 m ahead, which are the higher the farther they are. Few are on the ground behind them.
    #[test]
    fn stones_do_not_tilt_the_ground_ahead() {
        let mut rng = Rng::new(3);
        let point = |index: usize| {
            let [x, y, z] = [(); 3].map(|()| rng.unit_f64());
            let near = 2.0 + 6.0 * y;
            let position = if index.is_multiple_of(11) {
                [20.0 * x - 10.0, 9.0 + 16.0 * y, 0.1 * z]
            } else {
                [
                    4.0 * x - 2.0,
                    near,
                    0.12 * (near - 3.0).max(0.0) * (0.6 + 0.4 * z),
                ]
            };
            Point {
                position,
                color: None,
                views: 3,
            }
        };
        let points: Vec<Point> = (0..1320).map(point).collect();
        let walk =
            [-2.0, -1.5, -1.0, -0.5].map(|y| camera([0.0, y, 1.5], [0.0, 1.0, -0.25], [0.0, 0.0, 1.0]));
        is_up(&walk, &points, UpSource::Ground);
    }

    #[test]
    fn what_nothing_shows_is_not_known() {
        assert_eq!(find_up(&[], &ground()), None);
        let one = camera([0.0, 0.0, 2.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]);
        assert_eq!(found(&[one, one], &[]), None);
        // One place, one heading, straight at a plane: a wall or the ground.
        let still = camera([0.0, 0.0, 6.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]);
        assert_eq!(found(&[still, still], &ground()), None);
        let mut broken = one;
        broken.translation.x = f64::NAN;
        assert_eq!(found(&[broken], &ground()), None);
        let mut nowhere = ground();
        nowhere
            .iter_mut()
            .for_each(|point| point.position[0] = f64::INFINITY);
        assert!(Plane::fit(&[], &nowhere).is_none());
    }
}
