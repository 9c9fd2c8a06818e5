//! `render`: pictures of a trained field along a path, which `video` makes a film of.

use marf_field::Device;
use marf_scene::{Camera, Pose};
use marf_stage::{Document, ParamError, Params};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Where the camera goes.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum PathKind {
    /// A smooth path through training cameras that lie far apart.
    #[default]
    Flythrough,
    /// To the photos held out.
    Heldout,
    /// To the photos trained on.
    Train,
    /// Around the point the cameras look at.
    Orbit,
}

/// Parameters of `render`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct RenderParams {
    /// Where the camera goes.
    pub path: PathKind,
    /// Pictures along the path; for `heldout` and `train` at most so many.
    pub frames: u32,
    /// Width of a picture, pixels; the height follows from the photos.
    pub width: u32,
    /// Whether pictures of the depth are made too.
    pub depth: bool,
    /// Which processor trains and renders: `auto` (a GPU where there is one, never a software adapter), `cpu`, `gpu`,
    /// or `gpu:NAME` for the adapter whose name holds NAME. Only what was opened is in the key.
    pub device: Device,
}

impl Default for RenderParams {
    fn default() -> Self {
        Self {
            path: PathKind::Flythrough,
            frames: 96,
            width: 640,
            depth: false,
            device: Device::default(),
        }
    }
}

/// Largest picture and longest path; beyond it a number is a slip.
const MAX_WIDTH_PX: u32 = 4096;
const MAX_FRAMES: u32 = 10_000;
impl Params for RenderParams {
    const STAGE: &'static str = "render";
}

impl RenderParams {
    /// Checks what can be checked without a scene.
    ///
    /// # Errors
    /// Names the key that is out of range.
    pub fn check(&self) -> Result<(), ParamError> {
        let within = |key: &str, value: u32, most: u32| match value {
            0 => Err(ParamError::new(key, "0 makes no picture; at least 1")),
            _ if value > most => Err(ParamError::new(key, format!("{value} is more than {most}"))),
            _ => Ok(()),
        };
        within("frames", self.frames, MAX_FRAMES)?;
        within("width", self.width, MAX_WIDTH_PX)
    }
}

/// Output `poses` of `render`: the cameras along the path, in order.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Poses(pub Vec<Place>);

impl Document for Poses {
    const STAGE: &'static str = RenderParams::STAGE;
    const OUTPUT: &'static str = "poses";
}

/// A camera along the path.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Place {
    /// Name of the viewpoint.
    pub name: String,
    /// Size and focal length, pixels.
    pub camera: Camera,
    /// Where it stands and looks.
    pub cam_from_world: Pose,
}
