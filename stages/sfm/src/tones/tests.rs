use super::*;
use marf_numeric::Rng;

/// Ids of photos.
const IDS: [&str; 11] = ["00", "01", "02", "03", "04", "05", "06", "07", "08", "09", "10"];

/// Points of which photos show `shown(point, photo)`, in 0 to 1, `None` where they do not see it.
fn tracks(
    points: usize,
    photos: usize,
    mut shown: impl FnMut(usize, usize) -> Option<[f64; 3]>,
) -> Vec<Vec<PointTone>> {
    let mut tone = |point: usize, photo: usize| {
        let rgb = shown(point, photo)?.map(|channel| (255.0 * channel + 0.5).clamp(0.0, 255.0) as u8);
        PointTone::unclipped(photo, 0.0, rgb)
    };
    let mut point = |point: usize| (0..photos).filter_map(|photo| tone(point, photo)).collect();
    (0..points).map(&mut point).collect()
}

/// Colours of points, 0.1 to 0.6.
fn colors(count: usize, seed: u64) -> Vec<[f64; 3]> {
    let mut rng = Rng::new(seed);
    let mut color = || [(); 3].map(|()| 0.5f64.mul_add(rng.unit_f64(), 0.1));
    (0..count).map(|_| color()).collect()
}

/// Gains and offsets that were planted, with means of 0 as the solution has them.
fn planted(photo: usize, photos: usize, channel: usize) -> [f64; 2] {
    // Neighbours are far apart.
    let place = 2.0 * (photo * 5 % photos) as f64 / (photos as f64 - 1.0) - 1.0;
    [0.3 * place * (1.0 + 0.2 * channel as f64), 0.06 * place]
}

fn show(color: [f64; 3], photo: usize, photos: usize) -> [f64; 3] {
    [0, 1, 2].map(|channel| {
        let [log_gain, offset] = planted(photo, photos, channel);
        exp(log_gain) * color[channel] + offset
    })
}

/// The exposures as they are once gains have a mean logarithm of 0 and shifts a mean of 0, which is how the solution fixes them.
fn assert_recovered(found: &Tones, photos: usize, tolerance: f64) {
    for channel in 0..3 {
        let mean_shift = (0..photos).map(|photo| {
            let [log_gain, offset] = planted(photo, photos, channel);
            offset / exp(log_gain)
        });
        let mean_shift = mean_shift.sum::<f64>() / photos as f64;
        for (photo, tone) in found.photos.iter().enumerate() {
            let [log_gain, offset] = planted(photo, photos, channel);
            let gain_off = exp(tone.log_gain[channel] - log_gain) - 1.0;
            let offset_off = tone.offset[channel] - (offset - exp(log_gain) * mean_shift);
            assert!(
                gain_off.abs() < tolerance,
                "gain of {photo}, {channel}: {gain_off}"
            );
            assert!(
                offset_off.abs() < tolerance,
                "offset of {photo}, {channel}: {offset_off}"
            );
        }
    }
}

/// y = 2 x + 0.1 exactly: its slope, and the means 0.2 and 0.5.
#[test]
fn a_line_through_exact_tones_is_that_line() {
    let tones: Vec<[f64; 2]> = (0..13)
        .map(|k| f64::from(k) / 30.0)
        .map(|x| [x, 2.0 * x + 0.1])
        .collect();
    let found = line(&tones).unwrap();
    assert!((found.slope - 2.0).abs() < 1e-12, "{}", found.slope);
    assert!(
        (found.means[0] - 0.2).abs() < 1e-12 && (found.means[1] - 0.5).abs() < 1e-12,
        "{:?}",
        found.means
    );
    assert!(line(&tones[..LEAST_COMMON - 1]).is_none(), "too few");
    assert!(line(&[[0.3, 0.3]; 20]).is_none(), "without variation");
}

