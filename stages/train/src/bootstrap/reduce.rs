//! The reduction: members to maps, drawings and figures.

use marf_cache::Digest;
use marf_schema::bootstrap::{BootstrapParams, Metrics, Mode};
use marf_stage::{Ctx, Inputs, Outputs, StageError, TypedOutputs};

use super::{
    drawing::Scales, mapper::Mapper, out_of_bag::out_of_bag, reach::Reach, report::report,
    retrainings::Retrainings, viewpoints::map_views, visibility::Witnesses,
};
use crate::{
    io::read_scene,
    photos::PhotoReader,
    split::{NamedFrame, split},
};

/// Renders every member at every viewpoint, and writes maps and figures. `identity` identifies the node and its fields.
pub(super) fn reduce(
    ctx: &Ctx<'_>,
    identity: Digest,
    params: &BootstrapParams,
    inputs: &Inputs,
    outputs_of_members: &[Outputs],
) -> Result<Outputs, StageError> {
    let scene = read_scene(ctx, inputs)?;
    let members = Retrainings::read(ctx, outputs_of_members)?;
    let first = &members.metrics[0];
    let training = split(&scene, first.holdout, first.fold)?.training;
    // A photo that no member was trained on is not a witness.
    let used = training.iter().filter(|named| members.has_used(named));
    let used: Vec<NamedFrame<'_>> = used.cloned().collect();
    let photos = PhotoReader::for_field(ctx, &scene, first.scale, &first.config);
    let views = map_views(&photos, params, &scene, &used, members.first())?;
    let fields = members.fields(ctx, &params.device)?;
    let witness = &fields[members.lowest_seed()];
    let witnesses = Witnesses::new(identity, witness, &photos, &used, &scene)?;
    let mut mapper = Mapper::new(ctx, identity, fields, witnesses, views.len());

    let studies = mapper.studies(&views, &scene)?;
    let report = Metrics {
        out_of_bag: match params.mode {
            Mode::Seeds => None,
            Mode::Photos => out_of_bag(identity, &members.metrics, &mapper.fields, &photos, &training)?,
        },
        ..report(params.mode, members.report(), &studies)
    };
    let reach = studies
        .iter()
        .fold(Reach::default(), |reach, study| reach.max(&study.reach));
    let metres_per_unit = scene.metres_per_unit;
    let scales = Scales::new(&reach, report.heldout.as_ref(), metres_per_unit, used.len());
    let mut outputs = Outputs::new();
    mapper.put_views(&views, &scales, &mut outputs)?;
    outputs.put(ctx, &report)?;
    outputs.put(ctx, &members.weights()?)?;
    Ok(outputs)
}
