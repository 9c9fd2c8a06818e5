use marf_cache::{Digest, digest_of};
use marf_field::{Field, Render as Rendered};
use marf_scene::{
    Scene,
    path::{self, Viewpoint},
    picture::{ColorScale, Palette, draw_map, round_upper_limit},
};
use marf_schema::{
    output::{DEPTH, FRAMES, SCENE, WEIGHTS},
    render::{PathKind, Place, Poses, RenderParams},
    video::Film,
};
use marf_stage::{
    Ctx, Define, Document, Inputs, Outputs, ParamError, Params, Port, Set, StageError, TypedOutputs,
};

use crate::{
    TrainError,
    checkpoint::{Journal, identity},
    io::{put_png, read_field, read_scene},
    split::named_frames,
    stage_on_device,
    view::{floats, render_view},
};

/// Rays with less opacity have no depth.
const MIN_OPACITY: f32 = 0.5;

/// Renders a trained field along a path.
#[derive(Debug)]
pub struct Render {
    params: RenderParams,
}

impl Define for Render {
    type Params = RenderParams;
    const NAME: &'static str = RenderParams::STAGE;
    const ABOUT: &'static str = "Renders a trained field along a path: the pictures of a film";
    const VERSION: u32 = 5;
    const PORTS: &'static [Port] = &[Port::required("input", WEIGHTS), Port::required("input", SCENE)];
    const OUTPUTS: &'static [&'static str] = &[Film::OUTPUT, Poses::OUTPUT, FRAMES, DEPTH];

    fn new(params: RenderParams) -> Result<Self, ParamError> {
        params.check()?;
        Ok(Self { params })
    }
}

stage_on_device!(Render, Set);

impl Set for Render {
    fn run(&self, ctx: &Ctx<'_>, inputs: &Inputs) -> Result<Outputs, StageError> {
        let scene = read_scene(ctx, inputs)?;
        let field = read_field(ctx, inputs, &self.params.device)?;
        let path = viewpoints(&scene, &self.params)?;
        let mut outputs = Outputs::new();
        outputs.put(ctx, &Poses(places(&path)))?;
        let of = identity(self, inputs, "");
        let mut journal = Journal::new(ctx, "pictures", of);
        let (mut film, mut depths) = (Film::default(), Vec::new());
        for (index, place) in path.iter().enumerate() {
            let note = format!("picture {}", place.name);
            ctx.progress.at(index as u64, path.len() as u64, &note);
            let rendered = journal.piece(
                |bytes| PathPicture::unpack(ctx, bytes),
                || {
                    let of = digest_of(&(of, index as u64));
                    let picture = PathPicture::new(ctx, of, &field, place, self.params.depth)?;
                    let bytes = picture.pack();
                    Ok((picture, bytes))
                },
            )?;
            outputs.insert(format!("{FRAMES}{:04}.png", index + 1), rendered.png);
            film.0.push(rendered.png);
            if self.params.depth {
                depths.push(rendered.depth);
            }
        }
        journal.end();
        put_depths(ctx, &scene, &path, &depths, &mut outputs)?;
        outputs.put(ctx, &film)?;
        Ok(outputs)
    }
}

/// A rendered picture of the path.
struct PathPicture {
    png: Digest,
    /// Depth along every ray, -1 where the ray met too little; empty where it is not asked for.
    depth: Vec<f32>,
}

impl PathPicture {
    /// Renders the picture and stores it as PNG.
    fn new(
        ctx: &Ctx<'_>,
        of: Digest,
        field: &Field,
        place: &Viewpoint,
        with_depth: bool,
    ) -> Result<Self, StageError> {
        let render = render_view(ctx, of, field, &place.camera, &place.cam_from_world)?;
        Ok(Self {
            png: put_png(ctx, &mut Outputs::new(), place.name.clone(), &render.to_image())?,
            depth: if with_depth { depth_of(&render) } else { Vec::new() },
        })
    }

    /// Digest of the PNG, depths as f32 LE.
    fn pack(&self) -> Vec<u8> {
        let depth = self.depth.iter().flat_map(|depth| depth.to_le_bytes());
        self.png.as_bytes().iter().copied().chain(depth).collect()
    }

    /// Reads what [`PathPicture::pack`] wrote; none if its PNG is not stored any more.
    fn unpack(ctx: &Ctx<'_>, bytes: &[u8]) -> Option<Self> {
        let (png, depth) = bytes.split_first_chunk::<32>()?;
        let png = Digest::from_bytes(*png);
        let depth = floats(depth)?;
        ctx.blobs.contains(&png).then_some(Self { png, depth })
    }
}

/// Returns the cameras along the path.
fn viewpoints(scene: &Scene, params: &RenderParams) -> Result<Vec<Viewpoint>, TrainError> {
    let photos = |held_out: bool| {
        let frames = named_frames(scene).into_iter();
        let chosen = frames.filter(move |named| named.frame.held_out == held_out);
        let first = chosen.take(params.frames as usize);
        path::viewpoints_at(first.map(|named| (named.frame, named.name)), params.width)
    };
    let (name, path) = match params.path {
        PathKind::Flythrough => ("flythrough", path::flythrough(scene, params.frames, params.width)),
        PathKind::Heldout => ("heldout", photos(true)),
        PathKind::Train => ("train", photos(false)),
        PathKind::Orbit => ("orbit", path::orbit(scene, params.frames, params.width)),
    };
    let Some(first) = path.first() else {
        return Err(TrainError::NoPath { path: name });
    };
    if matches!(params.path, PathKind::Flythrough | PathKind::Orbit) {
        // These are made for films: what no video can hold is refused before the first picture.
        marf_video::check_size(first.camera.width, first.camera.height)?;
    }
    Ok(path)
}

/// Returns the cameras as they are written.
fn places(path: &[Viewpoint]) -> Vec<Place> {
    path.iter()
        .map(|viewpoint| Place {
            name: viewpoint.name.clone(),
            camera: viewpoint.camera,
            cam_from_world: viewpoint.cam_from_world,
        })
        .collect()
}

/// Returns the depth along every ray, -1 where the ray met too little.
fn depth_of(render: &Rendered) -> Vec<f32> {
    let pixels = render.depth.iter().zip(&render.opacity);
    pixels
        .map(|(depth, opacity)| if *opacity > MIN_OPACITY { *depth } else { -1.0 })
        .collect()
}

/// Draws all depths on one scale, in metres where the scene knows them.
fn put_depths(
    ctx: &Ctx<'_>,
    scene: &Scene,
    path: &[Viewpoint],
    depths: &[Vec<f32>],
    outputs: &mut Outputs,
) -> Result<(), StageError> {
    let metres = scene.metres_per_unit.unwrap_or(1.0) as f32;
    let in_metres = |depth: &f32| if *depth < 0.0 { -1.0 } else { depth * metres };
    let depths: Vec<Vec<f32>> = depths
        .iter()
        .map(|depth| depth.iter().map(in_metres).collect())
        .collect();
    let scale = ColorScale {
        title: "depth".to_owned(),
        unit: if scene.metres_per_unit.is_some() {
            "m"
        } else {
            "scene units"
        }
        .to_owned(),
        low: 0.0,
        high: round_upper_limit(&depths.concat(), 0.99),
        palette: Palette::Viridis,
    };
    for (index, (depth, place)) in depths.iter().zip(path).enumerate() {
        ctx.check()?;
        let map = draw_map(depth, place.camera.width, place.camera.height, &scale);
        put_png(ctx, outputs, format!("{DEPTH}{:04}.png", index + 1), &map)?;
    }
    Ok(())
}
