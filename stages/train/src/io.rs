//! Scenes, fields and pictures in the store.

use marf_cache::Digest;
use marf_field::{Device, Field};
use marf_scene::{Image, Scene, Srgb, encode_png, picture::encode_gif};
use marf_schema::output::{SCENE, VIDEO, WEIGHTS};
use marf_stage::{Ctx, Inputs, Outputs, StageError, TypedOutputs};

use crate::TrainError;

/// Reads the input `scene`.
pub(crate) fn read_scene(ctx: &Ctx<'_>, inputs: &Inputs) -> Result<Scene, StageError> {
    let bytes = ctx.get(inputs.required(SCENE)?)?;
    Ok(Scene::decode(&bytes).map_err(TrainError::from)?)
}

/// Reads the input `weights` as a field that renders on `device`.
pub(crate) fn read_field(ctx: &Ctx<'_>, inputs: &Inputs, device: &Device) -> Result<Field, StageError> {
    let field = Field::decode(&ctx.get(inputs.required(WEIGHTS)?)?);
    Ok(field
        .and_then(|field| field.on(device))
        .map_err(TrainError::from)?)
}

/// Stores a picture as PNG, lists it under `name` and returns its digest.
pub(crate) fn put_png(
    ctx: &Ctx<'_>,
    outputs: &mut Outputs,
    name: String,
    image: &Image<Srgb>,
) -> Result<Digest, StageError> {
    let png = encode_png(image).map_err(|error| picture_failed(&name, &error))?;
    let digest = ctx.put(&png)?;
    outputs.insert(name, digest);
    Ok(digest)
}

/// Stores pictures of one size as the output `video`.
///
/// # Errors
/// A cancellation before any picture, pictures that cannot be encoded or stored.
pub(crate) fn put_video(
    ctx: &Ctx<'_>,
    outputs: &mut Outputs,
    pictures: &[Image<Srgb>],
    fps: u32,
) -> Result<(), StageError> {
    let gif = encode_gif(pictures, fps, &|| ctx.cancel.is_set());
    let gif = gif.map_err(|error| picture_failed(VIDEO, &error))?;
    outputs.put_bytes(ctx, VIDEO, &gif.ok_or(StageError::Cancelled)?)
}

fn picture_failed(name: &str, cause: &dyn std::fmt::Display) -> TrainError {
    TrainError::Picture {
        name: name.to_owned(),
        cause: cause.to_string(),
    }
}
