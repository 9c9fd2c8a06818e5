//! How a step is cut into submits: a driver takes one that lasts for seconds for a device that hangs, and resets it.

use std::time::Instant;

use super::Gpu;
use super::record::{Recorder, Work};

/// Seconds that a submit is predicted to take at most. Windows resets a device after 2 s, some phones and
/// integrated devices after less. A picture on the screen that the device drives waits for as long.
pub const MOST_S: f64 = 0.2;
/// Dispatches are not equally dear: a part of a step is counted on to take up to twice its share.
const UNEVEN: f64 = 2.0;

/// Time of a step, or of a round of a picture. It decides only how they are cut.
#[derive(Debug, Default)]
pub struct Submits {
    /// Seconds, as last measured. `None` before the first.
    step_s: Option<f64>,
    /// When the steps that were last measured were seen to be done: those behind them did not run before.
    done: Option<Instant>,
}

impl Submits {
    /// Notes that the `steps` steps submitted since `submitted` are done.
    pub fn took(&mut self, steps: u64, submitted: Instant) {
        let now = Instant::now();
        let begun = self.done.map_or(submitted, |done| done.max(submitted));
        if steps > 0 {
            self.note((now - begun).as_secs_f64() / steps as f64);
        }
        self.done = Some(now);
    }

    /// Notes what a step takes.
    pub fn note(&mut self, step_s: f64) {
        self.step_s = Some(step_s);
    }

    /// Returns how many of the dispatches of a step go into one submit, at least one: as many as are
    /// predicted to take [`MOST_S`]. One before a step was measured, or if the time is NaN.
    pub fn most(&self, dispatches: usize) -> usize {
        let parts = self
            .step_s
            .map_or(f64::INFINITY, |step_s| step_s * UNEVEN / MOST_S);
        if parts <= 1.0 {
            return dispatches.max(1);
        }
        // NaN becomes 0.
        ((dispatches as f64 / parts.ceil()) as usize).max(1)
    }

    /// Submits a step, cut according to its time. The bits are the same however it is cut.
    pub fn submit(&self, gpu: &Gpu, record: impl FnOnce(&mut Recorder<'_>)) {
        if self.most(usize::MAX) == usize::MAX {
            return gpu.submit(record);
        }
        let work = Work::recorded(record);
        for part in work.parts(self.most(work.len())) {
            gpu.submit(|recorder| part.record(recorder));
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::gpu::session::GpuSession;
    use crate::gpu::testing::gpu;
    use marf_field::backend::Session;
    use marf_field::test_scene::{ball, small};
    use marf_field::training::Training;

    fn measured(step_s: f64) -> Submits {
        Submits {
            step_s: Some(step_s),
            done: None,
        }
    }

    /// Of 60 dispatches in 1 s ten submits of 6 take a tenth each, and up to twice that.
    #[test]
    fn no_submit_is_predicted_to_take_more_than_a_fifth_of_a_second() {
        assert_eq!(Submits::default().most(60), 1);
        for (step_s, most) in [
            (0.0, 60),
            (1e-9, 60),
            (0.1, 60),
            (0.101, 30),
            (1.0, 6),
            (6.0, 1),
            (1e9, 1),
            (f64::INFINITY, 1),
            (f64::NAN, 1),
        ] {
            assert_eq!(measured(step_s).most(60), most, "{step_s} s");
            let predicted_s = UNEVEN * step_s * most as f64 / 60.0;
            assert!(
                most == 1 || predicted_s <= MOST_S * 1.0001,
                "{step_s}: {predicted_s}"
            );
        }
        assert_eq!([measured(1.0).most(0), measured(0.0).most(0)], [1, 1]);
    }

    #[test]
    fn a_step_has_the_same_bits_however_it_is_cut() {
        let Some(gpu) = gpu("a_step_has_the_same_bits_however_it_is_cut") else {
            return;
        };
        let trained = |gpu: &Arc<Gpu>, step_s: f64| {
            let mut training = Training::new(ball(4, 16), &[], &small(), 7).unwrap();
            let mut session = GpuSession::new(gpu, &mut training).unwrap();
            while training.state.steps < 20 {
                session.submits.note(step_s);
                let most = 20 - training.state.steps;
                session.advance(&mut training, most).unwrap();
            }
            session.settle(&mut training).unwrap();
            session.download(&mut training.state).unwrap();
            training.state
        };
        let whole = trained(&gpu, 0.0);
        for step_s in [0.7, 100.0] {
            assert!(trained(&gpu, step_s) == whole, "{step_s} s a step");
        }
    }
}
