use super::super::synthetic::add_noise;
use super::*;

#[test]
fn a_hand_worked_case() {
    // One camera at the origin, f = 100, and one at (1, 0, 0), both held, looking along z. A point at (0, 0, 2) is
    // seen at (0, 0) and (-50, 0) from the centre of the photo. It starts at (0, 0, 1).
    let camera = marf_scene::Camera::pinhole(200, 200, 100.0);
    let right = Pose {
        translation: nalgebra::Vector3::new(-1.0, 0.0, 0.0),
        ..Pose::identity()
    };
    let seen = |pose, x, y| Observation {
        point: 0,
        pose,
        pixel: nalgebra::Vector2::new(x, y),
    };
    let mut problem = Problem {
        cameras: vec![camera],
        camera_freedom: vec![CameraFreedom {
            focal: false,
            lens: LensModel::Pinhole,
            principal_point: false,
        }],
        poses: vec![Pose::identity(), right],
        pose_freedom: vec![PoseFreedom::Fixed; 2],
        camera_of_pose: vec![0, 0],
        points: vec![nalgebra::Vector3::new(0.0, 0.0, 1.0)],
        observations: vec![seen(0, 100.0, 100.0), seen(1, 50.0, 100.0)],
        priors: Vec::new(),
    };
    // Before: residuals (0, 0) and (-100 + 50, 0), cost ½ 50² = 1250.
    let before = residual(&problem, &problem.observations[1]).unwrap();
    assert_eq!(before, nalgebra::Vector2::new(-50.0, 0.0));
    let report = run(&mut problem, &EXACT);
    assert_eq!(report.initial_cost, 1250.0);
    assert_eq!((report.residuals, report.parameters), (4, 3));
    assert!((problem.points[0] - nalgebra::Vector3::new(0.0, 0.0, 2.0)).norm() < 1e-12);
}

#[test]
fn exact_observations_give_back_the_truth_from_five_degrees_and_a_fifth_of_the_focal_length_off() {
    let exact = ring(&SMALL);
    let mut problem = perturbed(&exact, 5.0_f64.to_radians(), 0.1);
    problem.cameras[0].fx_px *= 1.2;
    problem.cameras[0].fy_px *= 1.2;
    problem.cameras[0].k1 = 0.0;
    problem.cameras[0].k2 = 0.0;
    let report = run(&mut problem, &EXACT);
    let (angle, centre) = distance(&problem.poses, &exact.poses);
    assert!(
        report.converged && angle < 1e-10 && centre < 1e-10,
        "{report:?} {angle} {centre}"
    );
    assert!(
        (problem.cameras[0].fx_px - 726.5).abs() < 1e-7,
        "{:?}",
        problem.cameras[0]
    );
    assert!(
        (problem.cameras[0].k1 - 0.094).abs() < 1e-10,
        "{:?}",
        problem.cameras[0]
    );
}

#[test]
fn the_residual_follows_the_noise_less_the_degrees_of_freedom() {
    let exact = ring(&RingSize { points: 600, ..SMALL });
    for sigma_px in [0.0, 0.1, 1.0, 5.0] {
        let mut problem = exact.clone();
        add_noise(&mut problem, sigma_px, &mut Rng::new(21));
        perturb(&mut problem, 0.01, 0.02, &mut Rng::new(22));
        let report = run(&mut problem, &EXACT);
        let scalars = report.residuals as f64;
        let rms = (2.0 * report.final_cost / scalars).sqrt();
        let wanted = sigma_px * (1.0 - report.parameters as f64 / scalars).sqrt();
        assert!(
            (rms - wanted).abs() < 0.05 * sigma_px + 1e-10,
            "{sigma_px}: {rms}, {wanted}"
        );
    }
}

#[test]
fn a_tenth_of_wild_observations_is_outvoted_under_cauchy() {
    let exact = ring(&RingSize { points: 400, ..SMALL });
    let mut problem = exact.clone();
    let mut rng = Rng::new(31);
    for seen in &mut problem.observations {
        if rng.below(10) == 0 {
            seen.pixel += synthetic::normal_pair(&mut rng) * 100.0;
        }
    }
    perturb(&mut problem, 0.01, 0.02, &mut rng);
    let robust = BundleOptions {
        loss: Loss::Cauchy(1.0),
        max_iterations: 200,
        ..EXACT
    };
    let squared = distance(
        &{
            let mut p = problem.clone();
            run(&mut p, &EXACT);
            p
        }
        .poses,
        &exact.poses,
    );
    run(&mut problem, &robust);
    let (angle, centre) = distance(&problem.poses, &exact.poses);
    assert!(
        angle < 1e-3 && centre < 4e-3,
        "{angle} {centre}; squared {squared:?}"
    );
    assert!(centre < 0.1 * squared.1, "{centre}; squared {squared:?}");
}

#[test]
fn the_richer_lens_is_chosen_only_where_it_is_needed() {
    for (k1, needed) in [(0.0, LensModel::Pinhole), (0.2, LensModel::SimpleRadial)] {
        let mut exact = ring(&RingSize { points: 400, ..SMALL });
        exact.cameras[0].k1 = k1;
        exact.cameras[0].k2 = 0.0;
        for index in 0..exact.observations.len() {
            let off = residual(&exact, &exact.observations[index]).unwrap();
            exact.observations[index].pixel += off;
        }
        add_noise(&mut exact, 0.5, &mut Rng::new(41));
        let criterion = |lens| {
            let mut problem = exact.clone();
            problem.camera_freedom[0].lens = lens;
            problem.cameras[0].k1 = 0.0;
            information_criterion(&run(&mut problem, &EXACT))
        };
        let models = [LensModel::Pinhole, LensModel::SimpleRadial, LensModel::Radial];
        let best = models
            .into_iter()
            .min_by(|a, b| criterion(*a).total_cmp(&criterion(*b)));
        assert_eq!(best, Some(needed), "k1 {k1}");
    }
}
