//! `calibrate`: photos and priors to a calibrated scene.

use crate::rigs::StereoPair;
use marf_stage::{Document, ParamError, Params};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Parameters of `calibrate`: how cameras are found, and how photos are prepared.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct CalibrateParams {
    /// Source of the cameras: `sfm` (the photos themselves, labels as priors), `labels` (the archive's labels
    /// as they are) or `import` (transforms.json or a COLMAP model next to the photos).
    pub method: Method,
    /// Which photos are kept from training and measured: `place` (whole places, spread over the scene: stereo
    /// pairs, versions and neighbours together) or `every` (one in `hold_every` by file name, starting with
    /// the first, as in papers). An import with train and test file names decides by itself.
    pub hold: Hold,
    /// About one photo in this many is kept from training. 0 keeps none.
    pub hold_every: u32,
    /// Longest side of the photos that the field is trained on, pixels. Larger photos are reduced by a
    /// whole factor. Default: photos keep their size.
    pub longest_side_px: Option<u32>,
    /// Fewest photos with a camera. With fewer the node fails and says why.
    pub min_registered: u32,
    /// `labels`: the site (first number of the rover motion counter) to build. Default: the one with most
    /// photos. Frames of different sites agree to metres only.
    pub site: Option<i64>,
    /// `sfm`: most features of a photo.
    pub max_features: u32,
    /// `sfm`: longest side of the photos in which features are detected, pixels. Larger photos are reduced
    /// by a whole factor.
    pub feature_side_px: u32,
    /// `sfm`: where the search for features begins: `native`, or `doubled` (more features, four times the work).
    pub first_octave: FirstOctaveParam,
    /// `sfm`: which photos are compared: `auto`, `exhaustive` or `sequential`.
    pub pairs: Pairs,
    /// `sfm`: fewest verified matches that link two photos.
    pub min_matches: u32,
    /// `sfm`: lens terms: `auto` (the smallest model the photos support), `pinhole`, `simple-radial`, `radial`,
    /// `opencv`.
    pub lens: LensParam,
    /// `sfm`: which photos share a camera: `camera` (one instrument, size and focal length) or `photo` (none).
    pub intrinsics: Intrinsics,
    /// `sfm`: principal point: `centre` (of the photo, or the label's), `free`, or `auto` (free if 20
    /// photos or more look from all sides, no label gives it, and the photos support it).
    pub principal_point: PrincipalPoint,
    /// `sfm`: seed of all random samples.
    pub seed: u64,
    /// `import`: file to read (`transforms.json`, `sparse/0/cameras.bin`) if there are several.
    pub file: Option<String>,
    /// `import`: whether to find points in the photos to train on if the file with the cameras names none.
    /// They decide the box of the field, and where rays begin and end. Features and pairs are chosen by the
    /// keys of `sfm`.
    pub find_points: bool,
    /// `sfm`: keep the scene of the last run as it is and register only the new photos. Held-out photos
    /// stay held out. `hold_every` decides how many of the new photos are. That scene is then an input of
    /// this node. Without it, or with `false`, the scene is built from scratch.
    pub extend: bool,
}

/// Source of the cameras.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Method {
    /// Structure from motion: the photos themselves, labels as priors.
    Sfm,
    /// Camera models and rover poses of the labels.
    Labels,
    /// Cameras of another program.
    Import,
    /// `import` if there is a file with cameras next to the photos, otherwise `sfm`.
    Auto,
}

/// Which photos are kept from training.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Hold {
    /// Whole places: groups of photos near in position and direction.
    Place,
    /// One in `hold_every`, by file name.
    Every,
}

/// Start of the search for features.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum FirstOctaveParam {
    /// At the working size.
    Native,
    /// At twice the working size: more and smaller features for four times the work.
    Doubled,
}

/// Which photos are compared.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Pairs {
    /// All pairs of up to 60 photos. Of more photos: neighbours by name, photos that look alike, and photos
    /// whose labels overlap.
    Auto,
    /// All.
    Exhaustive,
    /// Neighbours by name: those 1, 2, 4, 8 … further on.
    Sequential,
}

/// Lens terms of the cameras.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum LensParam {
    /// The smallest model the photos support.
    Auto,
    /// None.
    Pinhole,
    /// k1.
    SimpleRadial,
    /// k1 and k2.
    Radial,
    /// k1, k2, p1 and p2.
    Opencv,
}

/// Principal point of the cameras.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum PrincipalPoint {
    /// Moves where the photos support it.
    Auto,
    /// Stays where it is.
    Centre,
    /// Moves as the last step.
    Free,
}

/// Which photos share a camera.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Intrinsics {
    /// Photos of one instrument, size and focal length.
    Camera,
    /// None: each has its own.
    Photo,
}

impl Default for CalibrateParams {
    fn default() -> Self {
        Self {
            method: Method::Sfm,
            hold: Hold::Place,
            hold_every: 8,
            longest_side_px: None,
            min_registered: 2,
            site: None,
            max_features: 2048,
            feature_side_px: 1280,
            first_octave: FirstOctaveParam::Native,
            pairs: Pairs::Auto,
            min_matches: 15,
            lens: LensParam::Auto,
            intrinsics: Intrinsics::Camera,
            principal_point: PrincipalPoint::Auto,
            seed: 0,
            file: None,
            find_points: true,
            extend: false,
        }
    }
}

