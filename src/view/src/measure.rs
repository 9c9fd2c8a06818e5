//! Points that are picked in a picture, and their distance with its interval.

use marf_depth::{CloudDistance, Ray};
use marf_field::{Field as Trained, FieldError, Render};
use marf_scene::{Camera, Pose};
use nalgebra::{Vector2, Vector3};
use serde::Serialize;

use crate::field::{Field, MIN_OPACITY};
use crate::frames::{FrameError, View, window};
use crate::source::DepthInterval;

/// Pixels to each side of a picked one whose variances are averaged with its own, as the intervals of the bootstrap are fitted.
const AROUND: u32 = 2;
/// 90 % of the positions in a pixel are at most so far from its middle along a line, pixels.
const WITHIN_PX: f64 = 0.45;

/// Share of the retrainings that have a surface along a ray, at least, where the field has one. Far ground of which photos see no
/// parallax is anything to a retraining: a speck before the camera, or nothing (`benches/view.md`).
const AGREEING: f64 = 0.8;
/// Half of a 90 % interval, as a share of the distance, at most: with a longer one the retrainings only say that something is there.
const MOST_HALF: f64 = 0.5;
/// A field and pairs that differ by more standard deviations show different surfaces.
const CONTRADICTED: f64 = 2.0;
/// Half of a 90 % interval of a normal distribution, standard deviations.
const NINETY: f64 = 1.644_853_626_951_472;

/// A point that was picked in a picture.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Picked {
    /// Where the ray of the pixel ends, in the world: at the mean of the retrainings' depths, or the field's where there are none,
    /// and of the depth by pairs of photos, weighted by what each is sure of. `None` where neither pairs nor retrainings agree on a surface.
    pub point: Option<[f64; 3]>,
    /// Unit vector of the ray, in the world.
    #[serde(skip)]
    ray: Vector3<f64>,
    /// The end of the ray by each of the retrainings.
    #[serde(skip)]
    members: Vec<Option<Vector3<f64>>>,
    /// 90 % of the errors along the ray are at most so long, world units.
    #[serde(skip)]
    along: Option<f64>,
    /// 90 % of the errors across the ray are at most so long: where in the pixel the point is, world units.
    #[serde(skip)]
    across: f64,
    /// Pairs of photos saw a surface there.
    #[serde(skip)]
    by_pairs: bool,
}

/// The distance of two points that were picked.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Distance {
    /// World units.
    pub length: f64,
    /// Ends of its 90 % interval. `None` if held-out photos do not give it.
    pub interval: Option<[f64; 2]>,
    /// Sample standard deviation over the retrainings that have a surface at both points. `None` with fewer
    /// than two.
    pub spread: Option<f64>,
    /// Those retrainings.
    pub members: usize,
    /// Points at which pairs of photos saw a surface, too.
    pub by_pairs: usize,
}

/// Returns the point of the surface that a pixel of a view shows.
///
/// # Errors
/// A pixel outside the picture. A field that cannot be rendered.
pub fn pick(field: &Field, view: &View, [column, row]: [u32; 2]) -> Result<Picked, FrameError> {
    let View {
        camera,
        cam_from_world,
    } = view;
    if column >= camera.width || row >= camera.height {
        let message = format!("pixel ({column}, {row}) is outside the picture");
        return Err(FrameError::Failed(message));
    }
    let corner = [column, row].map(|at| i64::from(at) - i64::from(AROUND));
    let around = window(camera, corner, [2 * AROUND + 1; 2]);
    let render = |trained: &Trained| trained.render(&around, cam_from_world);
    let renders: Vec<Render> = field
        .members()
        .iter()
        .map(render)
        .collect::<Result<_, FieldError>>()?;
    let own = if renders.is_empty() {
        vec![render(field.trained())?]
    } else {
        Vec::new()
    };
    let ray = ray_of(camera, cam_from_world, [column, row])
        .ok_or_else(|| FrameError::Failed("the lens has no ray there".to_owned()))?;
    let half =
        |depth: f64| Some(half_width(field.depth_interval()?, local_spread(&renders)? / depth) * depth);
    let surface = mean_depth(if own.is_empty() { &renders } else { &own }, MIDDLE);
    let is_agreed = |depth: f64| half(depth).is_none_or(|half| half <= MOST_HALF * depth);
    let shown = surface.filter(|depth| agree(&renders) && is_agreed(*depth));
    let by_field = shown.and_then(half);
    let by_pairs = field.cloud().and_then(|cloud| {
        let ray = Ray {
            origin: cam_from_world.centre(),
            direction: ray,
            pixel: 1.0 / camera.fx_px.min(camera.fy_px),
        };
        cloud.along(&ray, surface)
    });
    let (depth, along) = combined(shown, by_field, by_pairs);
    // The interval of the field alone is fitted on points anywhere in their pixels.
    let step = by_pairs.map_or(0.0, |_| steps(if own.is_empty() { &renders } else { &own }));
    let end = |depth: f64| cam_from_world.centre() + ray * depth;
    let is_met = |render: &&Render| render.opacity[MIDDLE] > MIN_OPACITY;
    let of_member = |render: &Render| {
        Some(render)
            .filter(is_met)
            .map(|render| end(f64::from(render.depth[MIDDLE])))
    };
    Ok(Picked {
        point: depth.map(|depth| end(depth).into()),
        ray,
        members: renders.iter().map(of_member).collect(),
        along: along.map(|along| along.hypot(step)),
        across: WITHIN_PX * depth.unwrap_or(0.0) / camera.fx_px.min(camera.fy_px),
        by_pairs: by_pairs.is_some(),
    })
}

