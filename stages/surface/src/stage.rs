use marf_cache::Digest;
use marf_field::{Field, render_in_bands};
use marf_scene::{Camera, Frame, Observer, Photo, Scene, picture::png16, picture_names};
use marf_schema::bootstrap::MemberFields;
use marf_schema::output::{DEPTH, MESH_GLB, MESH_PLY, POINTS, SCENE, SURFACE_MAPS, WEIGHTS};
use marf_schema::surface::{ColorBy, SpreadOf, SurfaceParams, SurfaceReport, UncertaintyReport};
use marf_stage::{
    Ctx, Define, Document, Inputs, Outputs, ParamError, Params, Port, Set, Stage, StageError, Threads,
    TypedOutputs, Work, key_params,
};

use crate::extract::{Surface, Wanted, extract};
use crate::frame::ExportFrame;
use crate::map::SurfaceMap;
use crate::members::{self, MemberSpread};
use crate::mesh::Witnesses;
use crate::view::SurfaceView;
use crate::{SurfaceError, glb, ply};

/// Rays with less opacity end nowhere: haze before a sky has less, ground has more.
const MIN_OPACITY: f32 = 0.9;
/// Most pixels of all views together, 30 bytes each: where the photos are many, each is looked at with fewer.
const MOST_PIXELS: u64 = 40_000_000;

/// Makes mesh, points and maps of a trained field.
#[derive(Debug)]
pub struct MakeSurface {
    params: SurfaceParams,
}

impl Define for MakeSurface {
    type Params = SurfaceParams;
    const NAME: &'static str = SurfaceParams::STAGE;
    const ABOUT: &'static str =
        "Makes a mesh (PLY, GLB), points, a height map and an orthophoto of a trained field";
    const VERSION: u32 = 3;
    const PORTS: &'static [Port] = &[
        Port::required("input", WEIGHTS),
        Port::required("input", SCENE),
        Port::optional("members", MemberFields::OUTPUT),
    ];
    const OUTPUTS: &'static [&'static str] = &[
        SurfaceReport::OUTPUT,
        MESH_PLY,
        MESH_GLB,
        POINTS,
        SURFACE_MAPS,
        DEPTH,
    ];

    fn new(params: SurfaceParams) -> Result<Self, ParamError> {
        params.check()?;
        Ok(Self { params })
    }
}

impl Stage for MakeSurface {
    fn params(&self) -> serde_json::Value {
        key_params(&self.params, &["device"])
    }

    fn work(&self) -> Work<'_> {
        Work::Set(self)
    }

    fn threads(&self) -> Threads {
        Threads::All
    }

    fn backend_id(&self) -> Option<String> {
        self.params.device.backend_id()
    }

    fn backend_id_on(&self, gpu: Option<&str>) -> Result<Option<String>, StageError> {
        self.params.device.backend_id_on(gpu).map_err(StageError::new)
    }
}

impl Set for MakeSurface {
    fn run(&self, ctx: &Ctx<'_>, inputs: &Inputs) -> Result<Outputs, StageError> {
        let scene = Scene::decode(&ctx.get(inputs.required(SCENE)?)?).map_err(SurfaceError::from)?;
        let field = self.field(ctx, inputs.required(WEIGHTS)?)?;
        let frame = ExportFrame::of(&scene);
        let mut outputs = Outputs::new();
        let views = views_of(&scene)?;
        let seen = self.look(ctx, &scene, &field, &views, &mut outputs)?;
        let photos = seen.views.len();
        ctx.progress.at(photos as u64, photos as u64, "surface");
        let mut surface =
            extract(&seen.views, &seen.observers, self.wanted(&frame)).map_err(StageError::from)?;
        drop(seen);
        ctx.check()?;
        let members = self.look_with_members(ctx, inputs, &views, &mut surface)?;
        self.write(ctx, surface, &frame, (photos, members), &mut outputs)?;
        Ok(outputs)
    }
}

/// The field at the views of the photos.
#[derive(Default)]
struct Seen {
    views: Vec<SurfaceView>,
    observers: Vec<Observer>,
}

