//! The rules of single filters, the paper's among them, on cases worked by hand.

use crate::common::{
    Photos, bind, defaults, dynamic, encoded, ground, item, jpeg, noise, png, recoloured, smeared,
};
use image::ImageFormat;
use marf_scene::{Image, Sensor, Srgb};
use serde_json::json;

#[test]
fn size_counts_stored_bytes_and_bits_a_pixel() {
    let mut photos = Photos::default();
    for (id, bytes, side) in [
        ("small", 19_999, 320),
        ("enough", 20_000, 320),
        ("mud", 50_000, 1600),
    ] {
        photos.add_with(id, b"never opened", |facts| {
            facts.size_bytes = bytes;
            (facts.width, facts.height) = (side, side);
        });
    }
    let verdicts = photos.judge("size", defaults());
    assert_eq!(verdicts["small"].reason, "19999 bytes, at least 20000");
    assert!(verdicts["enough"].keeps());
    assert_eq!(
        verdicts["mud"].reason,
        "0.156 bits a pixel (50000 bytes), at least 0.25"
    );
    let paper = photos.judge("size", json!({"min_bytes": 100_000, "min_bits_per_pixel": 0.0}));
    assert!(paper.values().all(|verdict| verdict.verdict == "size"));
}

fn shapes(sizes: &[(&str, u32, u32, usize)]) -> Photos {
    let mut photos = Photos::default();
    for (name, width, height, count) in sizes {
        for copy in 0..*count {
            photos.add_with(&format!("{name}-{copy}"), b"never opened", |facts| {
                (facts.width, facts.height) = (*width, *height);
                facts.thumbnail = name.starts_with("thumbnail");
            });
        }
    }
    photos
}

#[test]
fn shape_rejects_thumbnails_small_photos_and_odd_ones_out() {
    let photos = shapes(&[
        ("full", 1440, 1920, 40),
        ("turned", 1920, 1440, 1),
        ("four-fifths", 1152, 1536, 1),
        ("half", 720, 960, 2),
        ("strip", 4320, 600, 1),
        ("tiny", 144, 192, 3),
        ("thumbnail", 1440, 1920, 1),
    ]);
    let verdicts = photos.judge("shape", defaults());
    for verdict in verdicts.values() {
        let good = ["full", "turned", "four"]
            .iter()
            .any(|name| verdict.id.starts_with(name));
        assert_eq!(verdict.keeps(), good, "{verdict:?}");
    }
    assert_eq!(
        verdicts["half-0"].reason,
        "720 x 960 pixels, an odd one out: short side 720, usual 1440, at least 864"
    );
}

#[test]
fn shape_keeps_the_strips_and_tiles_a_camera_often_makes() {
    let verdicts = shapes(&[("tile", 1288, 968, 31), ("strip", 1280, 240, 5)]).judge("shape", defaults());
    assert!(verdicts.values().all(marf_stage::Verdict::keeps), "{verdicts:?}");
}

#[test]
fn grayscale_sees_one_band_and_three_equal_bands_and_not_a_gray_edge() {
    let gray = dynamic(&ground(0)).to_luma8();
    let place = ground(1);
    let edge = Image::from_fn(320, 240, |x, y| if x < 40 { [90; 3] } else { place.at(x, y) });
    let noisy = recoloured(&ground(2), |[red, ..]| {
        [red, red.saturating_sub(2), red.saturating_add(2)]
    });
    let mut photos = Photos::default();
    photos
        .add("one-band", &encoded(&gray.clone().into(), ImageFormat::Png))
        .add("equal-bands", &jpeg(&gray.into(), 75))
        .add("noisy", &png(&noisy))
        .add("edge", &png(&edge))
        .add("color", &png(&ground(3)));
    let verdicts = photos.judge("grayscale", defaults());
    for (id, keeps) in [
        ("one-band", false),
        ("equal-bands", false),
        ("noisy", false),
        ("edge", true),
        ("color", true),
    ] {
        assert_eq!(verdicts[id].keeps(), keeps, "{:?}", verdicts[id]);
    }
    let all = photos.judge("grayscale", json!({"keep": "all"}));
    assert!(
        all.values().all(marf_stage::Verdict::keeps),
        "monochrome missions keep all"
    );
}

