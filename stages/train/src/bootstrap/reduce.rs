use marf_cache::{Digest, digest_of};
use marf_field::{Device, Field, Render};
use marf_scene::{
    Image, Scene, Srgb,
    path::{self, Viewpoint},
};
use marf_schema::{
    bootstrap::{BootstrapParams, Member, MemberFields, Members, Metrics},
    output::{FLYTHROUGH, MAPS, WEIGHTS},
    train,
    video::Film,
};
use marf_stage::{Ctx, Inputs, Outputs, StageError, TypedOutputs};

use super::{
    auto::rounds,
    drawing::{Scales, flythrough_picture, flythrough_size, put_view},
    maps::{Maps, maps},
    out_of_bag::out_of_bag,
    report::report,
    seen::Witnesses,
    study::{ViewStudy, study},
    viewpoints::{MapView, map_views},
};
use crate::{
    TrainError,
    checkpoint::Journal,
    child::Child,
    error::field_failed,
    io::{put_png, read_scene},
    photos::PhotoReader,
    split::{NamedFrame, split},
    view::{self, render_view},
};

/// Renders the fields of all members, maps where they disagree and reports progress.
struct Mapper<'a> {
    ctx: &'a Ctx<'a>,
    /// What is reduced.
    of: Digest,
    fields: Vec<Field>,
    /// What photos saw, by the member with the lowest seed: the delivered field, where it is a member.
    witnesses: Witnesses,
    /// Viewpoints that are done.
    done: u64,
    total: u64,
}

/// Renders every member at every viewpoint and along the fly-through, and writes maps and figures.
///
/// Viewpoints are walked through twice, since scales and intervals follow from all of them: the maps of one at a time are in memory,
/// and those of the first walk are kept among the checkpoints for the second.
pub(crate) fn reduce(
    ctx: &Ctx<'_>,
    of: Digest,
    params: &BootstrapParams,
    inputs: &Inputs,
    outputs_of_members: &[Outputs],
) -> Result<Outputs, StageError> {
    let scene = read_scene(ctx, inputs)?;
    let children: Vec<Child<'_>> = (0..)
        .zip(outputs_of_members)
        .map(|(member, outputs): (u32, _)| {
            let name = format!("member {member:02}");
            Child { name, outputs }
        })
        .collect();
    let first = children
        .first()
        .ok_or_else(|| StageError::new("no member was trained"))?;
    let metrics = children
        .iter()
        .map(|child| child.read(ctx))
        .collect::<Result<Vec<train::Metrics>, _>>()?;
    let training = split(&scene, metrics[0].holdout, metrics[0].fold)?.training;
    // What no member was trained on is no witness.
    let is_used = |named: &&NamedFrame<'_>| metrics.iter().any(|member| member.has_drawn(&named.frame.id));
    let used: Vec<NamedFrame<'_>> = training.iter().filter(is_used).cloned().collect();
    let photos = PhotoReader::new(ctx, &scene, metrics[0].scale);
    let views = map_views(&photos, params, &scene, &used, first)?;
    let flythrough = path::flythrough(&scene, params.frames, params.width);
    check_film(&flythrough)?;
    let fields = fields(ctx, &children, &params.device)?;
    let first = (0..fields.len()).min_by_key(|member| metrics[*member].seed);
    let witness = &fields[first.unwrap_or(0)];
    let mut mapper = Mapper {
        witnesses: Witnesses::new(of, witness, &photos, &used, &scene)?,
        ctx,
        of,
        fields,
        done: 0,
        total: (views.len() + flythrough.len()) as u64,
    };

    let studies = studies(&mut mapper, &views, &scene)?;
    let report = Metrics {
        rounds: match params.b {
            Members::Auto => rounds(ctx, &params.device, inputs, outputs_of_members)?,
            Members::Count(_) => Vec::new(),
        },
        out_of_bag: out_of_bag(ctx, of, &metrics, &mapper.fields, &photos, &training)?,
        ..report(params.mode, members(&metrics), &studies)
    };
    let scales = Scales::of(
        studies.iter().map(|study| &study.tops),
        report.heldout.as_ref(),
        scene.metres_per_unit,
    );
    let mut outputs = Outputs::new();
    put_views(&mapper, &views, &scales, &mut outputs)?;
    outputs.put(ctx, &report)?;
    let weights = children.iter().map(|child| child.digest(WEIGHTS).copied());
    outputs.put(ctx, &MemberFields(weights.collect::<Result<_, _>>()?))?;
    let draw = |maps: &Maps| flythrough_picture(maps, &scales, params.show);
    render_flythrough(&flythrough, &draw, &mut mapper, &mut outputs)?;
    Ok(outputs)
}

/// Refuses a fly-through that no video can hold, before its first picture is rendered.
fn check_film(flythrough: &[Viewpoint]) -> Result<(), TrainError> {
    if let Some(first) = flythrough.first() {
        let (width, height) = flythrough_size(first.camera.width, first.camera.height);
        marf_video::check_size(width, height)?;
    }
    Ok(())
}

impl<'a> Mapper<'a> {
    /// Returns the maps of viewpoint `index` of all.
    fn maps(&self, index: u64, place: &Viewpoint) -> Result<Maps, StageError> {
        let renders = self.render(index, place)?;
        maps(self.ctx, &renders, &|surfaces| {
            self.witnesses.sights(place, surfaces)
        })
    }

