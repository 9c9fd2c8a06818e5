//! An adjustment that was stopped is gone on with; one that was finished is not repeated.

use super::adjust::StepControl;
use super::options::{BundleOptions, BundleReport, Solver};
use super::problem::{CameraFreedom, LensModel, PoseFreedom, Prior, Problem};
use super::residual::CentredPose;
use super::state::State;
use crate::Supervisor;
use crate::bytes::{Fingerprint, Reader, Writer};
use crate::supervisor::{SAVE_FINISHED, SAVE_UNFINISHED};

/// Forms of both states; a new number where one is written or used otherwise.
const FINISHED: &[u8; 8] = b"adjend01";
const UNFINISHED: &[u8; 8] = b"adjrun01";

/// The checkpoint of one adjustment, by the fingerprint of its problem.
pub(super) struct Checkpoint<'a> {
    pub supervisor: &'a dyn Supervisor,
    part: String,
    of: u64,
    /// What an earlier run has saved.
    saved: Option<Vec<u8>>,
}

impl<'a> Checkpoint<'a> {
    pub fn new(supervisor: &'a dyn Supervisor, problem: &Problem, options: &BundleOptions) -> Self {
        let of = fingerprint(problem, options);
        let part = format!("adjustment-{of:016x}");
        Self {
            saved: supervisor.load(&part),
            supervisor,
            part,
            of,
        }
    }

    /// Sets the problem to its result if an earlier run has found it, and returns the report.
    pub fn finished(&self, problem: &mut Problem) -> Option<BundleReport> {
        let mut reader = Reader::new(self.saved.as_ref()?, FINISHED, self.of)?;
        let cameras = reader.list(problem.cameras.len(), Reader::camera)?;
        let poses = reader.list(problem.poses.len(), Reader::pose)?;
        let points = reader.list(problem.points.len(), Reader::point)?;
        let report = BundleReport {
            iterations: u32::try_from(reader.count()?).ok()?,
            initial_cost: reader.number()?,
            final_cost: reader.number()?,
            residuals: reader.index()?,
            parameters: reader.index()?,
            hidden: reader.index()?,
            converged: reader.count()? == 1,
        };
        reader.end()?;
        (problem.cameras, problem.poses, problem.points) = (cameras, poses, points);
        Some(report)
    }

    /// Saves the result, unless it took so little time that it is found again as fast.
    pub fn save_finished(&self, problem: &Problem, report: &BundleReport) {
        if self.supervisor.unsaved_for() < SAVE_FINISHED {
            return;
        }
        let mut writer = Writer::new(FINISHED, self.of);
        writer.list(&problem.cameras, Writer::camera);
        writer.list(&problem.poses, Writer::pose);
        writer.list(&problem.points, Writer::point);
        writer.count(u64::from(report.iterations));
        writer.number(report.initial_cost);
        writer.number(report.final_cost);
        for count in [report.residuals, report.parameters, report.hidden] {
            writer.count(count as u64);
        }
        writer.count(u64::from(report.converged));
        self.supervisor.save(&self.part, &writer.finish());
    }

    /// Goes on from the step before which an earlier run was saved.
    pub fn resume(&self, state: &mut State, control: &mut StepControl, report: &mut BundleReport) {
        let read = self.saved.as_ref().and_then(|saved| {
            let mut reader = Reader::new(saved, UNFINISHED, self.of)?;
            let read = (
                State {
                    cameras: reader.list(state.cameras.len(), Reader::camera)?,
                    views: reader.list(state.views.len(), |reader| {
                        Some(CentredPose {
                            rotation: reader.matrix()?,
                            centre: reader.point()?,
                        })
                    })?,
                    points: reader.list(state.points.len(), Reader::point)?,
                },
                StepControl {
                    damping: reader.number()?,
                    rise: reader.number()?,
                    forcing: reader.number()?,
                    ..*control
                },
                BundleReport {
                    iterations: u32::try_from(reader.count()?).ok()?,
                    final_cost: reader.number()?,
                    converged: false,
                    ..*report
                },
            );
            reader.end()?;
            Some(read)
        });
        if let Some(read) = read {
            (*state, *control, *report) = read;
        }
    }

