//! Comparison of pictures of splats with those of the field.

use marf_scene::metrics::psnr;
use marf_scene::{Image, Srgb};

use super::raster::Raster;
use super::{Picture, Splat};
use crate::ply::to_byte;

/// Comparison of pictures of splats with those of the field.
#[derive(Debug, Clone, PartialEq)]
pub struct SplatComparison {
    /// PSNR over the pixels where the field shows a surface, before black, dB.
    pub psnr_db: f64,
    /// Share of the pixels that were compared.
    pub share: f64,
    /// Picture of the splats.
    pub splats: Image<Srgb>,
    /// Picture of the field, black where it shows no surface.
    pub field: Image<Srgb>,
}

/// Compares a picture of splats with the field's. `None` if the field shows no surface at all.
pub fn judge(splats: &[Splat], picture: &Picture<'_>) -> Option<SplatComparison> {
    let drawn = Raster::new(splats, picture.camera, picture.cam_from_world).picture(splats);
    let hidden: Vec<bool> = picture.opacity.iter().map(|opacity| *opacity <= 0.0).collect();
    let image = |of: &[[f32; 3]]| Image {
        width: picture.camera.width,
        height: picture.camera.height,
        pixels: of.iter().map(|rgb| rgb.map(to_byte)).collect(),
    };
    let (splats, mut field) = (image(&drawn), image(picture.rgb));
    let psnr_db = psnr(&splats, &field, &hidden);
    for (pixel, _) in field
        .pixels
        .iter_mut()
        .zip(&hidden)
        .filter(|(_, hidden)| **hidden)
    {
        *pixel = [0; 3];
    }
    Some(SplatComparison {
        psnr_db: psnr_db.ok()?,
        share: hidden.iter().filter(|hidden| !**hidden).count() as f64 / hidden.len() as f64,
        splats,
        field,
    })
}
