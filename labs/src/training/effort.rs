//! Time and work of a training.

use std::time::Instant;

use marf_field::Step;

use crate::process::cpu_s;

/// Time and work so far.
#[derive(Default)]
pub struct Effort {
    pub wall_s: f64,
    pub cpu_s: f64,
    pub rays: u64,
    pub samples: u64,
}

impl Effort {
    /// Does a work and adds its time.
    pub fn timed<T>(&mut self, work: impl FnOnce() -> T) -> T {
        let (wall, cpu_before_s) = (Instant::now(), cpu_s());
        let done = work();
        self.wall_s += wall.elapsed().as_secs_f64();
        self.cpu_s += cpu_s() - cpu_before_s;
        done
    }

    /// Adds the work of a step.
    pub fn add(&mut self, step: &Step) {
        self.rays += step.rays;
        self.samples += step.samples;
    }
}
