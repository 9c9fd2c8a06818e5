//! The fields that a path is rendered with.

use marf_cache::{Digest, digest_of};
use marf_field::{Field, Render as Rendered};
use marf_scene::path::Viewpoint;
use marf_schema::{
    bootstrap::MemberFields,
    output::WEIGHTS,
    render::{Layer, RenderParams},
};
use marf_stage::{Ctx, Document, Inputs, StageError};

use crate::{TrainError, io::read_field, view::render_view};

/// The fields that a path is rendered with.
pub(super) struct Fields {
    /// The delivered field. `None` if only retrainings are requested.
    own: Option<Field>,
    /// The retrainings. Empty if no uncertainty is requested.
    members: Vec<Field>,
    /// What they are: their digests, and what renders them.
    own_id: Digest,
    members_id: Digest,
}

impl Fields {
    /// Reads the fields that the outputs need.
    ///
    /// # Errors
    /// The uncertainty is requested without retrainings, or a field cannot be read.
    pub fn read(ctx: &Ctx<'_>, inputs: &Inputs, params: &RenderParams) -> Result<Self, StageError> {
        let backend = marf_field_gpu::backend_id(&params.device);
        let weights = inputs.required(WEIGHTS)?;
        let needs_own = params.outputs.iter().any(|layer| *layer != Layer::Uncertainty);
        let own = needs_own.then(|| read_field(ctx, weights, &params.device));
        let digests = if params.outputs.contains(&Layer::Uncertainty) {
            inputs
                .optional(MemberFields::OUTPUT)
                .ok_or(TrainError::NoMembers)?;
            inputs.read::<MemberFields>(ctx)?.0
        } else {
            Vec::new()
        };
        let member = |weights: &Digest| read_field(ctx, weights, &params.device);
        Ok(Self {
            own: own.transpose()?,
            own_id: digest_of(&(*weights, backend.clone())),
            members_id: digest_of(&(digests.clone(), backend)),
            members: digests.iter().map(member).collect::<Result<_, _>>()?,
        })
    }

    /// Returns the identity of the fields that a layer shows.
    pub fn id(&self, layer: Layer) -> Digest {
        match layer {
            Layer::Rgb | Layer::Depth => self.own_id,
            Layer::Uncertainty => self.members_id,
        }
    }

    /// Renders a viewpoint with the delivered field.
    pub fn own(&self, ctx: &Ctx<'_>, place: &Viewpoint) -> Result<Rendered, StageError> {
        let missing = || StageError::new("a field that is needed was not rendered");
        let field = self.own.as_ref().ok_or_else(missing)?;
        render_view(ctx, field, &place.camera, &place.cam_from_world)
    }

    /// Renders a viewpoint with each of the retrainings.
    pub fn members(&self, ctx: &Ctx<'_>, place: &Viewpoint) -> Result<Vec<Rendered>, StageError> {
        let members = self.members.iter();
        members
            .map(|field| render_view(ctx, field, &place.camera, &place.cam_from_world))
            .collect()
    }
}
