//! Facts of a photo that are known without decoding it.

use serde::{Deserialize, Serialize};

use crate::{Cahvor, Pose};

/// The facts of a photo, as the row of a manifest keeps them.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PhotoFacts {
    /// Name of the file in its archive, relative, with `/`.
    pub file: String,
    /// Bytes of the image as stored in the archive.
    pub size_bytes: u64,
    /// Width, pixels.
    pub width: u32,
    /// Height, pixels.
    pub height: u32,
    /// Bands stored in the file, 1 or 3.
    pub bands: u8,
    /// Sol: the Martian day since landing.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sol: Option<u32>,
    /// Instrument and eye as the archive names them (`ZL`, `NAVCAM_LEFT`).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub instrument: Option<String>,
    /// Colour filter as the archive names it (`0` is broad-band).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub filter: Option<String>,
    /// Whether its camera sees colour, where product name or label say so.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sensor: Option<Sensor>,
    /// Whether the archive calls it a thumbnail.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub thumbnail: bool,
    /// Camera model and pose of the label.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub prior: Option<CameraPrior>,
    /// Where the rover stood, of a label whose camera cannot be used.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub place: Option<RoverPlace>,
    /// Focal length from EXIF, pixels of the stored image.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub focal_px: Option<f64>,
    /// Make and model of the camera from EXIF, for grouping photos by camera.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub device: Option<String>,
    /// What was changed or could not be used in reading (`turned upright`, `label has no camera: …`).
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub notes: Vec<String>,
}

/// Whether a camera sees colour.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Sensor {
    /// Every photo of it is gray.
    Monochrome,
    /// It has a colour mosaic. A gray photo of it is one band, or a mosaic that is not developed.
    Color,
}

/// Where a rover stood when it took a photo.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RoverPlace {
    /// Frame of the rover (`ROVER_NAV_FRAME`), or `SITE_FRAME`.
    pub frame: String,
    /// Pose of that frame in its site, if the label has it: x north, y east, z down, metres.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub site_from_frame: Option<Pose>,
    /// Rover motion counter: site, drive, pose, …
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub motion_counter: Vec<i64>,
}

/// The camera model of a label and the frame it is in.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CameraPrior {
    /// The model, in the photo's own pixel grid (integer = pixel centre, 0-based) and in `frame`.
    pub model: Cahvor,
    /// Frame of the model (`ROVER_NAV_FRAME`, `SITE_FRAME`).
    pub frame: String,
    /// Pose of that frame in its site, if the label has it: x north, y east, z down, metres.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub site_from_frame: Option<Pose>,
    /// Rover motion counter: site, drive, pose, … Photos that share the first three share the rover's pose.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub motion_counter: Vec<i64>,
}

impl PhotoFacts {
    /// Returns the rover motion counter of the label: site, drive, pose, … Empty without one.
    pub fn motion_counter(&self) -> &[i64] {
        match (&self.prior, &self.place) {
            (Some(prior), _) => &prior.motion_counter,
            (None, Some(place)) => &place.motion_counter,
            (None, None) => &[],
        }
    }

    /// Returns the facts as JSON.
    pub fn to_json(&self) -> serde_json::Value {
        // Strings, numbers and lists always serialise. A non-finite float becomes null and is refused on reading.
        serde_json::to_value(self).unwrap_or_default()
    }

    /// Reads the facts from JSON.
    ///
    /// # Errors
    /// JSON with other fields or types.
    pub fn from_json(value: &serde_json::Value) -> Result<Self, serde_json::Error> {
        Self::deserialize(value)
    }
}
