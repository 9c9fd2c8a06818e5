//! Semi-global matching: costs summed along eight directions (Hirschmueller, PAMI 2008).

use marf_numeric::InstructionSet;

use crate::cost::{BLOCK, COST_MAX, Volume};
use crate::kernel::{self, Kernel};
use crate::raster::Raster;

/// Room on both sides of the costs of a path: disparities that a neighbour does not have.
const MARGIN: usize = 40;

/// Paths of a half: from the left, from the left above, from above, from the right above.
const PATHS: usize = 4;

/// What a change of the disparity from one pixel to the next costs.
#[derive(Debug, Clone)]
pub(crate) struct Penalties {
    /// By one pixel.
    one: u8,
    /// By more, where brightness changes by 0 to 255.
    more: [u8; 256],
}

impl Penalties {
    /// A jump costs `flat` in even brightness. It falls to `edge`, by half where brightness changes by `half_at`.
    pub fn new(one: u8, flat: u8, edge: u8, half_at: u16) -> Self {
        let more = std::array::from_fn(|change| {
            let fall = u16::from(flat - edge) * half_at / (half_at + change as u16);
            (edge + fall as u8).min(u8::MAX - COST_MAX)
        });
        Self { one, more }
    }
}

/// Which half of the eight directions.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Sweep {
    /// From the left and from above.
    Down,
    /// From the right and from below.
    Up,
}

/// Path costs of each half of the directions, each the mean of four. `[height x width x candidates]`.
pub(crate) struct PathCosts {
    pub down: Vec<u8>,
    pub up: Vec<u8>,
}

/// Returns the path costs of a volume.
///
/// L(p, d) = C(p, d) + min(L(q, d), L(q, d +- 1) + P1, min L(q) + P2) - min L(q), where q is the pixel before p on the
/// path and P2 falls with the difference of their brightness. L is at most [`COST_MAX`] + P2, which fits a byte.
pub(crate) fn path_costs(
    set: InstructionSet,
    volume: &Volume,
    grey: &Raster<u8>,
    penalties: &Penalties,
) -> PathCosts {
    let half = |sweep| {
        kernel::run(
            set,
            Half {
                volume,
                grey,
                penalties,
                sweep,
            },
        )
    };
    let (down, up) = rayon::join(|| half(Sweep::Down), || half(Sweep::Up));
    PathCosts { down, up }
}

struct Half<'a> {
    volume: &'a Volume,
    grey: &'a Raster<u8>,
    penalties: &'a Penalties,
    sweep: Sweep,
}

/// Path costs of the pixels of one row, with a pixel more on each side.
struct PathRow {
    /// `[(width + 2) x PATHS x stride]`.
    costs: Vec<u8>,
    /// The least cost of each path. `[(width + 2) x PATHS]`.
    least: Vec<u8>,
    stride: usize,
}

impl PathRow {
    /// Costs of zero: a path that starts costs nothing.
    fn new(width: usize, candidates: usize) -> Self {
        let stride = candidates + 2 * MARGIN;
        let paths = (width + 2) * PATHS;
        let mut costs = vec![u8::MAX; paths * stride];
        for path in costs.chunks_exact_mut(stride) {
            path[MARGIN..MARGIN + candidates].fill(0);
        }
        Self {
            costs,
            least: vec![0; paths],
            stride,
        }
    }
}

/// The step from the pixel before.
#[derive(Clone, Copy)]
struct Link {
    /// By how much the first candidate is higher than that of the pixel before.
    shift: i32,
    /// The penalty of a jump.
    jump: u8,
}

/// The pixel before on a path.
struct Before<'a> {
    /// Its costs at the candidates of the pixel, with one more on each side.
    costs: &'a [u8],
    least: u8,
    /// The least cost and a jump.
    cap: u8,
    /// 255 if the two pixels have no candidate in common.
    apart: u8,
}

impl<'a> Before<'a> {
    #[inline(always)]
    fn new(costs: &'a [u8], least: u8, link: Link) -> Self {
        let apart = link.shift.unsigned_abs() as usize >= MARGIN;
        let start = if apart {
            MARGIN as i32
        } else {
            MARGIN as i32 + link.shift
        } as usize;
        let costs = &costs[start - 1..start + 1 + costs.len() - 2 * MARGIN];
        Self {
            costs,
            least,
            cap: least + link.jump,
            apart: if apart { u8::MAX } else { 0 },
        }
    }

