//! Walks along rays through occupied cells of the contracted box.

use super::clearance::Clearance;
use super::encode::Points;
use super::simd::{Block, Isa, Kernel, LANES};
use super::space::{Bits, contract};

/// Distances at which every ray is looked at, shared by all rays, in half sides of the box.
///
/// Step k begins at t_k and has the length max(shortest, cone t_k). Made in f64 by counting, so no ray can
/// stall where t + dt = t.
#[derive(Clone, Debug, PartialEq)]
pub struct Steps {
    /// Begin of a step, padded to a multiple of 16.
    pub begin: Vec<f32>,
    /// Length of a step. 0 in the padding.
    pub length: Vec<f32>,
    /// Steps without the padding.
    pub count: usize,
}

/// No table is longer, whatever the configuration.
pub const MOST_STEPS: usize = 1 << 15;

impl Steps {
    /// Steps from `near` to `far`.
    pub fn new(near: f64, far: f64, shortest: f64, cone: f64) -> Self {
        let (mut begin, mut length) = (Vec::new(), Vec::new());
        let mut t = near;
        while t < far && begin.len() < MOST_STEPS {
            let dt = (cone * t).max(shortest);
            begin.push(t as f32);
            length.push(dt as f32);
            t += dt;
        }
        let count = begin.len();
        let padded = count.next_multiple_of(LANES);
        begin.resize(padded, t as f32);
        length.resize(padded, 0.0);
        Self { begin, length, count }
    }
}

/// Samples of many rays, one array a number.
#[derive(Clone, Debug, Default)]
pub struct Samples {
    /// Position in the unit box.
    pub x: Vec<f32>,
    /// Position in the unit box.
    pub y: Vec<f32>,
    /// Position in the unit box.
    pub z: Vec<f32>,
    /// Distance from the camera, half sides.
    pub t: Vec<f32>,
    /// Length, contracted.
    pub delta: Vec<f32>,
    /// Number of the step as a share of all steps, in [0, 1].
    pub place: Vec<f32>,
}

impl Samples {
    /// Returns the number of samples.
    pub fn len(&self) -> usize {
        self.x.len()
    }

    /// Returns whether there is none.
    pub fn is_empty(&self) -> bool {
        self.x.is_empty()
    }

    /// Returns the positions.
    pub fn points(&self) -> Points<'_> {
        let (x, y, z) = (&self.x, &self.y, &self.z);
        Points { x, y, z }
    }

    /// Returns the arrays, in the order of the fields.
    #[inline(always)]
    pub fn arrays(&mut self) -> [&mut Vec<f32>; 6] {
        [
            &mut self.x,
            &mut self.y,
            &mut self.z,
            &mut self.t,
            &mut self.delta,
            &mut self.place,
        ]
    }

    /// Makes every array `len` long. New samples are at the origin and have no length.
    pub fn resize(&mut self, len: usize) {
        for array in self.arrays() {
            array.resize(len, 0.0);
        }
    }
}

/// Appends the samples of one ray that are in occupied cells.
pub struct March<'a> {
    /// Where to look.
    pub steps: &'a Steps,
    /// What is occupied.
    pub bits: &'a Bits,
    /// Its empty space, where whole blocks of steps are left out. Only with the steps of [`Steps::new`].
    pub clearance: Option<&'a Clearance>,
    /// Camera centre, half sides.
    pub origin: [f32; 3],
    /// Unit vector.
    pub direction: [f32; 3],
    /// Place within every step, in [0, 1).
    pub jitter: f32,
    /// First step, a multiple of 16.
    pub first: usize,
    /// Stops after the block of 16 steps in which this many samples are reached.
    pub limit: usize,
    /// Receives the samples.
    pub samples: &'a mut Samples,
}

impl Kernel for March<'_> {
    /// The step to continue from. `steps.begin.len()` or more at the end.
    type Output = usize;

    #[inline(always)]
    fn run<I: Isa>(mut self, isa: I) -> usize {
        let start = self.samples.len();
        let blocks = self.steps.begin.len() / LANES;
        for group in (self.first / LANES..blocks).step_by(LANES) {
            let mut near = self.near(isa, group);
            while near != 0 {
                let block = group + near.trailing_zeros() as usize;
                near &= near - 1;
                self.block(isa, block);
                if self.samples.len() - start >= self.limit {
                    return (block + 1) * LANES;
                }
            }
        }
        blocks * LANES
    }
}

/// Share of a distance along a ray that its rounding, and that of the middle of a block, amounts to at most.
const ROUNDING: f32 = 2.0 * f32::EPSILON;