    /// Saves the state before a step, now and then.
    pub fn save_unfinished(&self, state: &State, control: &StepControl, report: &BundleReport) {
        if report.iterations == 0 || self.supervisor.unsaved_for() < SAVE_UNFINISHED {
            return;
        }
        let mut writer = Writer::new(UNFINISHED, self.of);
        writer.list(&state.cameras, Writer::camera);
        writer.list(&state.views, |writer, view| {
            writer.matrix(&view.rotation);
            writer.point(&view.centre);
        });
        writer.list(&state.points, Writer::point);
        for number in [control.damping, control.rise, control.forcing] {
            writer.number(number);
        }
        writer.count(u64::from(report.iterations));
        writer.number(report.final_cost);
        self.supervisor.save(&self.part, &writer.finish());
    }
}

/// Returns a fingerprint of all that the result depends on.
fn fingerprint(problem: &Problem, options: &BundleOptions) -> u64 {
    problem_fingerprint(problem, |writer| {
        for loss in [options.loss, options.prior_loss] {
            let (kind, width) = loss.kind_and_width();
            writer.count(kind);
            writer.number(width);
        }
        writer.count(u64::from(options.max_iterations));
        writer.number(options.tolerance);
        writer.count(match options.solver {
            Solver::Auto => 0,
            Solver::Dense => 1,
            Solver::ConjugateGradients => 2,
        });
    })
}

/// Returns a fingerprint of a problem and of what is asked of it.
pub(super) fn problem_fingerprint(problem: &Problem, asked: impl FnOnce(&mut Writer)) -> u64 {
    let mut found = Fingerprint::new();
    let mut writer = Writer::new(FINISHED, 0);
    writer.list(&problem.cameras, Writer::camera);
    writer.list(&problem.camera_freedom, camera_freedom);
    writer.list(&problem.poses, Writer::pose);
    writer.list(&problem.pose_freedom, pose_freedom);
    writer.list(&problem.camera_of_pose, |writer, camera| {
        writer.count(u64::from(*camera));
    });
    writer.list(&problem.points, Writer::point);
    writer.list(&problem.priors, prior);
    asked(&mut writer);
    found.add_state(writer);
    for observation in &problem.observations {
        found.add(u64::from(observation.point) << 32 | u64::from(observation.pose));
        found.add(observation.pixel.x.to_bits());
        found.add(observation.pixel.y.to_bits());
    }
    found.value()
}

fn camera_freedom(writer: &mut Writer, freedom: &CameraFreedom) {
    let lens = match freedom.lens {
        LensModel::Pinhole => 0,
        LensModel::SimpleRadial => 1,
        LensModel::Radial => 2,
        LensModel::OpenCv => 3,
    };
    writer.count(lens << 2 | u64::from(freedom.focal) << 1 | u64::from(freedom.principal_point));
}

fn pose_freedom(writer: &mut Writer, freedom: &PoseFreedom) {
    writer.count(match freedom {
        PoseFreedom::Free => 0,
        PoseFreedom::Fixed => 1,
        PoseFreedom::CentreAxisFixed(axis) => 2 + u64::from(*axis),
    });
}

fn prior(writer: &mut Writer, prior: &Prior) {
    match prior {
        Prior::Centre { pose, centre, sigma } => {
            writer.count(u64::from(*pose) << 2);
            writer.point(centre);
            writer.number(*sigma);
        }
        Prior::Attitude {
            pose,
            cam_from_world,
            sigma_rad,
        } => {
            writer.count(u64::from(*pose) << 2 | 1);
            writer.pose(cam_from_world);
            writer.number(*sigma_rad);
        }
        Prior::Relative {
            pose_1,
            pose_2,
            cam2_from_cam1,
            sigma_rad,
            sigma,
        } => {
            writer.count(u64::from(*pose_1) << 2 | 2);
            writer.count(u64::from(*pose_2));
            writer.pose(cam2_from_cam1);
            writer.number(*sigma_rad);
            writer.number(*sigma);
        }
        Prior::Focal {
            camera,
            focal_px,
            sigma_share,
        } => {
            writer.count(u64::from(*camera) << 2 | 3);
            writer.number(*focal_px);
            writer.number(*sigma_share);
        }
    }
}
