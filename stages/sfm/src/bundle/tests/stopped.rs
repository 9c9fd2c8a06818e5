//! An adjustment that is stopped ends soon, with the best state so far.

use super::*;
use crate::tests::polls::Polls;

/// Perturbed poses and points, with a focal length far off: some dozen steps, rejected ones among them.
fn start() -> Problem {
    let mut problem = perturbed(&ring(&SMALL), 5.0_f64.to_radians(), 0.1);
    problem.cameras[0].fx_px *= 1.2;
    problem.cameras[0].fy_px *= 1.2;
    problem
}

fn options(solver: Solver) -> BundleOptions {
    BundleOptions {
        solver,
        loss: Loss::Cauchy(1.0),
        ..EXACT
    }
}

#[test]
fn a_stop_ends_within_a_step_and_keeps_what_was_gained() {
    for solver in [Solver::Dense, Solver::ConjugateGradients] {
        let options = options(solver);
        for after in [0, 1, 4, 5, 6, 7, 11, 19, 37] {
            let polls = Polls::new(after);
            let report = adjust(&mut start(), &options, &|| polls.stop()).unwrap();
            // A step polls at least twice, and is not begun after a stop.
            assert!(
                u64::from(report.iterations) <= after / 2 + 1,
                "{solver:?} {after}: {report:?}"
            );
            assert!(
                report.final_cost <= report.initial_cost,
                "{solver:?} {after}: {report:?}"
            );
            assert!(
                polls.count() <= after + 2,
                "{solver:?} {after}: {}",
                polls.count()
            );
        }
    }
}
