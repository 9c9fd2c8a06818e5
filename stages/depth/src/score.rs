//! How far the depths of photos are from ranges that other programs measured.

use std::collections::BTreeMap;

use marf_cache::Digest;
use marf_numeric::{quantile, upper_median};
use marf_scene::picture::png16::read_quantity;
use marf_scene::{Cahvor, Camera, Frame, PhotoFacts, Pinhole};
use marf_schema::depth::{Agreement, OctaveAgreement, RangeDifference};
use nalgebra::{Vector2, Vector3};
use rayon::prelude::*;

/// Four neighbours are one surface if their inverse depths differ by at most this share: level ground 2 m below a camera does up to a
/// distance of a hundred metres.
const SAME_SURFACE: f32 = 0.1;
/// A difference of at most this share of the range is small.
const SMALL: f64 = 0.01;
/// Standard deviations that a difference may have.
const SIGMAS: f64 = 3.0;
/// Share of the differences that are below the one reported as large.
const LARGE: f64 = 0.9;
/// Largest distance between the cameras of a photo and of a product of it, metres. The eyes of a mast are ten times as far apart.
const SAME_CENTRE_M: f64 = 0.02;

/// Why a photo's depths cannot be compared.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ScoreError {
    /// The label of the photo has no camera.
    #[error("the label of its photo has no usable camera")]
    NoCamera,
    /// The depths are for another picture than those that the label's camera gives.
    #[error("its photo was resampled to another camera than that of its label")]
    Resampled,
    /// The pictures are not those of the stage.
    #[error("the pictures of inverse depth and sigma of its photo cannot be read")]
    Pictures,
    /// Another camera.
    #[error("its camera is {distance_m:.3} m from that of its photo")]
    Apart {
        /// Distance between the two.
        distance_m: f64,
    },
}

/// A depth at one place of a photo.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Depth {
    /// Distance from the camera's centre, metres.
    pub range_m: f64,
    /// Standard deviation of the inverse depth, as a share of it.
    pub sigma_share: f64,
}

/// The depths of a photo, by the camera of its label.
#[derive(Debug, Clone)]
pub struct LabelledDepths {
    /// Model of the label, in the photo's own pixels.
    model: Cahvor,
    /// The pinhole that the photo was resampled to. `None` if the depths are for its own pixels.
    pinhole: Option<Pinhole>,
    /// Pixels of the photo, or of the pinhole, that are one of the pictures.
    factor: f64,
    /// Camera of the pictures.
    camera: Camera,
    /// Metres⁻¹, 0 where there is none.
    inverse: Vec<f32>,
    sigma: Vec<f32>,
}

impl LabelledDepths {
    /// Reads the pictures that the stage wrote for a photo.
    ///
    /// - `image`: digest of the photo as it was read.
    /// - `pictures`: PNG of the inverse depth and of its standard deviation, in metres⁻¹.
    ///
    /// # Errors
    /// See [`ScoreError`].
    pub fn read(
        frame: &Frame,
        facts: &PhotoFacts,
        image: Option<Digest>,
        pictures: [&[u8]; 2],
    ) -> Result<Self, ScoreError> {
        let model = facts.prior.as_ref().ok_or(ScoreError::NoCamera)?.model;
        let [inverse, sigma] = [(pictures[0], "inverse-depth"), (pictures[1], "sigma")]
            .map(|(bytes, name)| read_quantity(bytes, name));
        let (Some((width, height, inverse)), Some((_, _, sigma))) = (inverse, sigma) else {
            return Err(ScoreError::Pictures);
        };
        let shrunk = frame.camera.width.checked_div(width).unwrap_or(0).max(1);
        let camera = frame.camera.box_reduced(shrunk);
        if (camera.width, camera.height) != (width, height) || inverse.len() != sigma.len() {
            return Err(ScoreError::Pictures);
        }
        let (pinhole, reduced) = if image == Some(frame.image) {
            (None, 1)
        } else {
            let pinhole = label_pinhole(&model, facts).ok_or(ScoreError::Resampled)?;
            let reduced = (pinhole.camera.width / frame.camera.width).max(1);
            let same = pinhole.camera.box_reduced(reduced);
            if (same.width, same.height) != (frame.camera.width, frame.camera.height) {
                return Err(ScoreError::Resampled);
            }
            (Some(pinhole), reduced)
        };
        Ok(Self {
            model,
            pinhole,
            factor: f64::from(shrunk * reduced),
            camera,
            inverse,
            sigma,
        })
    }

