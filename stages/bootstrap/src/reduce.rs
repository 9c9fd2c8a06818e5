use std::collections::BTreeMap;

use marf_cache::Digest;
use marf_field::{Device, Field, FieldError, Render, render_in_bands};
use marf_scene::{
    Camera, Image, Photo, Scene, Srgb,
    metrics::psnr,
    path::{self, Viewpoint},
    picture::encode_gif,
    picture_names,
};
use marf_schema::{
    bootstrap::{BootstrapParams, Member, Viewpoints},
    output::{FLYTHROUGH, MAPS, PHOTO, SCENE, VIDEO, WEIGHTS},
    train,
};
use marf_stage::{Ctx, Document, Inputs, Outputs, StageError, TypedOutputs};

use crate::{
    BootstrapError, Maps,
    draw::{Scales, flight_picture, mean_picture, put_png, put_view},
    maps::{gray, maps},
    report::{Truth, View, report},
};

/// A viewpoint, and its photo where one was held out.
struct Stop {
    place: Viewpoint,
    photo: Option<(Digest, Image<Srgb>)>,
}

/// Counts renders for the progress.
struct Renders<'a> {
    ctx: &'a Ctx<'a>,
    fields: Vec<Field>,
    done: u64,
    total: u64,
}

/// Renders every member at every viewpoint and along the fly-through, and writes maps and figures.
pub(crate) fn reduce(
    ctx: &Ctx<'_>,
    params: &BootstrapParams,
    inputs: &Inputs,
    children: &[Outputs],
) -> Result<Outputs, StageError> {
    let scene = Scene::decode(&ctx.get(inputs.required(SCENE)?)?).map_err(BootstrapError::from)?;
    let members = members(ctx, children)?;
    let scale = members.first().map_or(1, |member| member.scale);
    let stops = stops(ctx, params.viewpoints, params.map_frames, &scene, scale, children)?;
    let flight = path::flythrough(&scene, params.frames, params.width);
    let fields = fields(ctx, children, &params.device)?;
    let total = ((stops.len() + flight.len()) * fields.len()) as u64;
    let mut renders = Renders {
        ctx,
        fields,
        done: 0,
        total,
    };

    let mut outputs = Outputs::new();
    let mut views = Vec::with_capacity(stops.len());
    for stop in &stops {
        let maps = maps(&renders.at(&stop.place)?);
        if let Some((digest, _)) = &stop.photo {
            outputs.insert(format!("{MAPS}{}-photo.png", stop.place.name), *digest);
        }
        views.push(View {
            name: stop.place.name.clone(),
            truth: truth(&maps, stop)?,
            maps,
        });
    }
    let scales = Scales::of(&views, scene.metres_per_unit);
    for view in &views {
        put_view(ctx, view, &scales, scene.metres_per_unit, &mut outputs)?;
    }
    outputs.put(ctx, &report(params.b, params.mode, members, &views))?;
    drop(views);
    fly(params, &flight, &scales, &mut renders, &mut outputs)?;
    Ok(outputs)
}

impl Renders<'_> {
    fn at(&mut self, place: &Viewpoint) -> Result<Vec<Render>, StageError> {
        let mut renders = Vec::with_capacity(self.fields.len());
        for field in &self.fields {
            let note = format!("render {}", place.name);
            self.ctx.progress.at(self.done, self.total, &note);
            let keep_going = || self.ctx.check();
            renders.push(render_in_bands(
                field,
                &place.camera,
                &place.cam_from_world,
                keep_going,
                |error| gpu_failed(error).into(),
            )?);
            self.done += 1;
        }
        Ok(renders)
    }
}

fn fly(
    params: &BootstrapParams,
    flight: &[Viewpoint],
    scales: &Scales,
    renders: &mut Renders<'_>,
    outputs: &mut Outputs,
) -> Result<(), StageError> {
    let mut pictures = Vec::with_capacity(flight.len());
    for place in flight {
        let maps = maps(&renders.at(place)?);
        let picture = flight_picture(&maps, scales, params.show);
        let name = format!("{FLYTHROUGH}{}.png", place.name);
        let digest = put_png(renders.ctx, &name, &picture)?;
        outputs.insert(name, digest);
        pictures.push(picture);
    }
    let video = encode_gif(&pictures, params.fps).map_err(|error| BootstrapError::Picture {
        name: VIDEO.to_owned(),
        cause: error.to_string(),
    })?;
    outputs.put_bytes(renders.ctx, VIDEO, &video)
}

