use marf_cache::{Digest, digest_of};
use marf_field::{Device, Field, Render};
use marf_scene::{
    Camera, Image, Photo, Scene, Srgb,
    metrics::psnr,
    path::{self, Viewpoint},
    picture_names,
};
use marf_schema::{
    bootstrap::{BootstrapParams, Member, Viewpoints},
    output::{FLYTHROUGH, MAPS, PHOTO, WEIGHTS},
    train,
    video::Film,
};
use marf_stage::{Ctx, Inputs, Outputs, StageError, TypedOutputs};

use super::{
    drawing::{Scales, flythrough_picture, flythrough_size, mean_picture, put_view},
    maps::{Maps, gray, maps},
    report::{GroundTruth, ViewMaps, report},
};
use crate::{
    TrainError,
    checkpoint::Journal,
    child::Child,
    error::field_failed,
    io::{put_png, read_scene},
    view::{self, render_view},
};

/// A viewpoint of maps, and its photo where one was held out.
struct MapView {
    place: Viewpoint,
    photo: Option<(Digest, Image<Srgb>)>,
}

/// Renders the fields of all members and reports progress.
struct MemberRenderer<'a> {
    ctx: &'a Ctx<'a>,
    /// What is reduced.
    of: Digest,
    fields: Vec<Field>,
    /// Viewpoints that are done.
    done: u64,
    total: u64,
}

