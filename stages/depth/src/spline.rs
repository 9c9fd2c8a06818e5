//! Brightness between the pixels of a photo, by Catmull-Rom splines.

use nalgebra::Vector2;

use crate::raster::Picture;

/// Returns the brightness at a place in a photo, or nothing where one of the 4 x 4 pixels around is missing.
pub(crate) fn sampled(photo: &Picture, at: Vector2<f64>) -> Option<u8> {
    let [x, y] = [at.x - 0.5, at.y - 0.5];
    let (column, row) = (x.floor(), y.floor());
    let inside = column >= 1.0
        && row >= 1.0
        && column + 2.0 < photo.grey.width as f64
        && row + 2.0 < photo.grey.height as f64;
    if !inside {
        return None;
    }
    let (weights_x, weights_y) = (catmull_rom(x - column), catmull_rom(y - row));
    let mut sum = 0.0;
    for (v, weight_y) in weights_y.iter().enumerate() {
        for (u, weight_x) in weights_x.iter().enumerate() {
            let (px, py) = (column as usize + u - 1, row as usize + v - 1);
            if !photo.usable.at(px, py) {
                return None;
            }
            sum += weight_y * weight_x * f64::from(photo.grey.at(px, py));
        }
    }
    Some(sum.round().clamp(0.0, 255.0) as u8)
}

/// Returns the weights of four samples at -1, 0, 1 and 2 for a place in [0, 1).
fn catmull_rom(t: f64) -> [f64; 4] {
    let (t2, t3) = (t * t, t * t * t);
    [
        0.5 * (2.0 * t2 - t - t3),
        0.5 * (3.0 * t3 - 5.0 * t2 + 2.0),
        0.5 * (4.0 * t2 + t - 3.0 * t3),
        0.5 * (t3 - t2),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_weights_of_a_place_add_up_to_one_and_hit_the_samples() {
        assert_eq!(catmull_rom(0.0), [0.0, 1.0, 0.0, 0.0]);
        assert_eq!(catmull_rom(0.5), [-0.0625, 0.5625, 0.5625, -0.0625]);
    }
}
