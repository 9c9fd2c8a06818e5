//! A trained field with its scene, as the 3-D view shows it.

use std::sync::Arc;

use marf_cache::Digest;
use marf_depth::PointCloud;
use marf_field::{Device, Field as Trained, FieldError, Render, Vignetting};
use marf_scene::path::{focus_point, orbit, typical_camera};
use marf_scene::picture::{ColorScale, DEPTH_DECADES, Palette, round_upper_limit};
use marf_scene::{Camera, Falloff, Frame, Pose, Scene};
use marf_surface::ExportFrame;
use nalgebra::Vector3;
use serde::Serialize;

use crate::difference::SCALE_END;
use crate::source::{DepthInterval, FieldSource, Source};

/// Width of the renders that the scales are taken from, pixels.
const SCALE_PX: u32 = 64;
/// Rays with less opacity have no depth.
pub const MIN_OPACITY: f32 = 0.5;

/// A field that can be rendered.
pub struct Field {
    node: String,
    scene: Scene,
    /// Digest of its scene, by which bookmarks name it.
    scene_digest: Digest,
    trained: Trained,
    members: Vec<Trained>,
    depth_interval: Option<DepthInterval>,
    cloud: Option<PointCloud>,
    scales: Scales,
    start: Pose,
}

/// The colour scales.
#[derive(Debug, Clone, PartialEq)]
pub struct Scales {
    /// Of depth: world units.
    pub depth: ColorScale,
    /// Of uncertainty: standard deviation of gray, white = 1.
    pub uncertainty: ColorScale,
    /// Of the difference from a photo: gray, white = 1.
    pub difference: ColorScale,
}

impl Scales {
    /// Returns scales whose ends for depth and uncertainty are given.
    fn to(depth: f64, uncertainty: f64) -> Self {
        let of_gray = |high| ColorScale::linear("", "", high, Palette::Inferno);
        Self {
            depth: ColorScale::linear("", "", depth, Palette::Viridis).over_decades(DEPTH_DECADES),
            uncertainty: of_gray(uncertainty),
            difference: of_gray(SCALE_END),
        }
    }

    /// Returns the lowest and highest value of each.
    fn ends(&self) -> Ends {
        let ends = |scale: &ColorScale| [scale.low, scale.high];
        Ends {
            depth: ends(&self.depth),
            uncertainty: ends(&self.uncertainty),
            difference: ends(&self.difference),
        }
    }
}

/// The lowest and highest value of each of the [`Scales`].
#[derive(Debug, Serialize)]
struct Ends {
    depth: [f64; 2],
    uncertainty: [f64; 2],
    difference: [f64; 2],
}

/// Facts of a field for the page.
#[derive(Debug, Serialize)]
pub struct SceneView<'a> {
    node: &'a str,
    scene: Digest,
    /// Metres per unit of the world. `None` if the scene has no scale.
    metres_per_unit: Option<f64>,
    /// Unit vector in the world.
    up: [f64; 3],
    /// The point that the photos look at, in the world.
    focus: [f64; 3],
    /// Initial view.
    start: Pose,
    /// The camera of the view, 640 pixels wide.
    camera: Camera,
    members: usize,
    scales: Ends,
    photos: Vec<PhotoView<'a>>,
}

/// A photo of the scene.
#[derive(Debug, Serialize)]
struct PhotoView<'a> {
    file: &'a str,
    image: Digest,
    camera: Camera,
    cam_from_world: Pose,
    held_out: bool,
}

impl Field {
    /// Reads a field.
    ///
    /// # Errors
    /// One sentence: a lost or damaged object, or an unavailable device.
    pub fn read(of: &FieldSource, source: &dyn Source, device: &Device) -> Result<Self, String> {
        let object = |digest: &Digest| source.object(digest).ok_or_else(|| lost(&of.label, digest));
        let trained = |digest: &Digest| -> Result<Trained, String> {
            let field = Trained::decode(&object(digest)?)
                .and_then(|field| field.with_backend(marf_field_gpu::open(device)?));
            field.map_err(|error| format!("the field of `{}`: {error}", of.label))
        };
        let scene = Scene::decode(&object(&of.scene)?).map_err(|error| error.to_string())?;
        let scale = ExportFrame::new(&scene).scale();
        let cloud = |digest: &Digest| {
            let cloud = PointCloud::decode(&object(digest)?, scale);
            cloud.ok_or_else(|| format!("the points of `{}` by pairs of photos cannot be read", of.label))
        };
        let start = orbit(&scene, 1, SCALE_PX)
            .first()
            .map(|place| place.cam_from_world);
        let mut field = Self {
            node: of.label.clone(),
            trained: trained(&of.weights)?,
            members: of.members.iter().map(trained).collect::<Result<_, _>>()?,
            depth_interval: of.depth_interval,
            cloud: of.cloud.as_ref().map(cloud).transpose()?,
            scene_digest: of.scene,
            scales: Scales::to(1.0, 1.0),
            start: start.ok_or_else(|| format!("the scene of `{}` has no photo", of.label))?,
            scene,
        };
        field.scales = field.measured_scales().map_err(|error| error.to_string())?;
        Ok(field)
    }