    /// Returns the depth where the photo shows a point, given in the frame of its label. `None` where it has none.
    pub fn depth(&self, point: &Vector3<f64>) -> Option<Depth> {
        let own = self.model.project(point)?;
        let pixel = match &self.pinhole {
            // The photo was resampled by the directions of its rays.
            Some(pinhole) => {
                let ray = self.model.unproject(&own)?.direction;
                pinhole.camera.project(&pinhole.cam_from_frame.direction(&ray))?
            }
            None => own.add_scalar(0.5),
        };
        self.at(&(pixel / self.factor))
    }

    /// Returns the depth at a place of the pictures: between four pixels of one surface by interpolation, as the inverse depth of a plane is
    /// linear, and else that of the nearest pixel.
    fn at(&self, place: &Vector2<f64>) -> Option<Depth> {
        let nearest = self.index(place)?;
        let centred = place.add_scalar(-0.5);
        let corner = centred.map(f64::floor);
        let share = centred - corner;
        let around = [[0.5, 0.5], [1.5, 0.5], [0.5, 1.5], [1.5, 1.5]]
            .map(|offset| self.index(&(corner + Vector2::from(offset))));
        let inverse = match around {
            [Some(a), Some(b), Some(c), Some(d)] if self.is_one_surface([a, b, c, d]) => {
                let [a, b, c, d] = [a, b, c, d].map(|index| f64::from(self.inverse[index]));
                (a * (1.0 - share.x) + b * share.x) * (1.0 - share.y)
                    + (c * (1.0 - share.x) + d * share.x) * share.y
            }
            _ => f64::from(self.inverse[nearest]),
        };
        Some(Depth {
            range_m: self.camera.unproject(place)?.norm() / inverse,
            sigma_share: f64::from(self.sigma[nearest]) / inverse,
        })
    }

    /// Returns the index of the pixel at a place, if it has a depth.
    fn index(&self, place: &Vector2<f64>) -> Option<usize> {
        let (width, height) = (f64::from(self.camera.width), f64::from(self.camera.height));
        if !(0.0..width).contains(&place.x) || !(0.0..height).contains(&place.y) {
            return None;
        }
        let index = place.y as usize * self.camera.width as usize + place.x as usize;
        (self.inverse[index] > 0.0).then_some(index)
    }

    fn is_one_surface(&self, pixels: [usize; 4]) -> bool {
        let inverse = pixels.map(|index| self.inverse[index]);
        let (least, most) = inverse
            .iter()
            .fold((f32::INFINITY, 0.0_f32), |(least, most), value| {
                (least.min(*value), most.max(*value))
            });
        most - least <= SAME_SURFACE * most
    }
}

/// Returns the pinhole that `calibrate` takes for a photo of this label.
fn label_pinhole(model: &Cahvor, facts: &PhotoFacts) -> Option<Pinhole> {
    let exact = model.exact_pinhole(facts.width, facts.height).ok()?;
    exact.or_else(|| model.linearised(facts.width, facts.height).ok())
}

/// A photo that shows what a product measured.
#[derive(Debug, Clone)]
pub struct View {
    /// Camera of the product in the frame of the photo's label.
    camera: Cahvor,
    depths: LabelledDepths,
}

impl View {
    /// Returns the view of a product whose camera is given in the frame of the photo's label.
    ///
    /// # Errors
    /// [`ScoreError::Apart`] if the product is of another camera.
    pub fn new(camera: Cahvor, depths: LabelledDepths) -> Result<Self, ScoreError> {
        let distance_m = (Vector3::from(camera.c) - Vector3::from(depths.model.c)).norm();
        if distance_m > SAME_CENTRE_M {
            return Err(ScoreError::Apart { distance_m });
        }
        Ok(Self { camera, depths })
    }

    /// Returns the depth of the photo where a pixel of the product (integer = pixel centre, 0-based) has a range.
    fn depth(&self, pixel: &Vector2<f64>, range_m: f64) -> Option<Depth> {
        let ray = self.camera.unproject(pixel)?;
        // The ray of a CAHVORE camera starts some millimetres from C, from which the range is measured.
        let start = ray.origin - Vector3::from(self.camera.c);
        let along = start.dot(&ray.direction);
        let rest = along * along - start.norm_squared() + range_m * range_m;
        if rest < 0.0 {
            return None;
        }
        self.depths
            .depth(&(ray.origin + ray.direction * (rest.sqrt() - along)))
    }
}