/// The middle pixel of those around a picked one.
const MIDDLE: usize = (2 * AROUND * (AROUND + 1)) as usize;

/// Returns the direction of a pixel's ray in the world, of length 1.
fn ray_of(camera: &Camera, cam_from_world: &Pose, [column, row]: [u32; 2]) -> Option<Vector3<f64>> {
    let middle = Vector2::new(f64::from(column) + 0.5, f64::from(row) + 0.5);
    let ray = camera.unproject(&middle)?;
    Some(cam_from_world.rotation.transpose() * ray.normalize())
}

/// Returns the mean depth of renders at a pixel. `None` if their mean opacity is too low.
fn mean_depth(renders: &[Render], pixel: usize) -> Option<f64> {
    let mean = |value: fn(&Render, usize) -> f32| {
        let sum: f64 = renders.iter().map(|render| f64::from(value(render, pixel))).sum();
        sum / renders.len() as f64
    };
    let opacity = mean(|render, pixel| render.opacity[pixel]);
    (opacity > f64::from(MIN_OPACITY)).then(|| mean(|render, pixel| render.depth[pixel]))
}

/// Returns whether enough of the retrainings have a surface at the middle pixel. None contradict each other where there are none.
fn agree(renders: &[Render]) -> bool {
    let met = renders
        .iter()
        .filter(|render| render.opacity[MIDDLE] > MIN_OPACITY);
    met.count() as f64 >= AGREEING * renders.len() as f64
}

/// Returns by how much the depth changes from pixel to pixel around the middle one at most: where in the pixel the point is decides how
/// far it is, and at an edge cameras decide on which side of it.
fn steps(renders: &[Render]) -> f64 {
    let Some(middle) = mean_depth(renders, MIDDLE) else {
        return 0.0;
    };
    let (around, row) = (AROUND as i32, 2 * AROUND as usize + 1);
    let from_middle = |at: usize| (at as i32 - around).unsigned_abs();
    let step = |pixel: usize| {
        let apart = from_middle(pixel % row).max(from_middle(pixel / row)).max(1);
        Some((mean_depth(renders, pixel)? - middle).abs() / f64::from(apart))
    };
    (0..row * row).filter_map(step).fold(0.0, f64::max)
}

/// Returns the root of the mean variance of the depth over the pixels that have one, world units. `None` with
/// fewer than two renders.
fn local_spread(renders: &[Render]) -> Option<f64> {
    let [first, _, ..] = renders else { return None };
    let variance = |pixel: usize| {
        let mean = mean_depth(renders, pixel)?;
        let squares = renders
            .iter()
            .map(|render| (f64::from(render.depth[pixel]) - mean).powi(2));
        Some(squares.sum::<f64>() / (renders.len() - 1) as f64)
    };
    let variances: Vec<f64> = (0..first.depth.len()).filter_map(variance).collect();
    (!variances.is_empty()).then(|| (variances.iter().sum::<f64>() / variances.len() as f64).sqrt())
}

/// Returns a depth with half of its 90 % interval, from what the field shows, with half of its interval, and what pairs of photos saw.
///
/// Each counts by the inverse of its variance. Where they differ by more than both are unsure of, the interval is wider by that ratio
/// (R. T. Birge, Phys. Rev. 40, 1932). Where they differ by more than twice that, they show two surfaces, and the interval contains both.
/// A field without an interval does not count beside pairs.
fn combined(
    shown: Option<f64>,
    half: Option<f64>,
    by_pairs: Option<CloudDistance>,
) -> (Option<f64>, Option<f64>) {
    let Some(pairs) = by_pairs else {
        return (shown, half);
    };
    let (Some(shown), Some(half)) = (shown, half) else {
        return (Some(pairs.distance), Some(NINETY * pairs.sigma));
    };
    let field = half / NINETY;
    let both = field.hypot(pairs.sigma);
    if both == 0.0 {
        return (Some(pairs.distance), Some((shown - pairs.distance).abs()));
    }
    let share = (field / both).powi(2);
    let apart = (shown - pairs.distance).abs() / both;
    let within = if apart > CONTRADICTED {
        apart * both
    } else {
        NINETY * field * pairs.sigma / both * apart.max(1.0)
    };
    (Some(shown + share * (pairs.distance - shown)), Some(within))
}