/// Renders every member at every viewpoint and along the fly-through, and writes maps and figures.
pub(crate) fn reduce(
    ctx: &Ctx<'_>,
    of: Digest,
    params: &BootstrapParams,
    inputs: &Inputs,
    children: &[Outputs],
) -> Result<Outputs, StageError> {
    let scene = read_scene(ctx, inputs)?;
    let children: Vec<Child<'_>> = (0..)
        .zip(children)
        .map(|(member, outputs): (u32, _)| {
            let name = format!("member {member:02}");
            Child { name, outputs }
        })
        .collect();
    let members = members(ctx, &children)?;
    let scale = members.first().map_or(1, |member| member.scale);
    let map_views = map_views(ctx, params, &scene, scale, &children)?;
    let flythrough = path::flythrough(&scene, params.frames, params.width);
    check_film(&flythrough)?;
    let fields = fields(ctx, &children, &params.device)?;
    let total = (map_views.len() + flythrough.len()) as u64;
    let mut renderer = MemberRenderer {
        ctx,
        of,
        fields,
        done: 0,
        total,
    };

    let mut outputs = Outputs::new();
    let mut views = Vec::with_capacity(map_views.len());
    let mut journal = Journal::new(ctx, "maps", of);
    for view in &map_views {
        let size = (view.place.camera.width, view.place.camera.height);
        let maps = journal.piece(
            |bytes| Maps::unpack(bytes, size),
            || {
                let maps = maps(ctx, &renderer.render(&view.place)?)?;
                let bytes = maps.pack();
                Ok((maps, bytes))
            },
        )?;
        renderer.passed(&view.place);
        let name = view.place.name.clone();
        if let Some((digest, _)) = &view.photo {
            outputs.insert(format!("{MAPS}{name}-photo.png"), *digest);
        }
        views.push(ViewMaps {
            name,
            truth: ground_truth(&maps, view)?,
            maps,
        });
    }
    journal.end();
    let scales = Scales::of(&views, scene.metres_per_unit);
    put_views(ctx, of, &views, &scales, scene.metres_per_unit, &mut outputs)?;
    outputs.put(ctx, &report(ctx, params.b, params.mode, members, &views)?)?;
    drop(views);
    let draw = |maps: &Maps| flythrough_picture(maps, &scales, scene.metres_per_unit, params.show);
    render_flythrough(&flythrough, &draw, &mut renderer, &mut outputs)?;
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

impl MemberRenderer<'_> {
    /// Returns the render of every member at one viewpoint.
    fn render(&mut self, place: &Viewpoint) -> Result<Vec<Render>, StageError> {
        let of = digest_of(&(self.of, self.done));
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

    /// Reports that a viewpoint is done.
    fn passed(&mut self, place: &Viewpoint) {
        self.done += 1;
        let note = format!("render {}", place.name);
        self.ctx.progress.at(self.done, self.total, &note);
    }
}

/// Writes the pictures of the fly-through and their order.
fn render_flythrough(
    flythrough: &[Viewpoint],
    draw: &dyn Fn(&Maps) -> Image<Srgb>,
    renderer: &mut MemberRenderer<'_>,
    outputs: &mut Outputs,
) -> Result<(), StageError> {
    let ctx = renderer.ctx;
    let mut journal = Journal::new(ctx, "flythrough", renderer.of);
    let mut film = Film::default();
    for place in flythrough {
        let digest = journal.piece(
            |bytes| known_picture(ctx, bytes),
            || {
                let picture = draw(&maps(ctx, &renderer.render(place)?)?);
                let digest = put_png(ctx, &mut Outputs::new(), place.name.clone(), &picture)?;
                Ok((digest, digest.as_bytes().to_vec()))
            },
        )?;
        renderer.passed(place);
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

/// Draws and stores the maps of every viewpoint.
fn put_views(
    ctx: &Ctx<'_>,
    of: Digest,
    views: &[ViewMaps],
    scales: &Scales,
    metres_per_unit: Option<f64>,
    outputs: &mut Outputs,
) -> Result<(), StageError> {
    let mut journal = Journal::new(ctx, "drawings", of);
    for view in views {
        let of_view = journal.piece(
            |bytes| {
                let stored: Outputs = serde_json::from_slice(bytes).ok()?;
                let whole = stored.values().all(|digest| ctx.blobs.contains(digest));
                whole.then_some(stored)
            },
            || {
                let mut stored = Outputs::new();
                put_view(ctx, view, scales, metres_per_unit, &mut stored)?;
                let bytes = serde_json::to_vec(&stored);
                Ok((stored, bytes.map_err(|error| StageError::new(error.to_string()))?))
            },
        )?;
        outputs.extend(of_view);
    }
    journal.end();
    Ok(())
}

/// Returns what the report says of every member.
fn members(ctx: &Ctx<'_>, children: &[Child<'_>]) -> Result<Vec<Member>, StageError> {
    let member = |child: &Child<'_>| {
        let metrics: train::Metrics = child.read(ctx)?;
        Ok(Member {
            seed: metrics.seed,
            scale: metrics.scale,
            psnr: metrics.scores.psnr,
            ssim: metrics.scores.ssim,
        })
    };
    children.iter().map(member).collect()
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

/// Returns the viewpoints that maps are made at.
fn map_views(
    ctx: &Ctx<'_>,
    params: &BootstrapParams,
    scene: &Scene,
    scale: u32,
    children: &[Child<'_>],
) -> Result<Vec<MapView>, StageError> {
    let widths = scene.frames.iter().map(|frame| frame.camera.width);
    let width = (widths.max().unwrap_or(1) / scale).max(1);
    let without_photo = |places: Vec<Viewpoint>| -> Vec<MapView> {
        let places = places.into_iter();
        places.map(|place| MapView { place, photo: None }).collect()
    };
    let frames = params.map_frames;
    let (name, views) = match params.viewpoints {
        Viewpoints::Heldout => ("heldout", held_out_views(ctx, scene, scale, children)?),
        Viewpoints::Flythrough => (
            "flythrough",
            without_photo(path::flythrough(scene, frames, width)),
        ),
        Viewpoints::Orbit => ("orbit", without_photo(path::orbit(scene, frames, width))),
    };
    if views.is_empty() {
        return Err(TrainError::NoViewpoint { viewpoints: name }.into());
    }
    Ok(views)
}

/// Returns the views of the photos that the members held out, with the photos as the first member wrote them.
fn held_out_views(
    ctx: &Ctx<'_>,
    scene: &Scene,
    scale: u32,
    children: &[Child<'_>],
) -> Result<Vec<MapView>, StageError> {
    let Some(first) = children.first() else {
        return Ok(Vec::new());
    };
    let mut views = Vec::new();
    for (frame, name) in scene.frames.iter().zip(picture_names(scene)) {
        let output = format!("{PHOTO}{name}.png");
        let Some(digest) = first.outputs.get(&output) else {
            continue;
        };
        let photo = Photo::decode(&ctx.get(digest)?).map_err(|error| first.malformed(&output, &error))?;
        views.push(MapView {
            place: Viewpoint {
                name,
                camera: sized(&frame.camera.box_reduced(scale), &photo.image),
                cam_from_world: frame.cam_from_world,
            },
            photo: Some((*digest, photo.image)),
        });
    }
    Ok(views)
}

/// Returns the camera with the size of the photo as it was written.
fn sized(camera: &Camera, photo: &Image<Srgb>) -> Camera {
    Camera {
        width: photo.width,
        height: photo.height,
        ..*camera
    }
}

/// Returns the error of the mean render, where there is a photo.
fn ground_truth(maps: &Maps, view: &MapView) -> Result<Option<GroundTruth>, TrainError> {
    let Some((_, photo)) = &view.photo else {
        return Ok(None);
    };
    let grays = photo
        .pixels
        .iter()
        .map(|rgb| gray(&rgb.map(|channel| f32::from(channel) / 255.0)));
    let pixels = maps.gray.iter().zip(grays);
    let psnr = psnr(&mean_picture(maps), photo).map_err(|error| TrainError::Picture {
        name: view.place.name.clone(),
        cause: error.to_string(),
    })?;
    Ok(Some(GroundTruth {
        error: pixels
            .map(|(mean, photo)| (f64::from(*mean) - photo).abs() as f32)
            .collect(),
        psnr,
    }))
}
