//! The members of a bootstrap: their outputs, their metrics and their fields.

use marf_field::{Device, Field};
use marf_schema::{
    bootstrap::{Member, MemberFields},
    output::WEIGHTS,
    train,
};
use marf_stage::{Ctx, Outputs, StageError};

use crate::{TrainError, child::Child, error::field_failed, split::NamedFrame};

/// The finished members of a bootstrap, in their order.
pub(super) struct Retrainings<'a> {
    children: Vec<Child<'a>>,
    pub metrics: Vec<train::Metrics>,
}

impl<'a> Retrainings<'a> {
    /// Reads the metrics of the members.
    ///
    /// # Errors
    /// There is no member, or the metrics of one cannot be read.
    pub fn read(ctx: &Ctx<'_>, outputs: &'a [Outputs]) -> Result<Self, StageError> {
        let children = Child::numbered("member", outputs);
        if children.is_empty() {
            return Err(StageError::new("no member was trained"));
        }
        let metrics: Result<_, StageError> = children.iter().map(|child| child.read(ctx)).collect();
        Ok(Self {
            children,
            metrics: metrics?,
        })
    }

    /// Returns the first member.
    pub fn first(&self) -> &Child<'a> {
        &self.children[0]
    }

    /// Returns the index of the member with the lowest seed: the delivered field, where it is a member.
    pub fn lowest_seed(&self) -> usize {
        let members = 0..self.metrics.len();
        members
            .min_by_key(|member| self.metrics[*member].seed)
            .unwrap_or(0)
    }

    /// Returns whether any member was trained on a photo.
    pub fn has_used(&self, named: &NamedFrame<'_>) -> bool {
        self.metrics
            .iter()
            .any(|member| member.has_drawn(&named.frame.id))
    }

    /// Reads the field of every member.
    ///
    /// # Errors
    /// A member whose field is missing or cannot be read.
    pub fn fields(&self, ctx: &Ctx<'_>, device: &Device) -> Result<Vec<Field>, StageError> {
        let field = |child: &Child<'_>| {
            let bytes = ctx.get(child.digest(WEIGHTS)?)?;
            let field = Field::decode(&bytes).map_err(|error| child.malformed(WEIGHTS, &error))?;
            let field = marf_field_gpu::open(device).and_then(|backend| field.with_backend(backend));
            field.map_err(field_failed)
        };
        self.children.iter().map(field).collect()
    }

    /// Returns the digests of the fields.
    ///
    /// # Errors
    /// A member whose field is missing.
    pub fn weights(&self) -> Result<MemberFields, TrainError> {
        let weights = self.children.iter().map(|child| child.digest(WEIGHTS).copied());
        Ok(MemberFields(weights.collect::<Result<_, _>>()?))
    }

    /// Returns the entry of every member in the report.
    pub fn report(&self) -> Vec<Member> {
        let member = |metrics: &train::Metrics| Member {
            seed: metrics.seed,
            scale: metrics.scale,
            psnr: metrics.scores.psnr,
            ssim: metrics.scores.ssim,
        };
        self.metrics.iter().map(member).collect()
    }
}
