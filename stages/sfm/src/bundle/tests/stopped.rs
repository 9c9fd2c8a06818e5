//! An adjustment that is stopped anywhere goes on to the same bits.

use super::*;
use crate::Supervisor;
use crate::supervisor::testing::Stopping;

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

fn same(found: &Problem, expected: &Problem) -> bool {
    (&found.cameras, &found.poses, &found.points) == (&expected.cameras, &expected.poses, &expected.points)
}

/// Stops again and again, each time after as many questions, and returns how often.
fn in_pieces(supervisor: &Stopping, questions: u64, options: &BundleOptions) -> (Problem, BundleReport, u32) {
    for stops in 0..1000 {
        let mut problem = start();
        supervisor.after(questions);
        let report = adjust(&mut problem, options, supervisor).unwrap();
        if !supervisor.stop() {
            return (problem, report, stops);
        }
    }
    panic!("no progress in pieces of {questions} questions");
}

#[test]
fn the_bits_are_the_same_wherever_it_was_stopped_and_no_step_is_repeated_but_the_last() {
    for solver in [Solver::Dense, Solver::ConjugateGradients] {
        let options = options(solver);
        let mut whole = start();
        let expected = run(&mut whole, &options);
        for questions in [0, 1, 4, 5, 6, 7, 11, 19, 37, 60] {
            let supervisor = Stopping::default();
            let mut stopped = start();
            adjust(&mut stopped, &options, supervisor.after(questions)).unwrap();
            let mut resumed = start();
            let report = adjust(&mut resumed, &options, supervisor.after(u64::MAX)).unwrap();
            assert_eq!(report, expected, "{solver:?} {questions}");
            assert!(same(&resumed, &whole), "{solver:?} {questions}");
        }
    }
    // Dense, a step asks four times.
    let (found, report, stops) = in_pieces(&Stopping::default(), 13, &options(Solver::Dense));
    let mut whole = start();
    assert_eq!(report, run(&mut whole, &options(Solver::Dense)));
    assert!(same(&found, &whole));
    assert!(
        stops > 1 && stops <= report.iterations / 2 + 1,
        "{stops} {report:?}"
    );
}

#[test]
fn a_finished_adjustment_is_not_repeated() {
    let options = options(Solver::Dense);
    let supervisor = Stopping::default();
    let mut first = start();
    let expected = adjust(&mut first, &options, supervisor.after(u64::MAX)).unwrap();
    let mut again = start();
    // Not a single step could be taken.
    assert_eq!(
        adjust(&mut again, &options, supervisor.after(1)).unwrap(),
        expected
    );
    assert!(same(&again, &first));
}

#[test]
fn a_problem_that_differs_anywhere_has_a_checkpoint_of_its_own() {
    type Change = fn(&mut Problem, &mut BundleOptions);
    let changes: [Change; 8] = [
        |_, _| (),
        |problem, _| problem.observations[3].pixel.x += 1e-9,
        |problem, _| problem.points[7].z += 1e-9,
        |problem, _| problem.poses[2].translation.y += 1e-9,
        |problem, _| problem.cameras[0].k1 += 1e-9,
        |problem, _| problem.pose_freedom[5] = PoseFreedom::Fixed,
        |_, options| options.max_iterations = 7,
        |_, options| options.loss = Loss::Huber(1.0),
    ];
    let supervisor = Stopping::default();
    for (index, change) in changes.iter().enumerate() {
        let (mut problem, mut options) = (start(), options(Solver::Dense));
        change(&mut problem, &mut options);
        adjust(&mut problem, &options, supervisor.after(u64::MAX)).unwrap();
        assert_eq!(supervisor.parts().len(), index + 1);
    }
}

#[test]
fn a_damaged_checkpoint_costs_only_time() {
    let options = options(Solver::Dense);
    let mut whole = start();
    let expected = run(&mut whole, &options);
    for questions in [20, u64::MAX] {
        let damages: [fn(&mut Vec<u8>); 4] = [
            |bytes| bytes.clear(),
            |bytes| bytes.truncate(bytes.len() - 1),
            |bytes| bytes[7] ^= 1,
            |bytes| bytes.push(0),
        ];
        for damage in damages {
            let supervisor = Stopping::default();
            adjust(&mut start(), &options, supervisor.after(questions)).unwrap();
            assert_eq!(supervisor.parts().len(), 1);
            supervisor.damage(damage);
            let mut found = start();
            let report = adjust(&mut found, &options, supervisor.after(u64::MAX)).unwrap();
            assert!(report == expected && same(&found, &whole), "{questions}");
        }
    }
}