impl MakeSurface {
    /// Returns what is asked for, in world units.
    fn wanted(&self, frame: &ExportFrame) -> Wanted {
        let in_world = |length: f64| length / frame.scale();
        Wanted {
            cell: self.params.cell.map(in_world),
            reach: self.params.reach.map(in_world),
            least_photos: self.params.least_photos,
            most_spread: self.params.most_spread.map(in_world),
        }
    }

    fn field(&self, ctx: &Ctx<'_>, weights: &Digest) -> Result<Field, StageError> {
        let field = Field::decode(&ctx.get(weights)?).and_then(|field| field.on(&self.params.device));
        Ok(field.map_err(SurfaceError::from)?)
    }

    /// Renders the field at the views of the photos that it was trained on.
    fn look(
        &self,
        ctx: &Ctx<'_>,
        scene: &Scene,
        field: &Field,
        views: &[(&Frame, String)],
        outputs: &mut Outputs,
    ) -> Result<Seen, StageError> {
        let mut seen = Seen::default();
        for (index, (frame, name)) in views.iter().enumerate() {
            let note = format!("what {name} saw");
            ctx.progress.at(index as u64, views.len() as u64, &note);
            let factor = factor(
                &frame.camera,
                self.params.side_px,
                MOST_PIXELS / views.len() as u64,
            );
            let Rendered {
                camera,
                mut distance,
                rgb,
            } = rendered(ctx, field, frame, factor)?;
            if self.params.depth {
                let png = png16::depth(camera.width, camera.height, &distance, scene.metres_per_unit)
                    .map_err(SurfaceError::from)?;
                outputs.put_bytes(ctx, format!("{DEPTH}{name}.png"), &png)?;
            }
            hide(ctx, frame, factor, &camera, &mut distance)?;
            let pose = frame.cam_from_world;
            seen.observers.push(Observer::new(camera, pose, &distance));
            seen.views.push(SurfaceView::new(camera, pose, &distance, rgb));
        }
        Ok(seen)
    }

    /// Gives the points of a surface how far the retrainings differ there, and returns how many there are. They are looked at with half
    /// as many pixels a side: their surface is as smooth as the field's.
    fn look_with_members(
        &self,
        ctx: &Ctx<'_>,
        inputs: &Inputs,
        views: &[(&Frame, String)],
        surface: &mut Surface,
    ) -> Result<u32, StageError> {
        if inputs.optional(MemberFields::OUTPUT).is_none() {
            return Ok(0);
        }
        let MemberFields(members) = inputs.read(ctx)?;
        let side_px = (self.params.side_px / 2).max(1);
        let total = (members.len() * views.len()) as u64;
        let mut spreads = [surface.mesh.vertices.len(), surface.points.len()].map(MemberSpread::new);
        for (index, weights) in (0_u64..).zip(&members) {
            let field = self.field(ctx, weights)?;
            let mut seen = Vec::with_capacity(views.len());
            for (view, (frame, name)) in (0_u64..).zip(views) {
                let note = format!("what {name} saw, by retraining {}", index + 1);
                ctx.progress.at(index * views.len() as u64 + view, total, &note);
                let factor = factor(&frame.camera, side_px, MOST_PIXELS / views.len() as u64);
                let Rendered {
                    camera,
                    mut distance,
                    rgb,
                } = rendered(ctx, &field, frame, factor)?;
                hide(ctx, frame, factor, &camera, &mut distance)?;
                seen.push(SurfaceView::new(camera, frame.cam_from_world, &distance, rgb));
            }
            let witnesses = Witnesses {
                views: &seen,
                observers: &[],
                band: surface.band,
            };
            spreads[0].add(&witnesses, &surface.mesh.vertices);
            spreads[1].add(&witnesses, &surface.points);
        }
        spreads[0].give(&mut surface.mesh.vertices);
        spreads[1].give(&mut surface.points);
        Ok(members.len() as u32)
    }

