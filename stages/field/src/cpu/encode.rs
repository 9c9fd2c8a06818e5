//! Multiresolution hash grid: trilinear lookup and its transpose (instant-ngp, arXiv 2201.05989, section 3).

use super::simd::{
    Block, Checked, CheckedMut, Indices, Isa, Kernel, LANES, Stripe, Table, TableMut, flat, prefetch_all,
};

/// Multipliers of the spatial hash for y and z (instant-ngp, eq. 4). That of x is 1, so that neighbours share
/// lines.
pub const PRIMES: [u32; 2] = [2_654_435_761, 805_459_861];

/// Brings a table of at most [`WARMED_BYTES`] to the second cache, line after line: rows are then found there, or in the third,
/// and not fetched at random from memory. To be called before the first of many points is looked up or scattered.
pub fn warm(table: &[f32]) {
    if size_of_val(table) <= WARMED_BYTES {
        prefetch_all(table);
    }
}

/// One level of the grid.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shape {
    /// Cells a side. There are `resolution + 1` corners a side.
    pub resolution: u32,
    /// Entries of the table. A power of two where corners are hashed.
    pub entries: u32,
    /// Every corner has its own entry.
    pub dense: bool,
}

impl Shape {
    /// Returns the level of `resolution` cells a side with at most `2^log2_table` entries.
    pub fn new(resolution: u32, log2_table: u32) -> Self {
        let corners = (u64::from(resolution) + 1).pow(3);
        let table = 1_u64 << log2_table;
        let dense = corners <= table;
        Self {
            resolution,
            entries: corners.min(table) as u32,
            dense,
        }
    }
}

/// Tables above this size in bytes do not stay in the second cache (1 MB a core here): their rows are asked for
/// ahead. Below it, that costs 40 %.
const CACHED_BYTES: usize = 1 << 20;
/// Tables up to this size are prefetched whole, see [`warm`]. Of twice as much, too little stays until it is
/// read.
const WARMED_BYTES: usize = 2 * CACHED_BYTES;
/// Blocks of 16 points between asking for rows and reading them.
const AHEAD: usize = 3;
/// Blocks between computing corners and using them where nothing is asked for: hides the arithmetic's latency.
const NEXT: usize = 1;
/// Blocks that are remembered: more than [`AHEAD`], a power of two.
const RING: usize = 4;

/// Entries and weights of the 8 corners around 16 points. Corner = x + 2 y + 4 z.
#[derive(Clone, Copy)]
struct Corners {
    index: Indices,
    /// Weights of both neighbours along x.
    along: [Block; 2],
    /// Products of the weights along y and z, y + 2 z.
    across: [Block; 4],
}

/// Both neighbours of 16 coordinates on one axis: their part of the index, and their weights.
struct Axis<I: Isa> {
    part: [I::U; 2],
    weight: [I::V; 2],
}

impl<I: Isa> Axis<I> {
    /// Returns the two corners of a coordinate along an axis. `factor` is the axis' stride or prime.
    ///
    /// The last cell includes 1.0. NaN counts as 0.
    #[inline(always)]
    fn new(isa: I, at: &Block, resolution: u32, factor: u32) -> Self {
        let q = isa.mul(isa.unit(isa.load(at)), isa.splat(resolution as f32));
        let below = isa.min_u(isa.whole(q), isa.splat_u(resolution.saturating_sub(1)));
        let share = isa.sub(q, isa.float(below));
        let factor = isa.splat_u(factor);
        let part = isa.mul_u(below, factor);
        Self {
            part: [part, isa.add_u(part, factor)],
            weight: [isa.sub(isa.splat(1.0), share), share],
        }
    }
}

impl Corners {
    const ZERO: Self = Self {
        index: Indices::ZERO,
        along: [Block::ZERO; 2],
        across: [Block::ZERO; 4],
    };

    #[inline(always)]
    fn fill<I: Isa>(&mut self, isa: I, shape: &Shape, [x, y, z]: [&[f32; LANES]; 3]) {
        let side = shape.resolution + 1;
        let [row, slab] = if shape.dense { [side, side * side] } else { PRIMES };
        let x = Axis::new(isa, &Block(*x), shape.resolution, 1);
        let y = Axis::new(isa, &Block(*y), shape.resolution, row);
        let z = Axis::new(isa, &Block(*z), shape.resolution, slab);
        for side in 0..4 {
            let weight = isa.mul(y.weight[side & 1], z.weight[side >> 1]);
            isa.store(weight, &mut self.across[side]);
        }
        let mask = isa.splat_u(shape.entries.wrapping_sub(1));
        let mut index = [mask; 8];
        for corner in 0..8 {
            let (x, y, z) = (x.part[corner & 1], y.part[corner >> 1 & 1], z.part[corner >> 2]);
            index[corner] = if shape.dense {
                isa.add_u(x, isa.add_u(y, z))
            } else {
                isa.and_u(isa.xor_u(x, isa.xor_u(y, z)), mask)
            };
        }
        self.index.fill(isa, index);
        for dx in 0..2 {
            isa.store(x.weight[dx], &mut self.along[dx]);
        }
    }
}

/// Points in the unit box, one coordinate an array, lengths a multiple of 16.
#[derive(Clone, Copy)]
pub struct Points<'a> {
    /// x in [0, 1].
    pub x: &'a [f32],
    /// y in [0, 1].
    pub y: &'a [f32],
    /// z in [0, 1].
    pub z: &'a [f32],
}

