//! Camera poses from three points (P3P).

use marf_scene::Pose;
use nalgebra::{Matrix3, SMatrix, Vector2, Vector3};

use super::roots::real_roots;

/// Gauss-Newton steps on the three distances. They start within 1e-6 but at a double root.
const STEPS: usize = 5;

/// Returns the poses `cam_from_world` that see three world points at three plane points, at most four.
///
/// The distances are the intersections of two conics (Persson and Nordberg, Lambda Twist, ECCV 2018), found by
/// splitting their degenerate member into lines (Ding, Yang, Larsson, Olsson, Astrom, CVPR 2023). Works in
/// differences of the world points, scaled to 1: their unit and origin cost only the digits that the coordinates
/// themselves have lost. Collinear or equal points, and values that are not finite, give no pose. A double solution
/// comes once or twice, with half of the digits.
pub(crate) fn p3p(plane: &[Vector2<f64>; 3], world: &[Vector3<f64>; 3]) -> Vec<Pose> {
    let rays = plane.map(|point| point.push(1.0).normalize());
    let sides = [world[0] - world[1], world[0] - world[2], world[1] - world[2]];
    let size = sides.iter().fold(0.0_f64, |most, side| most.max(side.norm()));
    let sides = sides.map(|side| side / size);
    let area = sides[0].cross(&sides[1]).norm();
    let finite = rays.iter().all(|ray| ray.iter().all(|value| value.is_finite()));
    // With a triangle of height 1e-7 the rotation about its line depends on the last digits.
    if !finite || area.is_nan() || area < 1e-7 {
        return Vec::new();
    }
    let squares = sides.map(|side| side.norm_squared());
    let cosines = [
        rays[0].dot(&rays[1]),
        rays[0].dot(&rays[2]),
        rays[1].dot(&rays[2]),
    ];
    let mut poses = Vec::with_capacity(4);
    for distances in all_distances(&squares, &cosines) {
        if let Some(distances) = refined(distances, &squares, &cosines) {
            let points = [0, 1, 2].map(|i| rays[i] * (distances[i] * size));
            poses.extend(align(&points, world));
        }
    }
    poses
}

/// Returns the quadratic form whose value at distances d is d_i² + d_j² - 2 cos d_i d_j.
fn form(i: usize, j: usize, cosine: f64) -> Matrix3<f64> {
    let mut form = Matrix3::zeros();
    (form[(i, i)], form[(j, j)], form[(i, j)], form[(j, i)]) = (1.0, 1.0, -cosine, -cosine);
    form
}

/// Returns the distances along the three rays that reproduce the three sides, before refinement.
fn all_distances(squares: &[f64; 3], cosines: &[f64; 3]) -> Vec<Vector3<f64>> {
    let forms = [
        form(0, 1, cosines[0]),
        form(0, 2, cosines[1]),
        form(1, 2, cosines[2]),
    ];
    // Two conics through all solutions. Both compare with the longest side, so no scale is lost.
    let longest = (1..3).fold(0, |best, i| if squares[i] > squares[best] { i } else { best });
    let (i, j) = ((longest + 1) % 3, (longest + 2) % 3);
    let conic = |i: usize| forms[i] * squares[longest] - forms[longest] * squares[i];
    let (first, second) = (conic(i), conic(j));
    let mut found = Vec::with_capacity(4);
    let Some((lines, other)) = split(&first, &second) else {
        return found;
    };
    for line in lines {
        for direction in intersections(&line, &other) {
            let d = if direction.sum() < 0.0 {
                -direction
            } else {
                direction
            };
            let unit = (d.transpose() * forms[longest] * d)[0];
            if d.min() > 0.0 && unit > 0.0 {
                found.push(d * (squares[longest] / unit).sqrt());
            }
        }
    }
    found
}

