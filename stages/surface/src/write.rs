//! The outputs of `surface`: what was extracted, as files and as a report.

use std::collections::BTreeMap;

use marf_schema::output::{MESH_GLB, MESH_PLY, POINTS, SURFACE_MAPS};
use marf_schema::surface::{ColorBy, SplatReport, SpreadOf, SurfaceParams, SurfaceReport, UncertaintyReport};
use marf_stage::{Ctx, Outputs, StageError, TypedOutputs};

use crate::extract::Surface;
use crate::frame::ExportFrame;
use crate::map::SurfaceMap;
use crate::{SurfaceError, glb, members, ply};

/// Products of `surface` from a field.
pub struct SurfaceResult {
    /// Mesh and points.
    pub surface: Surface,
    /// Photos whose views were looked at.
    pub photos: usize,
    /// The least and the largest factor by which a photo was shrunk for its view.
    pub shrunk: [u32; 2],
    /// Retrainings that were looked at.
    pub members: u32,
    /// Report of the splats, which are written already. `None` if they were not requested.
    pub splats: Option<SplatReport>,
}

/// Writes mesh, points, maps and the report.
///
/// # Errors
/// A store that cannot be written. A picture that cannot be encoded.
pub fn write(
    ctx: &Ctx<'_>,
    params: &SurfaceParams,
    mut made: SurfaceResult,
    frame: &ExportFrame,
    outputs: &mut Outputs,
) -> Result<(), StageError> {
    let scale = frame.scale();
    let pixel_m = params.map_cell.unwrap_or(made.surface.cell * scale);
    // From the colours of the photos, whatever mesh and points are painted with.
    let map = SurfaceMap::draw(&made.surface.mesh, frame, pixel_m);
    let uncertainty = members::report(&made.surface.mesh.vertices, made.members, scale);
    if params.color == ColorBy::Uncertainty {
        members::paint(&mut made.surface.mesh.vertices, uncertainty.scale_end, scale);
        members::paint(&mut made.surface.points, uncertainty.scale_end, scale);
    }
    made.put_surface(ctx, params, &uncertainty, frame, outputs)?;
    let mut report = report(made, uncertainty, frame);
    match map {
        Ok(map) => {
            put_maps(ctx, &map, outputs)?;
            report.map = Some(map.report);
        }
        // The mesh is useful without a map, and the report holds the reason why there is none.
        Err(refused @ SurfaceError::Refused { .. }) => {
            report
                .refused
                .insert(SURFACE_MAPS.to_owned(), refused.to_string());
        }
        Err(error) => return Err(error.into()),
    }
    outputs.put(ctx, &report)
}

impl SurfaceResult {
    /// Writes mesh and points.
    fn put_surface(
        &self,
        ctx: &Ctx<'_>,
        params: &SurfaceParams,
        uncertainty: &UncertaintyReport,
        frame: &ExportFrame,
        outputs: &mut Outputs,
    ) -> Result<(), StageError> {
        let Self { surface, photos, .. } = self;
        let scale = frame.scale();
        let colors = color_words(params.color, uncertainty, frame);
        let comments = [
            format!("surface where the mean signed distance of {photos} views of the field is 0 (Curless and Levoy 1996)"),
            "rays end at their mean depth where the field takes more than 0.9 of their light".to_owned(),
            format!("distance between samples: {}", surface.cell * scale),
            format!("least photos: {}; largest spread: {}", params.least_photos, surface.most_spread * scale),
            colors.clone(),
            "photos: those that show the vertex; spread: root mean square of the views' distances, -1 of one view".to_owned(),
        ];
        outputs.put_bytes(ctx, MESH_PLY, &ply::mesh(&surface.mesh, frame, &comments))?;
        outputs.put_bytes(ctx, POINTS, &ply::points(&surface.points, frame, &comments))?;
        let generator = format!("marf {}", env!("CARGO_PKG_VERSION"));
        let glb = glb::mesh(&surface.mesh, frame, &generator, &colors);
        outputs.put_bytes(ctx, MESH_GLB, &glb)
    }
}

/// Returns the report, without a map.
fn report(made: SurfaceResult, uncertainty: UncertaintyReport, frame: &ExportFrame) -> SurfaceReport {
    let (surface, scale) = (made.surface, frame.scale());
    SurfaceReport {
        unit: frame.unit().to_owned(),
        photos: made.photos as u64,
        shrunk: made.shrunk,
        cell: surface.cell * scale,
        band: surface.band * scale,
        reach: surface.reach * scale,
        most_spread: surface.most_spread * scale,
        vertices: surface.mesh.vertices.len() as u64,
        triangles: surface.mesh.triangles.len() as u64,
        points: surface.points.len() as u64,
        uncertainty,
        map: None,
        splats: made.splats,
        refused: BTreeMap::new(),
    }
}

/// Describes the colours.
fn color_words(color: ColorBy, uncertainty: &UncertaintyReport, frame: &ExportFrame) -> String {
    let spread = match uncertainty.of {
        SpreadOf::Retrainings => format!("standard deviation of {} retrainings", uncertainty.members),
        SpreadOf::Views => "root mean square difference of the views of one field".to_owned(),
    };
    match color {
        ColorBy::Photos => "colours: what the field shows at the views of the photos".to_owned(),
        ColorBy::Uncertainty => format!(
            "colours: uncertainty along the normal ({spread}), inferno from 0 to {} ({}), gray where not known",
            uncertainty.scale_end,
            frame.unit()
        ),
    }
}

fn put_maps(ctx: &Ctx<'_>, map: &SurfaceMap, outputs: &mut Outputs) -> Result<(), StageError> {
    let pictures = [
        ("height", map.height_png()?),
        ("spread", map.spread_png()?),
        ("orthophoto", map.photo_png()?),
    ];
    let tiffs = [
        ("height", map.height_tiff()?),
        ("spread", map.spread_tiff()?),
        ("orthophoto", map.photo_tiff()?),
    ];
    for (name, tiff) in tiffs {
        outputs.put_bytes(ctx, format!("{SURFACE_MAPS}{name}.tif"), &tiff)?;
    }
    for (name, png) in pictures {
        outputs.put_bytes(ctx, format!("{SURFACE_MAPS}{name}.png"), &png)?;
        outputs.put_bytes(
            ctx,
            format!("{SURFACE_MAPS}{name}.pgw"),
            map.world_file().as_bytes(),
        )?;
    }
    Ok(())
}
