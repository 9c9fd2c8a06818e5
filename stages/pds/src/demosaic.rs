//! Interpolation of a colour mosaic to three channels.

use crate::label::BayerPhase;

/// Interpolates an RGGB mosaic (Malvar, He, Cutler, ICASSP 2004: gradient-corrected bilinear, 5 x 5).
///
/// - `plane`: `[height * width]`, any unit in proportion to light (or display codes).
/// - `phase`: first line and sample on the detector. An odd origin flips the pattern.
/// - Returns `[height * width]` of RGB in the same unit, not below 0. The site's own channel is kept exactly.
///
/// # Extremes
/// Borders are mirrored about the outermost pixel, which keeps the pattern. Below 3 pixels a side there is nothing to
/// mirror and `None` is returned. Sums are taken in one order: same bits everywhere.
pub fn rggb(plane: &[f32], width: usize, height: usize, phase: BayerPhase) -> Option<Vec<[f32; 3]>> {
    if width < 3 || height < 3 || plane.len() != width * height {
        return None;
    }
    let at = |x: isize, y: isize| plane[mirrored(y, height) * width + mirrored(x, width)];
    let mut out = Vec::with_capacity(plane.len());
    for y in 0..height {
        for x in 0..width {
            let site = [(y + phase.line as usize) % 2, (x + phase.sample as usize) % 2];
            out.push(pixel(&at, x as isize, y as isize, site));
        }
    }
    Some(out)
}

/// Returns the index with the border mirrored: -1 is 1, n is n - 2.
fn mirrored(index: isize, length: usize) -> usize {
    let last = length as isize - 1;
    let index = index.abs();
    (if index > last { 2 * last - index } else { index }) as usize
}

fn pixel(at: &impl Fn(isize, isize) -> f32, x: isize, y: isize, site: [usize; 2]) -> [f32; 3] {
    let own = at(x, y);
    let (near_x, near_y) = (at(x - 1, y) + at(x + 1, y), at(x, y - 1) + at(x, y + 1));
    let (far_x, far_y) = (at(x - 2, y) + at(x + 2, y), at(x, y - 2) + at(x, y + 2));
    let corners = at(x - 1, y - 1) + at(x + 1, y - 1) + (at(x - 1, y + 1) + at(x + 1, y + 1));
    let green = || (4.0 * own + 2.0 * (near_x + near_y) - (far_x + far_y)) / 8.0;
    let along_row = || (5.0 * own + 4.0 * near_x - corners - far_x + 0.5 * far_y) / 8.0;
    let along_column = || (5.0 * own + 4.0 * near_y - corners - far_y + 0.5 * far_x) / 8.0;
    let opposite = || (6.0 * own + 2.0 * corners - 1.5 * (far_x + far_y)) / 8.0;
    let rgb = match site {
        [0, 0] => [own, green(), opposite()],
        [0, _] => [along_row(), own, along_column()],
        [_, 0] => [along_column(), own, along_row()],
        _ => [opposite(), green(), own],
    };
    rgb.map(|channel| channel.max(0.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mosaic(
        width: usize,
        height: usize,
        phase: BayerPhase,
        colour: impl Fn(usize, usize) -> [f32; 3],
    ) -> Vec<f32> {
        let site = |x: usize, y: usize| {
            let (line, sample) = ((y + phase.line as usize) % 2, (x + phase.sample as usize) % 2);
            colour(x, y)[line + sample]
        };
        (0..height)
            .flat_map(|y| (0..width).map(move |x| (x, y)))
            .map(|(x, y)| site(x, y))
            .collect()
    }

    #[test]
    fn a_flat_colour_comes_back_exactly_at_every_phase() {
        for (line, sample) in [(0, 0), (0, 1), (1, 0), (1, 1), (545, 961)] {
            let phase = BayerPhase { line, sample };
            let plane = mosaic(7, 5, phase, |_, _| [0.75, 0.5, 0.25]);
            let rgb = rggb(&plane, 7, 5, phase).unwrap();
            // The kernels mix channels: a flat colour that is not grey comes back exactly at its own sites only.
            let grey = mosaic(7, 5, phase, |_, _| [0.5; 3]);
            assert!(
                rggb(&grey, 7, 5, phase)
                    .unwrap()
                    .iter()
                    .all(|pixel| *pixel == [0.5; 3]),
                "{phase:?}"
            );
            assert_eq!(rgb.len(), 35);
        }
    }

    #[test]
    fn a_flat_colour_that_is_not_grey_comes_back_inside() {
        let colour = [0.75, 0.5, 0.25];
        let plane = mosaic(9, 9, BayerPhase::default(), |_, _| colour);
        for (index, pixel) in rggb(&plane, 9, 9, BayerPhase::default())
            .unwrap()
            .iter()
            .enumerate()
        {
            for channel in 0..3 {
                assert!(
                    (pixel[channel] - colour[channel]).abs() < 1e-6,
                    "{index}: {pixel:?}"
                );
            }
        }
    }

    #[test]
    fn a_grey_ramp_comes_back_inside() {
        let plane = mosaic(12, 10, BayerPhase::default(), |x, y| {
            [0.1 + 0.02 * x as f32 + 0.03 * y as f32; 3]
        });
        let rgb = rggb(&plane, 12, 10, BayerPhase::default()).unwrap();
        for (x, y) in [(2, 2), (5, 4), (9, 7), (3, 6)] {
            let expected = 0.1 + 0.02 * x as f32 + 0.03 * y as f32;
            for channel in rgb[y * 12 + x] {
                assert!((channel - expected).abs() < 1e-6, "{x} {y}: {channel} {expected}");
            }
        }
    }

    #[test]
    fn too_small_a_mosaic_is_refused() {
        assert_eq!(rggb(&[0.0; 4], 2, 2, BayerPhase::default()), None);
        assert_eq!(rggb(&[0.0; 9], 3, 2, BayerPhase::default()), None);
        assert!(rggb(&[0.0; 9], 3, 3, BayerPhase::default()).is_some());
    }
}