/// Gray photos of a camera of this name and sensor, and photos of it with colour.
fn camera(photos: &mut Photos, name: &str, sensor: Option<Sensor>, grays: usize, colors: usize) {
    let gray = encoded(&dynamic(&ground(0)).to_luma8().into(), ImageFormat::Png);
    let color = png(&ground(1));
    for at in 0..grays + colors {
        let bytes = if at < grays { &gray } else { &color };
        photos.add_with(&format!("{name}-{at}"), bytes, |facts| {
            (facts.instrument, facts.sensor) = (Some(name.to_owned()), sensor);
        });
    }
}

/// Photos that the default rule keeps, and those of them that it keeps as monochrome, of 87 gray and some coloured ones.
fn kept_of_camera(sensor: Option<Sensor>, colors: usize) -> (usize, usize) {
    let mut photos = Photos::default();
    camera(&mut photos, "NAVCAM_LEFT", sensor, 87, colors);
    let verdicts = photos.judge("grayscale", defaults());
    let kept_as = verdicts.values().filter_map(marf_stage::Verdict::kept_as);
    let monochrome = kept_as.filter(|kept| *kept == ("monochrome", "NAVCAM_LEFT"));
    (
        verdicts.values().filter(|verdict| verdict.keeps()).count(),
        monochrome.count(),
    )
}

#[test]
fn grayscale_keeps_the_photos_of_a_monochrome_camera_and_says_so() {
    assert_eq!(kept_of_camera(None, 0), (87, 87), "no photo has colour");
    assert_eq!(kept_of_camera(Some(Sensor::Monochrome), 0), (87, 87));
    assert_eq!(kept_of_camera(None, 1), (88, 87), "one flare is no evidence");
    assert_eq!(
        kept_of_camera(Some(Sensor::Monochrome), 40),
        (127, 87),
        "its name knows better"
    );
}

#[test]
fn grayscale_rejects_gray_photos_of_a_colour_camera() {
    assert_eq!(kept_of_camera(Some(Sensor::Color), 0), (0, 0));
    assert_eq!(kept_of_camera(Some(Sensor::Color), 9), (9, 0));
    assert_eq!(kept_of_camera(None, 9), (9, 0), "9 of 96 have colour");
}

/// Another camera's colours do not matter.
#[test]
fn grayscale_judges_each_camera_by_its_own_photos() {
    let mut photos = Photos::default();
    camera(&mut photos, "NLA", None, 5, 0);
    camera(&mut photos, "ML", None, 1, 9);
    let verdicts = photos.judge("grayscale", defaults());
    let rejected: Vec<_> = verdicts.values().filter(|verdict| !verdict.keeps()).collect();
    assert_eq!(rejected.len(), 1, "{rejected:?}");
    assert_eq!(
        (rejected[0].id.as_str(), rejected[0].reason.as_str()),
        ("ML-0", "one band: 9 of 10 photos of its camera have colour")
    );
}

/// A mosaic of a reddish ground, and its gray twin, whose means at the four positions are equal.
#[test]
fn grayscale_never_keeps_a_colour_mosaic_as_gray() {
    let place = ground(0);
    let mosaic = Image::from_fn(320, 240, |x, y| {
        let [red, green, blue] = place.at(x, y);
        let light = [red, green, green, blue][(2 * (y % 2) + x % 2) as usize];
        [light; 3]
    });
    for sensor in [None, Some(Sensor::Monochrome), Some(Sensor::Color)] {
        let mut photos = Photos::default();
        let bytes = encoded(&dynamic(&mosaic).to_luma8().into(), ImageFormat::Png);
        photos.add_with("mosaic", &bytes, |facts| facts.sensor = sensor);
        let verdict = &photos.judge("grayscale", defaults())["mosaic"];
        assert_eq!(verdict.verdict, "grayscale", "{verdict:?}");
        assert!(
            verdict.reason.contains("mosaic that is not developed"),
            "{verdict:?}"
        );
    }
}

