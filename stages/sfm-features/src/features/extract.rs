//! Feature extraction: SIFT keypoints with RootSIFT descriptors.

use super::describe;
use super::extrema;
use super::gradient::Gradient;
use super::gray::Gray;
use super::keypoint::{Descriptor, Features, Keypoint};
use super::mask::{ClosedPixels, Mask};
use super::orient;
use super::pyramid::{FirstOctave, OctaveGrid, ScaleSpace};
use super::ranking::{self, Candidate};
use crate::simd::{self, InstructionSet, Kernel, Lanes};

/// Limits of feature extraction.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FeatureOptions {
    /// Largest number of features of a photo.
    pub max_features: u32,
    /// Size at which the search begins.
    pub first_octave: FirstOctave,
}

impl Default for FeatureOptions {
    /// At the size that was enough for the reference photos.
    fn default() -> Self {
        Self {
            max_features: 2048,
            first_octave: FirstOctave::Native,
        }
    }
}

/// Smallest absolute difference of Gaussians at a keypoint, for luminance in [0, 1] (COLMAP: 0.02 / 3 layers).
pub(super) const CONTRAST: f32 = 0.02 / 3.0;
/// A photo with fewer features than this is searched again with a third of the contrast threshold.
const FEW: usize = 500;

/// Returns the SIFT features of a photo (Lowe, IJCV 2004) with RootSIFT descriptors (Arandjelovic and Zisserman, CVPR
/// 2012).
///
/// Three layers an octave from a blur of 1.6 px (the photo is assumed to have a blur of 0.5 px), keypoints by a
/// quadratic fit, up to two orientations a keypoint. Descriptors are `L1`-normalised, square-rooted, times 512, in 8
/// bits. The photo is searched again with a third of the contrast threshold if fewer than 500 features are found.
///
/// # Extremes
/// No features if a side is under 16 px, a pixel is not in [0, 1] (NaN included), or the mask has another size. `None` if
/// `stop`, which is polled at each octave and layer, returns true.
pub fn extract(
    gray: &Gray,
    mask: &Mask,
    options: &FeatureOptions,
    stop: &dyn Fn() -> bool,
) -> Option<Features> {
    extract_on(InstructionSet::best(), gray, mask, options, stop)
}

/// [`extract`] on a given instruction set.
pub(super) fn extract_on(
    set: InstructionSet,
    gray: &Gray,
    mask: &Mask,
    options: &FeatureOptions,
    stop: &dyn Fn() -> bool,
) -> Option<Features> {
    let fits = (gray.width, gray.height) == (mask.width, mask.height) && gray.pixels.len() == mask.open.len();
    if !gray.is_valid() || !fits {
        return Some(Features::default());
    }
    let photo = Photo {
        gray,
        mask,
        options,
        stop,
    };
    let features = extract_above(set, &photo, CONTRAST)?;
    // A cap may leave one less than it allows.
    let few = FEW.min(options.max_features.saturating_sub(1) as usize);
    if features.keypoints.len() >= few {
        return Some(features);
    }
    extract_above(set, &photo, CONTRAST / 3.0)
}

/// A photo that is searched, with how and how long.
pub(super) struct Photo<'a> {
    pub gray: &'a Gray,
    pub mask: &'a Mask,
    pub options: &'a FeatureOptions,
    pub stop: &'a dyn Fn() -> bool,
}

/// Rank of the keypoint, keypoint, descriptor.
type RankedFeature = (u32, Keypoint, Descriptor);

/// Returns the features with at least the given contrast.
pub(super) fn extract_above(set: InstructionSet, photo: &Photo<'_>, contrast: f32) -> Option<Features> {
    let &Photo {
        gray,
        mask,
        options,
        stop,
    } = photo;
    let closed = ClosedPixels::new(mask);
    let mut scale_space = ScaleSpace::new(set, gray, options.first_octave);
    let (mut octaves, mut points) = (Vec::new(), Vec::new());
    while scale_space.is_large() {
        if stop() {
            return None;
        }
        scale_space.fill(set);
        if stop() {
            return None;
        }
        let grid = scale_space.grid;
        let found = extrema::find(set, &scale_space, contrast).into_iter();
        let open = found
            .filter(|found| closed.allows(grid.position_px(found.x, found.y), grid.step_px * found.sigma));
        let octave = octaves.len();
        points.extend(open.map(|found| Candidate {
            octave,
            extremum: found,
            rank: 0,
        }));
        octaves.push((grid, scale_space.halve()));
    }
    ranking::rank(&mut points, &octaves, gray);
    points.retain(|point| point.rank < options.max_features);
    let mut gradient = Gradient::default();
    let layers = points.chunk_by(|a, b| (a.octave, a.extremum.cell[0]) == (b.octave, b.extremum.cell[0]));
    let mut features = Vec::with_capacity(points.len() * 5 / 4);
    for points in layers {
        let Some((grid, inner)) = octaves.get(points[0].octave) else {
            continue;
        };
        if stop() {
            return None;
        }
        gradient.take(set, &inner[points[0].extremum.cell[0]], grid.width);
        features.extend(simd::run(
            set,
            DescriptorKernel {
                gradient: &gradient,
                grid,
                points,
            },
        ));
    }
    Some(keep_first(features, options.max_features as usize))
}

/// Computes orientations and descriptors of the keypoints of one layer.
struct DescriptorKernel<'a> {
    gradient: &'a Gradient,
    grid: &'a OctaveGrid,
    points: &'a [Candidate],
}

impl Kernel for DescriptorKernel<'_> {
    type Output = Vec<RankedFeature>;

    #[inline(always)]
    fn run<L: Lanes>(self, _: L) -> Vec<RankedFeature> {
        let mut features = Vec::with_capacity(self.points.len() * 5 / 4);
        for Candidate { extremum, rank, .. } in self.points {
            let [x_px, y_px] = self.grid.position_px(extremum.x, extremum.y);
            for eighths in orient::orientations(self.gradient, extremum) {
                let keypoint = Keypoint {
                    x_px,
                    y_px,
                    scale_px: self.grid.step_px * extremum.sigma,
                    angle_rad: eighths * std::f32::consts::FRAC_PI_4,
                };
                features.push((
                    *rank,
                    keypoint,
                    describe::describe(self.gradient, extremum, eighths),
                ));
            }
        }
        features
    }
}

/// Returns the features of the best ranks, at most `most`, in their given order.
fn keep_first(mut features: Vec<RankedFeature>, most: usize) -> Features {
    if features.len() > most {
        let mut ranks: Vec<u32> = features.iter().map(|feature| feature.0).collect();
        ranks.sort_unstable();
        // A keypoint with two orientations is kept or dropped whole.
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
