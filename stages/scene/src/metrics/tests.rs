use super::*;
use crate::{Image, Srgb};

/// scikit-image and this file may differ by rounding only.
const SSIM_TOLERANCE: f64 = 1e-9;

fn flat(value: u8) -> Image<Srgb> {
    Image::from_fn(16, 12, |_, _| [value; 3])
}

/// Returns two images by formulas. scikit-image computed the expected values on the same formulas.
fn patterns(width: u32, height: u32) -> (Image<Srgb>, Image<Srgb>) {
    let a = Image::from_fn(width, height, |x, y| {
        [(x * 7 + y * 3) % 256, (x * x + y) % 256, (x * y) % 256].map(|v| v as u8)
    });
    let b = Image::from_fn(width, height, |x, y| {
        [
            (x * 7 + y * 3 + 5) % 256,
            (x * x + 2 * y) % 256,
            (x * y + x) % 256,
        ]
        .map(|v| v as u8)
    });
    (a, b)
}

#[test]
fn psnr_of_one_grey_step_is_48_decibels() {
    // MSE = (1 / 255)²: 20 log10(255).
    let psnr = psnr(&flat(100), &flat(101), &[]).unwrap();
    assert!((psnr - 48.130_803_608_679_1).abs() < 1e-12, "{psnr}");
}

#[test]
fn psnr_runs_from_0_for_opposites_to_100_for_equals() {
    assert_eq!(psnr(&flat(0), &flat(255), &[]).unwrap(), 0.0);
    let equal = psnr(&flat(9), &flat(9), &[]).unwrap();
    assert!((equal - 100.0).abs() < 1e-12, "{equal}");
}

#[test]
fn the_papers_psnr_measures_against_the_brightest_value_of_the_photo() {
    // max = 51 / 255 = 0.2: 20 log10(51) instead of 20 log10(255).
    let dark = psnr_paper(&flat(50), &flat(51), &[]).unwrap();
    assert!((dark - 34.151_403_521_958_73).abs() < 1e-12, "{dark}");
    let bright = psnr_paper(&flat(254), &flat(255), &[]).unwrap();
    assert_eq!(bright, psnr(&flat(254), &flat(255), &[]).unwrap());
    assert_eq!(psnr_paper(&flat(3), &flat(0), &[]), Err(MetricError::NoPeak));
}

#[test]
fn our_logarithm_is_the_libms() {
    for x in [
        1e-300, 1e-10, 0.5, 0.707, 0.7072, 1.0, 1.414, 1.415, 2.0, 255.0, 1e10, 1e300,
    ] {
        let (ours, theirs) = (ln(x), f64::ln(x));
        assert!(
            (ours - theirs).abs() <= 4e-16 * theirs.abs(),
            "{x}: {ours} {theirs}"
        );
    }
}

/// Of scikit-image 0.26 on [`patterns`]: size, `structural_similarity`, `peak_signal_noise_ratio`.
const SCIKIT_IMAGE: [((u32, u32), f64, f64); 7] = [
    ((11, 11), 0.985_936_185_859_638_4, 33.124_780_102_987_25),
    ((12, 11), 0.987_158_381_785_562_8, 32.808_923_914_528_016),
    ((37, 29), 0.768_714_590_906_962_3, 14.666_531_889_766_592),
    ((11, 64), 0.946_829_376_784_194_1, 19.013_821_381_945_238),
    ((65, 33), 0.665_216_876_939_498_3, 12.928_506_544_010_83),
    ((128, 96), 0.355_621_184_786_306, 9.843_095_064_594_849),
    ((301, 203), 0.296_334_513_512_726, 9.302_902_129_241_705),
];

#[test]
fn ssim_and_psnr_equal_those_of_scikit_image_at_every_size() {
    for (size, ssim_there, psnr_there) in SCIKIT_IMAGE {
        let (a, b) = patterns(size.0, size.1);
        let (ssim, psnr) = (ssim(&a, &b, &[]).unwrap(), psnr(&a, &b, &[]).unwrap());
        assert!((ssim - ssim_there).abs() < SSIM_TOLERANCE, "{size:?}: {ssim}");
        assert!((psnr - psnr_there).abs() < 1e-9, "{size:?}: {psnr}");
    }
}

#[test]
fn ssim_with_a_flat_image_equals_scikit_images() {
    for (other, expected) in [
        (flat(103), 0.999_563_435_332_282_9),
        (patterns(16, 12).0, 0.176_709_722_131_038_17),
    ] {
        let ssim = ssim(&flat(100), &other, &[]).unwrap();
        assert!((ssim - expected).abs() < SSIM_TOLERANCE, "{ssim} {expected}");
    }
}

#[test]
fn ssim_of_flat_images_is_the_luminance_term() {
    // a = 0, b = 1: (0 + C1)(0 + C2) / ((1 + C1)(0 + C2)) = 1e-4 / 1.0001.
    let ssim = ssim(&flat(0), &flat(255), &[]).unwrap();
    assert!((ssim - 1e-4 / 1.0001).abs() < 1e-9, "{ssim}");
}

#[test]
fn ssim_is_symmetric_and_1_for_equals() {
    let (a, b) = patterns(20, 15);
    assert_eq!(ssim(&a, &b, &[]), ssim(&b, &a, &[]));
    let equal = ssim(&a, &a, &[]).unwrap();
    assert!((equal - 1.0).abs() < 1e-12, "{equal}");
}