/// An eighth of the mosaic is left in gray copies of colour photos that were interpolated carelessly.
#[test]
fn grayscale_keeps_gray_photos_with_a_trace_of_a_mosaic() {
    let place = ground(0);
    let gray = Image::from_fn(320, 240, |x, y| {
        let [red, green, blue] = place.at(x, y).map(u16::from);
        let light = [red, green, green, blue][(2 * (y % 2) + x % 2) as usize];
        [((7 * green + light) / 8) as u8; 3]
    });
    let mut photos = Photos::default();
    photos.add("trace", &png(&gray));
    let verdict = &photos.judge("grayscale", defaults())["trace"];
    assert!(verdict.keeps(), "{verdict:?}");
}

/// By hand: of 200 pixels one has spread 9, which is 0.5 %: not below the default.
#[test]
fn grayscale_counts_the_share_of_pixels_with_spread() {
    for (spread, keeps) in [(8, false), (9, true)] {
        let image = Image::from_fn(20, 10, |x, y| {
            if (x, y) == (3, 4) {
                [90 + spread, 90, 90]
            } else {
                [90; 3]
            }
        });
        let mut photos = Photos::default();
        photos.add("a", &png(&image));
        let verdict = &photos.judge("grayscale", json!({"keep": "color"}))["a"];
        assert_eq!(verdict.keeps(), keeps, "spread {spread}: {verdict:?}");
    }
}

/// A photo of 6 % of the light has colours some steps apart. Noise of one step in a gray one is still none.
#[test]
fn grayscale_keeps_a_dark_photo_with_colour_and_rejects_a_dark_gray_one() {
    let place = ground(3);
    let at = |light: f64| {
        recoloured(&place, |rgb| {
            rgb.map(|channel| (f64::from(channel) * light).round() as u8)
        })
    };
    let gray = |light: f64| {
        recoloured(&place, |[red, ..]| {
            let dark = (f64::from(red) * light).round() as u8;
            [dark, dark + red % 2, dark]
        })
    };
    for light in [1.0, 0.5, 0.25, 0.12, 0.06] {
        let mut photos = Photos::default();
        photos
            .add("color", &png(&at(light)))
            .add("gray", &png(&gray(light * 0.9)));
        let verdicts = photos.judge("grayscale", defaults());
        for (id, keeps) in [("color", true), ("gray", false)] {
            assert_eq!(verdicts[id].keeps(), keeps, "{light}: {:?}", verdicts[id]);
        }
    }
}

/// Eight places and one photo under test.
fn among_others(name: &str, image: &Image<Srgb>) -> Photos {
    let mut photos = Photos::default();
    for seed in 100..108 {
        photos.add(&format!("place-{seed}"), &png(&ground(seed)));
    }
    photos.add(name, &png(image));
    photos
}

#[test]
fn histogram_rejects_lost_areas_blocks_stripes_and_wrong_light() {
    let place = ground(110);
    let lost = |value: u8| Image::from_fn(320, 240, |x, y| if y < 80 { place.at(x, y) } else { [value; 3] });
    let stripes = Image::from_fn(320, 240, |x, y| {
        if (y / 16) % 2 == 0 {
            [255, 0, 255]
        } else {
            place.at(x, y)
        }
    });
    let blocks = Image::from_fn(320, 240, |x, y| [0, 1, 2].map(|band| noise(x / 32, y / 32, band)));
    let dark = recoloured(&place, |pixel| pixel.map(|value| value / 8));
    let negative = recoloured(&place, |pixel| pixel.map(|value| 255 - value));
    for (name, image) in [
        ("lost-black", lost(0)),
        ("lost-gray", lost(90)),
        ("stripes", stripes),
        ("blocks", blocks),
        ("dark", dark),
        ("negative", negative),
    ] {
        let verdicts = among_others(name, &image).judge("histogram", defaults());
        for verdict in verdicts.values() {
            assert_eq!(verdict.keeps(), verdict.id != name, "{verdict:?}");
        }
    }
}