/// Returns two lines that contain all common points of two conics, and the conic to intersect them with.
fn split(first: &Matrix3<f64>, second: &Matrix3<f64>) -> Option<([Vector3<f64>; 2], Matrix3<f64>)> {
    let (of_first, of_second) = (adjugate(first), adjugate(second));
    let cubic = [
        first.determinant(),
        of_first.dot(second),
        of_second.dot(first),
        second.determinant(),
    ];
    // The member that is two real lines, not two complex ones: its adjugate has a negative diagonal.
    let mut best: Option<(Matrix3<f64>, Matrix3<f64>, f64)> = None;
    for root in real_roots(&cubic) {
        let member = first + second * root;
        let member = member / member.amax();
        let adjugate = -adjugate(&member);
        let clear = adjugate.diagonal().max();
        if clear >= 0.0 && best.as_ref().is_none_or(|(_, _, most)| clear > *most) {
            best = Some((member, adjugate, clear));
        }
    }
    let (member, adjugate, clear) = best?;
    let crossing = adjugate.column(adjugate.diagonal().imax()) / clear.max(1e-300).sqrt();
    let product = member + super::rotation::cross_matrix(&crossing);
    let (row, column) = product.iamax_full();
    let lines = [product.row(row).transpose(), product.column(column).into_owned()];
    Some((lines, *second))
}

/// Returns the adjugate of a symmetric matrix, from cross products of its columns.
fn adjugate(m: &Matrix3<f64>) -> Matrix3<f64> {
    let column = |i: usize| m.column(i).into_owned();
    let rows = [
        column(1).cross(&column(2)),
        column(2).cross(&column(0)),
        column(0).cross(&column(1)),
    ];
    Matrix3::from_rows(&rows.map(|row| row.transpose()))
}

/// Returns the intersections of a line and a conic: two points, or one twice. Empty if they are complex.
fn intersections(line: &Vector3<f64>, conic: &Matrix3<f64>) -> Vec<Vector3<f64>> {
    let Some(unit) = line.try_normalize(0.0) else {
        return Vec::new();
    };
    let u = super::svd::any_orthogonal(&unit);
    let v = unit.cross(&u);
    let along = |a: &Vector3<f64>, b: &Vector3<f64>| a.dot(&(conic * b));
    let (a, b, c) = (along(&u, &u), along(&u, &v), along(&v, &v));
    let discriminant = b * b - a * c;
    // Rounding may push a double point off the line of reals.
    if discriminant.is_nan() || discriminant < -1e-9 * (b * b + (a * c).abs()) {
        return Vec::new();
    }
    // a s² + 2 b s t + c t² = 0 without cancellation: w = -(b + sign(b) root). The solutions s : t are w : a and c :
    // w.
    let w = -(b + discriminant.max(0.0).sqrt().copysign(b));
    let points = [u * w + v * a, u * c + v * w];
    points
        .into_iter()
        .filter(|point| point.norm_squared() > 0.0)
        .collect()
}

/// Returns the distances after Newton steps. `None` if the sides are not reproduced within 1e-6.
fn refined(mut d: Vector3<f64>, squares: &[f64; 3], cosines: &[f64; 3]) -> Option<Vector3<f64>> {
    let residual = |d: &Vector3<f64>| {
        Vector3::new(
            d.x * d.x + d.y * d.y - 2.0 * cosines[0] * d.x * d.y - squares[0],
            d.x * d.x + d.z * d.z - 2.0 * cosines[1] * d.x * d.z - squares[1],
            d.y * d.y + d.z * d.z - 2.0 * cosines[2] * d.y * d.z - squares[2],
        )
    };
    let mut error = residual(&d);
    for _ in 0..STEPS {
        let slopes = Matrix3::new(
            d.x - cosines[0] * d.y,
            d.y - cosines[0] * d.x,
            0.0,
            d.x - cosines[1] * d.z,
            0.0,
            d.z - cosines[1] * d.x,
            0.0,
            d.y - cosines[2] * d.z,
            d.z - cosines[2] * d.y,
        );
        let Some(inverse) = slopes.try_inverse() else {
            break;
        };
        let next = d - inverse * error * 0.5;
        let after = residual(&next);
        if after.amax().is_nan() || after.amax() >= error.amax() {
            break;
        }
        (d, error) = (next, after);
    }
    // Distances of 1e4 sides carry 1e-8 of rounding in their squares.
    (error.amax() < 1e-6 && d.min() > 0.0).then_some(d)
}

