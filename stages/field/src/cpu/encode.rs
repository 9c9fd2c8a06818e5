//! Multiresolution hash grid: trilinear lookup and its transpose (instant-ngp, arXiv 2201.05989, section 3).

use super::simd::{Block, Isa, Kernel, LANES, flat, flat_mut};

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
struct Corners {
    index: [[u32; LANES]; 8],
    weight: [[f32; LANES]; 8],
}

/// Cell and share of one coordinate; the last cell takes 1.0, NaN counts as 0.
#[inline(always)]
fn cells(at: &[f32; LANES], resolution: u32) -> ([u32; LANES], [f32; LANES]) {
    let scale = resolution as f32;
    let (mut cell, mut share) = ([0; LANES], [0.0; LANES]);
    for lane in 0..LANES {
        let x = if at[lane] > 0.0 { at[lane] } else { 0.0 };
        let q = (if x < 1.0 { x } else { 1.0 }) * scale;
        let below = (q as i32).min(resolution as i32 - 1);
        cell[lane] = below as u32;
        share[lane] = q - below as f32;
    }
    (cell, share)
}

#[inline(always)]
fn corners(shape: &Shape, xyz: [&[f32; LANES]; 3]) -> Corners {
    let (x, fx) = cells(xyz[0], shape.resolution);
    let (y, fy) = cells(xyz[1], shape.resolution);
    let (z, fz) = cells(xyz[2], shape.resolution);
    let mut found = Corners {
        index: [[0; LANES]; 8],
        weight: [[0.0; LANES]; 8],
    };
    let side = shape.resolution + 1;
    let mask = shape.entries - 1;
    for corner in 0..8_u32 {
        let (dx, dy, dz) = (corner & 1, (corner >> 1) & 1, corner >> 2);
        let (index, weight) = (&mut found.index[corner as usize], &mut found.weight[corner as usize]);
        for lane in 0..LANES {
            let (cx, cy, cz) = (x[lane] + dx, y[lane] + dy, z[lane] + dz);
            index[lane] = if shape.dense {
                cx.wrapping_add(cy.wrapping_mul(side)).wrapping_add(cz.wrapping_mul(side * side))
            } else {
                (cx ^ cy.wrapping_mul(PRIMES[0]) ^ cz.wrapping_mul(PRIMES[1])) & mask
            };
            let wx = if dx == 1 { fx[lane] } else { 1.0 - fx[lane] };
            let wy = if dy == 1 { fy[lane] } else { 1.0 - fy[lane] };
            let wz = if dz == 1 { fz[lane] } else { 1.0 - fz[lane] };
            weight[lane] = wx * wy * wz;
        }
    }
    found
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

/// Looks up one level for all points.
///
/// Writes features `first .. first + F` of every row; rows have `width` blocks.
pub struct Lookup<'a, const F: usize> {
    /// The level.
    pub shape: Shape,
    /// `[entries, F]`.
    pub table: &'a [f32],
    /// The points.
    pub points: Points<'a>,
    /// `[n, width]`.
    pub rows: &'a mut [Block],
    /// Blocks a row.
    pub width: usize,
    /// First feature of this level in the row.
    pub first: usize,
}

impl<const F: usize> Kernel for Lookup<'_, F> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, _isa: I) {
        let table = self.table.as_chunks::<F>().0;
        let row = self.width * LANES;
        let rows = flat_mut(self.rows).chunks_exact_mut(row * LANES);
        for (xyz, rows) in self.points.blocks().zip(rows) {
            let found = corners(&self.shape, xyz);
            for lane in 0..LANES {
                let mut sum = [0.0; F];
                for corner in 0..8 {
                    let entry = &table[found.index[corner][lane] as usize];
                    let weight = found.weight[corner][lane];
                    for f in 0..F {
                        sum[f] = weight.mul_add(entry[f], sum[f]);
                    }
                }
                rows[lane * row + self.first..][..F].copy_from_slice(&sum);
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
        for (xyz, rows) in self.points.blocks().zip(rows) {
            let found = corners(&self.shape, xyz);
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
