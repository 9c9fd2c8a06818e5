//! How long a training is: its steps, a time or a quality, whichever comes first.

mod judging;
mod target;
mod time;
mod training_planner;

pub(crate) use judging::{JUDGED_SHARE, JudgingCost, slower};
pub(crate) use target::PsnrTarget;
pub(crate) use time::{JudgingReserve, TrainingTime};
pub(crate) use training_planner::{Planner, PlannerState};
