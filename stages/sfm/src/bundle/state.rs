//! The parameters, in normalised coordinates: the middle of the scene at zero, its size near one.

use marf_numeric::upper_median;
use marf_scene::{Camera, Pose};
use nalgebra::Vector3;

use super::index::{Index, NONE};
use super::problem::{Prior, Problem};
use super::residual::{CameraParam, CentredPose};
use super::so3;

/// The transform to normalised coordinates: (X - middle) / scale.
#[derive(Debug, Clone, Copy)]
pub(super) struct Normalization {
    middle: Vector3<f64>,
    pub scale: f64,
}

impl Normalization {
    /// Returns the normalisation of a problem, by medians, so that a few points near infinity have no influence.
    pub(super) fn new(problem: &Problem) -> Self {
        let observed = problem
            .observations
            .chunk_by(|a, b| a.point == b.point)
            .map(|group| problem.points[group[0].point as usize]);
        let places: Vec<Vector3<f64>> = observed.chain(problem.poses.iter().map(Pose::centre)).collect();
        let median =
            |value: &dyn Fn(&Vector3<f64>) -> f64| upper_median(places.iter().map(value)).unwrap_or(0.0);
        let middle = Vector3::from_fn(|axis, _| median(&|place| place[axis]));
        let size = median(&|place| (place - middle).norm());
        let usable = size.is_finite() && size > 0.0 && (1.0 / size).is_finite();
        Self {
            middle,
            scale: if usable { size } else { 1.0 },
        }
    }

    /// Returns a position in normalised coordinates.
    fn normalize(&self, place: &Vector3<f64>) -> Vector3<f64> {
        (place - self.middle) / self.scale
    }

    /// Returns a position in the coordinates of the problem.
    fn denormalize(&self, place: &Vector3<f64>) -> Vector3<f64> {
        place * self.scale + self.middle
    }

    /// Returns a pose in normalised coordinates.
    fn view(&self, pose: &Pose) -> CentredPose {
        let twice = so3::orthonormal(&so3::orthonormal(&pose.rotation));
        CentredPose {
            rotation: so3::orthonormal(&twice),
            centre: self.normalize(&pose.centre()),
        }
    }

    /// Returns a pose in the coordinates of the problem.
    fn pose(&self, view: &CentredPose) -> Pose {
        Pose {
            rotation: view.rotation,
            translation: -(view.rotation * self.denormalize(&view.centre)),
        }
    }

    /// Returns a prior in normalised coordinates.
    pub(super) fn prior(&self, prior: &Prior) -> Prior {
        let mut prior = *prior;
        match &mut prior {
            Prior::Centre { centre, sigma, .. } => {
                *centre = self.normalize(centre);
                *sigma /= self.scale;
            }
            Prior::Relative {
                cam2_from_cam1,
                sigma,
                ..
            } => {
                cam2_from_cam1.translation /= self.scale;
                *sigma /= self.scale;
            }
            Prior::Attitude { .. } | Prior::Focal { .. } => {}
        }
        prior
    }
}

/// The parameters.
#[derive(Debug, Clone)]
pub(super) struct State {
    pub cameras: Vec<Camera>,
    pub views: Vec<CentredPose>,
    pub points: Vec<Vector3<f64>>,
}

/// A change of the parameters.
#[derive(Debug, Default)]
pub(super) struct Step {
    /// Parameters of cameras, then rotations and centres of poses ([`Index`]).
    pub reduced: Vec<f64>,
    pub points: Vec<Vector3<f64>>,
}

impl Step {
    /// Whether all changes are finite.
    pub(super) fn is_finite(&self) -> bool {
        let finite = |point: &Vector3<f64>| (point.x + point.y + point.z).is_finite();
        self.reduced.iter().all(|value| value.is_finite()) && self.points.iter().all(finite)
    }
}

impl State {
    pub(super) fn new(problem: &Problem, normalization: &Normalization) -> Self {
        Self {
            cameras: problem.cameras.clone(),
            views: problem
                .poses
                .iter()
                .map(|pose| normalization.view(pose))
                .collect(),
            points: problem
                .points
                .iter()
                .map(|point| normalization.normalize(point))
                .collect(),
        }
    }

