//! `surface`: the surface of a trained field as mesh, points, height map and orthophoto.

use std::collections::BTreeMap;

use marf_field::Device;
use marf_stage::ParamError;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::check::{check_length, check_within};

/// Largest picture of the field. A larger number is taken for a mistake.
const MAX_SIDE_PX: u32 = 4096;

/// Parameters of `surface`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct SurfaceParams {
    /// Distance between samples of the surface, metres (or units of the scene). Default: twice the width of
    /// a pixel on the nearer quarter of the ground that the photos show.
    pub cell: Option<f64>,
    /// Largest distance from a photo to a surface taken from it, metres (or units of the scene). Default:
    /// where a pixel is four cells wide.
    pub reach: Option<f64>,
    /// Photos that must show a point. With fewer there is a hole.
    pub least_photos: u32,
    /// Largest root mean square of the distances between a point and the surfaces that the views show there,
    /// metres (or units of the scene). With more there is a hole. Default: a cell.
    pub most_spread: Option<f64>,
    /// Longest side of the pictures that are rendered to find the surface, pixels.
    pub side_px: u32,
    /// Width of a pixel of height map and orthophoto, metres. Default: a cell.
    pub map_cell: Option<f64>,
    /// Colours of mesh and points: `photos` or `uncertainty` (dark: none, bright: large, gray: not known).
    /// Uncertainty is the difference between the retrainings of `members`. Without `members`, it is the
    /// difference between the views of the field.
    pub color: ColorBy,
    /// Whether to write the depths at the views of all photos too, as PNG of 16 bits.
    pub depth: bool,
    /// Whether to write Gaussian splats too, with their PSNR against the field's pictures.
    pub splats: bool,
    /// Device that renders: `auto` (a GPU if there is one, never a software adapter), `cpu`, `gpu`, or
    /// `gpu:NAME` for the adapter whose name contains NAME. Only the device that is used is part of the
    /// key.
    pub device: Device,
}

/// Colours of a surface.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ColorBy {
    /// Colours of the field at the views of the photos.
    #[default]
    Photos,
    /// Uncertainty of the surface.
    Uncertainty,
}

impl Default for SurfaceParams {
    fn default() -> Self {
        Self {
            cell: None,
            reach: None,
            least_photos: 2,
            most_spread: None,
            side_px: 640,
            map_cell: None,
            color: ColorBy::default(),
            depth: false,
            splats: false,
            device: Device::default(),
        }
    }
}

impl SurfaceParams {
    /// Checks what can be checked without a scene.
    ///
    /// # Errors
    /// Names the key that is out of range.
    pub fn check(&self) -> Result<(), ParamError> {
        for (key, length) in [
            ("cell", self.cell),
            ("reach", self.reach),
            ("most_spread", self.most_spread),
            ("map_cell", self.map_cell),
        ] {
            check_length(key, length)?;
        }
        if self.least_photos == 0 {
            return Err(ParamError::new(
                "least_photos",
                "0 would keep what no photo saw: use at least 1",
            ));
        }
        check_within("side_px", self.side_px, 16..=MAX_SIDE_PX)
    }
}

/// Output `surface` of `surface`: the products and their numbers.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SurfaceReport {
    /// Unit of all lengths here and in the files.
    pub unit: String,
    /// Photos whose views were looked at.
    pub photos: u64,
    /// The least and the largest factor by which the sides of a photo were divided for its view, and so for its depths.
    pub shrunk: [u32; 2],
    /// Distance between samples.
    pub cell: f64,
    /// Surfaces within this distance were averaged.
    pub band: f64,
    /// Largest distance from a photo.
    pub reach: f64,
    /// Largest spread of a vertex.
    pub most_spread: f64,
    /// Vertices of the mesh.
    pub vertices: u64,
    /// Triangles of the mesh.
    pub triangles: u64,
    /// Points of the cloud.
    pub points: u64,
    /// How sure the vertices of the mesh are.
    pub uncertainty: UncertaintyReport,
    /// The height map. `None` if it is refused.
    pub map: Option<MapReport>,
    /// The splats. `None` if they were not requested.
    pub splats: Option<SplatReport>,
    /// Outputs that the scene cannot give, with the reason.
    pub refused: BTreeMap<String, String>,
}

/// Quantity that differs at a point of a surface.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SpreadOf {
    /// The views of one field, root mean square.
    Views,
    /// The retrainings of a bootstrap, standard deviation.
    Retrainings,
}

/// How sure the vertices of a mesh are, in the unit of the report.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct UncertaintyReport {
    /// The quantity that differs.
    pub of: SpreadOf,
    /// Retrainings. 0 without a bootstrap.
    pub members: u32,
    /// The value that half of the vertices are below.
    pub median: f64,
    /// The value that 95 of 100 vertices are below: the bright end of the colours.
    pub scale_end: f64,
    /// Share of the vertices whose uncertainty is known.
    pub known_share: f64,
}

/// Gaussian splats, in the unit of the report.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SplatReport {
    /// How many.
    pub splats: u64,
    /// How many more there would be, which float before the surface that other views show.
    pub floating: u64,
    /// Smallest standard deviation of a splat along its disc.
    pub finest: f64,
    /// Largest.
    pub coarsest: f64,
    /// Steps by which their colours were adjusted to the field's pictures.
    pub color_steps: u32,
    /// Against the field's pictures at the views of the photos trained on, whose colours were adjusted.
    /// `None` if nothing was compared.
    pub trained_on: Option<SplatPsnr>,
    /// The same at the views of held-out photos, whose pictures no splat was made of.
    pub held_out: Option<SplatPsnr>,
    /// The same without the pixels of a surface that no photo trained on saw: the field invents them, and no
    /// splat covers them.
    pub held_out_seen: Option<SplatPsnr>,
}

/// Pictures of splats against those of the field, over the pixels where the field shows a surface.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct SplatPsnr {
    /// Views.
    pub photos: u64,
    /// Mean PSNR over the views, dB.
    pub mean_db: f64,
    /// PSNR of the worst view, dB.
    pub least_db: f64,
    /// Share of the pixels that were compared: the field shows a surface there, and no mask hides it.
    pub share: f64,
}

/// Numbers of height map and orthophoto.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MapReport {
    /// Columns.
    pub columns: u32,
    /// Rows.
    pub rows: u32,
    /// Width of a pixel, metres.
    pub pixel_m: f64,
    /// Height of the value 1, metres along up from the origin.
    pub lowest_m: f64,
    /// Metres from one value to the next.
    pub interval_m: f64,
    /// Position of the centre of the first pixel: to the right and to the top of the origin, metres.
    pub first_m: [f64; 2],
    /// The axes to the right, to the top and up, in the world.
    pub axes: [[f64; 3]; 3],
    /// Whose origin coordinates count from: `site 3`, or the world of the scene.
    pub origin: String,
    /// Share of the pixels that have a height.
    pub covered_share: f64,
}