#[test]
fn histogram_judges_small_sets_by_lost_areas_only() {
    let lost = ground(2);
    let mut photos = Photos::default();
    photos
        .add("a", &png(&ground(0)))
        .add(
            "b",
            &png(&recoloured(&ground(1), |pixel| pixel.map(|value| value / 8))),
        )
        .add(
            "c",
            &png(&Image::from_fn(320, 240, |x, y| {
                if y < 80 { lost.at(x, y) } else { [0; 3] }
            })),
        );
    let verdicts = photos.judge("histogram", defaults());
    assert!(verdicts["a"].keeps() && verdicts["b"].keeps(), "{verdicts:?}");
    assert_eq!(verdicts["c"].verdict, "histogram");
}

#[test]
fn the_papers_histogram_rule_counts_bins_out_of_place() {
    // All bins of the others hold 1/256 but for a jitter. The odd one has all its pixels in one bin.
    let even = |step: u32| {
        Image::from_fn(256, 16, |x, y| {
            [if y == 0 { (x * step % 256) as u8 } else { x as u8 }; 3]
        })
    };
    let mut photos = Photos::default();
    for step in [1, 3, 5, 7] {
        photos.add(&format!("even-{step}"), &png(&even(step)));
    }
    photos.add("odd", &png(&Image::from_fn(256, 16, |_, _| [200; 3])));
    let verdicts = photos.judge("histogram", json!({"rule": "paper"}));
    assert_eq!(verdicts["odd"].score, Some(1.0), "{:?}", verdicts["odd"]);
    assert_eq!(verdicts["odd"].verdict, "histogram");
    let mut two = Photos::default();
    two.add("a", &png(&even(1))).add("b", &png(&even(3)));
    for verdict in two.judge("histogram", json!({"rule": "paper"})).values() {
        assert!(verdict.keeps() && !verdict.reason.is_empty(), "{verdict:?}");
    }
}

#[test]
fn blur_rejects_smear_along_either_axis_and_noise() {
    let turn = |image: &Image<Srgb>| Image::from_fn(image.height, image.width, |x, y| image.at(y, x));
    let static_noise = Image::from_fn(320, 240, |x, y| [0, 1, 2].map(|band| noise(x, y, band)));
    for (name, image) in [
        ("along-rows", smeared(&ground(120), 15)),
        ("along-columns", turn(&smeared(&turn(&ground(120)), 15))),
        ("focus", turn(&smeared(&turn(&smeared(&ground(120), 5)), 5))),
        ("noise", static_noise),
    ] {
        let verdicts = among_others(name, &image).judge("blur", defaults());
        for verdict in verdicts.values() {
            assert_eq!(verdict.keeps(), verdict.id != name, "{verdict:?}");
        }
    }
}

/// A measure as `blur` keeps it: the variance, then five numbers of the first of three sizes: pixels, sums before and after the blur.
fn kept_sharpness(numbers: [u8; 5]) -> Vec<u8> {
    [&[1], &1.0_f64.to_le_bytes()[..], &[1], &numbers, &[0, 0]].concat()
}

