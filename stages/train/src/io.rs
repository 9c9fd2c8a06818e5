//! Scenes, fields and pictures in the store.

use marf_cache::Digest;
use marf_field::{Device, Field};
use marf_scene::{Image, Scene, Srgb, encode_png};
use marf_schema::{
    output::SCENE,
    train::{Setup, WarmStart},
};
use marf_stage::{Ctx, Document, Inputs, Outputs, StageError};

use crate::TrainError;

/// Reads the input `scene`.
pub(crate) fn read_scene(ctx: &Ctx<'_>, inputs: &Inputs) -> Result<Scene, StageError> {
    let bytes = ctx.get(inputs.required(SCENE)?)?;
    Ok(Scene::decode(&bytes).map_err(TrainError::from)?)
}

/// Reads the setup of another training, if one is connected.
///
/// # Errors
/// The bytes are not a setup, or it started from an earlier field, which no other seed or draw repeats.
pub(crate) fn read_setup(ctx: &Ctx<'_>, inputs: &Inputs) -> Result<Option<Setup>, StageError> {
    let Some(digest) = inputs.optional(Setup::OUTPUT) else {
        return Ok(None);
    };
    let setup = Setup::decode(&ctx.get(digest)?);
    let setup = setup.map_err(|error| TrainError::Setup(error.to_string()))?;
    match setup.warm_start {
        Some(WarmStart::From(_)) => Err(TrainError::WarmStarted.into()),
        _ => Ok(Some(setup)),
    }
}

/// Reads weights as a field that renders on `device`.
pub(crate) fn read_field(ctx: &Ctx<'_>, weights: &Digest, device: &Device) -> Result<Field, StageError> {
    let field = Field::decode(&ctx.get(weights)?);
    Ok(field
        .and_then(|field| field.with_backend(marf_field_gpu::open(device)?))
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

/// Returns the error of a picture that cannot be written or read back.
pub(crate) fn picture_failed(name: &str, cause: &dyn std::fmt::Display) -> TrainError {
    TrainError::Picture {
        name: name.to_owned(),
        cause: cause.to_string(),
    }
}