    /// Sets this state to `from` plus `step`. Camera parameters stop at their bounds.
    pub(super) fn set_stepped(
        &mut self,
        from: &Self,
        step: &Step,
        index: &Index,
        camera_bounds: &[CameraBounds],
    ) {
        for (camera, terms) in index.terms.iter().enumerate() {
            self.cameras[camera] = from.cameras[camera];
            let change = &step.reduced[index.camera_at[camera]..];
            for (term, change) in terms.iter().zip(change) {
                camera_bounds[camera].change(&mut self.cameras[camera], *term, *change);
            }
        }
        for (pose, &slot) in index.slot_of_pose.iter().enumerate() {
            if slot == NONE {
                continue;
            }
            let at = index.pose_at(slot as usize);
            let change = |offset| Vector3::from_fn(|row, _| step.reduced[at + offset + row]);
            self.views[pose] = CentredPose {
                rotation: so3::orthonormal(&(so3::exp(&change(0)) * from.views[pose].rotation)),
                centre: from.views[pose].centre + change(3),
            };
        }
        for ((to, from), change) in self.points.iter_mut().zip(&from.points).zip(&step.points) {
            *to = from + change;
        }
    }

    /// Writes changes since `start` to the problem. Parameters that did not move keep their bits.
    pub(super) fn write(&self, start: &Self, normalization: &Normalization, problem: &mut Problem) {
        problem.cameras.clone_from(&self.cameras);
        for (pose, (view, old)) in problem.poses.iter_mut().zip(self.views.iter().zip(&start.views)) {
            if view != old {
                *pose = normalization.pose(view);
            }
        }
        for (point, (new, old)) in problem
            .points
            .iter_mut()
            .zip(self.points.iter().zip(&start.points))
        {
            if new != old {
                *point = normalization.denormalize(new);
            }
        }
    }
}

/// Bounds of the parameters of one camera.
#[derive(Debug, Clone, Copy)]
pub(super) struct CameraBounds {
    focal: (f64, f64),
    /// Largest magnitude of k1, k2, p1, p2.
    lens: [f64; 4],
}

impl CameraBounds {
    /// Returns the bounds: focal length in [0.1, 10] times the longer side, |k|, |p| at most 1. A start outside may
    /// at most double (long telephoto lenses are 10 times the longer side).
    pub(super) fn new(camera: &Camera) -> Self {
        let longer = f64::from(camera.width.max(camera.height));
        let focal = (0.1 * longer, 10.0 * longer);
        let within = focal.0 < camera.fx_px && camera.fx_px < focal.1;
        Self {
            focal: if within {
                focal
            } else {
                (0.5 * camera.fx_px, 2.0 * camera.fx_px)
            },
            lens: [camera.k1, camera.k2, camera.p1, camera.p2]
                .map(|start| if start.abs() < 1.0 { 1.0 } else { 2.0 * start.abs() }),
        }
    }

    /// Adds to a parameter, within its bounds.
    fn change(&self, camera: &mut Camera, term: CameraParam, change: f64) {
        let within = |value: f64, limit: f64| (value + change).clamp(-limit, limit);
        match term {
            CameraParam::Focal => {
                let focal = (camera.fx_px * libm::exp(change)).clamp(self.focal.0, self.focal.1);
                camera.fy_px *= focal / camera.fx_px;
                camera.fx_px = focal;
            }
            CameraParam::K1 => camera.k1 = within(camera.k1, self.lens[0]),
            CameraParam::K2 => camera.k2 = within(camera.k2, self.lens[1]),
            CameraParam::P1 => camera.p1 = within(camera.p1, self.lens[2]),
            CameraParam::P2 => camera.p2 = within(camera.p2, self.lens[3]),
            CameraParam::Cx => camera.cx_px += change,
            CameraParam::Cy => camera.cy_px += change,
        }
    }

    /// Whether a parameter is on its bound, where it is held.
    pub(super) fn reached(&self, camera: &Camera, term: CameraParam) -> bool {
        match term {
            CameraParam::Focal => camera.fx_px <= self.focal.0 || camera.fx_px >= self.focal.1,
            CameraParam::K1 => camera.k1.abs() >= self.lens[0],
            CameraParam::K2 => camera.k2.abs() >= self.lens[1],
            CameraParam::P1 => camera.p1.abs() >= self.lens[2],
            CameraParam::P2 => camera.p2.abs() >= self.lens[3],
            CameraParam::Cx | CameraParam::Cy => false,
        }
    }
}
