//! How far the retrainings of a bootstrap differ at the points of a surface.

use marf_numeric::quantile;
use marf_scene::picture::Palette;
use marf_schema::surface::{SpreadOf, UncertaintyReport};
use rayon::prelude::*;

use crate::mesh::{Retrained, Vertex, Witnesses};

/// Share of the points within the scale of colours: the highest are at its end.
const TOLD_APART: f64 = 0.95;

/// Sums over members at each point of a surface.
#[derive(Debug, Clone)]
pub struct MemberSpread {
    members: u32,
    sums: Vec<Sums>,
}

/// Running means and squares of what members show at a point (Welford 1962).
#[derive(Debug, Clone, Copy, Default)]
struct Sums {
    count: u32,
    /// Mean signed distance, world units, and sum of squares around it.
    depth: [f64; 2],
    /// The same of the gray of the colour, sRGB in [0, 1].
    gray: [f64; 2],
}

impl MemberSpread {
    /// Returns the sums over no member.
    pub fn new(points: usize) -> Self {
        Self {
            members: 0,
            sums: vec![Sums::default(); points],
        }
    }

    /// Adds what a member shows at the points, which must be those of all members.
    pub fn add(&mut self, member: &Witnesses<'_>, points: &[Vertex]) {
        self.members += 1;
        self.sums.par_iter_mut().zip(points).for_each(|(sums, point)| {
            if let Some(seen) = member.at(&point.position) {
                let gray = seen.color.iter().sum::<f64>() / 3.0;
                sums.add(seen.signed, gray);
            }
        });
    }

    /// Gives each point the sample standard deviations over the members. They are unknown if fewer than two,
    /// or fewer than half of them, show a surface within the band.
    pub fn give(&self, points: &mut [Vertex]) {
        let least = self.members.div_ceil(2).max(2);
        for (point, sums) in points.iter_mut().zip(&self.sums) {
            let deviation = |squares: f64| {
                if sums.count >= least {
                    (squares / f64::from(sums.count - 1)).sqrt() as f32
                } else {
                    -1.0
                }
            };
            point.retrained = Some(Retrained {
                depth: deviation(sums.depth[1]),
                color: deviation(sums.gray[1]),
            });
        }
    }
}

impl Sums {
    fn add(&mut self, depth: f64, gray: f64) {
        self.count += 1;
        for (sums, value) in [(&mut self.depth, depth), (&mut self.gray, gray)] {
            let off = value - sums[0];
            sums[0] += off / f64::from(self.count);
            sums[1] += off * (value - sums[0]);
        }
    }
}

/// Returns the uncertainty of a point, world units: the standard deviation of the retrainings along the
/// normal if there are any, else how far the views differ.
fn uncertainty(point: &Vertex) -> Option<f64> {
    let value = point.retrained.map_or(point.spread, |retrained| retrained.depth);
    (value >= 0.0).then_some(f64::from(value))
}

/// Reports kind and size of the uncertainties of points: median, and the value at the end of the colours (95
/// of 100 are below).
///
/// `scale`: from world units to the unit of exports.
pub fn report(points: &[Vertex], members: u32, scale: f64) -> UncertaintyReport {
    let known: Vec<f64> = points.iter().filter_map(uncertainty).collect();
    let at = |share: f64| quantile(known.iter().copied(), share).map_or(0.0, |value| value * scale);
    UncertaintyReport {
        of: if members > 0 {
            SpreadOf::Retrainings
        } else {
            SpreadOf::Views
        },
        members,
        median: at(0.5),
        scale_end: at(TOLD_APART),
        known_share: known.len() as f64 / points.len().max(1) as f64,
    }
}

/// Colours points by their uncertainty: dark where it is 0, bright at the end of the scale (unit of exports), gray where it is not known.
pub fn paint(points: &mut [Vertex], scale_end: f64, scale: f64) {
    for point in points {
        let share = uncertainty(point).map(|value| value * scale / scale_end.max(f64::MIN_POSITIVE));
        point.color = match share {
            Some(share) => Palette::Inferno
                .color(share as f32)
                .map(|channel| f32::from(channel) / 255.0),
            None => [0.5; 3],
        };
    }
}

