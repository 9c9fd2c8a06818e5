//! How far the maps of a viewpoint reach: what decides the ends of their colour scales.

use marf_scene::picture::quantile;

use super::maps::Maps;

/// Share of the pixels within a colour scale. Values above have the top colour, and the label says so.
const WITHIN: f64 = 0.95;

/// Values that most pixels of a viewpoint do not exceed. Lengths are in world units, the rest is sRGB with white = 1, or photos.
///
/// Only pixels that photos saw count. What none saw is as uncertain as can be, and a scale for it would leave the others one colour.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct Reach {
    pub std: f64,
    /// Of [`Maps::local_spread`].
    pub local_spread: f64,
    pub residual: f64,
    pub total: f64,
    pub depth: f64,
    pub depth_std: f64,
    pub error: f64,
    pub photos: f64,
}

impl Reach {
    /// Returns the reach of a viewpoint, with the errors of its pixels if a photo was held out. If photos saw none of its pixels, all count.
    pub fn new(maps: &Maps, error: &[f32]) -> Self {
        let pixels = 0..maps.std.len();
        let mut counted: Vec<usize> = pixels.clone().filter(|pixel| maps.is_seen(*pixel)).collect();
        if counted.is_empty() {
            counted.extend(pixels);
        }
        let top = |map: &[f32]| {
            let values: Vec<f32> = counted
                .iter()
                .filter_map(|pixel| map.get(*pixel).copied())
                .collect();
            f64::from(quantile(&values, WITHIN))
        };
        Self {
            std: top(&maps.std),
            local_spread: top(&maps.local_spread()),
            residual: top(&maps.residual),
            total: top(&maps.total),
            depth: top(&maps.depth),
            depth_std: top(&maps.depth_std),
            error: top(error),
            photos: top(&maps.photos),
        }
    }

    /// Returns the larger of each.
    pub fn max(self, other: &Self) -> Self {
        Self {
            std: self.std.max(other.std),
            local_spread: self.local_spread.max(other.local_spread),
            residual: self.residual.max(other.residual),
            total: self.total.max(other.total),
            depth: self.depth.max(other.depth),
            depth_std: self.depth_std.max(other.depth_std),
            error: self.error.max(other.error),
            photos: self.photos.max(other.photos),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::maps::tests::{example, maps_of};
    use super::*;

    /// Of four pixels the last was seen by no photo: its total of 0.85 decides nothing, and 0.0433 is the largest of the others.
    #[test]
    fn what_no_photo_saw_does_not_set_the_top() {
        let maps = maps_of(&example());
        let reach = Reach::new(&maps, &[0.01, 0.02, 0.03, 0.9]);
        let wanted = [
            (reach.total, 0.043_301),
            (reach.std, 0.048_990),
            (reach.error, 0.03),
        ];
        for (found, wanted) in wanted {
            assert!((found - wanted).abs() < 6e-7, "{found}, not {wanted}: {reach:?}");
        }
        assert_eq!((reach.depth, reach.photos), (3.5, 3.0));
    }

    #[test]
    fn of_a_view_that_no_photo_saw_all_pixels_count() {
        let mut maps = maps_of(&example());
        maps.unseen.fill(1.0);
        let reach = Reach::new(&maps, &[]);
        assert!((reach.total - 0.850_176).abs() < 6e-7, "{reach:?}");
        assert_eq!(reach.error, 0.0, "no photo");
    }

    /// 0.01 to 1.00 in steps: 95 of the 100 do not exceed 0.95, or its neighbour by the rounding of the quantile.
    #[test]
    fn a_twentieth_of_the_pixels_is_above() {
        let mut maps = maps_of(&example());
        maps.total = (1..=100).map(|step| step as f32 / 100.0).collect();
        maps.std = vec![0.0; 100];
        maps.unseen = vec![0.0; 100];
        let reach = Reach::new(&maps, &[]);
        let above = maps
            .total
            .iter()
            .filter(|total| f64::from(**total) > reach.total)
            .count();
        assert_eq!(above, 5, "{reach:?}");
        assert_eq!(
            reach
                .max(&Reach {
                    total: 2.0,
                    ..Reach::default()
                })
                .total,
            2.0
        );
    }
}
