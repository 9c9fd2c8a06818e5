//! What moves and who sees what: lists built once, in time linear in the observations.

use super::sight::Term;
use super::{CameraFreedom, LensModel, PoseFreedom, Prior, Problem};

/// Stands for "none" in a list of indices.
pub(super) const NONE: u32 = u32::MAX;

/// The six numbers of a pose that may move: turn, centre.
pub(super) const POSE_TERMS: usize = 6;

/// Numbers 0.. sorted into groups, rising within each.
#[derive(Debug, Default)]
pub(super) struct Groups {
    start: Vec<u32>,
    items: Vec<u32>,
}

impl Groups {
    /// Sorts positions by the group that `groups` gives for each; `NONE` goes nowhere.
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

    pub(super) fn of(&self, group: usize) -> &[u32] {
        &self.items[self.start[group] as usize..self.start[group + 1] as usize]
    }
}

/// An observation by a pose that may move.
#[derive(Debug, Clone, Copy)]
pub(super) struct Link {
    pub observation: u32,
    pub point: u32,
    /// Which of the poses that may move.
    pub slot: u32,
}

/// A point and a camera with terms that may move which sees it through one or more photos.
#[derive(Debug, Clone, Copy)]
pub(super) struct Couple {
    pub point: u32,
    pub camera: u32,
}

/// A pose whose observations pull on it or on its camera.
#[derive(Debug, Clone, Copy)]
pub(super) struct Active {
    pub pose: u32,
    /// Which of the poses that may move, or `NONE`.
    pub slot: u32,
}

/// Who sees what, and where each number stands in the reduced system: all cameras' terms, then all poses'.
#[derive(Debug, Default)]
pub(super) struct Index {
    /// Terms that may move, of each camera.
    pub terms: Vec<Vec<Term>>,
    /// First unknown of each camera.
    pub camera_at: Vec<usize>,
    /// Unknowns of all cameras.
    pub camera_unknowns: usize,
    /// Place of each pose among those that may move, or `NONE`.
    pub slot_of_pose: Vec<u32>,
    pub slots: usize,
    /// Coordinate of the centre that is held, of each pose that may move.
    pub held_axis: Vec<Option<u8>>,
    pub active: Vec<Active>,
    pub active_of_slot: Vec<u32>,
    pub observations_of_active: Groups,
    /// Observations of point i: `observation_start[i]..observation_start[i + 1]`.
    pub observation_start: Vec<u32>,
    pub links: Vec<Link>,
    pub link_start: Vec<u32>,
    pub links_of_slot: Groups,
    pub couples: Vec<Couple>,
    pub couple_start: Vec<u32>,
}

impl Index {
    pub(super) fn new(problem: &Problem) -> Self {
        let mut index = Self::default();
        index.add_cameras(problem);
        index.add_poses(problem);
        index.add_links(problem);
        index.add_couples(problem);
        index
    }

    /// Number of unknowns of the reduced system.
    pub(super) fn unknowns(&self) -> usize {
        self.camera_unknowns + POSE_TERMS * self.slots
    }

    /// First unknown of a pose that may move.
    pub(super) fn pose_at(&self, slot: usize) -> usize {
        self.camera_unknowns + POSE_TERMS * slot
    }

    /// Copies the terms that may move of each camera to their places.
    pub(super) fn place<const N: usize>(&self, of_cameras: &[[f64; N]], lenses: &mut [f64]) {
        for ((values, terms), &at) in of_cameras.iter().zip(&self.terms).zip(&self.camera_at) {
            lenses[at..at + terms.len()].copy_from_slice(&values[..terms.len()]);
        }
    }

    /// Numbers that may move, held axes and points without observation left out.
    pub(super) fn parameters(&self) -> usize {
        let held = self.held_axis.iter().flatten().count();
        let points = self
            .observation_start
            .windows(2)
            .filter(|pair| pair[0] < pair[1])
            .count();
        self.unknowns() - held + 3 * points
    }

    pub(super) fn observations_of(&self, point: usize) -> std::ops::Range<usize> {
        range(&self.observation_start, point)
    }

    pub(super) fn links_of(&self, point: usize) -> std::ops::Range<usize> {
        range(&self.link_start, point)
    }

    pub(super) fn couples_of(&self, point: usize) -> std::ops::Range<usize> {
        range(&self.couple_start, point)
    }