/// Returns half of the 90 % interval of a depth, as a share of it, for a spread that is a share of it.
fn half_width(interval: DepthInterval, spread: f64) -> f64 {
    interval.factor * spread.hypot(interval.floor)
}

/// Returns the distance of two picked points. `None` if one has no surface.
///
/// Errors along both rays and across them are taken as independent, and only what changes the distance counts. An error of the scene's scale is not in it.
pub fn distance(a: &Picked, b: &Picked) -> Option<Distance> {
    let (from, to) = (Vector3::from(a.point?), Vector3::from(b.point?));
    let length = (to - from).norm();
    // Two picks of one point have no line between them: the whole error counts.
    let line = (to - from).try_normalize(0.0);
    let errors = |picked: &Picked, here: Vector3<f64>, there: Vector3<f64>| {
        let cos = line.map_or(1.0, |line| line.dot(&picked.ray).abs().min(1.0));
        let along = picked.along?;
        // Not cos times the error: a large one turns the line.
        let changed =
            [along, -along].map(|error| ((here + picked.ray * error - there).norm() - length).abs());
        Some(
            changed[0]
                .max(changed[1])
                .hypot(picked.across * (1.0 - cos * cos).sqrt()),
        )
    };
    let half = errors(a, from, to)
        .zip(errors(b, to, from))
        .map(|(a, b)| a.hypot(b));
    let pairs = a.members.iter().zip(&b.members);
    let lengths: Vec<f64> = pairs.filter_map(|(a, b)| Some(((*b)? - (*a)?).norm())).collect();
    Some(Distance {
        length,
        interval: half.map(|half| [(length - half).max(0.0), length + half]),
        spread: sample_deviation(&lengths),
        members: lengths.len(),
        by_pairs: usize::from(a.by_pairs) + usize::from(b.by_pairs),
    })
}

