//! Layers of every viewpoint: colour, depth, uncertainty, each as values and as a drawing.

use marf_cache::{Digest, digest_of};
use marf_field::Render as Rendered;
use marf_scene::{
    Camera, Image, Photo, Scene, Srgb, encode_png,
    path::Viewpoint,
    picture::{
        ColorScale, DEPTH_DECADES, Palette, draw_map, draw_titled,
        png16::{self, Quantity, read_quantity},
        quantile, round_upper_limit, side_by_side,
    },
};
use marf_schema::{
    output::{DEPTH, DEPTH_PREVIEW, FRAMES, UNCERTAINTY, UNCERTAINTY_PREVIEW},
    render::Layer,
};
use marf_stage::{Ctx, Outputs, StageError};
use serde::{Deserialize, Serialize};

use super::fields::Fields;
use crate::{
    TrainError,
    bootstrap::maps::{gray, moments},
    depth_views::MIN_OPACITY,
    io::{picture_failed, put_png},
};

/// A colour scale reaches this share of the values of every picture: a few far ones would leave the others few colours.
const SCALE_SHARE: f64 = 0.95;

/// Kept pictures of a rendered viewpoint, layer by layer.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub(super) struct Frame(Vec<LayerPicture>);

/// A layer of a rendered viewpoint.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
struct LayerPicture {
    /// The picture (PNG): colours of 8 bits, or values of 16.
    png: Digest,
    /// The value that [`SCALE_SHARE`] of the pixels do not exceed. 0 for colours.
    top: f32,
}

/// The layers that are made at every viewpoint, and the fields that they show.
pub(super) struct LayerSource<'a> {
    pub layers: &'a [Layer],
    pub fields: &'a Fields,
    pub metres_per_unit: Option<f64>,
}

impl LayerSource<'_> {
    /// Returns the layers of a viewpoint, kept as pictures. Kept layers of the same fields and camera are reused, the rest is rendered.
    ///
    /// # Errors
    /// A field that cannot be rendered, a picture that cannot be stored.
    pub fn frame(&self, ctx: &Ctx<'_>, place: &Viewpoint) -> Result<Frame, StageError> {
        let key = |layer: Layer| memo_key(layer, self.fields, place, self.metres_per_unit);
        let kept = self.layers.iter().map(|layer| {
            if let Some(kept) = known(ctx, &key(*layer)) {
                return Ok(kept);
            }
            if *layer == Layer::Uncertainty {
                let kept = uncertainty(ctx, &self.fields.members(ctx, place)?)?;
                return keep(ctx, &key(*layer), kept);
            }
            // One render gives colour and depth. A later request for the other one reuses it.
            let render = self.fields.own(ctx, place)?;
            let colour = keep(ctx, &key(Layer::Rgb), colours(ctx, &render)?)?;
            let depth = keep(
                ctx,
                &key(Layer::Depth),
                depths(ctx, &render, self.metres_per_unit)?,
            )?;
            Ok(if *layer == Layer::Rgb { colour } else { depth })
        });
        Ok(Frame(kept.collect::<Result<_, StageError>>()?))
    }
}

/// Saves a layer as a memo and returns it.
fn keep(ctx: &Ctx<'_>, key: &Digest, kept: LayerPicture) -> Result<LayerPicture, StageError> {
    let bytes = serde_json::to_vec(&kept).map_err(|error| StageError::new(error.to_string()))?;
    ctx.memos.save(key, &bytes);
    Ok(kept)
}

/// Version of [`LayerPicture`], raised when the content of its picture changes.
const KEPT_VERSION: u32 = 1;

/// Returns the key of a layer: all that its picture depends on. The name of the viewpoint is not among it.
fn memo_key(layer: Layer, fields: &Fields, place: &Viewpoint, metres_per_unit: Option<f64>) -> Digest {
    // As JSON numbers have all their bits.
    let numbers = serde_json::json!([place.camera, place.cam_from_world, metres_per_unit]);
    let shown = (name(layer), fields.id(layer), numbers.to_string());
    digest_of(&("render layer", KEPT_VERSION, shown))
}

/// Returns a kept layer, or `None` if its picture is not stored any more.
fn known(ctx: &Ctx<'_>, key: &Digest) -> Option<LayerPicture> {
    let kept: LayerPicture = serde_json::from_slice(&ctx.memos.load(key)?).ok()?;
    ctx.blobs.contains(&kept.png).then_some(kept)
}

fn colours(ctx: &Ctx<'_>, render: &Rendered) -> Result<LayerPicture, StageError> {
    let png = encode_png(&render.to_image()).map_err(|error| picture_failed(name(Layer::Rgb), &error))?;
    let png = ctx.put(&png)?;
    Ok(LayerPicture { png, top: 0.0 })
}

