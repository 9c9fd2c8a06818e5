use marf_cache::ContentHash;
use marf_field::{Device, Field, render_in_bands};
use marf_scene::{
    Camera, Image, Pose, Scene, Srgb,
    path::{self, Viewpoint},
    picture::{ColorScale, Palette, draw_map, encode_gif, round_upper_limit},
};
use marf_stage::{Ctx, Define, Inputs, Outputs, ParamError, Port, Set, Stage, StageError, Threads, Work};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::{
    TrainError,
    error::field_failed,
    judge::{outputs, put_json, put_png},
    split::named,
    train::read_scene,
};

/// Where the camera goes.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema, ContentHash)]
#[serde(rename_all = "snake_case")]
pub enum PathKind {
    /// A smooth path through training cameras that lie far apart.
    #[default]
    Flythrough,
    /// To the photos held out.
    Heldout,
    /// To the photos trained on.
    Train,
    /// Around the point the cameras look at.
    Orbit,
}

/// Parameters of `render`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema, ContentHash)]
#[serde(default, deny_unknown_fields)]
pub struct RenderParams {
    /// Where the camera goes.
    pub path: PathKind,
    /// Pictures along the path; for `heldout` and `train` at most so many.
    pub frames: u32,
    /// Width of a picture, pixels; the height follows from the photos.
    pub width: u32,
    /// Pictures a second of the animation.
    pub fps: u32,
    /// Whether pictures of the depth are made too.
    pub depth: bool,
    /// Which processor trains and renders: `auto` (a GPU where there is one, never a software adapter), `cpu`, `gpu`,
    /// or `gpu:NAME` for the adapter whose name holds NAME. Only what was opened is in the key.
    #[content_hash(skip)]
    pub device: Device,
}

impl Default for RenderParams {
    fn default() -> Self {
        Self {
            path: PathKind::Flythrough,
            frames: 48,
            width: 320,
            fps: 12,
            depth: false,
            device: Device::default(),
        }
    }
}

/// Largest picture and longest animation; beyond it a number is a slip.
const MAX_WIDTH_PX: u32 = 4096;
const MAX_FRAMES: u32 = 10_000;
/// Rays that met less matter than this have no depth.
const SEEN: f32 = 0.5;

/// Renders a trained field along a path.
#[derive(Debug)]
pub struct Render {
    params: RenderParams,
}

/// An entry of the output `poses`.
#[derive(Debug, Serialize)]
struct Place<'a> {
    name: &'a str,
    camera: Camera,
    cam_from_world: Pose,
}

impl Define for Render {
    type Params = RenderParams;
    const NAME: &'static str = "render";
    const ABOUT: &'static str = "Renders a trained field along a path: pictures and an animation";
    const VERSION: u32 = 3;
    const PORTS: &'static [Port] = &[
        Port::required("input", "weights"),
        Port::required("input", "scene"),
    ];
    const OUTPUTS: &'static [&'static str] = &["video", "poses", "frames/", "depth/"];

    fn new(params: RenderParams) -> Result<Self, ParamError> {
        let within = |key: &str, value: u32, most: u32| match value {
            0 => Err(ParamError::new(key, "0 makes no picture; at least 1")),
            _ if value > most => Err(ParamError::new(key, format!("{value} is more than {most}"))),
            _ => Ok(()),
        };
        within("frames", params.frames, MAX_FRAMES)?;
        within("width", params.width, MAX_WIDTH_PX)?;
        within("fps", params.fps, 100)?;
        Ok(Self { params })
    }
}

impl Stage for Render {
    fn params(&self) -> &dyn ContentHash {
        &self.params
    }

    fn work(&self) -> Work<'_> {
        Work::Set(self)
    }

    fn threads(&self) -> Threads {
        Threads::All
    }

    fn backend_id(&self) -> Option<String> {
        self.params.device.class()
    }
}

impl Set for Render {
    fn run(&self, ctx: &Ctx<'_>, inputs: &Inputs) -> Result<Outputs, StageError> {
        let scene = read_scene(ctx, inputs.required("scene")?)?;
        let field = Field::decode(&ctx.get(inputs.required("weights")?)?);
        let field = field
            .and_then(|field| field.on(&self.params.device))
            .map_err(TrainError::from)?;
        let path = viewpoints(&scene, &self.params)?;
        let mut outputs = outputs([("poses", put_json(ctx, &places(&path))?)]);
        let (mut pictures, mut depths) = (Vec::new(), Vec::new());
        for (index, place) in path.iter().enumerate() {
            let note = format!("picture {}", place.name);
            ctx.progress.at(index as u64, path.len() as u64, &note);
            let (camera, pose) = (&place.camera, &place.cam_from_world);
            let render = render_in_bands(&field, camera, pose, || ctx.check(), field_failed)?;
            let picture = render.to_image();
            outputs.insert(format!("frames/{:04}.png", index + 1), put_png(ctx, &picture)?);
            if self.params.depth {
                depths.push(seen_depth(&render));
            }
            pictures.push(picture);
        }
        put_depths(ctx, &scene, &path, &depths, &mut outputs)?;
        outputs.insert("video".to_owned(), ctx.put(&video(&pictures, self.params.fps)?)?);
        Ok(outputs)
    }
}

fn viewpoints(scene: &Scene, params: &RenderParams) -> Result<Vec<Viewpoint>, TrainError> {
    let photos = |held_out: bool| {
        let frames = named(scene).into_iter();
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
    if path.is_empty() {
        return Err(TrainError::NoPath { path: name });
    }
    Ok(path)
}

fn places(path: &[Viewpoint]) -> Vec<Place<'_>> {
    let place = |place: &'_ Viewpoint| (place.camera, place.cam_from_world);
    path.iter()
        .map(|viewpoint| {
            let (camera, cam_from_world) = place(viewpoint);
            Place {
                name: &viewpoint.name,
                camera,
                cam_from_world,
            }
        })
        .collect()
}

/// All pictures in the size of the first: photos of one scene may differ in shape.
fn video(pictures: &[Image<Srgb>], fps: u32) -> Result<Vec<u8>, StageError> {
    let Some(first) = pictures.first() else {
        return Err(StageError::new("no picture to animate"));
    };
    let fitted: Vec<Image<Srgb>> = pictures
        .iter()
        .map(|picture| {
            Image::from_fn(first.width, first.height, |column, row| {
                let inside = column < picture.width && row < picture.height;
                if inside { picture.at(column, row) } else { [0; 3] }
            })
        })
        .collect();
    encode_gif(&fitted, fps).map_err(|error| StageError::new(error.to_string()))
}

/// Depth along the ray, -1 where nothing was met.
fn seen_depth(render: &marf_field::Render) -> Vec<f32> {
    let pixels = render.depth.iter().zip(&render.opacity);
    pixels
        .map(|(depth, opacity)| if *opacity > SEEN { *depth } else { -1.0 })
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
        let map = draw_map(depth, place.camera.width, place.camera.height, &scale);
        outputs.insert(format!("depth/{:04}.png", index + 1), put_png(ctx, &map)?);
    }
    Ok(())
}
