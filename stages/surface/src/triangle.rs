//! The pixels of a map that a triangle covers.

use nalgebra::{Vector2, Vector3};

/// A pixel whose centre a triangle covers.
pub struct CoveredPixel {
    /// From the left.
    pub column: u32,
    /// From the top.
    pub row: u32,
    /// Shares of the three corners at its centre. Their sum is 1.
    pub shares: [f64; 3],
}

/// Returns the pixels whose centres a triangle covers, with the shares of its corners there.
pub fn covered_pixels(
    corners: &[Vector3<f64>; 3],
    pixel_m: f64,
    first: &Vector2<f64>,
    columns: u32,
    rows: u32,
) -> Vec<CoveredPixel> {
    let [a, b, c] = corners.map(|corner| corner.xy() / pixel_m - first - Vector2::repeat(0.5));
    let area = (b - a).perp(&(c - a));
    if area.abs() < 1e-12 {
        return Vec::new();
    }
    let (low, high) = (a.inf(&b).inf(&c), a.sup(&b).sup(&c));
    let range = |low: f64, high: f64, most: u32| {
        low.ceil().max(0.0) as u32..(high.floor() + 1.0).clamp(0.0, f64::from(most)) as u32
    };
    let mut found = Vec::new();
    for up in range(low.y, high.y, rows) {
        for column in range(low.x, high.x, columns) {
            let at = Vector2::new(f64::from(column), f64::from(up));
            let shares = [
                (c - b).perp(&(at - b)),
                (a - c).perp(&(at - c)),
                (b - a).perp(&(at - a)),
            ]
            .map(|part| part / area);
            if shares.iter().all(|share| *share >= -1e-9) {
                found.push(CoveredPixel {
                    column,
                    row: rows - 1 - up,
                    shares,
                });
            }
        }
    }
    found
}
