//! What cannot be learnt from, numbers that run away, photos with few pixels or hidden ones.

use marf_scene::Image;

use crate::test_scene::{ball, ball_view, psnr, small, trained};
use crate::{Background, Config, FieldError, Pixels, Trainer, View};

#[test]
fn what_cannot_be_learnt_from_is_refused_by_name() {
    let refuse = |views: Vec<View>, points: &[[f64; 3]], config: Config| {
        Trainer::new(views, points, &config, 0).err().unwrap().to_string()
    };
    assert_eq!(
        refuse(vec![], &[], small()),
        "no views: a field needs at least one photo with a camera"
    );
    let mut views = ball(2, 8);
    views[1].image.pixels.pop();
    assert_eq!(
        refuse(views, &[], small()),
        "view `ball 3.14`: image of 8 x 8 with 63 pixels"
    );
    let mut views = ball(2, 8);
    views[0].image = Image::from_fn(0, 0, |_, _| [0; 3]).into();
    assert_eq!(
        refuse(views, &[], small()),
        "view `ball 0.00`: image of 0 x 0 with 0 pixels"
    );
    let mut views = ball(2, 8);
    views[0].camera.width = 9;
    assert!(refuse(views, &[], small()).contains("camera is for 9 x 8, the image has 8 x 8"));
    let mut views = ball(2, 8);
    views[1].cam_from_world.translation.x = f64::NAN;
    assert!(refuse(views, &[], small()).starts_with("view `ball 3.14`: camera or pose"));
    let point = [[0.0; 3], [1.0, f64::INFINITY, 0.0]];
    assert!(refuse(ball(2, 8), &point, small()).starts_with("point 1 is not finite"));
    let config = Config {
        learning_rate: f64::NAN,
        ..small()
    };
    assert_eq!(
        refuse(ball(2, 8), &[], config),
        "`learning_rate` is NaN, must be above 0, at most 1"
    );
}

#[test]
fn a_nan_weight_stops_the_step_and_leaves_the_state() {
    let mut trainer = trained(ball(3, 12), &small(), 2, 5);
    trainer.training.state.weights.tables[0].fill(f32::NAN);
    let before = trainer.save().unwrap();
    let error = trainer.advance(1).unwrap_err();
    let text = error.to_string();
    assert!(
        text.starts_with("step 5: `raw density` is not finite, or beyond 1e9, at chunk 0"),
        "{text}"
    );
    assert!(trainer.save().unwrap() == before);
}

#[test]
fn a_learning_rate_of_a_million_stops_by_name_or_stays_finite() {
    let mut trainer = Trainer::new(ball(3, 12), &[], &small(), 2).unwrap();
    trainer.training.config.learning_rate = 1e6;
    for _ in 0..50 {
        let before = trainer.save().unwrap();
        if let Err(error) = trainer.advance(1) {
            assert!(matches!(error, FieldError::NotFinite { .. }), "{error}");
            assert!(trainer.save().unwrap() == before);
            return;
        }
        let finite = |(_, values): (String, &[f32])| values.iter().all(|value| value.is_finite());
        assert!(
            trainer.training.state.weights.tensors().into_iter().all(finite),
            "step {}",
            trainer.steps()
        );
    }
}

#[test]
fn constant_photos_one_photo_and_one_pixel_train_without_harm() {
    for value in [0_u8, 128, 255] {
        for (count, width) in [(4, 8), (1, 8), (1, 1)] {
            let mut views = ball(count, width);
            views
                .iter_mut()
                .for_each(|view| view.image.pixels.fill([value; 3]));
            let mut trainer = trained(views.clone(), &small(), 4, 300);
            let score = psnr(&trainer.field().unwrap(), &views[0]);
            assert!(
                score > 20.0,
                "value {value}, {count} photos of {width} x {width}: {score} dB"
            );
        }
    }
}

#[test]
fn photos_of_different_sizes_train_together() {
    let mut views = ball(3, 12);
    views.push(ball_view(0.7, 0.2, 20));
    let trainer = trained(views, &small(), 4, 30);
    assert_eq!(trainer.steps(), 30);
}

/// The left third of every photo shows hardware, of this colour.
fn with_hardware(rgb: [u8; 3]) -> Vec<View> {
    let masked = |(index, view): (usize, View)| {
        let width = view.camera.width;
        let is_hidden = |column: u32| column < width / 3;
        let mask: Vec<bool> = (0..width * width).map(|place| is_hidden(place % width)).collect();
        let image = Image::from_fn(width, width, |column, row| {
            let (_, colour) = view.image.at((row * width + column) as usize);
            if is_hidden(column) {
                rgb
            } else {
                colour.map(|channel| (channel * 255.0 + 0.5) as u8)
            }
        });
        let image = Pixels::thinned(image, Some(&mask), 1, 0, index as u64);
        View { image, ..view }
    };
    ball(6, 24).into_iter().enumerate().map(masked).collect()
}

#[test]
fn nothing_under_a_mask_changes_what_is_learnt() {
    let config = Config {
        background: Background::Direction,
        ..small()
    };
    let [mut white, mut green] =
        [[255; 3], [0, 200, 0]].map(|rgb| trained(with_hardware(rgb), &config, 1, 30));
    assert_eq!(white.field().unwrap().encode(), green.field().unwrap().encode());
}

#[test]
fn a_photo_of_which_a_mask_leaves_nothing_is_named() {
    let mut views = with_hardware([0; 3]);
    let hidden = Pixels::thinned(Image::from_fn(24, 24, |_, _| [9; 3]), Some(&[true; 576]), 1, 0, 0);
    views[2].image = hidden;
    let error = Trainer::new(views, &[], &small(), 0).err().unwrap();
    assert!(error.to_string().contains("mask hides all"), "{error}");
}