fn depths(ctx: &Ctx<'_>, render: &Rendered, metres: Option<f64>) -> Result<LayerPicture, StageError> {
    let depth = depth_of(render);
    let png = png16::depth(render.width, render.height, &depth, metres);
    let png = png.map_err(|error| picture_failed(name(Layer::Depth), &error))?;
    let top = f64::from(quantile(&depth, SCALE_SHARE)) * metres.unwrap_or(1.0);
    let png = ctx.put(&png)?;
    Ok(LayerPicture { png, top: top as f32 })
}

fn uncertainty(ctx: &Ctx<'_>, members: &[Rendered]) -> Result<LayerPicture, StageError> {
    let first = members.first().ok_or(TrainError::NoMembers)?;
    let spread = spread(members);
    let kind = format!(
        "sample standard deviation of gray over {} retrainings",
        members.len()
    );
    let quantity = Quantity {
        name: name(Layer::Uncertainty),
        unit: SPREAD_UNIT,
        kind: &kind,
    };
    let png = png16::quantity(first.width, first.height, &spread, 1.0, &quantity);
    let png = png.map_err(|error| picture_failed(name(Layer::Uncertainty), &error))?;
    let png = ctx.put(&png)?;
    Ok(LayerPicture {
        png,
        top: quantile(&spread, SCALE_SHARE),
    })
}

/// Gray levels of a picture: drawings show the uncertainty in these.
const LEVELS: f32 = 255.0;
/// Unit of the uncertainty.
const SPREAD_UNIT: &str = "sRGB, white = 1";

/// Returns the name of a layer in the texts of pictures.
fn name(layer: Layer) -> &'static str {
    match layer {
        Layer::Rgb => "colour",
        Layer::Depth => "depth",
        Layer::Uncertainty => "uncertainty",
    }
}

/// Returns the depth along every ray, world units, or -1 where the ray met too little.
fn depth_of(render: &Rendered) -> Vec<f32> {
    let pixels = render.depth.iter().zip(&render.opacity);
    pixels
        .map(|(depth, opacity)| if *opacity > MIN_OPACITY { *depth } else { -1.0 })
        .collect()
}

/// Returns the sample standard deviation of gray over the renders of the retrainings, whatever their order. White is 1.
fn spread(members: &[Rendered]) -> Vec<f32> {
    let pixels = members.first().map_or(0, |render| render.rgb.len());
    let mut values = vec![0.0; members.len()];
    let spread_at = |pixel: usize| {
        for (value, member) in values.iter_mut().zip(members) {
            *value = gray(&member.rgb[pixel]);
        }
        moments(&mut values).sample as f32
    };
    (0..pixels).map(spread_at).collect()
}

/// Returns the size of the pictures of a film, pixels. It is a lower bound where texts are wider than pictures.
pub(super) fn film_size(camera: &Camera, layers: &[Layer]) -> (u32, u32) {
    if layers == [Layer::Rgb] {
        return (camera.width, camera.height);
    }
    let blank = Image::from_fn(camera.width, camera.height, |_, _| [0; 3]);
    let panel = draw_titled(&blank, "");
    (panel.width.saturating_mul(layers.len() as u32), panel.height)
}

/// Draws what was rendered, all pictures of a layer on one colour scale.
pub(super) struct Drawing<'a> {
    layers: &'a [Layer],
    /// One a layer. The scale of a colour layer is not used.
    scales: Vec<ColorScale>,
}

impl<'a> Drawing<'a> {
    /// Returns the drawing of all pictures of a path.
    pub fn new(scene: &Scene, layers: &'a [Layer], frames: &[Frame]) -> Self {
        let scales = layers.iter().enumerate().map(|(index, layer)| {
            let tops: Vec<f32> = frames.iter().map(|frame| frame.0[index].top).collect();
            let high = round_upper_limit(&tops, 1.0);
            let is_measured = scene.metres_per_unit.is_some();
            let length_unit = if is_measured { "m" } else { "units" };
            match layer {
                Layer::Rgb => ColorScale::linear("colour", "", high, Palette::Viridis),
                Layer::Depth => ColorScale::linear("depth", length_unit, high, Palette::Viridis)
                    .over_decades(DEPTH_DECADES),
                Layer::Uncertainty => {
                    let levels: Vec<f32> = tops.iter().map(|top| top * LEVELS).collect();
                    let high = round_upper_limit(&levels, 1.0);
                    ColorScale::linear("standard deviation", "gray levels", high, Palette::Inferno)
                }
            }
        });
        Self {
            layers,
            scales: scales.collect(),
        }
    }