    /// Returns the path costs of the k-th block of candidates.
    #[inline(always)]
    fn block(&self, k: usize, own: &[u8; BLOCK], one: u8) -> [u8; BLOCK] {
        let costs = &self.costs[k * BLOCK..k * BLOCK + BLOCK + 2];
        let mut out = [0; BLOCK];
        for i in 0..BLOCK {
            let side = costs[i].min(costs[i + 2]).saturating_add(one);
            let best = (costs[i + 1].min(side) | self.apart).min(self.cap);
            out[i] = own[i].wrapping_add(best.wrapping_sub(self.least));
        }
        out
    }
}

impl Kernel for Half<'_> {
    type Output = Vec<u8>;

    #[inline(always)]
    fn run(self) -> Vec<u8> {
        let Volume {
            width,
            height,
            candidates,
            ..
        } = *self.volume;
        let mut sums = vec![0; width * height * candidates];
        let mut above = PathRow::new(width, candidates);
        let mut row = PathRow::new(width, candidates);
        for step in 0..height {
            for s in 0..width {
                let n = step * width + s;
                let here = self.visited(n) * candidates;
                self.pixel(n, &above, &mut row, &mut sums[here..here + candidates]);
            }
            std::mem::swap(&mut above, &mut row);
        }
        sums
    }
}

impl Half<'_> {
    /// Returns the pixel that is visited as the n-th.
    #[inline(always)]
    fn visited(&self, n: usize) -> usize {
        match self.sweep {
            Sweep::Down => n,
            Sweep::Up => self.grey.values.len() - 1 - n,
        }
    }

    /// Returns the step from the pixel that was visited `back` before the n-th.
    #[inline(always)]
    fn link(&self, n: usize, back: usize, inside: bool) -> Link {
        if !inside {
            return Link {
                shift: 0,
                jump: self.penalties.more[0],
            };
        }
        let (here, there) = (self.visited(n), self.visited(n - back));
        let change = self.grey.values[here].abs_diff(self.grey.values[there]);
        let first = &self.volume.first.values;
        Link {
            shift: first[here] - first[there],
            jump: self.penalties.more[usize::from(change)],
        }
    }

    /// Computes the four paths of the n-th pixel, and their mean.
    #[inline(always)]
    fn pixel(&self, n: usize, above: &PathRow, row: &mut PathRow, mean: &mut [u8]) {
        let Volume {
            width, candidates, ..
        } = *self.volume;
        let (s, up, stride) = (n % width, n >= width, row.stride);
        let here = self.visited(n) * candidates;
        let (own, _) = self.volume.costs[here..here + candidates].as_chunks::<BLOCK>();

        let slot = (s + 1) * PATHS;
        let (done, now) = row.costs.split_at_mut(slot * stride);
        let path = |at: usize| at * stride..(at + 1) * stride;
        let at = [slot - PATHS, slot - PATHS + 1, slot + 2, slot + PATHS + 3];
        let before = [
            Before::new(&done[path(at[0])], row.least[at[0]], self.link(n, 1, s > 0)),
            Before::new(
                &above.costs[path(at[1])],
                above.least[at[1]],
                self.link(n, width + 1, up && s > 0),
            ),
            Before::new(
                &above.costs[path(at[2])],
                above.least[at[2]],
                self.link(n, width, up),
            ),
            Before::new(
                &above.costs[path(at[3])],
                above.least[at[3]],
                self.link(n, width - 1, up && s + 1 < width),
            ),
        ];

        let mut least = [[u8::MAX; BLOCK]; PATHS];
        for (k, (own, mean)) in own.iter().zip(mean.as_chunks_mut::<BLOCK>().0).enumerate() {
            let blocks: [_; PATHS] = std::array::from_fn(|p| before[p].block(k, own, self.penalties.one));
            for (p, block) in blocks.iter().enumerate() {
                let start = p * stride + MARGIN + k * BLOCK;
                now[start..start + BLOCK].copy_from_slice(block);
                for i in 0..BLOCK {
                    least[p][i] = least[p][i].min(block[i]);
                }
            }
            for i in 0..BLOCK {
                let left = average(blocks[0][i], blocks[1][i]);
                mean[i] = average(left, average(blocks[2][i], blocks[3][i]));
            }
        }
        for (p, least) in least.iter().enumerate() {
            row.least[slot + p] = least.iter().fold(u8::MAX, |least, &cost| least.min(cost));
        }
    }
}