    /// Returns the scene.
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// Returns the colour scales.
    pub fn scales(&self) -> &Scales {
        &self.scales
    }

    /// Returns the field itself.
    pub fn trained(&self) -> &Trained {
        &self.trained
    }

    /// Returns the retrainings.
    pub fn members(&self) -> &[Trained] {
        &self.members
    }

    /// Returns the factors for an interval from the spread of the retrainings' depths.
    pub fn depth_interval(&self) -> Option<DepthInterval> {
        self.depth_interval
    }

    /// Returns the points that pairs of photos gave.
    pub fn cloud(&self) -> Option<&PointCloud> {
        self.cloud.as_ref()
    }

    /// Returns the photo of a digest.
    ///
    /// # Errors
    /// One sentence: the scene has no such photo.
    pub fn photo(&self, image: &Digest) -> Result<&Frame, String> {
        let mut frames = self.scene.frames.iter();
        let found = frames.find(|frame| frame.image == *image);
        found.ok_or_else(|| "the scene has no such photo".to_owned())
    }

    /// Returns the vignetting of a photo's camera, if the field was trained on photos without it.
    pub fn falloff(&self, frame: &Frame) -> Option<&Falloff> {
        let tones = self.scene.tones.as_ref()?;
        let found = Falloff::real_one(&tones.vignetting, &frame.camera);
        found.filter(|_| self.trained.config().vignetting != Vignetting::Off)
    }

    /// Returns the facts of the field for the page.
    pub fn view(&self) -> SceneView<'_> {
        let photos = self.scene.frames.iter().map(|frame| PhotoView {
            file: &frame.file,
            image: frame.image,
            camera: frame.camera,
            cam_from_world: frame.cam_from_world,
            held_out: frame.held_out,
        });
        SceneView {
            node: &self.node,
            scene: self.scene_digest,
            metres_per_unit: self.scene.metres_per_unit,
            up: self.up().into(),
            focus: focus_point(&self.scene).into(),
            start: self.start,
            camera: typical_camera(&self.scene, 640),
            members: self.members.len(),
            scales: self.scales.ends(),
            photos: photos.collect(),
        }
    }

    /// Returns up in the world: the scene's, or else that of the first view.
    fn up(&self) -> Vector3<f64> {
        let known = self.scene.up.map(Vector3::from);
        known.unwrap_or_else(|| -self.start.rotation.row(1).transpose())
    }

    /// Takes the scales from the first view, so that colours mean the same from everywhere.
    fn measured_scales(&self) -> Result<Scales, FieldError> {
        let camera = typical_camera(&self.scene, SCALE_PX);
        let render = |field: &Trained| field.render(&camera, &self.start);
        let depths = depths(&render(&self.trained)?);
        let members: Vec<Render> = self.members.iter().map(render).collect::<Result<_, _>>()?;
        Ok(Scales::to(
            round_upper_limit(&depths, 0.95),
            round_upper_limit(&spread(&members), 0.98),
        ))
    }
}

/// Returns the depth along every ray, world units. -1 where the ray met too little.
pub fn depths(render: &Render) -> Vec<f32> {
    let pixels = render.depth.iter().zip(&render.opacity);
    pixels
        .map(|(depth, opacity)| if *opacity > MIN_OPACITY { *depth } else { -1.0 })
        .collect()
}

/// Returns the sample standard deviation (B - 1) of gray over renders, white = 1. Empty for fewer than two.
pub fn spread(renders: &[Render]) -> Vec<f32> {
    let [first, _, ..] = renders else {
        return Vec::new();
    };
    let gray = |render: &Render, pixel: usize| render.rgb[pixel].iter().sum::<f32>() / 3.0;
    let count = renders.len() as f32;
    let of_pixel = |pixel: usize| {
        let mean = renders.iter().map(|render| gray(render, pixel)).sum::<f32>() / count;
        let squares = renders.iter().map(|render| (gray(render, pixel) - mean).powi(2));
        (squares.sum::<f32>() / (count - 1.0)).sqrt()
    };
    (0..first.rgb.len()).map(of_pixel).collect()
}

fn lost(node: &str, digest: &Digest) -> String {
    format!(
        "object {} of `{node}` is not in the store any more: `marf run` makes it again",
        digest.short()
    )
}

/// A field that several requests share.
pub type SharedField = Arc<Field>;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_spread_is_the_sample_standard_deviation_of_gray() {
        let render = |value: f32| Render {
            rgb: vec![[value; 3]],
            ..Render::empty(1, 1)
        };
        // .50 .52 .48 .50: mean .50, squares .0008, divided by 3.
        let found = spread(&[0.50, 0.52, 0.48, 0.50].map(render));
        assert!((found[0] - 0.016_330).abs() < 1e-5, "{found:?}");
        assert!(spread(&[render(0.5)]).is_empty());
    }

    #[test]
    fn what_meets_too_little_has_no_depth() {
        let render = Render {
            opacity: vec![0.4, 0.9],
            depth: vec![3.0, 4.0],
            ..Render::empty(2, 1)
        };
        assert_eq!(depths(&render), [-1.0, 4.0]);
    }
}
