//! Which points to keep where there are too many.

use super::pyramid::Grid;
use super::{Gray, Point};

/// Cells a side of the grid.
const SIDE: usize = 8;

/// A point as the choice sees it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Candidate {
    /// Place in the photo, in [0, 1).
    pub across: f32,
    pub down: f32,
    /// More is better.
    pub worth: f32,
}

/// Sets the rank of every point.
pub(super) fn rank<T>(points: &mut [Point], octaves: &[(Grid, T)], gray: &Gray) {
    let candidate = |point: &Point| {
        let [x_px, y_px] = octaves[point.octave].0.place_px(point.found.x, point.found.y);
        Candidate {
            across: x_px / gray.width as f32,
            down: y_px / gray.height as f32,
            worth: point.found.response,
        }
    };
    let ranks = ranks(&points.iter().map(candidate).collect::<Vec<_>>());
    points
        .iter_mut()
        .zip(ranks)
        .for_each(|(point, rank)| point.rank = rank);
}

/// Returns the rank of every point, 0 the first to keep: the best of each of 8 x 8 cells, then the second of each.
///
/// In a round the better comes first; ties go to the lower index.
pub(super) fn ranks(points: &[Candidate]) -> Vec<u32> {
    let cell = |point: &Candidate| {
        let at = |share: f32| ((share * SIDE as f32) as usize).min(SIDE - 1);
        at(point.down) * SIDE + at(point.across)
    };
    let mut order: Vec<usize> = (0..points.len()).collect();
    order.sort_by(|&a, &b| points[b].worth.total_cmp(&points[a].worth).then(a.cmp(&b)));
    let mut rounds = [0_u32; SIDE * SIDE];
    let mut turn: Vec<(u32, usize)> = Vec::with_capacity(points.len());
    for index in order {
        let round = &mut rounds[cell(&points[index])];
        turn.push((*round, index));
        *round += 1;
    }
    turn.sort_by_key(|&(round, _)| round);
    let mut ranks = vec![0; points.len()];
    turn.into_iter()
        .zip(0..)
        .for_each(|((_, index), rank)| ranks[index] = rank);
    ranks
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_best_of_every_cell_comes_before_the_second_of_any() {
        let point = |across, worth| Candidate {
            across,
            down: 0.5,
            worth,
        };
        let points = [
            point(0.01, 9.0),
            point(0.02, 8.0),
            point(0.99, 1.0),
            point(0.01, 8.0),
            point(1.5, 0.5),
        ];
        assert_eq!(ranks(&points), [0, 2, 1, 4, 3]);
        assert!(ranks(&[]).is_empty());
    }
}