/// By hand: ratios of 2, 3, 4, 5 and 8. Without the 8 the median is 3.5, and 0.55 of it is 1.9. With `min_set` five
/// this is the limit, with six it is `min_ratio`.
#[test]
fn blur_compares_from_min_set_photos_on_and_leaves_the_photo_itself_out() {
    let mut photos = Photos::default();
    let ratios = [2, 3, 4, 5, 8];
    for ratio in ratios {
        photos.add(&format!("ratio-{ratio}"), b"never opened");
    }
    let measures = ratios.map(|ratio| kept_sharpness([1, ratio * 2 - 1, ratio * 2 - 1, 1, 1]));
    let thresholds = |min_set: u32| {
        let stage = bind("blur", json!({"min_set": min_set, "floor_ratio": 0.1}));
        let items: Vec<_> = photos
            .rows
            .iter()
            .zip(&measures)
            .map(|(row, measure)| item(0, row, measure))
            .collect();
        let verdicts = photos.decide(&*stage, &items);
        verdicts
            .into_iter()
            .map(|verdict| verdict.threshold.unwrap())
            .collect::<Vec<_>>()
    };
    assert_eq!(thresholds(6), [9.0; 5]);
    let expected = [4.5, 4.5, 4.0, 3.5, 3.5].map(|median| 0.55 * median);
    for (found, expected) in thresholds(5).into_iter().zip(expected) {
        assert!(
            (found / expected - 1.0).abs() < 0.008,
            "{found} for {expected}: half a bin off at the most"
        );
    }
}

/// No picture has such measures: no pixels, and a ratio that is NaN or infinite.
#[test]
fn a_ratio_that_is_no_number_or_infinite_moves_no_limit_of_others_beyond_numbers() {
    let mut photos = Photos::default();
    let mut measures = Vec::new();
    for at in 0..9 {
        photos.add(&format!("photo-{at}"), b"never opened");
        measures.push(match at {
            0 => kept_sharpness([0; 5]),
            1 => kept_sharpness([0, 9, 9, 0, 0]),
            _ => kept_sharpness([1, 9 + at, 9 + at, 0, 0]),
        });
    }
    let items: Vec<_> = photos
        .rows
        .iter()
        .zip(&measures)
        .map(|(row, measure)| item(0, row, measure))
        .collect();
    for verdict in photos.decide(&*bind("blur", defaults()), &items) {
        assert!(verdict.threshold.unwrap().is_finite(), "{verdict:?}");
        assert!(verdict.keeps() || verdict.id == "photo-1", "{verdict:?}");
    }
}

#[test]
fn blur_does_not_depend_on_the_brightness() {
    let mut photos = Photos::default();
    let dim = recoloured(&ground(130), |pixel| pixel.map(|value| value / 2));
    photos.add("bright", &png(&ground(130))).add("dim", &png(&dim));
    let verdicts = photos.judge("blur", defaults());
    let ratio = verdicts["dim"].score.unwrap() / verdicts["bright"].score.unwrap();
    assert!(
        (0.9..1.15).contains(&ratio),
        "half the light changes the ratio by {ratio}"
    );
}

/// By hand: columns 0 0 0 100 100 100 have Laplacians 0 100 -100 0, variance 5000.
#[test]
fn the_papers_blur_rule_is_the_variance_of_the_laplacian() {
    let step = Image::from_fn(6, 4, |x, _| [if x < 3 { 0 } else { 100 }; 3]);
    let mut photos = Photos::default();
    photos
        .add("step", &png(&step))
        .add("flat", &png(&Image::from_fn(6, 4, |_, _| [77; 3])));
    let verdicts = photos.judge("blur", json!({"rule": "laplacian"}));
    assert_eq!(
        (verdicts["step"].score, verdicts["step"].threshold),
        (Some(5000.0), Some(60.0))
    );
    assert_eq!(
        (verdicts["flat"].verdict.as_str(), verdicts["flat"].score),
        ("blur", Some(0.0))
    );
    let strict = photos.judge("blur", json!({"rule": "laplacian", "tau": 5000.1}));
    assert!(!strict["step"].keeps());
}
