use marf_numeric::Rng;

use super::extract::{Photo, extract_above, extract_on};
use super::*;
use crate::simd::InstructionSet;

/// A smooth texture: blobs of many sizes, as a function of the plane.
struct Texture(Vec<[f64; 4]>);

impl Texture {
    fn new(seed: u64) -> Self {
        let mut rng = Rng::new(seed);
        let blob = |_| {
            let sigma = 1.5 * 8_f64.powf(rng.unit_f64());
            [
                rng.unit_f64() * 400.0 - 200.0,
                rng.unit_f64() * 400.0 - 200.0,
                sigma,
                rng.unit_f64() - 0.5,
            ]
        };
        Self((0..1500).map(blob).collect())
    }

    /// Photographs the plane. `plane_from_photo` maps pixels from the middle of the photo.
    fn photo(&self, side: u32, plane_from_photo: [f64; 4]) -> Gray {
        let mut pixels = vec![0.5_f64; (side * side) as usize];
        let [a, b, c, d] = plane_from_photo;
        let determinant = a * d - b * c;
        let zoom = determinant.abs().sqrt();
        let middle = f64::from(side) / 2.0;
        for [x, y, sigma, height] in &self.0 {
            // A blob seen from afar is a smaller blob.
            let (u, v) = (
                (d * x - b * y) / determinant + middle,
                (a * y - c * x) / determinant + middle,
            );
            let s = sigma / zoom;
            let range = |at: f64| {
                ((at - 4.0 * s).max(0.0) as usize)..((at + 4.0 * s).clamp(0.0, f64::from(side)) as usize)
            };
            for row in range(v) {
                for column in range(u) {
                    let squared = (column as f64 + 0.5 - u).powi(2) + (row as f64 + 0.5 - v).powi(2);
                    pixels[row * side as usize + column] += 0.5 * height * (-0.5 * squared / (s * s)).exp();
                }
            }
        }
        Gray {
            width: side,
            height: side,
            pixels: pixels.iter().map(|pixel| pixel.clamp(0.0, 1.0) as f32).collect(),
        }
    }
}

fn open(gray: &Gray) -> Mask {
    Mask {
        width: gray.width,
        height: gray.height,
        open: vec![true; gray.pixels.len()],
    }
}

fn extracted(gray: &Gray) -> Features {
    searched(gray, &open(gray), &FeatureOptions::default())
}

fn searched(gray: &Gray, mask: &Mask, options: &FeatureOptions) -> Features {
    extract(gray, mask, options, &|| false).unwrap()
}

fn turn(degrees: f64, zoom: f64) -> [f64; 4] {
    let (sin, cos) = degrees.to_radians().sin_cos();
    [zoom * cos, -zoom * sin, zoom * sin, zoom * cos]
}

#[test]
fn features_come_back_when_the_photo_is_turned_and_scaled() {
    use crate::matching::match_pair;
    let texture = Texture::new(1);
    let side = 240;
    let middle = f64::from(side) / 2.0;
    let first = extracted(&texture.photo(side, turn(0.0, 1.0)));
    for (degrees, zoom) in [
        (0.0, 1.0),
        (30.0, 1.0),
        (45.0, 1.0),
        (90.0, 1.0),
        (137.0, 1.0),
        (180.0, 1.0),
        (20.0, 0.5),
        (60.0, 0.7),
        (10.0, 1.5),
        (170.0, 2.0),
    ] {
        let plane_from_photo = turn(degrees, zoom);
        let second = extracted(&texture.photo(side, plane_from_photo));
        let pairs = match_pair(&first, &second);
        let miss = |pair: &[u32; 2]| {
            let (from, to) = (
                &first.keypoints[pair[0] as usize],
                &second.keypoints[pair[1] as usize],
            );
            let (x, y) = (f64::from(to.x_px) - middle, f64::from(to.y_px) - middle);
            let [a, b, c, d] = plane_from_photo;
            (a * x + b * y + middle - f64::from(from.x_px))
                .hypot(c * x + d * y + middle - f64::from(from.y_px))
        };
        let right = pairs
            .iter()
            .filter(|pair| miss(pair) < 1.5 * zoom.max(1.0))
            .count();
        let common = zoom.min(1.0 / zoom).powi(2);
        let possible = first.keypoints.len().min(second.keypoints.len()) as f64 * common;
        println!(
            "{degrees} {zoom}: {} {} pairs {} right {right} of about {possible:.0}",
            first.keypoints.len(),
            second.keypoints.len(),
            pairs.len()
        );
        assert!(
            right * 10 >= pairs.len() * 9,
            "{degrees} x {zoom}: {right} of {} right",
            pairs.len()
        );
        assert!(
            right as f64 > 0.3 * possible,
            "{degrees} x {zoom}: {right} of {possible}"
        );
    }
}

