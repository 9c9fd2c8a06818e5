//! Where the error of a trained field is: training photos next to held-out photos, by scale in the image, by distance.

use marf_field::{Field, FieldError, Render};
use marf_scene::{Image, Pose, Srgb};
use serde::Serialize;

use super::photos::TestView;

/// Bands of the image: details of 1, 2, 4 and 8 px, and what is coarser.
const BANDS: usize = 5;
/// Parts of equal size that pixels are split into by depth and views by distance.
const THIRDS: usize = 3;

/// Errors on photos of one kind.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Found {
    views: usize,
    /// Mean over the views, peak 1.
    psnr: f64,
    /// The same after the affine map of each channel of each view that fits best: what exposure costs.
    psnr_affine: f64,
    bands: [Band; BANDS],
    /// By depth of the render, near to far.
    depths: [Part; THIRDS],
    /// By distance of the camera from the nearest one trained on, near to far. Empty for the photos trained on.
    distances: Vec<Part>,
}

/// Details of one size.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
struct Band {
    /// PSNR if nothing else were wrong.
    psnr: f64,
    /// Energy of the error over that of the photos. 1 if nothing of the band is rendered.
    missing: f64,
}

/// Pixels or views up to a distance.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
struct Part {
    /// Greatest distance, units of the scene.
    to: f64,
    psnr: f64,
}

/// Compares renders of some views with their photos. `trained` are cameras trained on, without the views.
///
/// # Errors
/// Returns an error if a device fails.
pub fn explain(field: &Field, views: &[TestView], trained: &[Pose]) -> Result<Found, FieldError> {
    let (mut bands, mut energies) = ([0.0; BANDS], [0.0; BANDS]);
    let (mut pixels, mut distances) = (Vec::new(), Vec::new());
    let (mut psnr, mut psnr_affine) = (0.0, 0.0);
    for view in views {
        let pose = &view.frame.cam_from_world;
        let render = field.render(&view.frame.camera, pose)?;
        let (width, height) = (render.width as usize, render.height as usize);
        let squares = squares(&render, &view.photo);
        let error = mean(&squares);
        psnr += decibels(error);
        let mut fitted = 0.0;
        for channel in 0..3 {
            let (shown, photo) = (shown(&render, channel), seen(&view.photo, channel));
            fitted += unexplained(&shown, &photo) / 3.0;
            let apart: Vec<f64> = shown.iter().zip(&photo).map(|(a, b)| a - b).collect();
            add_bands(&mut bands, apart, width, height);
            add_bands(&mut energies, photo, width, height);
        }
        psnr_affine += decibels(fitted);
        let depths = render.depth.iter().map(|depth| f64::from(*depth));
        pixels.extend(depths.zip(squares));
        let centre = pose.centre();
        let away = trained.iter().map(|other| (other.centre() - centre).norm());
        distances.extend(away.min_by(f64::total_cmp).map(|away| (away, error)));
    }
    let count = views.len().max(1) as f64;
    let band = |index: usize| Band {
        psnr: decibels(bands[index] / (3.0 * count)),
        missing: bands[index] / f64::max(energies[index], f64::MIN_POSITIVE),
    };
    Ok(Found {
        views: views.len(),
        psnr: psnr / count,
        psnr_affine: psnr_affine / count,
        bands: std::array::from_fn(band),
        depths: thirds(&mut pixels),
        distances: if distances.is_empty() {
            Vec::new()
        } else {
            thirds(&mut distances).to_vec()
        },
    })
}

/// Returns one channel of a render, sRGB in [0, 1].
fn shown(render: &Render, channel: usize) -> Vec<f64> {
    let cut = |rgb: &[f32; 3]| f64::from(rgb[channel]).clamp(0.0, 1.0);
    render.rgb.iter().map(cut).collect()
}

/// Returns one channel of a photo, sRGB in [0, 1].
fn seen(photo: &Image<Srgb>, channel: usize) -> Vec<f64> {
    let share = |rgb: &[u8; 3]| f64::from(rgb[channel]) / 255.0;
    photo.pixels.iter().map(share).collect()
}

/// Returns the squared error of every pixel, mean over channels.
fn squares(render: &Render, photo: &Image<Srgb>) -> Vec<f64> {
    let mut squares = vec![0.0; photo.pixels.len()];
    for channel in 0..3 {
        let pairs = shown(render, channel).into_iter().zip(seen(photo, channel));
        for (square, (a, b)) in squares.iter_mut().zip(pairs) {
            *square += (a - b) * (a - b) / 3.0;
        }
    }
    squares
}

/// Returns the mean squared error that is left by the affine map of `shown` that comes closest to `photo`.
fn unexplained(shown: &[f64], photo: &[f64]) -> f64 {
    let (a, b) = (mean(shown), mean(photo));
    let pairs = || shown.iter().map(|x| x - a).zip(photo.iter().map(|y| y - b));
    let count = shown.len().max(1) as f64;
    let moment = |product: fn((f64, f64)) -> f64| pairs().map(product).sum::<f64>() / count;
    let [xx, xy, yy] = [
        moment(|(x, _)| x * x),
        moment(|(x, y)| x * y),
        moment(|(_, y)| y * y),
    ];
    if xx > 0.0 {
        (yy - xy * xy / xx).max(0.0)
    } else {
        yy
    }
}