impl March<'_> {
    /// Returns one bit for each of 16 blocks of steps: whether the ray may meet matter there.
    #[inline(always)]
    fn near<I: Isa>(&self, isa: I, first: usize) -> u32 {
        let begins = &self.steps.begin.as_chunks::<LANES>().0[first..];
        let lengths = &self.steps.length.as_chunks::<LANES>().0[first..];
        let all = (1 << begins.len().min(LANES)) - 1;
        let Some(clearance) = self.clearance else {
            return all;
        };
        let (mut middle, mut half) = (Block::ZERO, Block::ZERO);
        for (lane, (begin, length)) in begins.iter().zip(lengths).take(LANES).enumerate() {
            let end = begin[LANES - 1] + length[LANES - 1];
            middle.0[lane] = 0.5 * (begin[0] + end);
            half.0[lane] = ROUNDING.mul_add(end, 0.5 * (end - begin[0]));
        }
        let mut points = [Block::ZERO; 3];
        for axis in 0..3 {
            for lane in 0..LANES {
                points[axis].0[lane] = self.direction[axis].mul_add(middle.0[lane], self.origin[axis]);
            }
        }
        clearance.near(isa, &points, &half) & all
    }

    /// Appends the samples of a block of 16 steps.
    #[inline(always)]
    fn block<I: Isa>(&mut self, isa: I, block: usize) {
        let first = block * LANES;
        let begin = &self.steps.begin.as_chunks::<LANES>().0[block];
        let length = &self.steps.length.as_chunks::<LANES>().0[block];
        let ([mut x, mut y, mut z], [mut t, mut delta]) = ([Block::ZERO; 3], [Block::ZERO; 2]);
        for lane in 0..LANES {
            t.0[lane] = self.jitter.mul_add(length[lane], begin[lane]);
            let p = [0, 1, 2].map(|axis: usize| self.direction[axis].mul_add(t.0[lane], self.origin[axis]));
            let (u, shrink) = contract(p);
            delta.0[lane] = length[lane] * shrink;
            (x.0[lane], y.0[lane], z.0[lane]) = (u[0], u[1], u[2]);
        }
        let within = self.steps.count.saturating_sub(first).min(LANES);
        let hits = self.bits.hits(isa, [&x, &y, &z]) & ((1_u32 << within) - 1);
        if hits > 0 {
            let mut place = Block::ZERO;
            for lane in 0..LANES {
                place.0[lane] = ((first + lane) as f32 + self.jitter) / self.steps.count as f32;
            }
            self.samples.append(isa, [&x, &y, &z, &t, &delta, &place], hits);
        }
    }
}

