//! View of a scene from above or from the side, and its place on the page.

use marf_scene::{Frame, Scene};

use super::vector::{Vec3, cross, dot, scaled, sub, unit};

pub(super) const WIDTH: f64 = 680.0;
/// A drawing is at most and at least so high.
const HEIGHT: f64 = 520.0;
const LEAST_HEIGHT: f64 = 200.0;
/// Margin around the cameras for their views, scale and compass, pixels.
const MARGIN: f64 = 126.0;
/// An axis whose cosine with up is larger counts as up, within 2.6 degrees.
const LEVEL: f64 = 0.999;

/// A right-handed frame whose third axis points up.
pub(super) struct Axes {
    pub(super) right: Vec3,
    pub(super) ahead: Vec3,
    pub(super) up: Vec3,
    /// Name of `ahead` in the drawing.
    pub(super) ahead_name: &'static str,
    pub(super) right_name: &'static str,
    pub(super) words: &'static str,
}

/// View of a drawing: two directions of the world, to the right and to the top of the page.
pub(super) struct View {
    pub(super) right: Vec3,
    pub(super) top: Vec3,
    pub(super) right_name: &'static str,
    pub(super) top_name: &'static str,
}

impl Axes {
    /// Cameras in metres with z down are in the site frame of labels (x north, y east): there north is known.
    pub(super) fn new(scene: &Scene) -> Self {
        let given = scene.up.and_then(unit);
        let up = given.unwrap_or([0.0, 0.0, 1.0]);
        let site = up[2] < -LEVEL && scene.metres_per_unit.is_some();
        let level = |axis: Vec3| unit(sub(axis, scaled(up, dot(axis, up))));
        let (x, y, z) = ([1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]);
        // A y-up world is looked at with z towards the reader, the others with y to the top of the page.
        let first = if site {
            x
        } else if up[1].abs() > LEVEL {
            scaled(z, -1.0)
        } else {
            y
        };
        let ahead = level(first).or_else(|| level(x)).unwrap_or(y);
        let (ahead_name, right_name) = match up {
            _ if site => ("north", "east"),
            [_, y, _] if y > LEVEL => ("-z", "x"),
            [_, y, _] if y < -LEVEL => ("-z", "-x"),
            [_, _, z] if z > LEVEL => ("y", "x"),
            [_, _, z] if z < -LEVEL => ("y", "-x"),
            _ => ("", ""),
        };
        let words = match (given.is_some(), site) {
            (true, true) => "north is at the top of the view from above",
            (true, false) => "north is not known",
            (false, _) => "up is not known: z of the scene is taken",
        };
        Self {
            right: cross(ahead, up),
            ahead,
            up,
            ahead_name,
            right_name,
            words,
        }
    }

    pub(super) fn above(&self) -> View {
        View {
            right: self.right,
            top: self.ahead,
            right_name: self.right_name,
            top_name: self.ahead_name,
        }
    }

    pub(super) fn aside(&self) -> View {
        View {
            right: self.right,
            top: self.up,
            right_name: self.right_name,
            top_name: "up",
        }
    }
}

/// Maps the world to the page.
pub(super) struct Fit<'v> {
    pub(super) view: &'v View,
    pub(super) centre: (f64, f64),
    /// Pixels of one unit.
    pub(super) px_each: f64,
    /// Height of the drawing: what is low gets a low one.
    pub(super) height: f64,
}

impl Fit<'_> {
    pub(super) fn place(&self, world: Vec3) -> (f64, f64) {
        let (x, y) = flat(self.view, world);
        (
            WIDTH / 2.0 + (x - self.centre.0) * self.px_each,
            self.height / 2.0 - (y - self.centre.1) * self.px_each,
        )
    }
}

fn flat(view: &View, world: Vec3) -> (f64, f64) {
    (dot(world, view.right), dot(world, view.top))
}