    /// A camera that no observation and no prior touches has no terms.
    fn add_cameras(&mut self, problem: &Problem) {
        let mut used = vec![false; problem.cameras.len()];
        for seen in &problem.observations {
            used[problem.camera_of_pose[seen.pose as usize] as usize] = true;
        }
        for prior in &problem.priors {
            if let Prior::Focal { camera, .. } = prior {
                used[*camera as usize] = true;
            }
        }
        for (freedom, used) in problem.camera_freedom.iter().zip(used) {
            let terms = if used { terms(freedom) } else { Vec::new() };
            self.camera_at.push(self.camera_unknowns);
            self.camera_unknowns += terms.len();
            self.terms.push(terms);
        }
    }

    /// A pose that no observation and no prior touches stays.
    fn add_poses(&mut self, problem: &Problem) {
        let mut seen = vec![false; problem.poses.len()];
        for observation in &problem.observations {
            seen[observation.pose as usize] = true;
        }
        let mut touched = seen.clone();
        for prior in &problem.priors {
            for pose in poses_of(prior).into_iter().flatten() {
                touched[pose as usize] = true;
            }
        }
        let mut active_of_pose = vec![NONE; problem.poses.len()];
        for (pose, freedom) in problem.pose_freedom.iter().enumerate() {
            let free = touched[pose] && *freedom != PoseFreedom::Fixed;
            let lens_free = !self.terms[problem.camera_of_pose[pose] as usize].is_empty();
            let slot = if free { self.slots as u32 } else { NONE };
            self.slot_of_pose.push(slot);
            if free || (seen[pose] && lens_free) {
                active_of_pose[pose] = self.active.len() as u32;
                self.active.push(Active {
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
            .map(|seen| active_of_pose[seen.pose as usize]);
        self.observations_of_active = Groups::new(self.active.len(), groups);
    }

    fn add_links(&mut self, problem: &Problem) {
        self.observation_start = starts(
            problem.points.len(),
            problem.observations.iter().map(|seen| seen.point),
        );
        for (observation, seen) in problem.observations.iter().enumerate() {
            let slot = self.slot_of_pose[seen.pose as usize];
            if slot != NONE {
                self.links.push(Link {
                    observation: observation as u32,
                    point: seen.point,
                    slot,
                });
            }
        }
        self.link_start = starts(problem.points.len(), self.links.iter().map(|link| link.point));
        self.links_of_slot = Groups::new(self.slots, self.links.iter().map(|link| link.slot));
    }

    fn add_couples(&mut self, problem: &Problem) {
        let mut cameras = Vec::new();
        for point in 0..problem.points.len() {
            let seen = problem.observations[self.observations_of(point)].iter();
            cameras.clear();
            cameras.extend(seen.map(|seen| problem.camera_of_pose[seen.pose as usize]));
            cameras.retain(|&camera| !self.terms[camera as usize].is_empty());
            cameras.sort_unstable();
            cameras.dedup();
            let point = point as u32;
            let couples = cameras.iter().map(|&camera| Couple { point, camera });
            self.couples.extend(couples);
        }
        let points = self.couples.iter().map(|couple| couple.point);
        self.couple_start = starts(problem.points.len(), points);
    }
}

/// Returns the poses a prior speaks of.
pub(super) fn poses_of(prior: &Prior) -> [Option<u32>; 2] {
    match *prior {
        Prior::Centre { pose, .. } | Prior::Attitude { pose, .. } => [Some(pose), None],
        Prior::Relative { pose_1, pose_2, .. } => [Some(pose_1), Some(pose_2)],
        Prior::Focal { .. } => [None, None],
    }
}

fn terms(freedom: &CameraFreedom) -> Vec<Term> {
    use Term::{Cx, Cy, Focal, K1, K2, P1, P2};
    let lens: &[Term] = match freedom.lens {
        LensModel::Pinhole => &[],
        LensModel::SimpleRadial => &[K1],
        LensModel::Radial => &[K1, K2],
        LensModel::OpenCv => &[K1, K2, P1, P2],
    };
    let focal: &[Term] = if freedom.focal { &[Focal] } else { &[] };
    let principal: &[Term] = if freedom.principal_point { &[Cx, Cy] } else { &[] };
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

fn range(start: &[u32], group: usize) -> std::ops::Range<usize> {
    start[group] as usize..start[group + 1] as usize
}
