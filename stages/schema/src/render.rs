//! `render`: pictures of a trained field along a path, which `video` makes a film of.

use std::collections::BTreeMap;

use marf_field::Device;
use marf_scene::{Camera, Pose};
use marf_stage::ParamError;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::check::check_within;

/// Path of the camera.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum PathKind {
    /// A smooth path through training cameras that are far apart.
    #[default]
    Flythrough,
    /// To the photos held out.
    Heldout,
    /// To the photos trained on.
    Train,
    /// Around the point the cameras look at.
    Orbit,
    /// A smooth path through the `keyframes`.
    Keyframes,
    /// To each of the `keyframes`: single pictures, which may be of any size.
    Stills,
}

impl PathKind {
    /// Returns the word as pipeline.toml has it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Flythrough => "flythrough",
            Self::Heldout => "heldout",
            Self::Train => "train",
            Self::Orbit => "orbit",
            Self::Keyframes => "keyframes",
            Self::Stills => "stills",
        }
    }

    fn has_keyframes(self) -> bool {
        matches!(self, Self::Keyframes | Self::Stills)
    }
}

/// Layer rendered at every viewpoint.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Layer {
    /// The colour of the field.
    Rgb,
    /// The distance along every ray: values as pictures of 16 bits, and a preview in colours.
    Depth,
    /// How far the retrainings of a bootstrap differ: sample standard deviation of gray, in the same two forms. Needs `members`.
    Uncertainty,
}

/// Parameters of `render`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct RenderParams {
    /// Path of the camera.
    pub path: PathKind,
    /// Cameras of the paths `keyframes` and `stills`, in order, as `marf view` saves them as bookmarks.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub keyframes: Vec<Place>,
    /// Pictures along the path. For `heldout` and `train`: most pictures. `stills` makes one for each
    /// keyframe.
    pub frames: u32,
    /// Width of a picture, pixels.
    pub width: u32,
    /// Height of a picture, pixels. It extends or crops the view above and below. Default: from the shape
    /// of the photos or keyframes.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub height: Option<u32>,
    /// Layers of every viewpoint, side by side in the film: `rgb`, `depth`, `uncertainty`.
    pub outputs: Vec<Layer>,
    /// Device that trains and renders: `auto` (a GPU if there is one, never a software adapter), `cpu`,
    /// `gpu`, or `gpu:NAME` for the adapter whose name contains NAME. Only the device that is used is part
    /// of the key.
    pub device: Device,
}

impl Default for RenderParams {
    fn default() -> Self {
        Self {
            path: PathKind::Flythrough,
            keyframes: Vec::new(),
            frames: 96,
            width: 640,
            height: None,
            outputs: vec![Layer::Rgb],
            device: Device::default(),
        }
    }
}

/// Largest picture and longest path. A larger number is taken for a mistake.
const MAX_SIDE_PX: u32 = 4096;
const MAX_FRAMES: u32 = 10_000;
/// Cameras whose focal length and height, as shares of the width, differ by no more have the same view.
/// Rounding to whole pixels moves them by up to half of this at a width of 100 pixels.
const SAME_LENS: f64 = 0.01;

impl RenderParams {
    /// Checks what can be checked without a scene.
    ///
    /// # Errors
    /// Names the key that is out of range, and the keyframe.
    pub fn check(&self) -> Result<(), ParamError> {
        check_within("frames", self.frames, 1..=MAX_FRAMES)?;
        check_within("width", self.width, 1..=MAX_SIDE_PX)?;
        check_within("height", self.height.unwrap_or(1), 1..=MAX_SIDE_PX)?;
        self.check_outputs()?;
        self.check_keyframes()
    }

    fn check_outputs(&self) -> Result<(), ParamError> {
        let refuse = |message: &str| Err(ParamError::new("outputs", message));
        let mut layers = (0..).zip(&self.outputs);
        if self.outputs.is_empty() {
            return refuse("the list is empty: name at least one of `rgb`, `depth`, `uncertainty`");
        }
        if layers.any(|(index, layer)| self.outputs[..index].contains(layer)) {
            return refuse("an output is listed twice");
        }
        Ok(())
    }