fn members(ctx: &Ctx<'_>, children: &[Outputs]) -> Result<Vec<Member>, StageError> {
    let numbered = children.iter().enumerate();
    numbered
        .map(|(member, outputs)| {
            let name = train::Metrics::OUTPUT;
            let bytes = ctx.get(output(outputs, member, name)?)?;
            let metrics = train::Metrics::decode(&bytes).map_err(|error| malformed(member, name, &error))?;
            Ok(Member {
                seed: metrics.seed,
                scale: metrics.scale,
                psnr: metrics.scores.psnr,
                ssim: metrics.scores.ssim,
            })
        })
        .collect()
}

fn fields(ctx: &Ctx<'_>, children: &[Outputs], device: &Device) -> Result<Vec<Field>, StageError> {
    let numbered = children.iter().enumerate();
    numbered
        .map(|(member, outputs)| {
            let bytes = ctx.get(output(outputs, member, WEIGHTS)?)?;
            let field = Field::decode(&bytes).map_err(|error| malformed(member, WEIGHTS, &error))?;
            Ok(field.on(device).map_err(gpu_failed)?)
        })
        .collect()
}

fn gpu_failed(error: FieldError) -> BootstrapError {
    BootstrapError::Gpu(error)
}

fn output<'a>(outputs: &'a Outputs, member: usize, name: &str) -> Result<&'a Digest, BootstrapError> {
    outputs.get(name).ok_or_else(|| BootstrapError::Missing {
        member,
        output: name.to_owned(),
    })
}

fn malformed(member: usize, name: &str, error: &dyn std::fmt::Display) -> BootstrapError {
    BootstrapError::Malformed {
        member,
        output: name.to_owned(),
        cause: error.to_string(),
    }
}

fn stops(
    ctx: &Ctx<'_>,
    viewpoints: Viewpoints,
    map_frames: u32,
    scene: &Scene,
    scale: u32,
    children: &[Outputs],
) -> Result<Vec<Stop>, StageError> {
    let width = scene
        .frames
        .iter()
        .map(|frame| frame.camera.width)
        .max()
        .unwrap_or(1);
    let width = (width / scale).max(1);
    let without_photo = |places: Vec<Viewpoint>| -> Vec<Stop> {
        let places = places.into_iter();
        places.map(|place| Stop { place, photo: None }).collect()
    };
    let (name, stops) = match viewpoints {
        Viewpoints::Heldout => ("heldout", held_out_stops(ctx, scene, scale, children)?),
        Viewpoints::Flythrough => (
            "flythrough",
            without_photo(path::flythrough(scene, map_frames, width)),
        ),
        Viewpoints::Orbit => ("orbit", without_photo(path::orbit(scene, map_frames, width))),
    };
    if stops.is_empty() {
        return Err(BootstrapError::NoViewpoint { viewpoints: name }.into());
    }
    Ok(stops)
}

/// The photos that the members held out, as the first member wrote them.
fn held_out_stops(
    ctx: &Ctx<'_>,
    scene: &Scene,
    scale: u32,
    children: &[Outputs],
) -> Result<Vec<Stop>, StageError> {
    let empty = BTreeMap::new();
    let first = children.first().unwrap_or(&empty);
    let mut stops = Vec::new();
    for (frame, name) in scene.frames.iter().zip(picture_names(scene)) {
        let output = format!("{PHOTO}{name}.png");
        let Some(digest) = first.get(&output) else {
            continue;
        };
        let photo = Photo::decode(&ctx.get(digest)?).map_err(|error| malformed(0, &output, &error))?;
        stops.push(Stop {
            place: Viewpoint {
                name,
                camera: sized(&frame.camera.box_reduced(scale), &photo.image),
                cam_from_world: frame.cam_from_world,
            },
            photo: Some((*digest, photo.image)),
        });
    }
    Ok(stops)
}

/// The reduced camera has the size of the reduced photo by construction; a foreign photo decides here.
fn sized(camera: &Camera, photo: &Image<Srgb>) -> Camera {
    Camera {
        width: photo.width,
        height: photo.height,
        ..*camera
    }
}

fn truth(maps: &Maps, stop: &Stop) -> Result<Option<Truth>, BootstrapError> {
    let Some((_, photo)) = &stop.photo else {
        return Ok(None);
    };
    let truth = photo
        .pixels
        .iter()
        .map(|rgb| gray(&rgb.map(|channel| f32::from(channel) / 255.0)));
    let pixels = maps.gray.iter().zip(truth);
    let psnr = psnr(&mean_picture(maps), photo).map_err(|error| BootstrapError::Picture {
        name: stop.place.name.clone(),
        cause: error.to_string(),
    })?;
    Ok(Some(Truth {
        error: pixels
            .map(|(gray, truth)| (f64::from(*gray) - truth).abs() as f32)
            .collect(),
        psnr,
    }))
}
