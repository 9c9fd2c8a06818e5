//! Where the learnt background starts: at what the photos show in each direction.

use nalgebra::{SMatrix, SVector, Vector2};

use marf_numeric::GOLDEN;

use crate::{View, sh};

/// Pixels looked at in a photo, at most.
const PIXELS: u64 = 576;
/// Colours are kept this far from 0 and 1, where the logit is infinite (4.6 in size).
const MARGIN: f64 = 0.01;
/// Pull of all coefficients but the first to zero, as a share of the pixels: few photos look into few directions.
const RIDGE: f64 = 0.01;

/// Returns the `[3, 16]` coefficients whose logits fit the pixels of all photos best, by ridge regression.
///
/// From zero, the background needs some hundred steps to become a bright sky. Until then, fog in front of the
/// cameras replaces it for good (lego, white background, 300 steps: 11.9 dB from zero, 20.2 dB from the mean
/// colour). Photos with transparency do not show it and are left out, as are pixels whose distortion has no
/// inverse. Without any pixels the background is gray.
pub fn fit(views: &[View]) -> Vec<f32> {
    let mut normal = SMatrix::<f64, { sh::COUNT }, { sh::COUNT }>::zeros();
    let mut right = SMatrix::<f64, { sh::COUNT }, 3>::zeros();
    let mut pixels = 0.0;
    let opaque = views.iter().filter(|view| !view.image.is_transparent());
    for (direction, rgb) in opaque.flat_map(looks) {
        let row = SVector::from(sh::harmonics(direction).map(f64::from));
        normal += row * row.transpose();
        right += row * rgb.map(logit).transpose();
        pixels += 1.0;
    }
    for index in 1..sh::COUNT {
        normal[(index, index)] += RIDGE * pixels;
    }
    let found = normal.cholesky().map(|normal| normal.solve(&right));
    found.map_or_else(
        || vec![0.0; 3 * sh::COUNT],
        |found| found.iter().map(|value| *value as f32).collect(),
    )
}

/// Directions in the world and colours of some pixels, spread over the photo by the golden ratio.
fn looks(view: &View) -> impl Iterator<Item = ([f32; 3], SVector<f64, 3>)> + '_ {
    let world_from_cam = view.cam_from_world.inverse();
    let kept = view.image.count();
    let place = move |index: u64| (u128::from(index.wrapping_mul(GOLDEN)) * kept as u128) >> 64;
    (0..PIXELS.min(kept as u64)).filter_map(move |index| {
        let kept = place(index) as usize;
        if view.image.is_hidden(kept) {
            return None;
        }
        let (pixel, rgb) = view.image.at(kept);
        let in_camera = view.camera.unproject(&Vector2::from(pixel))?;
        let direction = world_from_cam.direction(&in_camera).normalize();
        let rgb = SVector::from(rgb.map(f64::from));
        Some(([direction.x as f32, direction.y as f32, direction.z as f32], rgb))
    })
}

fn logit(value: f64) -> f64 {
    let value = value.clamp(MARGIN, 1.0 - MARGIN);
    libm::log(value / (1.0 - value))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cpu::composite::colour;
    use marf_scene::{Camera, Image, Pose};
    use nalgebra::Vector3;

    fn view(toward: Vector3<f64>, rgb: [u8; 3]) -> View {
        View {
            id: "v".to_owned(),
            camera: Camera::pinhole(16, 12, 12.0),
            cam_from_world: Pose::looking_at(Vector3::zeros(), toward, -Vector3::z()),
            image: Image::from_fn(16, 12, |_, _| rgb).into(),
            distances: Vec::new(),
        }
    }

    fn seen(coefficients: &[f32], direction: [f32; 3]) -> [f32; 3] {
        let harmonics = sh::harmonics(direction);
        [0, 1, 2].map(|channel| {
            let row = &coefficients[channel * sh::COUNT..][..sh::COUNT];
            colour(row.iter().zip(&harmonics).map(|(a, b)| a * b).sum())
        })
    }

    #[test]
    fn white_photos_give_a_white_background_in_every_direction() {
        let looks = [Vector3::x(), -Vector3::x(), Vector3::y(), -Vector3::y()];
        let found = fit(&looks.map(|toward| view(toward, [255; 3])));
        for direction in [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.6, 0.0, -0.8]] {
            let rgb = seen(&found, direction);
            assert!(
                rgb.iter().all(|channel| *channel > 0.97),
                "{direction:?}: {rgb:?}"
            );
        }
    }

    #[test]
    fn a_direction_gets_the_colour_that_is_seen_there() {
        let found = fit(&[
            view(Vector3::x(), [200, 100, 30]),
            view(-Vector3::x(), [20, 60, 220]),
        ]);
        let (ahead, behind) = (seen(&found, [1.0, 0.0, 0.0]), seen(&found, [-1.0, 0.0, 0.0]));
        assert!(ahead[0] > 0.6 && ahead[2] < 0.3, "{ahead:?}");
        assert!(behind[0] < 0.3 && behind[2] > 0.6, "{behind:?}");
    }

    #[test]
    fn one_pixel_and_no_view_give_finite_coefficients() {
        let mut one = view(Vector3::y(), [0; 3]);
        one.camera = Camera::pinhole(1, 1, 1.0);
        one.image = Image::from_fn(1, 1, |_, _| [0, 255, 7]).into();
        for views in [vec![one], vec![]] {
            let found = fit(&views);
            assert_eq!(found.len(), 3 * sh::COUNT);
            assert!(found.iter().all(|value| value.is_finite()), "{found:?}");
        }
    }
}