    fn check_keyframes(&self) -> Result<(), ParamError> {
        let refuse = |message: String| Err(ParamError::new("keyframes", message));
        let path = self.path.name();
        let Some(first) = self.keyframes.first() else {
            if self.path.has_keyframes() {
                return refuse(format!("the path `{path}` needs one at the least"));
            }
            return Ok(());
        };
        if !self.path.has_keyframes() {
            return refuse(format!(
                "the path `{path}` has none: take `keyframes` or `stills`"
            ));
        }
        if self.keyframes.len() > MAX_FRAMES as usize {
            return refuse(format!("{} are more than {MAX_FRAMES}", self.keyframes.len()));
        }
        for (number, place) in (1..).zip(&self.keyframes) {
            let name = &place.name;
            if !place.camera.is_valid() || !place.cam_from_world.is_valid() {
                return refuse(format!(
                    "number {number}, `{name}`: its camera or pose is not finite, not positive or not a rotation"
                ));
            }
            if self.path == PathKind::Keyframes && !has_lens_of(&place.camera, &first.camera) {
                return refuse(format!(
                    "number {number}, `{name}`, has another field of view than the first: make stills of them, or give all the same"
                ));
            }
        }
        Ok(())
    }
}

/// Returns true if two cameras of any size have the same field of view.
fn has_lens_of(camera: &Camera, other: &Camera) -> bool {
    let shares = |camera: &Camera| {
        let width = f64::from(camera.width);
        [camera.fx_px / width, f64::from(camera.height) / width]
    };
    let distortion = |camera: &Camera| [camera.k1, camera.k2, camera.p1, camera.p2];
    let mut pairs = shares(camera).into_iter().zip(shares(other));
    pairs.all(|(share, other)| (share - other).abs() <= SAME_LENS) && distortion(camera) == distortion(other)
}

/// Output `poses` of `render`: the cameras along the path, in order.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Poses(pub Vec<Place>);

/// A camera along the path.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Place {
    /// Name of the viewpoint.
    pub name: String,
    /// Size, focal length and principal point, pixels, and distortion.
    #[schemars(with = "BTreeMap<String, f64>")]
    pub camera: Camera,
    /// Pose of the camera: the rows of (R | t), world units.
    #[schemars(with = "[[f64; 4]; 3]")]
    pub cam_from_world: Pose,
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::{Value, json};

    fn bookmark(width: u32, focal_px: f64) -> Value {
        json!({"name": "rock", "camera": Camera::pinhole(width, width / 4 * 3, focal_px), "cam_from_world": Pose::identity()})
    }

    fn refused(table: Value) -> ParamError {
        let params: RenderParams = serde_json::from_value(table).unwrap();
        params.check().unwrap_err()
    }

    #[test]
    fn what_makes_no_picture_is_refused_by_its_key() {
        let one = bookmark(640, 500.0);
        let mut turned_in = one.clone();
        turned_in["cam_from_world"][0][0] = json!(2.0);
        for (table, key, word) in [
            (json!({"frames": 0}), "frames", "0 is not within 1 to 10000"),
            (json!({"width": 4097}), "width", "4097 is not within 1 to 4096"),
            (json!({"height": 0}), "height", "0 is not within 1 to 4096"),
            (json!({"outputs": []}), "outputs", "the list is empty"),
            (json!({"outputs": ["depth", "depth"]}), "outputs", "twice"),
            (json!({"path": "stills"}), "keyframes", "`stills` needs one"),
            (
                json!({"path": "orbit", "keyframes": [one]}),
                "keyframes",
                "`orbit` has none",
            ),
            (
                json!({"path": "stills", "keyframes": [one, turned_in]}),
                "keyframes",
                "number 2, `rock`",
            ),
            (
                json!({"path": "keyframes", "keyframes": [one, bookmark(640, 300.0)]}),
                "keyframes",
                "field of view",
            ),
        ] {
            let error = refused(table);
            assert_eq!(error.path, key, "{error:?}");
            assert!(error.message.contains(word), "{error:?}");
        }
        assert!(serde_json::from_value::<RenderParams>(json!({"outputs": ["normals"]})).is_err());
    }

    #[test]
    fn keyframes_of_one_lens_may_have_other_sizes() {
        let sizes = [bookmark(640, 500.0), bookmark(320, 250.0), bookmark(960, 750.0)];
        let params: RenderParams =
            serde_json::from_value(json!({"path": "keyframes", "keyframes": sizes})).unwrap();
        assert_eq!(params.check(), Ok(()));
        let other: RenderParams =
            serde_json::from_value(json!({"path": "stills", "keyframes": [sizes[0], bookmark(640, 300.0)]}))
                .unwrap();
        assert_eq!(other.check(), Ok(()), "stills may differ");
    }
}
