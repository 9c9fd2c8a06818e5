//! Free parameters and which pose observes which point: lists built once, in time linear in the observations.

use super::problem::{CameraFreedom, LensModel, PoseFreedom, Prior, Problem};
use super::residual::CameraParam;

/// Marks an absent entry in a list of indices.
pub(super) const NONE: u32 = u32::MAX;

/// Parameters of a free pose: rotation, centre.
pub(super) const POSE_PARAMS: usize = 6;

/// The numbers 0.. in groups, rising within each group.
#[derive(Debug, Default)]
pub(super) struct Groups {
    start: Vec<u32>,
    items: Vec<u32>,
}

impl Groups {
    /// Groups positions by the group that `groups` gives for each. `NONE` is left out.
    fn new(count: usize, groups: impl Iterator<Item = u32> + Clone) -> Self {
        let mut start = vec![0; count + 1];
        let members = || groups.clone().enumerate().filter(|&(_, group)| group != NONE);
        members().for_each(|(_, group)| start[group as usize + 1] += 1);
        for group in 0..count {
            start[group + 1] += start[group];
        }
        let mut next = start.clone();
        let mut items = vec![0; start[count] as usize];
        for (position, group) in members() {
            items[next[group as usize] as usize] = position as u32;
            next[group as usize] += 1;
        }
        Self { start, items }
    }

    /// Returns the members of a group.
    pub(super) fn members(&self, group: usize) -> &[u32] {
        &self.items[self.start[group] as usize..self.start[group + 1] as usize]
    }
}

/// An observation by a free pose.
#[derive(Debug, Clone, Copy)]
pub(super) struct FreeObservation {
    pub observation: u32,
    pub point: u32,
    /// Index among the free poses.
    pub slot: u32,
}

/// A point and a camera with free parameters that observes it in one or more photos.
#[derive(Debug, Clone, Copy)]
pub(super) struct PointCamera {
    pub point: u32,
    pub camera: u32,
}

/// A pose whose observations depend on free parameters, its own or its camera's.
#[derive(Debug, Clone, Copy)]
pub(super) struct ActivePose {
    pub pose: u32,
    /// Index among the free poses, or `NONE`.
    pub slot: u32,
}

/// Which pose observes which point, and the position of each parameter in the reduced system: those of all cameras, then
/// those of all poses.
#[derive(Debug, Default)]
pub(super) struct Index {
    /// Free parameters of each camera.
    pub terms: Vec<Vec<CameraParam>>,
    /// First unknown of each camera.
    pub camera_at: Vec<usize>,
    /// Unknowns of all cameras.
    pub camera_unknowns: usize,
    /// Index of each pose among the free ones, or `NONE`.
    pub slot_of_pose: Vec<u32>,
    /// Number of free poses.
    pub slots: usize,
    /// Coordinate of the centre that is fixed, for each free pose.
    pub held_axis: Vec<Option<u8>>,
    pub active: Vec<ActivePose>,
    pub active_of_slot: Vec<u32>,
    pub observations_of_active: Groups,
    /// Observations of point i: `observation_start[i]..observation_start[i + 1]`.
    pub observation_start: Vec<u32>,
    pub free_observations: Vec<FreeObservation>,
    pub free_start: Vec<u32>,
    pub free_of_slot: Groups,
    pub point_cameras: Vec<PointCamera>,
    pub point_camera_start: Vec<u32>,
}

impl Index {
    pub(super) fn new(problem: &Problem) -> Self {
        let mut index = Self::default();
        index.add_cameras(problem);
        index.add_poses(problem);
        index.add_free_observations(problem);
        index.add_point_cameras(problem);
        index
    }

    /// Returns the number of unknowns of the reduced system.
    pub(super) fn unknowns(&self) -> usize {
        self.camera_unknowns + POSE_PARAMS * self.slots
    }

    /// Returns the first unknown of a free pose.
    pub(super) fn pose_at(&self, slot: usize) -> usize {
        self.camera_unknowns + POSE_PARAMS * slot
    }

    /// Copies the free parameters of each camera to their positions.
    pub(super) fn place<const N: usize>(&self, of_cameras: &[[f64; N]], lenses: &mut [f64]) {
        for ((values, terms), &at) in of_cameras.iter().zip(&self.terms).zip(&self.camera_at) {
            lenses[at..at + terms.len()].copy_from_slice(&values[..terms.len()]);
        }
    }

    /// Returns the number of free parameters, without fixed coordinates and points without observations.
    pub(super) fn parameters(&self) -> usize {
        let held = self.held_axis.iter().flatten().count();
        let points = self
            .observation_start
            .windows(2)
            .filter(|pair| pair[0] < pair[1])
            .count();
        self.unknowns() - held + 3 * points
    }

    /// Returns the observations of a point.
    pub(super) fn observations_of(&self, point: usize) -> std::ops::Range<usize> {
        range(&self.observation_start, point)
    }

    /// Returns the observations of a point by free poses.
    pub(super) fn free_of(&self, point: usize) -> std::ops::Range<usize> {
        range(&self.free_start, point)
    }

    /// Returns the cameras with free parameters that observe a point.
    pub(super) fn point_cameras_of(&self, point: usize) -> std::ops::Range<usize> {
        range(&self.point_camera_start, point)
    }

