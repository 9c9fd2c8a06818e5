//! `render`: pictures of a trained field along a path, and their order as a film.
//!
//! The path is walked through twice, since a colour scale follows from all pictures: first the field is rendered and the values are kept
//! as pictures of 16 bits, one viewpoint at a time in memory; then previews and film are drawn from these.

mod layers;
mod path;

use marf_cache::{Digest, digest_of};
use marf_field::{Field, Render as Rendered};
use marf_scene::{Scene, path::Viewpoint};
use marf_schema::{
    bootstrap::MemberFields,
    output::{DEPTH, DEPTH_PREVIEW, FRAMES, SCENE, UNCERTAINTY, UNCERTAINTY_PREVIEW, WEIGHTS},
    render::{Layer, Poses, RenderParams},
    video::Film,
};
use marf_stage::{
    Ctx, Define, Document, Inputs, Outputs, ParamError, Params, Port, Set, StageError, TypedOutputs,
};

use crate::{
    TrainError,
    checkpoint::{Journal, identity},
    io::{read_field, read_scene},
    stage_on_device,
    view::render_view,
};
use layers::{Drawing, Drawn, Frame, frame};

/// Renders a trained field along a path.
#[derive(Debug)]
pub struct Render {
    params: RenderParams,
}

impl Define for Render {
    type Params = RenderParams;
    const NAME: &'static str = RenderParams::STAGE;
    const ABOUT: &'static str = "renders a trained field along a path: the pictures of a film";
    const VERSION: u32 = 7;
    const PORTS: &'static [Port] = &[
        Port::required("input", WEIGHTS),
        Port::required("input", SCENE),
        Port::optional("members", MemberFields::OUTPUT),
    ];
    const OUTPUTS: &'static [&'static str] = &[
        Film::OUTPUT,
        Poses::OUTPUT,
        FRAMES,
        DEPTH,
        DEPTH_PREVIEW,
        UNCERTAINTY,
        UNCERTAINTY_PREVIEW,
    ];

    fn new(params: RenderParams) -> Result<Self, ParamError> {
        params.check()?;
        Ok(Self { params })
    }
}

stage_on_device!(Render, Set);

impl Set for Render {
    fn run(&self, ctx: &Ctx<'_>, inputs: &Inputs) -> Result<Outputs, StageError> {
        let scene = read_scene(ctx, inputs)?;
        let path = path::viewpoints(&scene, &self.params)?;
        let fields = Fields::read(ctx, inputs, &self.params)?;
        let mut outputs = Outputs::new();
        outputs.put(ctx, &Poses(path::places(&path)))?;
        let frames = self.frames(ctx, inputs, &scene, &fields, &path)?;
        let drawing = Drawing::of(&scene, &self.params.outputs, &frames);
        let mut journal = Journal::new(ctx, "drawings", identity(self, inputs, ""));
        let mut film = Film::default();
        for (index, (frame, place)) in frames.iter().zip(&path).enumerate() {
            let note = format!("drawing {}", place.name);
            ctx.progress.at(index as u64, path.len() as u64, &note);
            let drawn = journal.piece(
                |bytes| Drawn::unpack(ctx, bytes),
                || {
                    let drawn = drawing.draw(ctx, frame, place, index + 1)?;
                    let bytes = drawn.pack()?;
                    Ok((drawn, bytes))
                },
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
    /// Renders every viewpoint of the path. Each layer of it is kept as a memo: a run that was stopped goes on, and another path or
    /// other outputs take what is known of the same fields and cameras.
    fn frames(
        &self,
        ctx: &Ctx<'_>,
        inputs: &Inputs,
        scene: &Scene,
        fields: &Fields,
        path: &[Viewpoint],
    ) -> Result<Vec<Frame>, StageError> {
        let of = identity(self, inputs, "");
        let mut frames = Vec::with_capacity(path.len());
        for (index, place) in path.iter().enumerate() {
            let note = format!("picture {}", place.name);
            ctx.progress.at(index as u64, path.len() as u64, &note);
            let of_viewpoint = digest_of(&(of, index as u64));
            frames.push(frame(
                ctx,
                scene,
                &self.params.outputs,
                fields,
                (of_viewpoint, place),
            )?);
        }
        Ok(frames)
    }
}

/// The fields that a path is rendered with.
pub(super) struct Fields {
    /// The delivered field; none where only retrainings are asked for.
    own: Option<Field>,
    /// The retrainings; none where no uncertainty is asked for.
    members: Vec<Field>,
    /// What they are: their digests, and what renders them.
    own_id: Digest,
    members_id: Digest,
}

impl Fields {
    /// Reads the fields that the outputs need.
    fn read(ctx: &Ctx<'_>, inputs: &Inputs, params: &RenderParams) -> Result<Self, StageError> {
        let backend = params.device.backend_id();
        let weights = inputs.required(WEIGHTS)?;
        let needs_own = params.outputs.iter().any(|layer| *layer != Layer::Uncertainty);
        let own = needs_own.then(|| read_field(ctx, weights, &params.device));
        let digests = match params.outputs.contains(&Layer::Uncertainty) {
            false => Vec::new(),
            true => {
                inputs
                    .optional(MemberFields::OUTPUT)
                    .ok_or(TrainError::NoMembers)?;
                inputs.read::<MemberFields>(ctx)?.0
            }
        };
        let member = |weights: &Digest| read_field(ctx, weights, &params.device);
        Ok(Self {
            own: own.transpose()?,
            own_id: digest_of(&(*weights, backend.clone())),
            members_id: digest_of(&(digests.clone(), backend)),
            members: digests.iter().map(member).collect::<Result<_, _>>()?,
        })
    }

    /// Returns what the fields are that a layer shows.
    pub fn id(&self, layer: Layer) -> Digest {
        match layer {
            Layer::Rgb | Layer::Depth => self.own_id,
            Layer::Uncertainty => self.members_id,
        }
    }

    /// Renders a viewpoint with the delivered field; `of` stands for the fields and the viewpoint.
    pub fn own(&self, ctx: &Ctx<'_>, of: Digest, place: &Viewpoint) -> Result<Rendered, StageError> {
        let missing = || StageError::new("a field that is needed was not rendered");
        let field = self.own.as_ref().ok_or_else(missing)?;
        render_view(ctx, of, field, &place.camera, &place.cam_from_world)
    }

    /// Renders a viewpoint with each of the retrainings.
    pub fn members(&self, ctx: &Ctx<'_>, of: Digest, place: &Viewpoint) -> Result<Vec<Rendered>, StageError> {
        let members = (0_u64..).zip(&self.members).map(|(index, field)| {
            let of = digest_of(&(of, index));
            render_view(ctx, of, field, &place.camera, &place.cam_from_world)
        });
        members.collect()
    }
}
