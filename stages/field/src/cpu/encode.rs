//! Multiresolution hash grid: trilinear lookup and its transpose (instant-ngp, arXiv 2201.05989, section 3).

use super::simd::{Block, Isa, Kernel, LANES, Stripe, flat};

/// Multipliers of the spatial hash for y and z (instant-ngp, eq. 4); x has 1, so that neighbours share lines.
const PRIMES: [u32; 2] = [2_654_435_761, 805_459_861];

/// One level of the grid.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shape {
    /// Cells a side; there are `resolution + 1` corners a side.
    pub resolution: u32,
    /// Entries of the table; a power of two where corners are hashed.
    pub entries: u32,
    /// Every corner has its own entry.
    pub dense: bool,
}

impl Shape {
    /// The level of `resolution` cells a side with at most `2^log2_table` entries.
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

/// Entries and weights of the 8 corners around 16 points.
#[repr(align(64))]
struct Corners {
    index: [[u32; LANES]; 8],
    weight: [[f32; LANES]; 8],
}

/// Both neighbours of 16 coordinates on one axis: their part of the index, and their weights.
#[repr(align(64))]
struct Axis {
    part: [[u32; LANES]; 2],
    weight: [[f32; LANES]; 2],
}

impl Axis {
    const EMPTY: Self = Self {
        part: [[0; LANES]; 2],
        weight: [[0.0; LANES]; 2],
    };

    /// The last cell takes 1.0; NaN counts as 0. `factor` is the axis' stride or prime.
    #[inline(always)]
    fn fill(&mut self, at: &[f32; LANES], resolution: u32, factor: u32) {
        let (scale, last) = (resolution as f32, resolution as i32 - 1);
        for lane in 0..LANES {
            let x = if at[lane] > 0.0 { at[lane] } else { 0.0 };
            let q = (if x < 1.0 { x } else { 1.0 }) * scale;
            let below = (q as i32).min(last);
            let share = q - below as f32;
            self.part[0][lane] = (below as u32).wrapping_mul(factor);
            self.part[1][lane] = (below as u32).wrapping_mul(factor).wrapping_add(factor);
            self.weight[0][lane] = 1.0 - share;
            self.weight[1][lane] = share;
        }
    }
}

impl Corners {
    const EMPTY: Self = Self {
        index: [[0; LANES]; 8],
        weight: [[0.0; LANES]; 8],
    };

    #[inline(always)]
    fn fill(&mut self, shape: &Shape, xyz: [&[f32; LANES]; 3]) {
        let side = shape.resolution + 1;
        let factors = if shape.dense {
            [1, side, side * side]
        } else {
            [1, PRIMES[0], PRIMES[1]]
        };
        let mut axes = [Axis::EMPTY; 3];
        for axis in 0..3 {
            axes[axis].fill(xyz[axis], shape.resolution, factors[axis]);
        }
        let [x, y, z] = &axes;
        let mask = shape.entries.wrapping_sub(1);
        for corner in 0..8 {
            let (dx, dy, dz) = (corner & 1, (corner >> 1) & 1, corner >> 2);
            let (index, weight) = (&mut self.index[corner], &mut self.weight[corner]);
            for lane in 0..LANES {
                weight[lane] = x.weight[dx][lane] * y.weight[dy][lane] * z.weight[dz][lane];
            }
            if shape.dense {
                for lane in 0..LANES {
                    index[lane] = x.part[dx][lane]
                        .wrapping_add(y.part[dy][lane])
                        .wrapping_add(z.part[dz][lane]);
                }
            } else {
                for lane in 0..LANES {
                    index[lane] = (x.part[dx][lane] ^ y.part[dy][lane] ^ z.part[dz][lane]) & mask;
                }
            }
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
    /// Returns 16 points at a time.
    #[inline(always)]
    fn blocks(self) -> impl Iterator<Item = [&'a [f32; LANES]; 3]> {
        let (x, y, z) = (
            self.x.as_chunks::<LANES>().0,
            self.y.as_chunks::<LANES>().0,
            self.z.as_chunks::<LANES>().0,
        );
        x.iter().zip(y).zip(z).map(|((x, y), z)| [x, y, z])
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
    fn run<I: Isa>(mut self, _isa: I) {
        let table = self.table.as_chunks::<F>().0;
        let mut found = Corners::EMPTY;
        for (block, xyz) in self.points.blocks().enumerate() {
            found.fill(&self.shape, xyz);
            let mut sums = [[0.0; F]; LANES];
            for lane in 0..LANES {
                for corner in 0..8 {
                    let entry = &table[found.index[corner][lane] as usize];
                    let weight = found.weight[corner][lane];
                    for f in 0..F {
                        sums[lane][f] = weight.mul_add(entry[f], sums[lane][f]);
                    }
                }
            }
            self.to.set(block * LANES, &sums);
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
    /// `[n, width]` gradients of the features.
    pub rows: &'a [Block],
    /// Blocks a row.
    pub width: usize,
    /// First feature of this level in the row.
    pub first: usize,
}

impl<const F: usize> Kernel for Scatter<'_, F> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, _isa: I) {
        let gradient = self.gradient.as_chunks_mut::<F>().0;
        let row = self.width * LANES;
        let rows = flat(self.rows).chunks_exact(row * LANES);
        let mut found = Corners::EMPTY;
        for (xyz, rows) in self.points.blocks().zip(rows) {
            found.fill(&self.shape, xyz);
            for lane in 0..LANES {
                let mut d = [0.0; F];
                d.copy_from_slice(&rows[lane * row + self.first..][..F]);
                for corner in 0..8 {
                    let entry = &mut gradient[found.index[corner][lane] as usize];
                    let weight = found.weight[corner][lane];
                    for f in 0..F {
                        entry[f] = weight.mul_add(d[f], entry[f]);
                    }
                }
            }
        }
    }
}
