//! `render`: pictures of a trained field along a path, and their order as a film.
//!
//! The path is visited twice, since a colour scale follows from all pictures. First the field is rendered, one viewpoint at a time in
//! memory, and the values are kept as pictures of 16 bits. Then previews and film are drawn from these.

mod fields;
mod layers;
mod path;

use marf_scene::{Scene, path::Viewpoint};
use marf_schema::{
    bootstrap::MemberFields,
    output::{DEPTH, DEPTH_PREVIEW, FRAMES, SCENE, UNCERTAINTY, UNCERTAINTY_PREVIEW, WEIGHTS},
    render::{Poses, RenderParams},
    video::Film,
};
use marf_stage::{Ctx, Document, Inputs, Outputs, Port, Set, StageError, Threads, TypedOutputs, stage};

use crate::{
    checkpoint::{Journal, identity},
    io::read_scene,
};
use fields::Fields;
use layers::{Drawing, Frame, FramePictures, LayerSource};

/// Renders a trained field along a path.
#[derive(Debug)]
pub struct Render {
    params: RenderParams,
}

stage! {
    Render { params: RenderParams },
    Set,
    Threads::All,
    about: "renders a trained field along a path: the pictures of a film",
    version: 8,
    ports: [
        Port::required("input", WEIGHTS),
        Port::required("input", SCENE),
        Port::optional("members", MemberFields::OUTPUT),
    ],
    outputs: [
        Film::OUTPUT,
        Poses::OUTPUT,
        FRAMES,
        DEPTH,
        DEPTH_PREVIEW,
        UNCERTAINTY,
        UNCERTAINTY_PREVIEW,
    ],
    device: device,
}

impl Set for Render {
    fn run(&self, ctx: &Ctx<'_>, inputs: &Inputs) -> Result<Outputs, StageError> {
        let scene = read_scene(ctx, inputs)?;
        let path = path::viewpoints(&scene, &self.params)?;
        let fields = Fields::read(ctx, inputs, &self.params)?;
        let mut outputs = Outputs::new();
        outputs.put(ctx, &Poses(path::places(&path)))?;
        let frames = self.frames(ctx, &scene, &fields, &path)?;
        let drawing = Drawing::new(&scene, &self.params.outputs, &frames);
        let mut journal = Journal::new(ctx, "drawings", identity(self, inputs, ""));
        let mut film = Film::default();
        for (index, (frame, place)) in frames.iter().zip(&path).enumerate() {
            let note = format!("drawing {}", place.name);
            ctx.progress.at(index as u64, path.len() as u64, &note);
            let drawn = journal.piece_of(
                |drawn: &FramePictures| drawn.are_stored(ctx),
                || drawing.draw(ctx, frame, place, index + 1),
            )?;
            outputs.extend(drawn.outputs);
            film.0.push(drawn.film);
        }
        journal.end();
        outputs.put(ctx, &film)?;
        Ok(outputs)
    }
}

impl Render {
    /// Renders every viewpoint of the path. Each layer is kept as a memo, so that a stopped run continues. Another path or other outputs
    /// reuse the memos of the same fields and cameras.
    fn frames(
        &self,
        ctx: &Ctx<'_>,
        scene: &Scene,
        fields: &Fields,
        path: &[Viewpoint],
    ) -> Result<Vec<Frame>, StageError> {
        let source = LayerSource {
            layers: &self.params.outputs,
            fields,
            metres_per_unit: scene.metres_per_unit,
        };
        let mut frames = Vec::with_capacity(path.len());
        for (index, place) in path.iter().enumerate() {
            let note = format!("picture {}", place.name);
            ctx.progress.at(index as u64, path.len() as u64, &note);
            frames.push(source.frame(ctx, place)?);
        }
        Ok(frames)
    }
}