    fn write(
        &self,
        ctx: &Ctx<'_>,
        mut surface: Surface,
        frame: &ExportFrame,
        (photos, members): (usize, u32),
        outputs: &mut Outputs,
    ) -> Result<(), StageError> {
        let scale = frame.scale();
        let pixel_m = self.params.map_cell.unwrap_or(surface.cell * scale);
        // From the colours of the photos, whatever mesh and points are painted with.
        let map = SurfaceMap::draw(&surface.mesh, frame, pixel_m);
        let uncertainty = members::report(&surface.mesh.vertices, members, scale);
        if self.params.color == ColorBy::Uncertainty {
            members::paint(&mut surface.mesh.vertices, uncertainty.scale_end, scale);
            members::paint(&mut surface.points, uncertainty.scale_end, scale);
        }
        let surface = &surface;
        let comments = [
            format!("surface where the mean signed distance of {photos} views of the field is 0 (Curless and Levoy 1996)"),
            "rays end at their mean depth where the field takes more than 0.9 of their light".to_owned(),
            format!("distance between samples: {}", surface.cell * scale),
            format!("least photos: {}; largest spread: {}", self.params.least_photos, surface.most_spread * scale),
            self.color_words(&uncertainty, frame),
            "photos: those that show the vertex; spread: root mean square of the views' distances, -1 of one view".to_owned(),
        ];
        outputs.put_bytes(ctx, MESH_PLY, &ply::mesh(&surface.mesh, frame, &comments))?;
        outputs.put_bytes(ctx, POINTS, &ply::points(&surface.points, frame, &comments))?;
        let colors = self.color_words(&uncertainty, frame);
        let generator = format!("marf {}", env!("CARGO_PKG_VERSION"));
        outputs.put_bytes(
            ctx,
            MESH_GLB,
            &glb::mesh(&surface.mesh, frame, &generator, &colors),
        )?;
        let mut report = SurfaceReport {
            unit: frame.unit().to_owned(),
            photos: photos as u64,
            cell: surface.cell * scale,
            band: surface.band * scale,
            reach: surface.reach * scale,
            most_spread: surface.most_spread * scale,
            vertices: surface.mesh.vertices.len() as u64,
            triangles: surface.mesh.triangles.len() as u64,
            points: surface.points.len() as u64,
            uncertainty,
            map: None,
            refused: std::collections::BTreeMap::new(),
        };
        match map {
            Ok(map) => {
                put_maps(ctx, &map, outputs)?;
                report.map = Some(map.report);
            }
            // The mesh is worth having without a map; whoever asks for one gets the reason.
            Err(refused @ SurfaceError::Refused { .. }) => {
                report
                    .refused
                    .insert(SURFACE_MAPS.to_owned(), refused.to_string());
            }
            Err(error) => return Err(error.into()),
        }
        outputs.put(ctx, &report)
    }
}

impl MakeSurface {
    /// Returns what the colours are, in words.
    fn color_words(&self, uncertainty: &UncertaintyReport, frame: &ExportFrame) -> String {
        let of = match uncertainty.of {
            SpreadOf::Retrainings => format!("standard deviation of {} retrainings", uncertainty.members),
            SpreadOf::Views => "root mean square difference of the views of one field".to_owned(),
        };
        match self.params.color {
            ColorBy::Photos => "colours: what the field shows at the views of the photos".to_owned(),
            ColorBy::Uncertainty => format!(
                "colours: uncertainty along the normal ({of}), inferno from 0 to {} ({}), gray where not known",
                uncertainty.scale_end,
                frame.unit()
            ),
        }
    }
}

/// A field at the view of a photo.
struct Rendered {
    camera: Camera,
    /// `[height * width]`, along the ray, world units; infinite where the ray ends nowhere.
    distance: Vec<f32>,
    /// `[height * width]`, sRGB in [0, 1].
    rgb: Vec<[f32; 3]>,
}