#[cfg(test)]
mod tests {
    use marf_scene::{Camera, Pose};
    use nalgebra::Vector3;

    use super::*;
    use crate::view::SurfaceView;

    /// A wall at a distance before a camera, in one gray.
    fn wall(distance: f64, gray: f32) -> SurfaceView {
        let camera = Camera::pinhole(40, 30, 40.0);
        let pose = Pose::looking_at(Vector3::new(0.0, -distance, 0.0), Vector3::zeros(), -Vector3::z());
        let along = |pixel: usize| {
            let at = nalgebra::Vector2::new((pixel % 40) as f64 + 0.5, (pixel / 40) as f64 + 0.5);
            (distance * camera.unproject(&at).unwrap().norm()) as f32
        };
        let distances: Vec<f32> = (0..1200).map(along).collect();
        SurfaceView::new(camera, pose, &distances, vec![[gray; 3]; 1200])
    }

    fn point() -> Vertex {
        Vertex {
            position: Vector3::new(0.01, 0.0, 0.02),
            normal: -Vector3::y(),
            color: [0.0; 3],
            photos: 2,
            spread: 0.5,
            retrained: None,
        }
    }

    /// A member that sees the wall of `wall(2)` farther away by `off`.
    fn member(off: f64, gray: f32) -> SurfaceView {
        let mut view = wall(2.0 + off, gray);
        view.move_to(wall(2.0, gray).centre());
        view
    }

    #[test]
    fn points_get_the_standard_deviation_of_depth_and_gray() {
        let mut points = [point()];
        let mut spread = MemberSpread::new(1);
        for (off, gray) in [(-0.1, 0.4), (0.0, 0.5), (0.1, 0.6)] {
            let views = [member(off, gray)];
            let witnesses = Witnesses {
                views: &views,
                observers: &[],
                band: 0.3,
            };
            spread.add(&witnesses, &points);
        }
        spread.give(&mut points);
        let found = points[0].retrained.unwrap();
        assert!(
            (found.depth - 0.1).abs() < 1e-4 && (found.color - 0.1).abs() < 1e-6,
            "{found:?}"
        );
        let report = report(&points, 3, 2.0);
        assert_eq!(
            (report.of, report.members, report.known_share),
            (SpreadOf::Retrainings, 3, 1.0)
        );
        assert!((report.median - 0.2).abs() < 1e-3, "{report:?}");
    }

    #[test]
    fn what_less_than_half_of_the_members_show_is_not_known() {
        let mut points = [point()];
        let mut spread = MemberSpread::new(1);
        for off in [0.0, 0.01, 5.0, 6.0, 7.0] {
            let views = [member(off, 0.5)];
            let witnesses = Witnesses {
                views: &views,
                observers: &[],
                band: 0.3,
            };
            spread.add(&witnesses, &points);
        }
        spread.give(&mut points);
        assert_eq!(points[0].retrained.unwrap().depth, -1.0);
        paint(&mut points, 1.0, 1.0);
        assert_eq!(points[0].color, [0.5; 3]);
    }

    #[test]
    fn without_retrainings_the_views_are_told_and_painted() {
        let mut points = [
            point(),
            Vertex {
                spread: 0.0,
                ..point()
            },
        ];
        let report = report(&points, 0, 1.0);
        assert_eq!((report.of, report.scale_end), (SpreadOf::Views, 0.5));
        paint(&mut points, report.scale_end, 1.0);
        let ends = [1.0, 0.0].map(|share| {
            Palette::Inferno
                .color(share)
                .map(|channel| f32::from(channel) / 255.0)
        });
        assert_eq!([points[0].color, points[1].color], ends);
    }
}