/// Returns the mean of two bytes, halves rounded up.
#[inline(always)]
fn average(a: u8, b: u8) -> u8 {
    (u16::from(a) + u16::from(b)).div_ceil(2) as u8
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn a_jump_costs_less_where_brightness_changes_and_always_fits_a_byte() {
        let penalties = Penalties::new(8, 96, 24, 8);
        // 24 + 72 x 8 / (8 + change), rounded down.
        assert_eq!(
            [0, 8, 64, 255].map(|change: usize| penalties.more[change]),
            [96, 60, 32, 26]
        );
        assert_eq!(Penalties::new(8, 255, 255, 8).more[0], u8::MAX - COST_MAX);
    }

    /// Path costs of one direction, by the formula alone.
    fn by_formula(volume: &Volume, grey: &Raster<u8>, penalties: &Penalties, [dx, dy]: [i64; 2]) -> Vec<i64> {
        let (width, height, n) = (
            volume.width as i64,
            volume.height as i64,
            volume.candidates as i64,
        );
        let mut costs = vec![0i64; volume.costs.len()];
        let rows: Vec<i64> = if dy >= 0 {
            (0..height).collect()
        } else {
            (0..height).rev().collect()
        };
        for y in rows {
            let columns: Vec<i64> = if dx >= 0 {
                (0..width).collect()
            } else {
                (0..width).rev().collect()
            };
            for x in columns {
                let (bx, by) = (x - dx, y - dy);
                let here = y * width + x;
                for i in 0..n {
                    let own = i64::from(volume.costs[(here * n + i) as usize]);
                    let mut extra = 0;
                    if bx >= 0 && by >= 0 && bx < width && by < height {
                        let there = by * width + bx;
                        let before = &costs[(there * n) as usize..((there + 1) * n) as usize];
                        let least = *before.iter().min().unwrap();
                        let shift = volume.first.values[here as usize] - volume.first.values[there as usize];
                        let at = |j: i64| usize::try_from(j).ok().and_then(|j| before.get(j)).copied();
                        let j = i + i64::from(shift);
                        let change = grey.values[here as usize].abs_diff(grey.values[there as usize]);
                        let one = i64::from(penalties.one);
                        let mut best = least + i64::from(penalties.more[usize::from(change)]);
                        for (j, penalty) in [(j, 0), (j - 1, one), (j + 1, one)] {
                            best = best.min(at(j).map_or(i64::MAX, |cost| cost + penalty));
                        }
                        extra = best - least;
                    }
                    costs[(here * n + i) as usize] = own + extra;
                }
            }
        }
        costs
    }

    fn any_volume() -> impl Strategy<Value = (Volume, Raster<u8>)> {
        (1usize..7, 1usize..5).prop_flat_map(|(width, height)| {
            let pixels = width * height;
            let costs = prop::collection::vec(0..=COST_MAX, pixels * BLOCK);
            let first = prop::collection::vec(prop_oneof![-2i32..3, -40i32..40], pixels);
            let grey = prop::collection::vec(any::<u8>(), pixels);
            (costs, first, grey).prop_map(move |(costs, first, grey)| {
                let first = Raster {
                    width,
                    height,
                    values: first,
                };
                (
                    Volume {
                        width,
                        height,
                        candidates: BLOCK,
                        first,
                        costs,
                        usable: [(); 2].map(|()| Raster::filled(width, height, true)),
                    },
                    Raster {
                        width,
                        height,
                        values: grey,
                    },
                )
            })
        })
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        #[test]
        fn path_costs_are_those_of_the_formula_on_every_set((volume, grey) in any_volume()) {
            let penalties = Penalties::new(5, 90, 20, 8);
            let mean = |directions: [[i64; 2]; PATHS]| -> Vec<u8> {
                let paths = directions.map(|direction| by_formula(&volume, &grey, &penalties, direction));
                let pair = |a: i64, b: i64| (a + b + 1) / 2;
                let sums = (0..volume.costs.len()).map(|i| {
                    pair(pair(paths[0][i], paths[1][i]), pair(paths[2][i], paths[3][i]))
                });
                sums.map(|mean| u8::try_from(mean).unwrap()).collect()
            };
            let down = mean([[1, 0], [1, 1], [0, 1], [-1, 1]]);
            let up = mean([[-1, 0], [-1, -1], [0, -1], [1, -1]]);
            for set in InstructionSet::all() {
                let found = path_costs(set, &volume, &grey, &penalties);
                prop_assert!(found.down == down, "{:?}", set);
                prop_assert!(found.up == up, "{:?}", set);
            }
        }
    }
}