    /// Lists the free parameters of the cameras. A camera without observation and prior has none.
    fn add_cameras(&mut self, problem: &Problem) {
        let mut used = vec![false; problem.cameras.len()];
        for observation in &problem.observations {
            used[problem.camera_of_pose[observation.pose as usize] as usize] = true;
        }
        for prior in &problem.priors {
            if let Prior::Focal { camera, .. } = prior {
                used[*camera as usize] = true;
            }
        }
        for (freedom, used) in problem.camera_freedom.iter().zip(used) {
            let terms = if used { free_params(freedom) } else { Vec::new() };
            self.camera_at.push(self.camera_unknowns);
            self.camera_unknowns += terms.len();
            self.terms.push(terms);
        }
    }

    /// Lists the free poses. A pose without observation and prior is held.
    fn add_poses(&mut self, problem: &Problem) {
        let mut observed = vec![false; problem.poses.len()];
        for observation in &problem.observations {
            observed[observation.pose as usize] = true;
        }
        let mut affected = observed.clone();
        for prior in &problem.priors {
            for pose in poses_of(prior).into_iter().flatten() {
                affected[pose as usize] = true;
            }
        }
        let mut active_of_pose = vec![NONE; problem.poses.len()];
        for (pose, freedom) in problem.pose_freedom.iter().enumerate() {
            let free = affected[pose] && *freedom != PoseFreedom::Fixed;
            let camera_free = !self.terms[problem.camera_of_pose[pose] as usize].is_empty();
            let slot = if free { self.slots as u32 } else { NONE };
            self.slot_of_pose.push(slot);
            if free || (observed[pose] && camera_free) {
                active_of_pose[pose] = self.active.len() as u32;
                self.active.push(ActivePose {
                    pose: pose as u32,
                    slot,
                });
            }
            if free {
                self.slots += 1;
                self.active_of_slot.push(active_of_pose[pose]);
                self.held_axis.push(match freedom {
                    PoseFreedom::CentreAxisFixed(axis) => Some((*axis).min(2)),
                    _ => None,
                });
            }
        }
        let groups = problem
            .observations
            .iter()
            .map(|observation| active_of_pose[observation.pose as usize]);
        self.observations_of_active = Groups::new(self.active.len(), groups);
    }

    /// Lists the observations by free poses, by point and by pose.
    fn add_free_observations(&mut self, problem: &Problem) {
        self.observation_start = starts(
            problem.points.len(),
            problem.observations.iter().map(|observation| observation.point),
        );
        for (number, observation) in problem.observations.iter().enumerate() {
            let slot = self.slot_of_pose[observation.pose as usize];
            if slot != NONE {
                self.free_observations.push(FreeObservation {
                    observation: number as u32,
                    point: observation.point,
                    slot,
                });
            }
        }
        self.free_start = starts(
            problem.points.len(),
            self.free_observations.iter().map(|free| free.point),
        );
        self.free_of_slot = Groups::new(self.slots, self.free_observations.iter().map(|free| free.slot));
    }

    /// Lists the cameras with free parameters of each point.
    fn add_point_cameras(&mut self, problem: &Problem) {
        let mut cameras = Vec::new();
        for point in 0..problem.points.len() {
            let observations = problem.observations[self.observations_of(point)].iter();
            cameras.clear();
            cameras.extend(observations.map(|observation| problem.camera_of_pose[observation.pose as usize]));
            cameras.retain(|&camera| !self.terms[camera as usize].is_empty());
            cameras.sort_unstable();
            cameras.dedup();
            let point = point as u32;
            let point_cameras = cameras.iter().map(|&camera| PointCamera { point, camera });
            self.point_cameras.extend(point_cameras);
        }
        let points = self.point_cameras.iter().map(|point_camera| point_camera.point);
        self.point_camera_start = starts(problem.points.len(), points);
    }
}

/// Returns the poses that a prior depends on.
pub(super) fn poses_of(prior: &Prior) -> [Option<u32>; 2] {
    match *prior {
        Prior::Centre { pose, .. } | Prior::Attitude { pose, .. } => [Some(pose), None],
        Prior::Relative { pose_1, pose_2, .. } => [Some(pose_1), Some(pose_2)],
        Prior::Focal { .. } => [None, None],
    }
}

/// Returns the free parameters of a camera.
fn free_params(freedom: &CameraFreedom) -> Vec<CameraParam> {
    use CameraParam::{Cx, Cy, Focal, K1, K2, P1, P2};
    let lens: &[CameraParam] = match freedom.lens {
        LensModel::Pinhole => &[],
        LensModel::SimpleRadial => &[K1],
        LensModel::Radial => &[K1, K2],
        LensModel::OpenCv => &[K1, K2, P1, P2],
    };
    let focal: &[CameraParam] = if freedom.focal { &[Focal] } else { &[] };
    let principal: &[CameraParam] = if freedom.principal_point { &[Cx, Cy] } else { &[] };
    [focal, lens, principal].concat()
}

/// Returns where each group starts in a list sorted by group, and the end.
fn starts(count: usize, groups: impl Iterator<Item = u32>) -> Vec<u32> {
    let mut start = vec![0; count + 1];
    groups.for_each(|group| start[group as usize + 1] += 1);
    for group in 0..count {
        start[group + 1] += start[group];
    }
    start
}

/// Returns the range of a group.
fn range(start: &[u32], group: usize) -> std::ops::Range<usize> {
    start[group] as usize..start[group + 1] as usize
}
