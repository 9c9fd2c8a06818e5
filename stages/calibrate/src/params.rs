use marf_cache::ContentHash;
use marf_stage::ParamError;
use schemars::JsonSchema;
use serde::Deserialize;

/// How cameras are found, and what is done with the photos.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema, ContentHash)]
#[serde(default, deny_unknown_fields)]
pub struct CalibrateParams {
    /// Where cameras come from: `labels` (the archive's labels), `import` (transforms.json or a COLMAP model
    /// beside the photos) or `colmap` (an installed COLMAP is run on the photos).
    pub method: Method,
    /// Every so many photos, sorted by file name and starting with the first, one is kept from training and
    /// measured; 0 keeps none. An import with train and test file names decides by itself.
    pub hold_every: u32,
    /// Longest side of the photos the field is trained on, in pixels: larger ones are reduced by a whole
    /// factor. Without it photos keep their size.
    pub longest_side_px: Option<u32>,
    /// Fewest photos with a camera; with fewer the node fails and says why.
    pub min_registered: u32,
    /// `labels`: the site (first number of the rover motion counter) to build; without it the one with most
    /// photos. Frames of different sites agree to metres only.
    pub site: Option<i64>,
    /// `import`: the file to read (`transforms.json`, `sparse/0/cameras.bin`), where there are several.
    pub file: Option<String>,
    /// `sfm`: keep the scene of the last run as it is and register only the photos that are new. That scene is
    /// then an input of this node; without it, or with `false`, the scene is built anew.
    pub extend: bool,
    /// `colmap`: the program to run; without it the `colmap` that is found on PATH.
    pub colmap: Option<String>,
}

/// Where cameras come from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, JsonSchema, ContentHash)]
#[serde(rename_all = "lowercase")]
pub enum Method {
    /// Camera models and rover poses of the labels.
    Labels,
    /// Cameras of another program.
    Import,
    /// Structure from motion; not in this version.
    Sfm,
    /// An installed COLMAP; its answer is not the same to the byte on every machine.
    Colmap,
}

impl Default for CalibrateParams {
    fn default() -> Self {
        Self {
            method: Method::Labels,
            hold_every: 8,
            longest_side_px: None,
            min_registered: 2,
            site: None,
            file: None,
            extend: false,
            colmap: None,
        }
    }
}

impl CalibrateParams {
    /// Checks what a type cannot.
    ///
    /// # Errors
    /// Names the key: a method that is not there yet, one photo in one held out, an earlier
    /// scene for another method than `sfm`, a working size below 16 px.
    pub fn check(&self) -> Result<(), ParamError> {
        if self.method == Method::Sfm {
            return Err(ParamError::new(
                "method",
                "structure from motion is not in this version; use method = \"labels\" or \"import\"",
            ));
        }
        if self.hold_every == 1 {
            return Err(ParamError::new(
                "hold_every",
                "1 would keep every photo from training; 0 keeps none",
            ));
        }
        if self.extend && self.method != Method::Sfm {
            return Err(ParamError::new(
                "extend",
                "only method = \"sfm\" goes on from an earlier scene",
            ));
        }
        match self.longest_side_px {
            Some(side) if side < 16 => Err(ParamError::new(
                "longest_side_px",
                format!("{side} px are no photo, at least 16"),
            )),
            _ => Ok(()),
        }
    }
}
