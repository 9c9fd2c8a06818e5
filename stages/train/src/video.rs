use marf_scene::{Image, Photo, Srgb};
use marf_schema::{
    output::VIDEO,
    video::{Film, VideoParams},
};
use marf_stage::{Ctx, Document, Inputs, Outputs, Port, Set, StageError, Threads, TypedOutputs, stage};
use marf_video::Encoder;

use crate::TrainError;

/// Encodes the pictures of a path. They are objects of the store, so another quality renders nothing.
#[derive(Debug)]
pub struct Video {
    params: VideoParams,
}

stage! {
    Video { params: VideoParams },
    Set,
    Threads::One,
    about: "makes a film (MP4) of the pictures of `render`",
    version: 1,
    ports: [Port::required("input", Film::OUTPUT).with_hint(
        "name a node of `render`. For a film with uncertainty, name one with `members = \"BOOTSTRAP\"` and \
         `outputs = [\"rgb\", \"uncertainty\", \"depth\"]`",
    )],
    outputs: [VIDEO],
}

impl Set for Video {
    fn run(&self, ctx: &Ctx<'_>, inputs: &Inputs) -> Result<Outputs, StageError> {
        let Film(pictures) = inputs.read(ctx)?;
        let mut encoder = Encoder::new(self.params.settings()).map_err(TrainError::from)?;
        let mut size = None;
        for (index, digest) in pictures.iter().enumerate() {
            ctx.check()?;
            let note = format!("picture {} of {}", index + 1, pictures.len());
            ctx.progress.at(index as u64, pictures.len() as u64, &note);
            let picture = Photo::decode(&ctx.get(digest)?)
                .map_err(|error| unreadable(index, &error))?
                .image;
            let (width, height) = *size.get_or_insert((picture.width, picture.height));
            let fitted = fitted(picture, width, height);
            encoder.push(&fitted).map_err(TrainError::from)?;
        }
        let mut outputs = Outputs::new();
        outputs.put_bytes(ctx, VIDEO, &encoder.finish().map_err(TrainError::from)?)?;
        Ok(outputs)
    }
}

/// Returns a picture in a size, cut or filled with black: photos of one scene may differ in shape.
fn fitted(picture: Image<Srgb>, width: u32, height: u32) -> Image<Srgb> {
    if (picture.width, picture.height) == (width, height) {
        return picture;
    }
    Image::from_fn(width, height, |column, row| {
        let inside = column < picture.width && row < picture.height;
        if inside { picture.at(column, row) } else { [0; 3] }
    })
}

fn unreadable(index: usize, cause: &dyn std::fmt::Display) -> TrainError {
    TrainError::Picture {
        name: (index + 1).to_string(),
        cause: cause.to_string(),
    }
}