impl CalibrateParams {
    /// Checks what a type cannot.
    ///
    /// # Errors
    /// Names the key: one photo in one held out, a working size below 16 px, features or matches too few to hold
    /// a pose.
    pub fn check(&self) -> Result<(), ParamError> {
        let least = [
            ("max_features", self.max_features, 64),
            ("feature_side_px", self.feature_side_px, 64),
            ("min_matches", self.min_matches, 8),
        ];
        if let Some((key, value, least)) = least.into_iter().find(|(_, value, least)| value < least) {
            return Err(ParamError::new(
                key,
                format!("{value} is too few, at least {least}"),
            ));
        }
        if self.hold_every == 1 {
            return Err(ParamError::new(
                "hold_every",
                "1 would keep every photo from training: 0 keeps none",
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
                format!("{side} px are too few: use at least 16"),
            )),
            _ => Ok(()),
        }
    }
}

/// Output `metrics` of `calibrate`: how each photo fared.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Metrics {
    /// The method, in a sentence.
    pub method: String,
    /// Sums.
    pub totals: Totals,
    /// One entry for each photo of the input, sorted by id.
    pub photos: Vec<PhotoMetrics>,
    /// Files the import has a camera for that are not among the photos, sorted by name.
    pub missing: Vec<Missing>,
    /// What ties the world to the site of its labels. Absent without such a tie.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tie: Option<Tie>,
    /// How up was found. Absent where it is not known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub up: Option<Up>,
    /// Stereo pairs by the labels, sorted by their photos. `sfm` only.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub stereo_pairs: Vec<StereoPair>,
}

/// How the up direction of a scene was found.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Up {
    /// What shows it.
    pub source: UpSource,
    /// Standard deviation, degrees. Absent where the source has none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sigma_deg: Option<f64>,
}

/// What shows the up direction of a scene.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum UpSource {
    /// The site frame of the labels.
    Labels,
    /// The scene that was extended.
    Extended,
    /// The x axes of the cameras, which are level.
    CameraAxes,
    /// The plane of the ground under the cameras.
    Ground,
}

impl Up {
    /// Returns the source and its uncertainty in words.
    #[must_use]
    pub fn words(&self) -> String {
        let source = match self.source {
            UpSource::Labels => "from the labels",
            UpSource::Extended => "from the extended scene",
            UpSource::CameraAxes => "from the cameras' axes",
            UpSource::Ground => "from the ground under the cameras",
        };
        self.sigma_deg
            .map_or_else(|| source.to_owned(), |sigma| format!("{source}, ± {sigma:.1}°"))
    }
}

/// Distances of cameras from their positions by the labels of their site.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Tie {
    /// Number of the site.
    pub site: i64,
    /// Placed photos with a label of it.
    pub photos: usize,
    /// Median distance, metres. 0 if the labels are the cameras.
    pub median_m: f64,
    /// Largest distance, metres.
    pub largest_m: f64,
}

impl Document for Metrics {
    const STAGE: &'static str = CalibrateParams::STAGE;
    const OUTPUT: &'static str = "metrics";

    /// JSON with a line a field, as people read it.
    fn encode(&self) -> Result<Vec<u8>, serde_json::Error> {
        serde_json::to_vec_pretty(self)
    }
}

/// Sums over all photos.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Totals {
    /// Photos of the input.
    pub photos: usize,
    /// Photos with a camera.
    pub registered: usize,
    /// Photos with a camera that are kept from training.
    pub held_out: usize,
    /// Photos without a camera.
    pub unplaced: usize,
    /// Files with a camera that are not among the photos.
    pub missing: usize,
    /// Sparse points.
    pub points: usize,
    /// Connected components of photos, that of the scene included, if the method knows them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub components: Option<usize>,
    /// Mean over the photos that have one of their mean reprojection error, pixels.
    pub error_px: Option<f64>,
    /// The same at the size at which features were sought, pixels. `sfm` only.
    pub error_working_px: Option<f64>,
}

/// Result of one photo.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct PhotoMetrics {
    /// Its id.
    pub id: String,
    /// Its file.
    pub file: String,
    /// Whether it has a camera.
    pub registered: bool,
    /// Whether it is kept from training.
    pub held_out: bool,
    /// Features found in it, if the method knows.
    pub features: Option<u32>,
    /// Features that match those of another photo, if the method knows.
    pub matches: Option<u32>,
    /// Features that belong to a point of the scene, if the method knows.
    pub inliers: Option<u32>,
    /// Mean reprojection error of those features, pixels of its camera.
    pub error_px: Option<f64>,
    /// Standard deviation of its attitude relative to the scene's first photo, degrees. `sfm` only.
    pub angle_sigma_deg: Option<f64>,
    /// Standard deviation of its centre, likewise, in the scene's unit. `sfm` only.
    pub centre_sigma: Option<f64>,
    /// A remark (a label that disagrees with the photos).
    pub note: Option<String>,
    /// Why it has no camera. Empty if it has one.
    pub reason: String,
}

/// A file with a camera that is not among the photos.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Missing {
    /// Its name in the import.
    pub file: String,
    /// Why it is not in the scene.
    pub reason: String,
}