/// Returns the rigid motion between two congruent triangles.
fn align(camera: &[Vector3<f64>; 3], world: &[Vector3<f64>; 3]) -> Option<Pose> {
    let rotation = triad(camera)? * triad(world)?.transpose();
    let translation = camera[0] - rotation * world[0];
    let pose = Pose {
        rotation,
        translation,
    };
    pose.is_valid().then_some(pose)
}

/// Returns the orthonormal frame of a triangle.
fn triad(points: &[Vector3<f64>; 3]) -> Option<Matrix3<f64>> {
    let (a, b) = (points[1] - points[0], points[2] - points[0]);
    let x = a.try_normalize(0.0)?;
    let z = a.cross(&b).try_normalize(0.0)?;
    Some(SMatrix::from_columns(&[x, z.cross(&x), z]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimators::scenes::{Scene, plane_of, pose};
    use marf_numeric::Rng;

    /// How far the nearest pose is from the truth: rotation, and translation relative to `unit`.
    fn miss(truth: &Pose, world: &[Vector3<f64>; 3], unit: f64) -> f64 {
        let poses = p3p(&world.map(|point| plane_of(&truth.point(&point))), world);
        assert!(poses.len() <= 4, "{}", poses.len());
        let miss = |pose: &Pose| {
            (pose.rotation - truth.rotation).norm() + (pose.translation - truth.translation).norm() / unit
        };
        poses.iter().map(miss).fold(f64::INFINITY, f64::min)
    }

    #[test]
    fn three_points_give_the_pose_at_any_unit() {
        for scale in [1e-12, 1e-3, 1.0, 1e12] {
            let mut missed = 0;
            for seed in 0..500 {
                let mut rng = Rng::new(seed);
                let mut truth = pose(
                    [rng.unit_f64(), -rng.unit_f64(), 2.0 * rng.unit_f64()],
                    [0.3, -0.2, 0.7],
                );
                let points = Scene::new(seed, 3, &Pose::identity(), 0.0).points;
                let camera = [0, 1, 2].map(|i| points[i] * scale);
                truth.translation *= scale;
                let world = camera.map(|point| truth.inverse().point(&point));
                missed += u32::from(miss(&truth, &world, scale) > 1e-6);
            }
            assert!(missed <= 2, "scale {scale:e}: {missed} of 500");
        }
    }

    #[test]
    fn an_origin_a_million_away_costs_six_digits_and_no_more() {
        for seed in 0..50 {
            let truth = pose([0.3, 0.1, -0.2], [1e6, -2e6, 1e6]);
            let points = Scene::new(seed, 3, &Pose::identity(), 0.0).points;
            let world = [0, 1, 2].map(|i| truth.inverse().point(&points[i]));
            let poses = p3p(&[0, 1, 2].map(|i| plane_of(&points[i])), &world);
            let miss = poses
                .iter()
                .map(|pose| (pose.rotation - truth.rotation).norm())
                .fold(1.0, f64::min);
            assert!(miss < 1e-5, "seed {seed}: {miss:e}");
        }
    }

    #[test]
    fn collinear_equal_and_broken_points_give_no_pose() {
        let line = [1.0, 2.0, 4.0].map(|x| Vector3::new(x, -x, 5.0 + x));
        let bad = Vector3::new(f64::NAN, 0.0, 1.0);
        for world in [line, [line[0]; 3], [line[0], line[0], line[1]], [bad; 3]] {
            assert!(
                p3p(&world.map(|point| plane_of(&point)), &world).is_empty(),
                "{world:?}"
            );
        }
    }

    /// A camera on the danger cylinder has a double solution: the equilateral triangle seen from above its
    /// corner.
    #[test]
    fn repeated_roots_keep_half_of_the_digits() {
        let world = [0.0, 2.0, 4.0].map(|k| {
            let angle = k * std::f64::consts::FRAC_PI_3;
            Vector3::new(libm::cos(angle), libm::sin(angle), 0.0)
        });
        for (name, eye) in [
            ("on the cylinder", Vector3::new(1.0, 0.0, 3.0)),
            ("on the axis", Vector3::new(0.0, 0.0, 3.0)),
        ] {
            let truth = Pose::looking_at(eye, Vector3::zeros(), Vector3::y());
            let got = miss(&truth, &world, 1.0);
            assert!(got < 1e-3, "{name}: {got:e}");
        }
    }
}