#[test]
fn sizes_that_differ_or_are_too_small_are_named() {
    let error = psnr(&flat(0), &patterns(16, 13).0, &[]).unwrap_err();
    assert_eq!(
        error.to_string(),
        "16 x 12 pixels cannot be compared with 16 x 13"
    );
    let (a, b) = patterns(10, 40);
    let error = ssim(&a, &b, &[]).unwrap_err();
    assert_eq!(error.to_string(), "10 x 40 pixels, at least 11 a side are needed");
    let (a, b) = patterns(0, 0);
    assert!(matches!(psnr(&a, &b, &[]), Err(MetricError::TooSmall { .. })));
}

fn real(name: &str) -> Option<Image<Srgb>> {
    let data = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/data");
    let data = std::env::var("MARF_SHARED_DATA").unwrap_or_else(|_| data.to_owned());
    let bytes = std::fs::read(format!("{data}/{name}")).ok()?;
    Some(crate::Photo::decode(&bytes).unwrap().image)
}

#[test]
fn real_photos_score_as_in_scikit_image() {
    let pairs = [
        (
            "rover4/images/frame_0000{}.png",
            ["3", "6"],
            17.822_650_611_055_26,
            0.412_328_459_104_695_2,
        ),
        (
            "fox4/images/000{}.png",
            ["1", "2"],
            19.130_840_489_622_727,
            0.450_064_433_734_451_4,
        ),
    ];
    for (name, [a, b], psnr_there, ssim_there) in pairs {
        let (Some(a), Some(b)) = (real(&name.replace("{}", a)), real(&name.replace("{}", b))) else {
            println!("skipped: real_photos_score_as_in_scikit_image needs ../shared/data");
            return;
        };
        let (psnr, ssim) = (psnr(&a, &b, &[]).unwrap(), ssim(&a, &b, &[]).unwrap());
        assert!((psnr - psnr_there).abs() < 1e-9, "{name}: {psnr}");
        assert!((ssim - ssim_there).abs() < SSIM_TOLERANCE, "{name}: {ssim}");
    }
}

#[test]
fn what_is_hidden_changes_nothing_and_all_hidden_is_an_error() {
    let (a, b) = patterns(40, 30);
    let hidden: Vec<bool> = (0..40 * 30).map(|place| place % 40 < 8).collect();
    let mut spoilt = b.clone();
    for (pixel, hidden) in spoilt.pixels.iter_mut().zip(&hidden) {
        if *hidden {
            *pixel = [255, 0, 255];
        }
    }
    assert_ne!(psnr(&a, &b, &[]), psnr(&a, &spoilt, &[]));
    assert_eq!(psnr(&a, &b, &hidden), psnr(&a, &spoilt, &hidden));
    assert_eq!(psnr_paper(&a, &b, &hidden), psnr_paper(&a, &spoilt, &hidden));
    assert_eq!(ssim(&a, &b, &hidden), ssim(&a, &spoilt, &hidden));
    // The remaining columns are a separate picture.
    let right = |image: &Image<Srgb>| Image::from_fn(32, 30, |column, row| image.at(column + 8, row));
    assert_eq!(psnr(&a, &b, &hidden), psnr(&right(&a), &right(&b), &[]));
    let (found, expected) = (
        ssim(&a, &b, &hidden).unwrap(),
        ssim(&right(&a), &right(&b), &[]).unwrap(),
    );
    assert!((found - expected).abs() < 1e-12, "{found} {expected}");
    assert_eq!(psnr(&a, &b, &[true; 1200]), Err(MetricError::Hidden));
    assert_eq!(ssim(&a, &b, &[true; 1200]), Err(MetricError::Hidden));
}

#[test]
fn nothing_hidden_gives_the_same_bits_as_no_mask() {
    let (a, b) = patterns(25, 19);
    let none = [false; 25 * 19];
    assert_eq!(psnr(&a, &b, &none), psnr(&a, &b, &[]));
    assert_eq!(ssim(&a, &b, &none), ssim(&a, &b, &[]));
}

#[test]
fn an_affine_fit_takes_away_gain_and_offset_and_nothing_else() {
    let render = Image::<Srgb>::from_fn(16, 16, |column, row| [column as u8 * 8, row as u8 * 8, 50]);
    let exposed = |pixel: [u8; 3]| pixel.map(|channel| channel / 2 * 3 + 20);
    let photo = Image::from_fn(16, 16, |column, row| exposed(render.at(column, row)));
    let equal = psnr(&photo, &photo, &[]);
    assert_eq!(psnr_affine(&render, &photo, &[]), equal);
    assert!(psnr(&render, &photo, &[]).unwrap() < 20.0);
    // No gain and no offset turns one picture into another of as many tones at other places.
    let turned = Image::from_fn(16, 16, |column, row| render.at(row, column));
    let fitted = psnr_affine(&render, &turned, &[]).unwrap();
    assert!(fitted < 25.0, "{fitted}");
    // Hidden pixels count neither in the fit nor in the score.
    let mut spoilt = photo.clone();
    spoilt.pixels[5] = [255, 0, 255];
    let hidden: Vec<bool> = (0..256).map(|index| index == 5).collect();
    assert_eq!(psnr_affine(&render, &spoilt, &hidden), equal);
    let black = Image::from_fn(16, 16, |_, _| [0; 3]);
    assert_eq!(psnr_affine(&black, &black, &[]), equal);
    assert_eq!(
        psnr_affine(&render, &photo, &[true; 256]),
        Err(MetricError::Hidden)
    );
}