/// Shows all cameras, and of the points those that are not stray.
pub(super) fn fitted<'v>(scene: &Scene, view: &'v View) -> Fit<'v> {
    let eyes: Vec<(f64, f64)> = scene
        .frames
        .iter()
        .map(|frame| flat(view, centre(frame)))
        .collect();
    let points: Vec<(f64, f64)> = scene
        .points
        .iter()
        .map(|point| flat(view, point.position))
        .collect();
    let range = |axis: fn(&(f64, f64)) -> f64| {
        let (low, high) = quantiles(eyes.iter().map(axis).collect(), 0.0);
        let (point_low, point_high) = quantiles(points.iter().map(axis).collect(), 0.03);
        (low.min(point_low), high.max(point_high))
    };
    let (x, y) = (range(|place| place.0), range(|place| place.1));
    let fit = |(low, high): (f64, f64), side: f64| {
        let extent = (high - low).abs();
        if extent > 1e-12 && extent.is_finite() {
            side / extent
        } else {
            f64::INFINITY
        }
    };
    let each = fit(x, WIDTH - MARGIN).min(fit(y, HEIGHT - MARGIN));
    let px_each = if each.is_finite() { each } else { 40.0 };
    Fit {
        view,
        centre: ((x.0 + x.1) / 2.0, (y.0 + y.1) / 2.0),
        px_each,
        height: (MARGIN + (y.1 - y.0).abs() * px_each).clamp(LEAST_HEIGHT, HEIGHT),
    }
}

/// Values below which this share, and all but this share, lie. (∞, -∞) for an empty list.
fn quantiles(mut values: Vec<f64>, share: f64) -> (f64, f64) {
    values.retain(|value| value.is_finite());
    values.sort_by(f64::total_cmp);
    let Some(last) = values.len().checked_sub(1) else {
        return (f64::INFINITY, f64::NEG_INFINITY);
    };
    let cut = (last as f64 * share) as usize;
    (values[cut], values[last - cut])
}

pub(super) fn centre(frame: &Frame) -> Vec3 {
    let centre = frame.cam_from_world.centre();
    [centre.x, centre.y, centre.z]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn axes(up: Option<Vec3>, metres_per_unit: Option<f64>) -> Axes {
        Axes::new(&Scene {
            up,
            metres_per_unit,
            ..Scene::default()
        })
    }

    #[test]
    fn a_site_frame_has_north_at_the_top_and_east_at_the_right() {
        let site = axes(Some([0.0, 0.0, -1.0]), Some(1.0));
        assert_eq!((site.ahead, site.right), ([1.0, 0.0, 0.0], [0.0, 1.0, 0.0]));
        assert_eq!((site.ahead_name, site.right_name), ("north", "east"));
        let other = axes(Some([0.0, 0.0, -1.0]), None);
        assert_eq!(other.ahead_name, "y", "north is known in metres alone");
    }

    #[test]
    fn seen_from_above_right_ahead_and_up_are_a_right_handed_frame() {
        for up in [
            [0.0, 0.0, 1.0],
            [0.0, -1.0, 0.0],
            [0.3, 0.9, -0.2],
            [1.0, 0.0, 0.0],
            [0.0; 3],
            [f64::NAN; 3],
        ] {
            let axes = axes(Some(up), None);
            let turned = cross(axes.right, axes.ahead);
            let apart = sub(turned, axes.up);
            assert!(
                dot(apart, apart) < 1e-20,
                "{up:?}: {turned:?} is not {:?}",
                axes.up
            );
        }
    }

    #[test]
    fn quantiles_of_nothing_are_empty_and_stray_values_are_cut() {
        assert_eq!(quantiles(vec![], 0.1), (f64::INFINITY, f64::NEG_INFINITY));
        assert_eq!(quantiles(vec![7.0], 0.1), (7.0, 7.0));
        let values: Vec<f64> = (0..=100).map(f64::from).collect();
        assert_eq!(quantiles(values, 0.03), (3.0, 97.0));
    }
}
