//! Which keypoints to keep where there are too many.

use super::extrema::Extremum;
use super::gray::Gray;
use super::pyramid::OctaveGrid;

/// Cells a side of the grid.
const SIDE: usize = 8;

/// An extremum found in an octave, before it is known whether it is kept.
pub(super) struct Candidate {
    pub octave: usize,
    pub extremum: Extremum,
    /// 0 is kept first.
    pub rank: u32,
}

/// What decides the rank of a keypoint.
#[derive(Debug, Clone, Copy)]
struct Score {
    /// Position in the photo, in [0, 1).
    across: f32,
    down: f32,
    response: f32,
    scale_px: f32,
}

/// Sets the rank of every candidate. 0 is kept first.
///
/// Two orders are interleaved: by strength within each of 8 x 8 cells (the strongest of every cell, then the second
/// of every cell, and so on), and by scale. Measured with 1,000 features of each of the 98 reference photos: strength
/// alone gave 322 pairs with 15 right matches and 33,000 observations in tracks, scale alone 313 and 35,200,
/// interleaved 319 and 34,400.
pub(super) fn rank<T>(points: &mut [Candidate], octaves: &[(OctaveGrid, T)], gray: &Gray) {
    let score = |point: &Candidate| {
        let grid = &octaves[point.octave].0;
        let [x_px, y_px] = grid.position_px(point.extremum.x, point.extremum.y);
        Score {
            across: x_px / gray.width as f32,
            down: y_px / gray.height as f32,
            response: point.extremum.response,
            scale_px: grid.step_px * point.extremum.sigma,
        }
    };
    let scores: Vec<Score> = points.iter().map(score).collect();
    let order = interleaved(&by_cells(&scores), &by(&scores, |point| point.scale_px));
    order
        .into_iter()
        .zip(0..)
        .for_each(|(index, rank)| points[index].rank = rank);
}

/// Returns all indices, the greatest value first, ties by index.
fn by(points: &[Score], value: fn(&Score) -> f32) -> Vec<usize> {
    let mut order: Vec<usize> = (0..points.len()).collect();
    order.sort_by(|&a, &b| value(&points[b]).total_cmp(&value(&points[a])).then(a.cmp(&b)));
    order
}

/// Returns all indices, the strongest of every cell first, then the second of every cell. Within a round the stronger
/// comes first.
fn by_cells(points: &[Score]) -> Vec<usize> {
    let at = |share: f32| ((share * SIDE as f32) as usize).min(SIDE - 1);
    let mut rounds = [0_u32; SIDE * SIDE];
    let mut round_of = |index: usize| {
        let round = &mut rounds[at(points[index].down) * SIDE + at(points[index].across)];
        *round += 1;
        (*round, index)
    };
    let mut by_round: Vec<(u32, usize)> = by(points, |point| point.response)
        .into_iter()
        .map(&mut round_of)
        .collect();
    by_round.sort_by_key(|&(round, _)| round);
    by_round.into_iter().map(|(_, index)| index).collect()
}

/// Interleaves two orders of the same indices. Each index stays where it first appears.
fn interleaved(a: &[usize], b: &[usize]) -> Vec<usize> {
    let mut seen = vec![false; a.len()];
    let both = a.iter().zip(b).flat_map(|(&a, &b)| [a, b]);
    both.filter(|&index| !std::mem::replace(&mut seen[index], true))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_strongest_of_every_cell_comes_before_the_second_of_any() {
        let point = |across, response| Score {
            across,
            down: 0.5,
            response,
            scale_px: 2.0,
        };
        let points = [
            point(0.01, 9.0),
            point(0.02, 8.0),
            point(0.99, 1.0),
            point(0.01, 8.0),
            point(1.5, 0.5),
        ];
        assert_eq!(by_cells(&points), [0, 2, 1, 4, 3]);
        assert!(by_cells(&[]).is_empty());
    }

    #[test]
    fn two_orders_are_interleaved_and_no_index_comes_twice() {
        assert_eq!(interleaved(&[0, 1, 2, 3], &[3, 0, 2, 1]), [0, 3, 1, 2]);
        assert!(interleaved(&[], &[]).is_empty());
    }
}