#[test]
fn planted_exposures_are_recovered_within_one_percent() {
    let (photos, colors) = (11, colors(1200, 1));
    // Each point is seen by four neighbouring photos.
    let tracks = tracks(1200, photos, |point, photo| {
        let first = point % (photos - 3);
        (first..first + 4)
            .contains(&photo)
            .then(|| show(colors[point], photo, photos))
    });
    let found = find_tones(&IDS[..photos], &tracks).unwrap();
    assert_eq!((found.photos.len(), found.difference.points), (11, 1200));
    assert!(
        found.difference.spread > 0.05 && found.difference.noise < 0.01,
        "{:?}",
        found.difference
    );
    assert_recovered(&found, photos, 0.01);
    assert_eq!(
        find_tones(&IDS[..photos], &tracks).unwrap(),
        found,
        "the same twice"
    );
}

/// One point in ten is a mismatch, whose tone is that of another point.
#[test]
fn mismatches_and_noise_hardly_move_the_exposures() {
    let (photos, colors) = (8, colors(2000, 2));
    let mut rng = Rng::new(3);
    let tracks = tracks(2000, photos, |point, photo| {
        let is_wrong = rng.unit_f64() < 0.1;
        let other = (rng.unit_f64() * 2000.0) as usize;
        let noise = 0.02 * (rng.unit_f64() - 0.5);
        let color = if is_wrong { colors[other] } else { colors[point] };
        (point % 2 == photo % 2 || photo < 4).then(|| show(color, photo, photos).map(|tone| tone + noise))
    });
    let found = find_tones(&IDS[..photos], &tracks).unwrap();
    assert!(found.difference.is_real(), "{:?}", found.difference);
    assert_recovered(&found, photos, 0.03);
}

#[test]
fn equal_exposures_stay_without_terms_whatever_the_noise() {
    for noise in [0.0_f64, 0.01, 0.1] {
        let colors = colors(800, 4);
        let mut rng = Rng::new(5);
        let tracks = tracks(800, 6, |point, _| {
            Some(colors[point].map(|tone| noise.mul_add(rng.unit_f64() - 0.5, tone)))
        });
        let found = find_tones(&IDS[..6], &tracks).unwrap();
        assert_eq!(found.photos, [], "noise {noise}: {:?}", found.difference);
    }
}

#[test]
fn one_photo_that_differs_from_all_others_is_found() {
    let colors = colors(800, 6);
    let tracks = tracks(800, 11, |point, photo| {
        let gain = if photo == 7 { 1.5 } else { 1.0 };
        Some(colors[point].map(|tone| gain * tone))
    });
    let found = find_tones(&IDS[..11], &tracks).unwrap();
    let gain = |photo: usize| exp(found.photos[photo].log_gain[1]);
    assert!((gain(7) / gain(6) - 1.5).abs() < 0.015, "{}", gain(7) / gain(6));
    assert!((gain(5) / gain(6) - 1.0).abs() < 0.01, "{}", gain(5) / gain(6));
}

#[test]
fn no_tracks_one_photo_black_and_saturated_photos_say_nothing() {
    assert_eq!(find_tones(&IDS[..3], &[]), None);
    assert_eq!(find_tones(&IDS[..0], &[]), None);
    let colors = colors(300, 7);
    let one = tracks(300, 1, |point, _| Some(colors[point]));
    assert_eq!(find_tones(&IDS[..1], &one), None);
    for tone in [0.0, 1.0] {
        let flat = tracks(300, 3, |_, _| Some([tone; 3]));
        assert_eq!(find_tones(&IDS[..3], &flat), None, "{tone}");
    }
    // A saturated photo among others changes nothing.
    let mixed = tracks(300, 4, |point, photo| {
        Some(if photo == 3 {
            [1.0; 3]
        } else {
            show(colors[point], photo, 3)
        })
    });
    let found = find_tones(&IDS[..4], &mixed).unwrap();
    assert_eq!(found.photos.len(), 3, "it has no exposure");
    assert_recovered(&found, 3, 0.01);
    // A constant tone in all photos has no line.
    let grey = tracks(300, 3, |_, _| Some([0.5; 3]));
    assert_eq!(find_tones(&IDS[..3], &grey), None);
}