/// Returns the sample standard deviation (divisor B - 1). `None` with fewer than two values.
fn sample_deviation(values: &[f64]) -> Option<f64> {
    let count = values.len() as f64;
    let mean = values.iter().sum::<f64>() / count;
    let squares: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
    (values.len() > 1).then(|| (squares / (count - 1.0)).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picked(point: [f64; 3], along: Option<f64>) -> Picked {
        Picked {
            point: Some(point),
            ray: Vector3::z(),
            members: Vec::new(),
            along,
            across: 0.0,
            by_pairs: false,
        }
    }

    #[test]
    fn errors_along_the_line_count_whole_and_others_by_how_they_turn_it() {
        let near = picked([0.0, 0.0, 2.0], Some(0.3));
        let behind = distance(&near, &picked([0.0, 0.0, 5.0], Some(0.4))).unwrap();
        assert_eq!(behind.length, 3.0);
        let [low, high] = behind.interval.unwrap();
        assert!(
            (low - 2.5).abs() < 1e-12 && (high - 3.5).abs() < 1e-12,
            "{behind:?}"
        );
        let beside = distance(&near, &picked([3.0, 0.0, 2.0], Some(0.4))).unwrap();
        // √(9 + 0.3²) and √(9 + 0.4²) are 0.014963 and 0.026549 longer.
        let around = |found: Distance, half: f64| {
            let [low, high] = found.interval.unwrap();
            assert!(
                (low - 3.0 + half).abs() < 1e-6 && (high - 3.0 - half).abs() < 1e-6,
                "{found:?}"
            );
        };
        around(beside, 0.030_475);
        let pixel = Picked {
            across: 0.01,
            ..near.clone()
        };
        let beside = distance(&pixel, &picked([3.0, 0.0, 2.0], Some(0.4))).unwrap();
        around(beside, 0.030_475_f64.hypot(0.01));
    }

    #[test]
    fn field_and_pairs_count_by_what_they_are_sure_of_and_differ_visibly() {
        let pairs = |distance| Some(CloudDistance { distance, sigma: 0.1 });
        let close = |found: (Option<f64>, Option<f64>), depth: f64, sigma: f64| {
            let (at, half) = (found.0.unwrap(), found.1.unwrap());
            let is_close = (at - depth).abs() < 1e-9 && (half - NINETY * sigma).abs() < 1e-9;
            assert!(is_close, "{found:?}");
        };
        // Standard deviations 0.2 and 0.1: weights 1 and 4, together 0.1 * 0.2 / sqrt(0.05).
        let both = 0.02 / 0.05_f64.sqrt();
        close(combined(Some(5.0), Some(0.2 * NINETY), pairs(5.1)), 5.08, both);
        // They differ by 1.5 and by 10 times what both are unsure of.
        let apart = |times: f64| 5.0 + times * 0.05_f64.sqrt();
        let found = combined(Some(5.0), Some(0.2 * NINETY), pairs(apart(1.5)));
        close(found, apart(1.2), 1.5 * both);
        let found = combined(Some(5.0), Some(0.2 * NINETY), pairs(apart(10.0)));
        close(found, apart(8.0), (apart(10.0) - 5.0) / NINETY);
        close(combined(Some(5.0), None, pairs(5.1)), 5.1, 0.1);
        close(combined(None, None, pairs(5.1)), 5.1, 0.1);
        assert_eq!(combined(Some(5.0), Some(0.3), None), (Some(5.0), Some(0.3)));
        assert_eq!(combined(None, None, None), (None, None));
    }

    #[test]
    fn one_point_twice_is_no_distance_within_its_errors() {
        let point = picked([1.0, 1.0, 1.0], Some(0.3));
        let found = distance(&point, &point).unwrap();
        let [low, high] = found.interval.unwrap();
        assert!(
            found.length == 0.0 && low == 0.0 && (high - 0.3 * 2.0_f64.sqrt()).abs() < 1e-12,
            "{found:?}"
        );
    }

    #[test]
    fn without_a_calibration_there_is_no_interval_and_without_a_surface_no_distance() {
        let [a, mut b] = [picked([0.0; 3], None), picked([0.0, 1.0, 0.0], Some(0.1))];
        assert_eq!(distance(&a, &b).unwrap().interval, None);
        b.point = None;
        assert_eq!(distance(&a, &b), None);
    }

    #[test]
    fn retrainings_without_a_surface_at_both_points_are_left_out() {
        let at = |z: f64| Some(Vector3::new(0.0, 0.0, z));
        let members = |members: [Option<Vector3<f64>>; 3]| Picked {
            members: members.to_vec(),
            ..picked([0.0; 3], None)
        };
        let (a, b) = (
            members([at(0.0), at(0.1), None]),
            members([at(1.0), at(1.3), at(9.0)]),
        );
        let found = distance(&a, &b).unwrap();
        assert_eq!(found.members, 2);
        assert!(
            (found.spread.unwrap() - 0.02_f64.sqrt()).abs() < 1e-12,
            "{found:?}"
        );
        assert_eq!(sample_deviation(&[1.0]), None);
    }

    #[test]
    fn a_spread_is_averaged_around_the_pixel_where_there_is_a_surface() {
        let render = |depth: f32, opacity: f32| Render {
            depth: vec![depth, 2.0 * depth, 7.0 * depth],
            opacity: vec![0.9, 0.9, opacity],
            ..Render::empty(3, 1)
        };
        // Variances 0.02 and 0.08. The third pixel has no surface.
        let found = local_spread(&[render(1.0, 0.1), render(1.2, 0.1)]).unwrap();
        assert!((found - 0.05_f64.sqrt()).abs() < 1e-6, "{found}");
        assert_eq!(local_spread(&[render(1.0, 0.1)]), None);
        let interval = DepthInterval {
            floor: 0.003,
            factor: 2.0,
        };
        assert!((half_width(interval, 0.004) - 0.01).abs() < 1e-12);
    }

    #[test]
    fn a_surface_takes_four_fifths_of_the_retrainings() {
        let render = |opacity: f32| Render {
            opacity: vec![opacity; MIDDLE + 1],
            ..Render::empty(1, 1)
        };
        let agreed = |opacities: &[f32]| {
            let renders: Vec<Render> = opacities.iter().map(|opacity| render(*opacity)).collect();
            agree(&renders)
        };
        assert!(agreed(&[]) && agreed(&[0.9]) && agreed(&[0.9, 0.6, 1.0, 0.51, 0.1]));
        // 0.5 is no surface, and 3 of 4 are too few.
        assert!(!agreed(&[0.9, 0.6, 1.0, 0.5, 0.1]) && !agreed(&[0.9, 0.9, 0.9, 0.0]));
    }

    #[test]
    fn a_ray_is_that_of_the_middle_of_its_pixel() {
        let pose = Pose::looking_at(
            Vector3::new(1.0, 0.0, 0.0),
            Vector3::new(4.0, 4.0, 0.0),
            Vector3::z(),
        );
        let ray = ray_of(&Camera::pinhole(3, 3, 2.0), &pose, [1, 1]).unwrap();
        assert!((ray - Vector3::new(0.6, 0.8, 0.0)).norm() < 1e-12, "{ray}");
    }
}