    /// Returns the render of every member at viewpoint `index`.
    fn render(&self, index: u64, place: &Viewpoint) -> Result<Vec<Render>, StageError> {
        let of = digest_of(&(self.of, index));
        let mut journal = Journal::new(self.ctx, "members", of);
        let (camera, pose) = (&place.camera, &place.cam_from_world);
        let members = (0_u64..).zip(&self.fields).map(|(member, field)| {
            journal.piece(
                |bytes| view::unpack(bytes, camera.width, camera.height),
                || {
                    let of = digest_of(&(of, member));
                    let render = render_view(self.ctx, of, field, camera, pose)?;
                    let bytes = view::pack(&render);
                    Ok((render, bytes))
                },
            )
        });
        members.collect()
    }

    /// Returns the next maps of a journal over the viewpoints.
    fn next_maps(
        &self,
        journal: &mut Journal<'_>,
        index: u64,
        place: &Viewpoint,
    ) -> Result<Maps, StageError> {
        let size = (place.camera.width, place.camera.height);
        journal.piece(
            |bytes| Maps::unpack(bytes, size),
            || {
                let maps = self.maps(index, place)?;
                let bytes = maps.pack();
                Ok((maps, bytes))
            },
        )
    }

    fn journal(&self) -> Journal<'a> {
        Journal::new(self.ctx, "maps", self.of)
    }

    /// Reports that a viewpoint is done.
    fn passed(&mut self, place: &Viewpoint) {
        self.done += 1;
        let note = format!("render {}", place.name);
        self.ctx.progress.at(self.done, self.total, &note);
    }
}

/// Makes the maps of every viewpoint and returns their figures.
fn studies(mapper: &mut Mapper<'_>, views: &[MapView], scene: &Scene) -> Result<Vec<ViewStudy>, StageError> {
    let ctx = mapper.ctx;
    let mut journal = mapper.journal();
    let mut studies = Vec::with_capacity(views.len());
    for (index, view) in (0..).zip(views) {
        let maps = mapper.next_maps(&mut journal, index, &view.place)?;
        let image = view.image(ctx)?;
        let truth = view.truth(image.as_ref());
        studies.push(study(&view.place, &maps, truth.as_ref(), &scene.points)?);
        mapper.passed(&view.place);
    }
    journal.end();
    Ok(studies)
}

/// Draws and stores the maps of every viewpoint.
fn put_views(
    mapper: &Mapper<'_>,
    views: &[MapView],
    scales: &Scales,
    outputs: &mut Outputs,
) -> Result<(), StageError> {
    let ctx = mapper.ctx;
    let (mut known, mut journal) = (mapper.journal(), Journal::new(ctx, "drawings", mapper.of));
    for (index, view) in (0..).zip(views) {
        let maps = mapper.next_maps(&mut known, index, &view.place)?;
        let of_view = journal.piece(
            |bytes| {
                let stored: Outputs = serde_json::from_slice(bytes).ok()?;
                let whole = stored.values().all(|digest| ctx.blobs.contains(digest));
                whole.then_some(stored)
            },
            || {
                let mut stored = Outputs::new();
                let image = view.image(ctx)?;
                let truth = view.truth(image.as_ref());
                put_view(ctx, &view.place.name, &maps, truth.as_ref(), scales, &mut stored)?;
                if let Some(photo) = &view.photo {
                    stored.insert(format!("{MAPS}{}-photo.png", view.place.name), photo.digest);
                }
                let bytes = serde_json::to_vec(&stored);
                Ok((stored, bytes.map_err(|error| StageError::new(error.to_string()))?))
            },
        )?;
        outputs.extend(of_view);
    }
    journal.end();
    Ok(())
}

/// Writes the pictures of the fly-through and their order.
fn render_flythrough(
    flythrough: &[Viewpoint],
    draw: &dyn Fn(&Maps) -> Image<Srgb>,
    mapper: &mut Mapper<'_>,
    outputs: &mut Outputs,
) -> Result<(), StageError> {
    let ctx = mapper.ctx;
    let mut journal = Journal::new(ctx, "flythrough", mapper.of);
    let mut film = Film::default();
    for place in flythrough {
        let index = mapper.done;
        let digest = journal.piece(
            |bytes| known_picture(ctx, bytes),
            || {
                let picture = draw(&mapper.maps(index, place)?);
                let digest = put_png(ctx, &mut Outputs::new(), place.name.clone(), &picture)?;
                Ok((digest, digest.as_bytes().to_vec()))
            },
        )?;
        mapper.passed(place);
        outputs.insert(format!("{FLYTHROUGH}{}.png", place.name), digest);
        film.0.push(digest);
    }
    outputs.put(ctx, &film)
}

/// Returns the digest of a picture from its bytes, if the picture is still stored.
fn known_picture(ctx: &Ctx<'_>, bytes: &[u8]) -> Option<Digest> {
    let digest = Digest::from_bytes(bytes.try_into().ok()?);
    ctx.blobs.contains(&digest).then_some(digest)
}

/// Returns what the report says of every member.
fn members(metrics: &[train::Metrics]) -> Vec<Member> {
    let member = |metrics: &train::Metrics| Member {
        seed: metrics.seed,
        scale: metrics.scale,
        psnr: metrics.scores.psnr,
        ssim: metrics.scores.ssim,
    };
    metrics.iter().map(member).collect()
}

/// Reads the field of every member.
fn fields(ctx: &Ctx<'_>, children: &[Child<'_>], device: &Device) -> Result<Vec<Field>, StageError> {
    let field = |child: &Child<'_>| {
        let bytes = ctx.get(child.digest(WEIGHTS)?)?;
        let field = Field::decode(&bytes).map_err(|error| child.malformed(WEIGHTS, &error))?;
        field.on(device).map_err(field_failed)
    };
    children.iter().map(field).collect()
}
