//! Points that can be found again in another photo: SIFT.
//!
//! A pure function of one photo's pixels, its mask and the options. Invariant: keypoints are sorted by octave,
//! layer, row and column, and are equal to the bit for any instruction set.

mod codec;
mod describe;
mod extrema;
mod gradient;
mod gray;
mod mask;
mod orient;
mod pyramid;
mod spread;

use serde::{Deserialize, Serialize};

use crate::simd::{Isa, Kernel, Lanes};
use extrema::{Found, Limits};
use gradient::Gradient;
pub(crate) use gray::Gray;
pub(crate) use mask::Mask;
use mask::Veto;
use pyramid::{Grid, Stack};

/// A point found in a photo, in pixels of the working size; (0, 0) is the top-left corner.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(crate) struct Keypoint {
    pub x_px: f32,
    pub y_px: f32,
    /// Standard deviation of the Gaussian it was found at, pixels of the working size.
    pub scale_px: f32,
    /// Direction of the strongest gradient, from x towards y.
    pub angle_rad: f32,
}

/// RootSIFT in 8 bits: 4 x 4 cells of 8 directions.
pub(crate) type Descriptor = [u8; 128];

/// What is found in one photo; both lists have one length.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct Features {
    pub keypoints: Vec<Keypoint>,
    pub descriptors: Vec<Descriptor>,
}

/// Size of the first octave.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum FirstOctave {
    /// The photo's own.
    Native,
    /// Twice the photo's, for photos up to 2 megapixels; larger ones keep their own.
    Doubled,
}

/// What to look for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct FeatureOptions {
    /// Most features of a photo.
    pub max_features: u32,
    /// Where the search begins.
    pub first_octave: FirstOctave,
    /// Least difference of Gaussians at a point, for luminance in [0, 1].
    pub contrast: f32,
    /// Largest ratio of the two curvatures at a point.
    pub edge_ratio: f32,
}

impl Default for FeatureOptions {
    /// COLMAP's thresholds (.0067 = .02 / 3 layers), at the size that was enough for the reference photos.
    fn default() -> Self {
        Self {
            max_features: 2048,
            first_octave: FirstOctave::Native,
            contrast: 0.02 / 3.0,
            edge_ratio: 10.0,
        }
    }
}

/// A photo with fewer features than this is searched again with a third of the contrast.
const FEW: usize = 500;

/// Finds the features of a photo (Lowe, IJCV 2004, with the root of Arandjelovic and Zisserman, CVPR 2012).
///
/// Three layers an octave from a blur of 1.6 px (the photo is taken to have .5 px), points by a quadratic fit,
/// up to two orientations a point, descriptors `L1`-normalised, rooted, times 512, held in 8 bits. The photo is
/// searched again with a third of the contrast where fewer than 500 features are found.
///
/// # Extremes
/// A side under 16 px, pixels that are not in [0, 1] (NaN too), or a mask of another size: no features.
pub(crate) fn extract(gray: &Gray, mask: &Mask, options: &FeatureOptions) -> Features {
    extract_on(Isa::best(), gray, mask, options)
}

/// [`extract`] on a given instruction set.
pub(crate) fn extract_on(isa: Isa, gray: &Gray, mask: &Mask, options: &FeatureOptions) -> Features {
    let fits = (gray.width, gray.height) == (mask.width, mask.height) && gray.pixels.len() == mask.open.len();
    if !gray.is_valid() || !fits {
        return Features::default();
    }
    let features = extract_above(isa, gray, mask, options, options.contrast);
    // A cap may leave one less than it allows.
    let few = FEW.min(options.max_features.saturating_sub(1) as usize);
    if features.keypoints.len() >= few {
        return features;
    }
    extract_above(isa, gray, mask, options, options.contrast / 3.0)
}

/// A point of an octave.
struct Point {
    octave: usize,
    found: Found,
    /// 0 is the first to keep.
    rank: u32,
}

/// A feature and the rank of its point.
type Ranked = (u32, Keypoint, Descriptor);

fn extract_above(isa: Isa, gray: &Gray, mask: &Mask, options: &FeatureOptions, contrast: f32) -> Features {
    let limits = Limits {
        contrast,
        edge_ratio: options.edge_ratio,
    };
    let veto = Veto::of(mask);
    let mut stack = Stack::new(isa, gray, options.first_octave);
    let (mut octaves, mut points) = (Vec::new(), Vec::new());
    while stack.is_large() {
        stack.fill(isa);
        let grid = stack.grid;
        let found = extrema::find(isa, &stack, &limits).into_iter();
        let open =
            found.filter(|found| veto.allows(grid.place_px(found.x, found.y), grid.step_px * found.sigma));
        let octave = octaves.len();
        points.extend(open.map(|found| Point {
            octave,
            found,
            rank: 0,
        }));
        octaves.push((grid, stack.halve()));
    }
    spread::rank(&mut points, &octaves, gray);
    points.retain(|point| point.rank < options.max_features);
    let mut gradient = Gradient::default();
    let layers = points.chunk_by(|a, b| (a.octave, a.found.cell[0]) == (b.octave, b.found.cell[0]));
    let mut features = Vec::with_capacity(points.len() * 5 / 4);
    for points in layers {
        let Some((grid, inner)) = octaves.get(points[0].octave) else {
            continue;
        };
        gradient.take(isa, &inner[points[0].found.cell[0]], grid.width);
        features.extend(isa.run(Describe {
            gradient: &gradient,
            grid,
            points,
        }));
    }
    keep_first(features, options.max_features as usize)
}

/// Describes the points of one layer.
struct Describe<'a> {
    gradient: &'a Gradient,
    grid: &'a Grid,
    points: &'a [Point],
}

impl Kernel for Describe<'_> {
    type Output = Vec<Ranked>;

    #[inline(always)]
    fn run<L: Lanes>(self, _: L) -> Vec<Ranked> {
        let mut features = Vec::with_capacity(self.points.len() * 5 / 4);
        for Point { found, rank, .. } in self.points {
            let [x_px, y_px] = self.grid.place_px(found.x, found.y);
            for eighths in orient::directions(self.gradient, found) {
                let keypoint = Keypoint {
                    x_px,
                    y_px,
                    scale_px: self.grid.step_px * found.sigma,
                    angle_rad: eighths * std::f32::consts::FRAC_PI_4,
                };
                features.push((*rank, keypoint, describe::describe(self.gradient, found, eighths)));
            }
        }
        features
    }
}

/// Keeps the features of the first ranks, in the order they come.
fn keep_first(mut features: Vec<Ranked>, most: usize) -> Features {
    if features.len() > most {
        let mut ranks: Vec<u32> = features.iter().map(|feature| feature.0).collect();
        ranks.sort_unstable();
        // A point whose two features do not both fit loses both.
        let end = ranks[most];
        features.retain(|feature| feature.0 < end);
    }
    let (keypoints, descriptors) = features
        .into_iter()
        .map(|(_, keypoint, descriptor)| (keypoint, descriptor))
        .unzip();
    Features {
        keypoints,
        descriptors,
    }
}

#[cfg(test)]
mod tests;