#[test]
fn the_angle_and_the_scale_follow_the_photo() {
    let texture = Texture::new(2);
    let (first, second) = (
        extracted(&texture.photo(200, turn(0.0, 1.0))),
        extracted(&texture.photo(200, turn(90.0, 1.0))),
    );
    // A quarter turn moves pixels onto pixels: nearly every point has its like.
    let like = |point: &&Keypoint| {
        second.keypoints.iter().any(|other| {
            let (x, y) = (other.x_px - 100.0, other.y_px - 100.0);
            let near = (-y + 100.0 - point.x_px).hypot(x + 100.0 - point.y_px) < 0.2;
            let turned = (point.angle_rad - other.angle_rad - std::f32::consts::FRAC_PI_2)
                .rem_euclid(std::f32::consts::TAU);
            near && turned.min(std::f32::consts::TAU - turned) < 0.05
                && (other.scale_px / point.scale_px - 1.0).abs() < 0.05
        })
    };
    let count = first.keypoints.iter().filter(like).count();
    println!("{count} of {}", first.keypoints.len());
    assert!(
        count * 10 > first.keypoints.len() * 9,
        "{count} of {}",
        first.keypoints.len()
    );
}

#[test]
fn features_are_equal_to_the_bit_on_every_set() {
    let gray = Texture::new(3).photo(150, turn(10.0, 0.8));
    for first_octave in [FirstOctave::Native, FirstOctave::Doubled] {
        let options = FeatureOptions {
            first_octave,
            ..FeatureOptions::default()
        };
        let plain = extract_on(InstructionSet::all()[0], &gray, &open(&gray), &options, &|| false).unwrap();
        assert!(plain.keypoints.len() > 50, "{}", plain.keypoints.len());
        for set in InstructionSet::all() {
            assert!(
                extract_on(set, &gray, &open(&gray), &options, &|| false)
                    .unwrap()
                    .encode()
                    == plain.encode(),
                "{set:?}"
            );
        }
    }
}

#[test]
fn extremes_give_finite_features_or_none() {
    let mut rng = Rng::new(4);
    let mut shape = |width: u32, height: u32, constant: Option<f32>| Gray {
        width,
        height,
        pixels: (0..width * height)
            .map(|_| constant.unwrap_or(rng.unit_f64() as f32))
            .collect(),
    };
    let photos = [
        shape(0, 0, None),
        shape(1, 1, None),
        shape(31, 31, None),
        shape(15, 400, None),
        shape(16, 300, None),
        shape(64, 64, Some(0.0)),
        shape(64, 64, Some(1.0)),
        shape(31, 31, Some(0.3)),
        shape(70, 70, None),
    ];
    for gray in photos {
        for first_octave in [FirstOctave::Native, FirstOctave::Doubled] {
            let options = FeatureOptions {
                first_octave,
                ..FeatureOptions::default()
            };
            let photo = Photo {
                gray: &gray,
                mask: &open(&gray),
                options: &options,
                stop: &|| false,
            };
            let features = if gray.width.min(gray.height) < 16 {
                searched(&gray, &open(&gray), &options)
            } else {
                extract_above(InstructionSet::best(), &photo, 1e-9).unwrap()
            };
            let inside = |point: &Keypoint| {
                let numbers = [point.x_px, point.y_px, point.scale_px, point.angle_rad];
                let (width, height) = (gray.width as f32, gray.height as f32);
                numbers.iter().all(|number| number.is_finite())
                    && (0.0..width).contains(&point.x_px)
                    && (0.0..height).contains(&point.y_px)
            };
            assert!(
                features.keypoints.iter().all(inside),
                "{} x {}",
                gray.width,
                gray.height
            );
            let constant = gray.pixels.windows(2).all(|pair| pair[0] == pair[1]);
            assert!(
                !constant || features.keypoints.is_empty(),
                "{} x {}",
                gray.width,
                gray.height
            );
        }
    }
    for bad in [f32::NAN, f32::INFINITY, -0.1, 1.1] {
        let mut gray = shape(64, 64, None);
        gray.pixels[77] = bad;
        assert_eq!(extracted(&gray), Features::default(), "{bad}");
    }
}

#[test]
fn the_cap_holds_and_a_closed_half_stays_empty() {
    let gray = Texture::new(5).photo(200, turn(0.0, 1.0));
    for max_features in [0, 1, 2, 50, 149] {
        let options = FeatureOptions {
            max_features,
            ..FeatureOptions::default()
        };
        let count = searched(&gray, &open(&gray), &options).keypoints.len();
        assert!(
            count <= max_features as usize && count + 1 >= max_features as usize,
            "{max_features}: {count}"
        );
    }
    let mut mask = open(&gray);
    (0..200 * 200)
        .filter(|index| index % 200 < 100)
        .for_each(|index| mask.open[index] = false);
    let features = searched(&gray, &mask, &FeatureOptions::default());
    assert!(!features.keypoints.is_empty());
    assert!(
        features
            .keypoints
            .iter()
            .all(|point| point.x_px > 100.0 + point.scale_px - 1.0)
    );
    mask.width = 100;
    assert_eq!(
        searched(&gray, &mask, &FeatureOptions::default()),
        Features::default()
    );
}

#[test]
fn keypoints_are_in_order_and_descriptors_have_their_length() {
    let features = extracted(&Texture::new(6).photo(200, turn(0.0, 1.0)));
    assert_eq!(features.keypoints.len(), features.descriptors.len());
    // Octaves of growing scale: the order within them is that of layer, row and column.
    assert!(
        features
            .keypoints
            .is_sorted_by_key(|point| (point.scale_px / 1.6).log2().floor() as i32 / 4)
    );
    for descriptor in &features.descriptors {
        let squares: u32 = descriptor.iter().map(|&byte| u32::from(byte).pow(2)).sum();
        assert!((f64::from(squares).sqrt() - 512.0).abs() < 12.0, "{squares}");
    }
}