/// Returns the photos that a field was trained on, with their names.
fn views_of(scene: &Scene) -> Result<Vec<(&Frame, String)>, StageError> {
    let named = scene.frames.iter().zip(picture_names(scene));
    let views: Vec<_> = named.filter(|(frame, _)| !frame.held_out).collect();
    match views.is_empty() {
        true => Err(SurfaceError::NoPhotos.into()),
        false => Ok(views),
    }
}

/// Renders a field at the view of a photo that is shrunk by a factor.
fn rendered(ctx: &Ctx<'_>, field: &Field, frame: &Frame, factor: u32) -> Result<Rendered, StageError> {
    let camera = frame.camera.box_reduced(factor);
    let render = render_in_bands(field, &camera, &frame.cam_from_world, |_, render| {
        ctx.check()?;
        Ok::<_, StageError>(render().map_err(SurfaceError::from)?)
    })?;
    let pixels = render.depth.iter().zip(&render.opacity);
    let distance = pixels.map(|(depth, opacity)| match *opacity > MIN_OPACITY {
        true => *depth,
        false => f32::INFINITY,
    });
    Ok(Rendered {
        camera,
        distance: distance.collect(),
        rgb: render.rgb,
    })
}

fn put_maps(ctx: &Ctx<'_>, map: &SurfaceMap, outputs: &mut Outputs) -> Result<(), StageError> {
    let pictures = [
        ("height", map.height_png()?),
        ("spread", map.spread_png()?),
        ("orthophoto", map.photo_png()?),
    ];
    let tiffs = [
        ("height", map.height_tiff()?),
        ("spread", map.spread_tiff()?),
        ("orthophoto", map.photo_tiff()?),
    ];
    for (name, tiff) in tiffs {
        outputs.put_bytes(ctx, format!("{SURFACE_MAPS}{name}.tif"), &tiff)?;
    }
    for (name, png) in pictures {
        outputs.put_bytes(ctx, format!("{SURFACE_MAPS}{name}.png"), &png)?;
        outputs.put_bytes(
            ctx,
            format!("{SURFACE_MAPS}{name}.pgw"),
            map.world_file().as_bytes(),
        )?;
    }
    Ok(())
}

/// Returns the factor by which a photo is shrunk to at most `side_px` a side and `most` pixels.
fn factor(camera: &Camera, side_px: u32, most: u64) -> u32 {
    let longest = camera.width.max(camera.height);
    let shortest = camera.width.min(camera.height).max(1);
    let mut factor = longest.div_ceil(side_px).max(1);
    while u64::from(camera.width / factor) * u64::from(camera.height / factor) > most && factor < shortest {
        factor += 1;
    }
    factor.min(shortest)
}

/// Takes away what the mask of a photo hides, if any pixel of a block is.
fn hide(
    ctx: &Ctx<'_>,
    frame: &Frame,
    factor: u32,
    camera: &Camera,
    distance: &mut [f32],
) -> Result<(), StageError> {
    let Some(mask) = &frame.mask else { return Ok(()) };
    let mask = read_mask(ctx, frame, mask)?;
    for (pixel, distance) in distance.iter_mut().enumerate() {
        let (column, row) = (pixel as u32 % camera.width, pixel as u32 / camera.width);
        let rows = row * factor..(row + 1) * factor;
        let mut block = rows.flat_map(|y| (column * factor..(column + 1) * factor).map(move |x| (x, y)));
        if block.any(|(x, y)| mask.image.at(x, y) != [255; 3]) {
            *distance = f32::NAN;
        }
    }
    Ok(())
}

fn read_mask(ctx: &Ctx<'_>, frame: &Frame, mask: &Digest) -> Result<Photo, StageError> {
    let bad = |cause: String| SurfaceError::Mask {
        id: frame.id.clone(),
        cause,
    };
    let mask = Photo::decode(&ctx.get(mask)?).map_err(|error| bad(error.to_string()))?;
    let (width, height) = (mask.image.width, mask.image.height);
    if (width, height) != (frame.camera.width, frame.camera.height) {
        return Err(bad(format!("{width} x {height} pixels, the photo has others")).into());
    }
    Ok(mask)
}