impl<'a> Points<'a> {
    /// Returns the coordinates of 16 points at a time.
    #[inline(always)]
    fn blocks(self) -> [&'a [[f32; LANES]]; 3] {
        let [x, y, z] = [self.x, self.y, self.z];
        let blocks = (x.len() / LANES).min(y.len() / LANES).min(z.len() / LANES);
        [
            &x.as_chunks().0[..blocks],
            &y.as_chunks().0[..blocks],
            &z.as_chunks().0[..blocks],
        ]
    }
}

/// Looks up one level for all points and writes its features, `[n, F]`.
pub struct Lookup<'a, const F: usize> {
    /// The level.
    pub shape: Shape,
    /// `[entries, F]`.
    pub table: &'a [f32],
    /// The points.
    pub points: Points<'a>,
    /// Receives the features.
    pub to: Stripe<'a>,
}

impl<const F: usize> Kernel for Lookup<'_, F> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, isa: I) {
        if size_of_val(self.table) > CACHED_BYTES {
            self.pass::<I, AHEAD>(isa);
        } else {
            self.pass::<I, NEXT>(isa);
        }
    }
}

impl<const F: usize> Lookup<'_, F> {
    #[inline(always)]
    fn pass<I: Isa, const AHEAD: usize>(mut self, isa: I) {
        let table = Table(self.table.as_chunks::<F>().0);
        let ([x, y, z], mut ring) = (self.points.blocks(), [Corners::ZERO; RING]);
        for block in 0..x.len() + AHEAD {
            if block < x.len() {
                let here = &mut ring[block % RING];
                here.fill(isa, &self.shape, [&x[block], &y[block], &z[block]]);
                if AHEAD > NEXT {
                    table.prefetch(&here.index);
                }
            }
            let Some(block) = block.checked_sub(AHEAD) else {
                continue;
            };
            let corners = &ring[block % RING];
            let Some(entries) = table.check(&corners.index) else {
                return;
            };
            self.to.fill(block * LANES, |lane| corners.mean(&entries, lane));
        }
    }
}

impl Corners {
    /// Interpolates across y and z for either neighbour along x, then between the two.
    #[inline(always)]
    fn mean<const F: usize>(&self, entries: &Checked<F>, lane: usize) -> [f32; F] {
        let mut sums = [[0.0; F]; 2];
        for side in 0..4 {
            let weight = self.across[side].0[lane];
            for dx in 0..2 {
                let entry = entries.row(2 * side + dx, lane);
                for f in 0..F {
                    sums[dx][f] = weight.mul_add(entry[f], sums[dx][f]);
                }
            }
        }
        let [below, above] = [self.along[0].0[lane], self.along[1].0[lane]];
        let mut mean = [0.0; F];
        for f in 0..F {
            mean[f] = below.mul_add(sums[0][f], above * sums[1][f]);
        }
        mean
    }

    /// Adds what a gradient of the mean is for the 8 entries.
    #[inline(always)]
    fn spread<const F: usize>(&self, entries: &mut CheckedMut<F>, lane: usize, slope: [f32; F]) {
        let mut parts = [slope; 2];
        for dx in 0..2 {
            for f in 0..F {
                parts[dx][f] *= self.along[dx].0[lane];
            }
        }
        for side in 0..4 {
            let weight = self.across[side].0[lane];
            for dx in 0..2 {
                let entry = entries.row(2 * side + dx, lane);
                for f in 0..F {
                    entry[f] = weight.mul_add(parts[dx][f], entry[f]);
                }
            }
        }
    }
}

/// Adds the gradients of one level's features to its entries, point after point in order.
pub struct Scatter<'a, const F: usize> {
    /// The level.
    pub shape: Shape,
    /// `[entries, F]`, added to.
    pub gradient: &'a mut [f32],
    /// The points.
    pub points: Points<'a>,
    /// `[n, stride]` gradients of the features.
    pub rows: &'a [Block],
    /// Numbers from a row to the next.
    pub stride: usize,
    /// First feature of this level in the row.
    pub first: usize,
}

impl<const F: usize> Kernel for Scatter<'_, F> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, isa: I) {
        if size_of_val(self.gradient) > CACHED_BYTES {
            self.pass::<I, AHEAD>(isa);
        } else {
            self.pass::<I, NEXT>(isa);
        }
    }
}

impl<const F: usize> Scatter<'_, F> {
    #[inline(always)]
    fn pass<I: Isa, const AHEAD: usize>(self, isa: I) {
        let mut table = TableMut(self.gradient.as_chunks_mut::<F>().0);
        let row = self.stride;
        let rows = flat(self.rows);
        let ([x, y, z], mut ring) = (self.points.blocks(), [Corners::ZERO; RING]);
        for block in 0..x.len() + AHEAD {
            if block < x.len() {
                let here = &mut ring[block % RING];
                here.fill(isa, &self.shape, [&x[block], &y[block], &z[block]]);
                if AHEAD > NEXT {
                    table.prefetch(&here.index);
                }
            }
            let Some(block) = block.checked_sub(AHEAD) else {
                continue;
            };
            let corners = &ring[block % RING];
            let Some(mut entries) = table.check(&corners.index) else {
                return;
            };
            let rows = &rows[block * LANES * row..][..LANES * row];
            for lane in 0..LANES {
                let mut slope = [0.0; F];
                slope.copy_from_slice(&rows[lane * row + self.first..][..F]);
                corners.spread(&mut entries, lane, slope);
            }
        }
    }
}