/// Adds the mean energy of every band of an image: means of blocks of 1, 2, 4, 8 and 16 px, each without that of the
/// next (Haar's pyramid). Bands are orthogonal, so they add up to the mean square where both sides are multiples of 16.
fn add_bands(bands: &mut [f64; BANDS], mut image: Vec<f64>, mut width: usize, mut height: usize) {
    for (index, band) in bands.iter_mut().enumerate() {
        if index + 1 == BANDS || width < 2 || height < 2 {
            *band += mean(&image.iter().map(|x| x * x).collect::<Vec<_>>());
            return;
        }
        let (half, rows) = (width / 2, height / 2);
        let mut coarse = vec![0.0; half * rows];
        let mut energy = 0.0;
        for (block, value) in coarse.iter_mut().enumerate() {
            let first = block / half * 2 * width + block % half * 2;
            let four = [first, first + 1, first + width, first + width + 1].map(|at| image[at]);
            *value = four.iter().sum::<f64>() / 4.0;
            energy += four.iter().map(|x| (x - *value) * (x - *value)).sum::<f64>() / 4.0;
        }
        *band += energy / coarse.len() as f64;
        (image, width, height) = (coarse, half, rows);
    }
}

/// Sorts (distance, squared error) by distance and returns the PSNR of each third. An empty part has a mean error of 0.
fn thirds(pairs: &mut [(f64, f64)]) -> [Part; THIRDS] {
    pairs.sort_by(|a, b| a.0.total_cmp(&b.0));
    std::array::from_fn(|third| {
        let [first, end] = [third, third + 1].map(|edge| pairs.len() * edge / THIRDS);
        let part = &pairs[first..end];
        let errors: Vec<f64> = part.iter().map(|(_, square)| *square).collect();
        Part {
            to: part.last().map_or(0.0, |(distance, _)| *distance),
            psnr: decibels(mean(&errors)),
        }
    })
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len().max(1) as f64
}

/// Returns the PSNR of a mean squared error with white = 1, at most 100 dB.
fn decibels(error: f64) -> f64 {
    -10.0 * error.max(1e-10).log10()
}

/// Returns both kinds of photos side by side.
pub fn table(trained: &Found, held_out: &Found) -> String {
    let row = |name: &str, value: &dyn Fn(&Found) -> String| {
        format!("{name:<34} {:>16} {:>16}", value(trained), value(held_out))
    };
    let mut rows = vec![
        row("", &|found| format!("{} views", found.views)),
        format!("{:<34} {:>16} {:>16}", "", "trained on", "held out"),
        row("PSNR dB", &|found| format!("{:.2}", found.psnr)),
        row("after an affine fit a channel", &|found| {
            format!("{:.2}", found.psnr_affine)
        }),
    ];
    for index in 0..BANDS {
        let more = if index + 1 == BANDS { " and more" } else { "" };
        let name = format!("details of {} px{more} (missing)", 1 << index);
        rows.push(row(&name, &|found| {
            let Band { psnr, missing } = found.bands[index];
            format!("{psnr:.2} ({:.0} %)", 100.0 * missing)
        }));
    }
    let part = |part: &Part| format!("{:.2} (<= {:.2})", part.psnr, part.to);
    for (index, name) in ["near", "middle", "far"].iter().enumerate() {
        rows.push(row(&format!("{name} third of the pixels"), &|found| {
            part(&found.depths[index])
        }));
        rows.push(row(&format!("{name} third of the views"), &|found| {
            found.distances.get(index).map_or_else(|| "-".to_owned(), part)
        }));
    }
    rows.push(
        "missing: energy of the error over that of the photos. Pixels by depth of the render, views by distance from \
         the nearest camera trained on, units of the scene"
            .to_owned(),
    );
    rows.join("\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wave(side: usize, period: usize) -> Vec<f64> {
        let value = |at: usize| {
            if at % side % period < period / 2 {
                1.0
            } else {
                -1.0
            }
        };
        (0..side * side).map(value).collect()
    }

    #[test]
    fn stripes_lie_in_the_band_of_their_width_and_bands_add_up() {
        for (index, period) in [2, 4, 8, 16].into_iter().enumerate() {
            let mut bands = [0.0; BANDS];
            add_bands(&mut bands, wave(32, period), 32, 32);
            let mut expected = [0.0; BANDS];
            expected[index] = 1.0;
            assert_eq!(bands, expected, "period {period}");
        }
        let mut bands = [0.0; BANDS];
        add_bands(&mut bands, vec![0.5; 256], 16, 16);
        assert_eq!(bands, [0.0, 0.0, 0.0, 0.0, 0.25]);
        // Nothing, and a row: no pyramid, no NaN.
        for (image, width, height) in [(Vec::new(), 0, 0), (vec![2.0; 5], 5, 1)] {
            let mut bands = [0.0; BANDS];
            add_bands(&mut bands, image, width, height);
            assert!(
                bands.iter().all(|band| band.is_finite()),
                "{width} x {height}: {bands:?}"
            );
        }
    }

    #[test]
    fn an_affine_fit_takes_gain_and_offset_out_and_a_flat_render_explains_nothing() {
        let shown = wave(16, 4);
        let photo: Vec<f64> = shown.iter().map(|x| 0.3 * x + 0.2).collect();
        assert!(unexplained(&shown, &photo) < 1e-15);
        assert!((unexplained(&vec![0.7; 256], &photo) - 0.09).abs() < 1e-12);
        assert_eq!(unexplained(&[], &[]), 0.0);
    }

    #[test]
    fn thirds_are_near_to_far_and_empty_ones_are_finite() {
        let mut pairs = [(9.0, 0.01), (1.0, 1.0), (5.0, 0.1)];
        let parts = thirds(&mut pairs).map(|part| (part.to, part.psnr.round()));
        assert_eq!(parts, [(1.0, 0.0), (5.0, 10.0), (9.0, 20.0)]);
        assert!(thirds(&mut []).iter().all(|part| part.psnr == 100.0));
    }
}
