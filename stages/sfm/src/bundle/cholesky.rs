//! Cholesky factorisation of a dense symmetric matrix, blocked so that it runs from the cache.
//!
//! Matrices are stored by rows, and only the lower triangle is read and written. Each element is computed by one
//! fixed sequence of operations for any number of threads.

use rayon::prelude::*;

/// Columns factored at once: their 4-row tiles (1.5 KB) stay in the first-level cache.
const PANEL: usize = 48;

/// Side of a register tile.
const TILE: usize = 4;

/// Column k of four rows.
type Strip = [f64; TILE];

/// Replaces A by its factor L (A = L Lᵀ). False if a pivot was not above `floor` times its diagonal, or if `stop`,
/// which is polled every 48 columns, became true. A is then undefined.
pub(super) fn factor(a: &mut [f64], n: usize, floor: f64, stop: &dyn Fn() -> bool) -> bool {
    // The smallest pivots that are taken.
    let least: Vec<f64> = (0..n).map(|row| floor * a[row * n + row]).collect();
    let mut packed = Vec::new();
    for start in (0..n).step_by(PANEL) {
        let end = (start + PANEL).min(n);
        if stop() || !factor_corner(a, n, start..end, &least) {
            return false;
        }
        let (upper, below) = a.split_at_mut(end * n);
        let corner = &upper[start * n..];
        below
            .par_chunks_mut(n)
            .with_min_len(TILE)
            .for_each(|row| solve_row(row, corner, n, start..end));
        pack(&mut packed, below, n, start..end);
        let tiles = below.par_chunks_mut(TILE * n).enumerate();
        let width = end - start;
        tiles.for_each(|(tile, rows)| subtract_tiles(rows, n, end, &packed[..(tile + 1) * width], width));
    }
    true
}

/// Replaces b by the solution of L Lᵀ x = b.
pub(super) fn solve(l: &[f64], n: usize, b: &mut [f64]) {
    forward(l, n, 0, b);
    for row in (0..n).rev() {
        let l = &l[row * n..=row * n + row];
        b[row] /= l[row];
        let value = b[row];
        b[..row].iter_mut().zip(l).for_each(|(b, l)| *b -= l * value);
    }
}

/// Replaces b by the solution of L x = b, where b is zero before `first`.
pub(super) fn forward(l: &[f64], n: usize, first: usize, b: &mut [f64]) {
    for row in first..n {
        let (known, rest) = b.split_at_mut(row);
        let l = &l[row * n..=row * n + row];
        rest[0] = (rest[0] - dot(&l[first..row], &known[first..])) / l[row];
    }
}

/// Returns the dot product, summed in four lanes that are added at the end: one order on every machine.
pub(super) fn dot(a: &[f64], b: &[f64]) -> f64 {
    let mut lanes = [0.0; 4];
    let (left, right) = (a.chunks_exact(4), b.chunks_exact(4));
    let rest: f64 = left
        .remainder()
        .iter()
        .zip(right.remainder())
        .map(|(a, b)| a * b)
        .sum();
    for (a, b) in left.zip(right) {
        for lane in 0..4 {
            lanes[lane] += a[lane] * b[lane];
        }
    }
    (lanes[0] + lanes[1]) + (lanes[2] + lanes[3]) + rest
}

/// Factors the block on the diagonal, row by row.
fn factor_corner(a: &mut [f64], n: usize, columns: std::ops::Range<usize>, least: &[f64]) -> bool {
    let start = columns.start;
    for row in columns {
        let (done, rest) = a.split_at_mut(row * n);
        let target = &mut rest[..=row];
        for column in start..row {
            let l = &done[column * n..=column * n + column];
            let sum = dot(&target[start..column], &l[start..column]);
            target[column] = (target[column] - sum) / l[column];
        }
        let pivot = target[row] - dot(&target[start..row], &target[start..row]);
        if pivot.is_nan() || pivot.is_infinite() || pivot <= least[row].max(0.0) {
            return false;
        }
        target[row] = pivot.sqrt();
    }
    true
}

/// Solves x Lᵀ = a for the panel's part of one row below it.
fn solve_row(row: &mut [f64], corner: &[f64], n: usize, columns: std::ops::Range<usize>) {
    let start = columns.start;
    for column in columns {
        let l = &corner[(column - start) * n..][..=column];
        let sum = dot(&row[start..column], &l[start..column]);
        row[column] = (row[column] - sum) / l[column];
    }
}

