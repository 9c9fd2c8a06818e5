//! The outputs of `depth` as files.

use marf_numeric::{quantile, upper_median};
use marf_scene::picture::{Palette, png16};
use marf_scene::{Image, encode_png};
use marf_schema::depth::PhotoMetrics;
use marf_schema::output::{DEPTH, DEPTH_CLASS, DEPTH_PREVIEW, INVERSE_DEPTH, NORMAL, SIGMA, SURFACE_MAPS};
use marf_stage::{Ctx, Outputs, StageError, TypedOutputs};
use marf_surface::{ExportFrame, SurfaceMap};
use nalgebra::{Vector2, Vector3};
use rayon::prelude::*;

use crate::disparities::Class;
use crate::merge::PhotoDepth;

/// Share of the depths that are nearer than the brightest colour, and farther than the darkest.
const OUTLIERS: f64 = 0.02;

/// Writes the pictures of a photo and returns its metrics, without its id and what is known of its pairs.
pub(crate) fn photo(
    ctx: &Ctx<'_>,
    name: &str,
    depth: &PhotoDepth,
    frame: &ExportFrame,
    outputs: &mut Outputs,
) -> Result<PhotoMetrics, StageError> {
    let (width, height) = (depth.camera.width, depth.camera.height);
    let along_ray = |index: usize| {
        let inverse = depth.inverse[index];
        let at = Vector2::new(
            (index as u32 % width) as f64 + 0.5,
            (index as u32 / width) as f64 + 0.5,
        );
        let ray = depth.camera.unproject(&at).filter(|_| inverse > 0.0);
        ray.map_or(0.0, |ray| (ray.norm() / f64::from(inverse)) as f32)
    };
    let distance: Vec<f32> = (0..depth.inverse.len()).into_par_iter().map(along_ray).collect();
    let metres = frame.metres_per_unit;
    let per = match metres {
        Some(_) => "1/metre",
        None => "1/unit of the scene, whose scale is not known",
    };
    let quantity = |name: &'static str, kind: &'static str| png16::Quantity {
        name,
        unit: per,
        kind,
    };
    let inverse = quantity(
        "inverse-depth",
        "inverse of the depth along the optical axis; 0: none",
    );
    let sigma = quantity("sigma", "one standard deviation of the inverse depth; 0: none");
    let factor = 1.0 / frame.scale();
    let write = |values: &[f32], quantity: &png16::Quantity<'_>| {
        png16::quantity(width, height, values, factor, quantity)
    };
    let class: Vec<u16> = depth.class.iter().map(|class| *class as u16).collect();
    let words = [(
        "marf:class",
        "0 none, 1 one pair, 2 confirmed by two, 3 next to an edge, 4 none: pairs differ, 5 none: sky"
            .to_owned(),
    )];
    let pictures = [
        (DEPTH, png16::depth(width, height, &distance, metres)),
        (INVERSE_DEPTH, write(&depth.inverse, &inverse)),
        (SIGMA, write(&depth.sigma, &sigma)),
        (NORMAL, normals(depth)),
        (DEPTH_CLASS, png16::gray(width, height, &class, &words)),
    ];
    for (folder, png) in pictures {
        let png = png.map_err(|error| StageError::new(error.to_string()))?;
        outputs.put_bytes(ctx, format!("{folder}{name}.png"), &png)?;
    }
    let preview = encode_png(&preview(depth)).map_err(|error| StageError::new(error.to_string()))?;
    outputs.put_bytes(ctx, format!("{DEPTH_PREVIEW}{name}.png"), &preview)?;
    let pixels = depth.class.len() as f64;
    let share =
        |of: &dyn Fn(&Class) -> bool| depth.class.iter().filter(|class| of(class)).count() as f64 / pixels;
    let known = depth
        .inverse
        .iter()
        .zip(&depth.sigma)
        .filter(|(inverse, _)| **inverse > 0.0);
    Ok(PhotoMetrics {
        id: String::new(),
        name: name.to_owned(),
        size_px: [width, height],
        depth_step: f64::from(distance.iter().copied().fold(0.0, f32::max)) * frame.scale() / png16::MOST,
        pairs: 0,
        share: share(&|class| !matches!(class, Class::None | Class::Differs | Class::Sky)),
        confirmed_share: share(&|class| *class == Class::Confirmed),
        differing_share: share(&|class| *class == Class::Differs),
        sky_share: share(&|class| *class == Class::Sky),
        median_sigma_share: upper_median(known.map(|(inverse, sigma)| f64::from(sigma / inverse))),
        reason: String::new(),
    })
}

/// Returns the normals as colours, transparent where there is no depth.
fn normals(depth: &PhotoDepth) -> Result<Vec<u8>, png16::PngError> {
    let colour = |(normal, inverse): (&[f32; 3], &f32)| {
        let away = Vector3::from(*normal).try_normalize(f32::MIN_POSITIVE)?;
        if *inverse <= 0.0 {
            return None;
        }
        let [x, y, z] = away.map(|part| (128.0 - 127.0 * part).round() as u8).into();
        Some([x, y, z, 255])
    };
    let pixels = depth.normal.iter().zip(&depth.inverse);
    let pixels: Vec<[u8; 4]> = pixels.map(|one| colour(one).unwrap_or_default()).collect();
    let words = "unit normal towards the camera, (x right, y down, z forward) = (value - 128) / 127; transparent: none";
    let words = [("marf:normal", words.to_owned())];
    png16::rgba(depth.camera.width, depth.camera.height, &pixels, &words)
}

/// Returns the depths in colours, near ones bright, black where there are none.
fn preview(depth: &PhotoDepth) -> Image<marf_scene::Srgb> {
    let known = || {
        depth
            .inverse
            .iter()
            .filter(|inverse| **inverse > 0.0)
            .map(|inverse| f64::from(*inverse))
    };
    let far = quantile(known(), OUTLIERS).unwrap_or(0.0);
    let near = quantile(known(), 1.0 - OUTLIERS).unwrap_or(1.0);
    Image::from_fn(depth.camera.width, depth.camera.height, |column, row| {
        let inverse = f64::from(depth.inverse[(row * depth.camera.width + column) as usize]);
        if inverse <= 0.0 {
            return [0; 3];
        }
        Palette::Viridis.color(((inverse - far) / (near - far).max(1e-300)) as f32)
    })
}

/// Writes the maps with their world files.
pub(crate) fn maps(ctx: &Ctx<'_>, map: &SurfaceMap, outputs: &mut Outputs) -> Result<(), StageError> {
    let failed = |error: marf_surface::SurfaceError| StageError::from(error);
    let files = [
        ("height.tif", map.height_tiff()),
        ("sigma.tif", map.spread_tiff()),
        ("orthophoto.tif", map.photo_tiff()),
        ("height.png", map.height_png()),
        ("sigma.png", map.spread_png()),
        ("orthophoto.png", map.photo_png()),
    ];
    for (name, bytes) in files {
        outputs.put_bytes(ctx, format!("{SURFACE_MAPS}{name}"), &bytes.map_err(failed)?)?;
        if let Some(stem) = name.strip_suffix(".png") {
            let world_file = format!("{SURFACE_MAPS}{stem}.pgw");
            outputs.put_bytes(ctx, world_file, map.world_file().as_bytes())?;
        }
    }
    Ok(())
}