/// Depth minus range of one pixel.
#[derive(Debug, Clone, Copy)]
struct Difference {
    metres: f32,
    /// As a share of the range.
    share: f32,
}

/// The pixels of one octave of range.
#[derive(Debug, Clone, Default)]
struct Octave {
    product_pixels: u64,
    within_small: u64,
    within_sigmas: u64,
    /// Of the pixels that both have.
    differences: Vec<Difference>,
}

/// Depths of photos against ranges of products. Each pixel that both have takes 8 bytes.
#[derive(Debug, Clone, Default)]
pub struct Comparison {
    /// By the whole part of log2 of the range in metres.
    octaves: BTreeMap<i32, Octave>,
}

impl Comparison {
    /// Compares the ranges of a product, in rows of `width` pixels, with the depths of the photos of its exposure. Of several photos, the first
    /// with a depth decides.
    pub fn new(ranges: &[Option<f64>], width: u32, views: &[View]) -> Self {
        let columns = width as usize;
        let depth = |(index, range): (usize, &Option<f64>)| {
            let pixel = Vector2::new((index % columns) as f64, (index / columns) as f64);
            views.iter().find_map(|view| view.depth(&pixel, (*range)?))
        };
        let depths: Vec<Option<Depth>> = ranges.par_iter().enumerate().map(depth).collect();
        let mut made = Self::default();
        for (range, depth) in ranges.iter().zip(depths) {
            if let Some(range_m) = range {
                made.add(*range_m, depth);
            }
        }
        made
    }

    fn add(&mut self, range_m: f64, depth: Option<Depth>) {
        let octave = self.octaves.entry(range_m.log2().floor() as i32).or_default();
        octave.product_pixels += 1;
        let Some(depth) = depth else { return };
        let metres = depth.range_m - range_m;
        let share = metres / range_m;
        // |1 / depth - 1 / range| is at most 3 sigma: sigma belongs to the inverse depth.
        octave.within_sigmas += u64::from(share.abs() <= SIGMAS * depth.sigma_share);
        octave.within_small += u64::from(share.abs() <= SMALL);
        octave.differences.push(Difference {
            metres: metres as f32,
            share: share as f32,
        });
    }

    /// Adds the pixels of another product.
    pub fn merge(&mut self, other: Self) {
        for (octave, mut pixels) in other.octaves {
            let own = self.octaves.entry(octave).or_default();
            own.product_pixels += pixels.product_pixels;
            own.within_small += pixels.within_small;
            own.within_sigmas += pixels.within_sigmas;
            own.differences.append(&mut pixels.differences);
        }
    }

    /// Returns the agreement of all pixels.
    pub fn agreement(&self) -> Agreement {
        let all: Vec<&Octave> = self.octaves.values().collect();
        agreement(&all)
    }

    /// Returns the agreement by octave of the products' ranges, the nearest first.
    pub fn by_octave(&self) -> Vec<OctaveAgreement> {
        let one = |(octave, pixels): (&i32, &Octave)| OctaveAgreement {
            from_m: 2.0_f64.powi(*octave),
            to_m: 2.0_f64.powi(*octave + 1),
            agreement: agreement(&[pixels]),
        };
        self.octaves.iter().map(one).collect()
    }
}