impl Samples {
    /// Appends the lanes whose bit is set. The numbers are in the order of the arrays.
    #[inline(always)]
    fn append<I: Isa>(&mut self, isa: I, numbers: [&Block; 6], lanes: u32) {
        let len = self.x.len() + lanes.count_ones() as usize;
        for (array, numbers) in self.arrays().into_iter().zip(numbers) {
            // A whole block is appended, which is then the last chunk, and cut: a copy of fixed length has no loop.
            array.extend_from_slice(&Block::ZERO.0);
            if let Some(to) = array.last_chunk_mut() {
                isa.pack(isa.load(numbers), lanes as u16, to);
            }
            array.truncate(len);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cpu::simd::{InstructionSet, Run};
    use crate::rng::{Purpose, random_numbers};

    fn full(side: u32) -> Bits {
        let mut bits = Bits::new(side);
        bits.words.fill(u64::MAX);
        bits
    }

    fn walk(steps: &Steps, bits: &Bits, origin: [f32; 3], direction: [f32; 3]) -> Samples {
        let mut samples = Samples::default();
        let end = InstructionSet::best().run(March {
            clearance: None,
            steps,
            bits,
            origin,
            direction,
            jitter: 0.5,
            first: 0,
            limit: usize::MAX,
            samples: &mut samples,
        });
        assert_eq!(end, steps.begin.len());
        samples
    }

    #[test]
    fn steps_grow_with_the_distance_and_their_number_is_bounded() {
        let steps = Steps::new(0.5, 8.0, 0.1, 0.25);
        assert_eq!(steps.begin[0], 0.5);
        assert_eq!(steps.length[0], 0.125);
        assert_eq!(
            steps.length[steps.count..],
            vec![0.0; steps.begin.len() - steps.count]
        );
        // At t = 1e5 a step of sqrt(3) / 1024 is lost in f32. The table counts in f64 and ends.
        let far = Steps::new(1e5, 1e5 + 10.0, 3.0_f64.sqrt() / 1024.0, 0.0);
        assert_eq!(far.count, 5913);
        assert_eq!(Steps::new(1.0, f64::MAX, 1e-4, 0.0).count, MOST_STEPS);
        // near = far: no step.
        assert_eq!(Steps::new(2.0, 2.0, 0.1, 0.1).count, 0);
    }

    #[test]
    fn rays_parallel_to_a_face_on_a_face_or_far_away_end_and_stay_in_the_box() {
        let (steps, bits) = (Steps::new(0.1, 512.0, 0.05, 0.05), full(16));
        let origins = [
            [1.0, 0.0, 0.0],
            [0.0; 3],
            [-1.0, 1.0, 1.0],
            [1e5, 0.0, 3.0],
            [-2e5, 7.0, 1e5],
        ];
        let directions = [
            [1.0, 0.0, 0.0],
            [0.0, -1.0, 0.0],
            [0.0, 0.0, 1.0],
            [0.6, 0.0, -0.8],
        ];
        for origin in origins {
            for direction in directions {
                let samples = walk(&steps, &bits, origin, direction);
                assert_eq!(samples.len(), steps.count, "{origin:?} {direction:?}");
                let all = samples.x.iter().chain(&samples.y).chain(&samples.z);
                assert!(
                    all.clone().all(|u| (0.0..=1.0).contains(u)),
                    "{origin:?} {direction:?}"
                );
                assert!(
                    samples.delta.iter().all(|delta| *delta > 0.0),
                    "{origin:?} {direction:?}"
                );
            }
        }
    }

    #[test]
    fn empty_cells_give_no_sample_and_a_single_cell_gives_its_own() {
        let steps = Steps::new(0.01, 4.0, 0.01, 0.0);
        let mut bits = Bits::new(16);
        assert_eq!(walk(&steps, &bits, [-1.5, 0.05, 0.05], [1.0, 0.0, 0.0]).len(), 0);
        // The cell right of the centre: contracted x in [0.5, 0.5625], world x in [0, 0.25].
        bits.set((8 * 16 + 8) * 16 + 8);
        let found = walk(&steps, &bits, [-1.0, 0.05, 0.05], [1.0, 0.0, 0.0]);
        assert_eq!(found.len(), 25);
        assert!(found.t.iter().all(|t| (1.0..1.25).contains(t)), "{:?}", found.t);
    }

    #[test]
    fn a_walk_past_empty_space_finds_what_a_walk_through_it_finds() {
        let mut rng = random_numbers(5, Purpose::Rays, 0, 1);
        let (mut found_any, mut found_none) = (0, 0);
        for (near, shortest, cone, share) in [
            (0.05, 0.002, 0.001, 1e-3),
            (0.05, 0.02, 0.02, 1e-4),
            (0.5, 0.3, 0.25, 1e-2),
            (0.05, 0.02, 0.02, 0.0),
            (0.05, 0.02, 0.02, 1.0),
        ] {
            let (steps, mut bits) = (Steps::new(near, 400.0, shortest, cone), Bits::new(32));
            for cell in 0..32_usize.pow(3) {
                if rng.unit_f32() < share {
                    bits.set(cell);
                }
            }
            let clearance = Clearance::new(&bits);
            for (level, _) in InstructionSet::all().into_iter().cycle().zip(0..100) {
                let reach = [0.5, 3.0, 40.0, 300.0][rng.below(4) as usize];
                let mut number = |size: f32| size * (2.0 * rng.unit_f32() - 1.0);
                let (origin, toward) = ([0; 3].map(|_| number(reach)), [0; 3].map(|_| number(1.0)));
                let norm = toward.iter().map(|axis| axis * axis).sum::<f32>().sqrt();
                let (direction, jitter) = (toward.map(|axis| axis / norm), rng.unit_f32());
                let [all, past] = [None, Some(&clearance)].map(|clearance| {
                    let mut samples = Samples::default();
                    let end = level.run(March {
                        clearance,
                        steps: &steps,
                        bits: &bits,
                        origin,
                        direction,
                        jitter,
                        first: 0,
                        limit: usize::MAX,
                        samples: &mut samples,
                    });
                    assert_eq!(end, steps.begin.len());
                    (samples.t, samples.x, samples.delta)
                });
                assert_eq!(past, all, "share {share}, {origin:?} to {direction:?}");
                *(if all.0.is_empty() {
                    &mut found_none
                } else {
                    &mut found_any
                }) += 1;
            }
        }
        assert!(found_any > 80 && found_none > 100, "{found_any} {found_none}");
    }

    #[test]
    fn a_walk_in_rounds_finds_what_a_walk_at_once_finds() {
        let (steps, bits) = (Steps::new(0.1, 64.0, 0.02, 0.03), full(16));
        let whole = walk(&steps, &bits, [0.1; 3], [0.0, 0.6, 0.8]);
        let (mut parts, mut first) = (Samples::default(), 0);
        while first < steps.begin.len() {
            let (origin, direction, samples) = ([0.1; 3], [0.0, 0.6, 0.8], &mut parts);
            let (steps, bits, jitter, limit) = (&steps, &bits, 0.5, 8);
            first = InstructionSet::best().run(March {
                clearance: None,
                steps,
                bits,
                origin,
                direction,
                jitter,
                first,
                limit,
                samples,
            });
        }
        assert_eq!(parts.t, whole.t);
    }
}