/// Copies the panel's columns of the rows below it, four rows side by side. Missing rows are zero.
fn pack(packed: &mut Vec<Strip>, below: &[f64], n: usize, columns: std::ops::Range<usize>) {
    packed.clear();
    for rows in below.chunks(TILE * n) {
        packed.extend(columns.clone().map(|column| {
            let mut strip = [0.0; TILE];
            let values = rows.chunks(n).map(|row| row[column]);
            strip.iter_mut().zip(values).for_each(|(to, value)| *to = value);
            strip
        }));
    }
}

/// Subtracts the panel's products from four rows, up to their diagonal tile. `packed`: the tiles up to that of these rows,
/// each of `width` columns.
fn subtract_tiles(rows: &mut [f64], n: usize, first: usize, packed: &[Strip], width: usize) {
    let left = &packed[packed.len() - width..];
    for (across, right) in packed.chunks_exact(width).enumerate() {
        let products = products(left, right);
        let at = first + across * TILE;
        let end = (at + TILE).min(n);
        for (row, products) in rows.chunks_mut(n).zip(&products) {
            let targets = row[at..end].iter_mut().zip(products);
            targets.for_each(|(target, product)| *target -= product);
        }
    }
}

/// Returns Σ left rightᵀ of two strips of columns.
#[inline]
fn products(left: &[Strip], right: &[Strip]) -> [Strip; TILE] {
    let mut sums = [[0.0; TILE]; TILE];
    for (left, right) in left.iter().zip(right) {
        for (sums, left) in sums.iter_mut().zip(left) {
            for (sum, right) in sums.iter_mut().zip(right) {
                *sum += left * right;
            }
        }
    }
    sums
}

#[cfg(test)]
mod tests {
    use super::*;
    use marf_numeric::Rng;

    /// M Mᵀ + n I of random M: well conditioned.
    fn matrix(n: usize) -> Vec<f64> {
        let mut rng = Rng::new(n as u64);
        let m: Vec<f64> = (0..n * n).map(|_| rng.unit_f64() - 0.5).collect();
        let element = |index: usize| {
            let (row, column) = (index / n, index % n);
            let product = dot(&m[row * n..][..n], &m[column * n..][..n]);
            if row == column {
                product + n as f64
            } else {
                product
            }
        };
        (0..n * n).map(element).collect()
    }

    #[test]
    fn a_hand_worked_matrix() {
        // The rows (4, 2), (2, 10) = (2, 0), (1, 3) times (2, 1), (0, 3).
        let mut a = vec![4.0, f64::NAN, 2.0, 10.0];
        assert!(factor(&mut a, 2, 0.0, &|| false));
        assert_eq!((a[0], a[2], a[3]), (2.0, 1.0, 3.0));
        let mut b = vec![8.0, 22.0];
        solve(&a, 2, &mut b);
        assert_eq!(b, [1.0, 2.0]);
    }

    #[test]
    fn it_solves_at_every_size_around_the_panels_and_tiles() {
        for n in [1, 2, 3, 4, 5, 47, 48, 49, 50, 51, 52, 53, 95, 96, 97, 143, 150] {
            let a = matrix(n);
            let x: Vec<f64> = (0..n).map(|i| i as f64 - 3.0).collect();
            let mut b: Vec<f64> = (0..n).map(|row| dot(&a[row * n..][..n], &x)).collect();
            let mut l = a.clone();
            assert!(factor(&mut l, n, 0.0, &|| false), "{n}");
            solve(&l, n, &mut b);
            let worst = x.iter().zip(&b).map(|(x, b)| (x - b).abs()).fold(0.0, f64::max);
            assert!(worst < 1e-11 * n as f64, "{n}: {worst}");
        }
    }

    #[test]
    fn what_is_not_positive_is_refused() {
        for bad in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            let mut a = matrix(60);
            a[55 * 60 + 55] = bad;
            assert!(!factor(&mut a, 60, 0.0, &|| false), "{bad}");
        }
        // Of rank 1.
        assert!(!factor(&mut [1.0, 1.0, 1.0, 1.0], 2, 1e-12, &|| false));
    }
}