    /// Draws the previews of a viewpoint and its picture of the film: colour alone, or all layers side by side.
    pub fn draw(
        &self,
        ctx: &Ctx<'_>,
        frame: &Frame,
        place: &Viewpoint,
        number: usize,
    ) -> Result<FramePictures, StageError> {
        let mut outputs = Outputs::new();
        let mut panels = Vec::with_capacity(self.layers.len());
        for ((layer, kept), scale) in self.layers.iter().zip(&frame.0).zip(&self.scales) {
            let (values, preview) = match layer {
                Layer::Rgb => (FRAMES, None),
                Layer::Depth => (DEPTH, Some(DEPTH_PREVIEW)),
                Layer::Uncertainty => (UNCERTAINTY, Some(UNCERTAINTY_PREVIEW)),
            };
            outputs.insert(format!("{values}{number:04}.png"), kept.png);
            if self.layers == [Layer::Rgb] {
                let film = kept.png;
                return Ok(FramePictures { outputs, film });
            }
            let panel = match preview {
                Some(_) => map(ctx, *layer, kept, &place.camera, scale)?,
                None => draw_titled(&colour(ctx, kept)?, &scale.title),
            };
            if let Some(preview) = preview {
                put_png(ctx, &mut outputs, format!("{preview}{number:04}.png"), &panel)?;
            }
            panels.push(panel);
        }
        let panels: Vec<&Image<Srgb>> = panels.iter().collect();
        let film = put_png(
            ctx,
            &mut Outputs::new(),
            place.name.clone(),
            &side_by_side(&panels),
        )?;
        Ok(FramePictures { outputs, film })
    }
}

/// The pictures of a viewpoint.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct FramePictures {
    /// Layers and previews, by name.
    pub outputs: Outputs,
    /// That of the film.
    pub film: Digest,
}

impl FramePictures {
    /// Returns whether all pictures are still stored.
    pub fn are_stored(&self, ctx: &Ctx<'_>) -> bool {
        let is_stored = |picture: &Digest| ctx.blobs.contains(picture);
        self.outputs.values().all(is_stored) && is_stored(&self.film)
    }
}

/// Reads kept colours.
fn colour(ctx: &Ctx<'_>, kept: &LayerPicture) -> Result<Image<Srgb>, StageError> {
    let read = Photo::decode(&ctx.get(&kept.png)?);
    Ok(read.map_err(|error| unreadable(Layer::Rgb, &error))?.image)
}

/// Draws kept values as colours. A ray without depth is gray.
fn map(
    ctx: &Ctx<'_>,
    layer: Layer,
    kept: &LayerPicture,
    camera: &Camera,
    scale: &ColorScale,
) -> Result<Image<Srgb>, StageError> {
    let read = read_quantity(&ctx.get(&kept.png)?, name(layer));
    let (width, height, mut values) = read
        .filter(|(width, height, _)| (*width, *height) == (camera.width, camera.height))
        .ok_or_else(|| unreadable(layer, &"it is not what was written"))?;
    match layer {
        Layer::Depth => {
            for value in values.iter_mut().filter(|value| **value == 0.0) {
                *value = -1.0;
            }
        }
        Layer::Uncertainty => values.iter_mut().for_each(|value| *value *= LEVELS),
        Layer::Rgb => {}
    }
    Ok(draw_map(&values, width, height, scale))
}

fn unreadable(layer: Layer, cause: &dyn std::fmt::Display) -> TrainError {
    picture_failed(name(layer), cause)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_meets_too_little_has_no_depth() {
        let render = Rendered {
            opacity: vec![0.5, 0.51],
            depth: vec![3.0, 4.0],
            ..Rendered::empty(2, 1)
        };
        assert_eq!(depth_of(&render), [-1.0, 4.0]);
    }

    #[test]
    fn the_spread_is_the_sample_standard_deviation_of_gray_in_any_order() {
        let render = |value: f32| Rendered {
            rgb: vec![[value; 3]],
            ..Rendered::empty(1, 1)
        };
        // .50 .52 .48 .50: mean .50, squares .0008, divided by 3.
        let mut renders = [0.50, 0.52, 0.48, 0.50].map(render);
        let found = spread(&renders);
        assert!((found[0] - 0.016_330).abs() < 1e-5, "{found:?}");
        renders.reverse();
        assert_eq!(spread(&renders), found);
        assert!(spread(&[]).is_empty());
    }

    #[test]
    fn a_film_of_several_layers_is_as_wide_as_its_panels() {
        let camera = Camera::pinhole(640, 480, 500.0);
        assert_eq!(film_size(&camera, &[Layer::Rgb]), (640, 480));
        let (width, height) = film_size(&camera, &[Layer::Rgb, Layer::Depth, Layer::Uncertainty]);
        assert!(width == 3 * 640 && height > 480, "{width} x {height}");
    }
}
