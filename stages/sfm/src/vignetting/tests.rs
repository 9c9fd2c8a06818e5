use libm::exp;
use marf_numeric::Rng;

use super::*;

/// Corners are at r² = 0.64.
fn camera() -> Camera {
    Camera::pinhole(640, 480, 500.0)
}

/// What is planted: noise of every tone, and how much darker corners are, quadratic for a half and r⁶ for the other.
#[derive(Clone, Copy)]
struct Planted {
    noise: f64,
    darkening: f64,
    /// Photos that take part.
    photos: usize,
    points: usize,
}

const PLANTED: Planted = Planted {
    noise: 0.04,
    darkening: 0.3,
    photos: 12,
    points: 3000,
};

/// Each point is seen by four photos, wherever `radius2` says, as photos of different gains show it.
fn tracks(planted: Planted, mut radius2: impl FnMut(&mut Rng) -> f64) -> Vec<Vec<PointTone>> {
    let mut rng = Rng::new(7);
    let mut point = |point: usize| {
        let color = [(); 3].map(|()| 0.3f64.mul_add(rng.unit_f64(), 0.3));
        let mut seen = |step: usize| {
            let photo = (point + step * (1 + point % 3)) % planted.photos;
            let radius2 = radius2(&mut rng);
            let share = radius2 / 0.64;
            let v = 1.0 - planted.darkening * 0.5 * (share + share.powi(3));
            let gain = exp(0.2 * (photo as f64 * 2.4).sin());
            // Twelve uniform numbers are nearly normal.
            let normal = (0..12).map(|_| rng.unit_f64()).sum::<f64>() - 6.0;
            let shown =
                color.map(|color| (255.0 * color * gain * v * exp(planted.noise * normal)).clamp(0.0, 255.0));
            PointTone::unclipped(photo, radius2, shown.map(|tone| (tone + 0.5) as u8))
        };
        (0..4).filter_map(&mut seen).collect()
    };
    (0..planted.points).map(&mut point).collect()
}

/// Where a pixel drawn from the whole photo is.
fn anywhere(rng: &mut Rng) -> f64 {
    camera().radius2(&nalgebra::Vector2::new(
        640.0 * rng.unit_f64(),
        480.0 * rng.unit_f64(),
    ))
}

fn found(planted: Planted) -> Vec<Falloff> {
    find_vignetting(&vec![camera(); planted.photos], &tracks(planted, anywhere))
}

#[test]
fn a_planted_falloff_is_found_within_its_uncertainty_whatever_the_gains() {
    for darkening in [0.1, 0.3, 0.5] {
        let planted = Planted { darkening, ..PLANTED };
        let [found] = found(planted)[..] else {
            panic!("{darkening}")
        };
        assert!(found.is_real(), "{}", found.words());
        assert!(found.sigma < 0.02, "{}", found.words());
        assert!(
            (found.darkening - darkening).abs() < 3.0 * found.sigma,
            "{}",
            found.words()
        );
        // Half way to the corner, where the planted curve has lost 0.5 (1/4 + 1/64) of its darkening.
        let half = 1.0 - darkening * 0.5 * (0.25 + 1.0 / 64.0);
        assert!((found.at(0.16) - half).abs() < 0.01, "{}", found.at(0.16));
    }
    assert_eq!(found(PLANTED), found(PLANTED), "the same twice");
}

/// One tone in ten is that of another point.
#[test]
fn mismatches_do_not_hide_it() {
    let mut tracks = tracks(PLANTED, anywhere);
    for point in (0..tracks.len()).step_by(3) {
        let other = tracks[(point + 1) % PLANTED.points][0].tone;
        tracks[point][1].tone = other;
    }
    let found = find_vignetting(&vec![camera(); PLANTED.photos], &tracks)[0];
    assert!(
        found.is_real() && (found.darkening - 0.3).abs() < 0.02,
        "{}",
        found.words()
    );
}

#[test]
fn photos_without_a_falloff_get_none_whatever_the_noise() {
    for noise in [0.0, 0.02, 0.1, 0.3] {
        let found = found(Planted {
            noise,
            darkening: 0.0,
            ..PLANTED
        });
        let words: Vec<String> = found.iter().map(Falloff::words).collect();
        assert!(found.len() == 1 && !found[0].is_real(), "{noise}: {words:?}");
    }
}

#[test]
fn one_photo_one_radius_and_black_or_white_photos_say_nothing() {
    let is_silent = |planted: Planted, points: &[Vec<PointTone>]| {
        let found = find_vignetting(&vec![camera(); planted.photos], points);
        assert!(found.is_empty(), "{}", found[0].words());
    };
    is_silent(PLANTED, &[]);
    for photos in [0, 1, 3] {
        let few = Planted {
            photos: photos.max(1),
            ..PLANTED
        };
        is_silent(
            Planted { photos, ..PLANTED },
            &tracks(few, anywhere)[..photos * 100],
        );
    }
    is_silent(PLANTED, &tracks(PLANTED, |_| 0.3));
    for tone in [0.0, 1.0] {
        let flat = tracks(
            Planted {
                noise: 0.0,
                ..PLANTED
            },
            anywhere,
        );
        let rgb = [(255.0 * tone) as u8; 3];
        let shown = |seen: &PointTone| PointTone::unclipped(seen.photo, seen.radius2, rgb);
        let flat: Vec<Vec<PointTone>> = flat
            .iter()
            .map(|seen| seen.iter().filter_map(shown).collect())
            .collect();
        is_silent(PLANTED, &flat);
    }
    let own: Vec<Camera> = (0..12)
        .map(|photo| Camera::pinhole(640, 480, 500.0 + f64::from(photo)))
        .collect();
    assert_eq!(
        find_vignetting(&own, &tracks(PLANTED, anywhere)),
        [],
        "each photo has a camera of its own"
    );
}

/// Photos of another camera have no part in it, and nearly equal radii leave it unsure.
#[test]
fn a_camera_is_judged_by_its_own_photos_and_a_narrow_ring_leaves_it_unsure() {
    let mut cameras = vec![camera(); PLANTED.photos];
    for camera in cameras.iter_mut().skip(9) {
        *camera = Camera::pinhole(640, 480, 900.0);
    }
    let found = find_vignetting(&cameras, &tracks(PLANTED, anywhere));
    assert_eq!(found.len(), 1);
    assert!(
        (found[0].darkening - 0.3).abs() < 3.0 * found[0].sigma,
        "{}",
        found[0].words()
    );
    let ring = tracks(PLANTED, |rng| 0.01f64.mul_add(rng.unit_f64(), 0.3));
    let unsure = find_vignetting(&vec![camera(); PLANTED.photos], &ring);
    assert!(unsure.iter().all(|one| !one.is_real()), "{}", unsure[0].words());
}