fn agreement(octaves: &[&Octave]) -> Agreement {
    let sum = |count: &dyn Fn(&Octave) -> u64| octaves.iter().map(|octave| count(octave)).sum::<u64>();
    let product_pixels = sum(&|octave| octave.product_pixels);
    let pixels = sum(&|octave| octave.differences.len() as u64);
    let of_pixels = |count: u64| count as f64 / pixels as f64;
    let differences = || octaves.iter().flat_map(|octave| &octave.differences);
    let shares = || differences().map(|difference| f64::from(difference.share));
    let metres = differences().map(|difference| f64::from(difference.metres.abs()));
    let difference = || {
        Some(RangeDifference {
            median_share: upper_median(shares())?,
            median_abs_m: upper_median(metres)?,
            median_abs_share: upper_median(shares().map(f64::abs))?,
            p90_abs_share: quantile(shares().map(f64::abs), LARGE)?,
            within_1_percent: of_pixels(sum(&|octave| octave.within_small)),
            within_3_sigma: of_pixels(sum(&|octave| octave.within_sigmas)),
        })
    };
    Agreement {
        product_pixels,
        pixels,
        share: pixels as f64 / product_pixels.max(1) as f64,
        difference: difference(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Looks along x with y to the right and z down, 100 px of focal length, from (1, 2, -3).
    fn camera(width: f64, height: f64, focal_px: f64) -> Cahvor {
        Cahvor {
            c: [1.0, 2.0, -3.0],
            a: [1.0, 0.0, 0.0],
            // Integers are centres of pixels.
            h: [width / 2.0 - 0.5, focal_px, 0.0],
            v: [height / 2.0 - 0.5, 0.0, focal_px],
            o: None,
            r: None,
            e: None,
        }
    }

    /// A photo of 80 x 60 pixels of the wall 5 m in front of the camera, whose depths are pictures of 40 x 30. The left quarter has none.
    fn wall() -> LabelledDepths {
        let known = |index: usize| index % 40 >= 10;
        LabelledDepths {
            model: camera(80.0, 60.0, 100.0),
            pinhole: None,
            factor: 2.0,
            camera: Camera::pinhole(40, 30, 50.0),
            inverse: (0..1200)
                .map(|index| if known(index) { 0.2 } else { 0.0 })
                .collect(),
            sigma: vec![0.001; 1200],
        }
    }

    /// Ranges of the wall in a product of 16 x 12 pixels of the same field of view, `factor` times as far.
    fn ranges(factor: f64) -> Vec<Option<f64>> {
        let range = |index: usize| {
            let (x, y) = ((index % 16) as f64 - 7.5, (index / 16) as f64 - 5.5);
            Some(factor * 5.0 * (1.0 + (x * x + y * y) / 400.0).sqrt())
        };
        (0..192).map(range).collect()
    }

    #[test]
    fn a_wall_has_the_ranges_of_a_product_with_another_grid() {
        let view = View::new(camera(16.0, 12.0, 20.0), wall()).unwrap();
        let same = Comparison::new(&ranges(1.0), 16, std::slice::from_ref(&view)).agreement();
        // The left quarter of the product's columns looks at pixels without a depth.
        assert_eq!((same.product_pixels, same.pixels, same.share), (192, 144, 0.75));
        let exact = same.difference.unwrap();
        assert!(
            exact.median_abs_m < 1e-5 && exact.p90_abs_share < 1e-5,
            "{exact:?}"
        );
        assert_eq!((exact.within_1_percent, exact.within_3_sigma), (1.0, 1.0));
        // Products 2 % too far: depths are nearer by 1 - 1 / 1.02, and 3 sigma are 1.5 %.
        let mut far = Comparison::new(&ranges(1.02), 16, &[view]);
        let found = far.agreement().difference.unwrap();
        assert!((found.median_share + 0.019_608).abs() < 1e-5, "{found:?}");
        assert!((found.p90_abs_share - 0.019_608).abs() < 1e-5, "{found:?}");
        assert_eq!((found.within_1_percent, found.within_3_sigma), (0.0, 0.0));
        // 5.1 m straight ahead, all below 8 m.
        let octaves = far.by_octave();
        assert_eq!(octaves.len(), 1);
        assert_eq!((octaves[0].from_m, octaves[0].to_m), (4.0, 8.0));
        far.merge(Comparison::new(&[None, Some(20.0)], 2, &[]));
        let both = far.agreement();
        assert_eq!((both.product_pixels, both.pixels), (193, 144));
        let last = far.by_octave().pop().unwrap();
        assert_eq!((last.from_m, last.agreement.difference), (16.0, None));
    }

    #[test]
    fn a_product_of_another_eye_is_refused_with_the_distance() {
        let mut other = camera(16.0, 12.0, 20.0);
        other.c[1] += 0.424;
        let refused = View::new(other, wall()).unwrap_err().to_string();
        assert_eq!(refused, "its camera is 0.424 m from that of its photo");
        assert!(Comparison::default().agreement().difference.is_none());
    }
}
