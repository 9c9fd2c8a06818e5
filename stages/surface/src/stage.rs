//! The stage `surface`: looks at a field, extracts its surface, hands it to those that write it.

use marf_cache::Digest;
use marf_field::Field;
use marf_scene::{Frame, Observer, Scene, picture::png16, picture_names, seen_at};
use marf_schema::bootstrap::MemberFields;
use marf_schema::output::{DEPTH, MESH_GLB, MESH_PLY, POINTS, SCENE, SPLAT_FILES, SURFACE_MAPS, WEIGHTS};
use marf_schema::surface::{SurfaceParams, SurfaceReport};
use marf_schema::train;
use marf_stage::{Ctx, Document, Inputs, Outputs, Port, Set, StageError, Threads, TypedOutputs, stage};

use crate::SurfaceError;
use crate::extract::{Surface, SurfaceLimits, extract};
use crate::frame::ExportFrame;
use crate::look::{FieldViews, RenderedView, factor, hide, rendered};
use crate::members::MemberSpread;
use crate::mesh::Witnesses;
use crate::splats::stage::{HeldOutView, SplatSet};
use crate::view::{PlaneRules, SurfaceView};
use crate::write::{SurfaceResult, write};

/// Most pixels of all views together, 30 bytes each: where the photos are many, each is looked at with fewer.
const MOST_PIXELS: u64 = 40_000_000;

/// Makes mesh, points, maps and splats of a trained field.
#[derive(Debug)]
pub struct MakeSurface {
    params: SurfaceParams,
}

stage! {
    MakeSurface { params: SurfaceParams },
    Set,
    Threads::All,
    about: "makes a mesh (PLY, GLB), points, splats, a height map and an orthophoto of a trained field",
    version: 7,
    ports: [
        Port::required("input", WEIGHTS),
        Port::required("input", train::Metrics::OUTPUT),
        Port::required("input", SCENE),
        Port::optional("members", MemberFields::OUTPUT),
    ],
    outputs: [
        SurfaceReport::OUTPUT,
        MESH_PLY,
        MESH_GLB,
        POINTS,
        SURFACE_MAPS,
        DEPTH,
        SPLAT_FILES,
    ],
    device: device,
}

impl Set for MakeSurface {
    fn run(&self, ctx: &Ctx<'_>, inputs: &Inputs) -> Result<Outputs, StageError> {
        let scene = Scene::decode(&ctx.get(inputs.required(SCENE)?)?).map_err(SurfaceError::from)?;
        let field = self.field(ctx, inputs.required(WEIGHTS)?)?;
        let frame = ExportFrame::new(&scene);
        let mut outputs = Outputs::new();
        let (views, held_out) = views_of(&scene, &inputs.read(ctx)?)?;
        let limits = self.limits(&frame);
        let seen = self.look(ctx, &scene, &field, &views, &mut outputs)?;
        let (photos, shrunk) = (seen.views.len(), seen.shrunk());
        ctx.progress.at(photos as u64, photos as u64, "surface");
        let mut surface =
            extract(&seen.views, &seen.observers, limits, ctx.cancel).map_err(StageError::from)?;
        ctx.check()?;
        let mut splats = None;
        if self.params.splats {
            let held_out = self.look_at_held_out(ctx, &field, &held_out, &seen.observers)?;
            let set = SplatSet::new(ctx, &seen, &limits)?;
            splats = Some(set.write(ctx, &seen, &held_out, &frame, &mut outputs)?);
        }
        drop(seen);
        let members = self.look_with_members(ctx, inputs, &views, &mut surface)?;
        let made = SurfaceResult {
            surface,
            photos,
            shrunk,
            members,
            splats,
        };
        write(ctx, &self.params, made, &frame, &mut outputs)?;
        Ok(outputs)
    }
}

impl MakeSurface {
    /// Returns the limits of the parameters, in world units.
    fn limits(&self, frame: &ExportFrame) -> SurfaceLimits {
        let in_world = |length: f64| length / frame.scale();
        SurfaceLimits {
            cell: self.params.cell.map(in_world),
            reach: self.params.reach.map(in_world),
            least_photos: self.params.least_photos,
            most_spread: self.params.most_spread.map(in_world),
        }
    }

    fn field(&self, ctx: &Ctx<'_>, weights: &Digest) -> Result<Field, StageError> {
        let field = Field::decode(&ctx.get(weights)?)
            .and_then(|field| field.with_backend(marf_field_gpu::open(&self.params.device)?));
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
    ) -> Result<FieldViews, StageError> {
        let mut seen = FieldViews::default();
        for (index, (frame, name)) in views.iter().enumerate() {
            let note = format!("what {name} saw");
            ctx.progress.at(index as u64, views.len() as u64, &note);
            let factor = factor(
                &frame.camera,
                self.params.side_px,
                MOST_PIXELS / views.len() as u64,
            );
            seen.factors.push(factor);
            let mut shown = rendered(ctx, field, frame, factor)?;
            if self.params.depth {
                let (width, height) = (shown.camera.width, shown.camera.height);
                let png = png16::depth(width, height, &shown.distance, scene.metres_per_unit)
                    .map_err(SurfaceError::from)?;
                outputs.put_bytes(ctx, format!("{DEPTH}{name}.png"), &png)?;
            }
            hide(ctx, frame, factor, &mut shown)?;
            seen.opacities.push(shown.shown());
            let pose = frame.cam_from_world;
            let RenderedView {
                camera,
                distance,
                rgb,
                ..
            } = shown;
            seen.observers.push(Observer::new(camera, pose, &distance));
            if self.params.splats {
                let rules = PlaneRules::SHOWN;
                let view = SurfaceView::with_rules(camera, pose, &distance, rgb.clone(), &rules);
                seen.shown.push(view);
            }
            seen.views.push(SurfaceView::new(camera, pose, &distance, rgb));
            if self.params.splats {
                seen.distances.push(distance);
            }
        }
        Ok(seen)
    }

    /// Renders the field at the views of photos that it was not trained on.
    fn look_at_held_out(
        &self,
        ctx: &Ctx<'_>,
        field: &Field,
        views: &[(&Frame, String)],
        observers: &[Observer],
    ) -> Result<Vec<HeldOutView>, StageError> {
        let shown = views.iter().enumerate().map(|(index, (frame, name))| {
            let note = format!("what {name} would have seen");
            ctx.progress.at(index as u64, views.len() as u64, &note);
            let factor = factor(&frame.camera, self.params.side_px, MOST_PIXELS);
            let mut shown = rendered(ctx, field, frame, factor)?;
            hide(ctx, frame, factor, &mut shown)?;
            Ok(HeldOutView {
                name: name.clone(),
                camera: shown.camera,
                cam_from_world: frame.cam_from_world,
                opacity: shown.shown(),
                seen_opacity: shown.shown_where(&frame.cam_from_world, |point| {
                    seen_at(observers, point, None).photos > 0
                }),
                rgb: shown.rgb,
            })
        });
        shown.collect()
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
                let mut shown = rendered(ctx, &field, frame, factor)?;
                hide(ctx, frame, factor, &mut shown)?;
                let RenderedView {
                    camera,
                    distance,
                    rgb,
                    ..
                } = shown;
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
}

/// Photos with their names.
type Named<'a> = Vec<(&'a Frame, String)>;

/// Returns the photos that a field was trained on, and those that the scene holds out.
fn views_of<'a>(scene: &'a Scene, trained: &train::Metrics) -> Result<(Named<'a>, Named<'a>), StageError> {
    let named = scene.frames.iter().zip(picture_names(scene));
    let is_trained_on = |frame: &Frame| match &trained.drawn {
        Some(drawn) => drawn.contains(&frame.id),
        None => !frame.held_out,
    };
    let (views, others): (Vec<_>, Vec<_>) = named.partition(|(frame, _)| is_trained_on(frame));
    if views.is_empty() {
        return Err(SurfaceError::NoPhotos.into());
    }
    let held_out = others.into_iter().filter(|(frame, _)| frame.held_out);
    Ok((views, held_out.collect()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use marf_scene::{Camera, Pose};

    #[test]
    fn photos_that_a_training_did_not_draw_are_not_looked_at() {
        let frame = |(index, id): (usize, &str)| Frame {
            id: id.to_owned(),
            file: format!("{id}.png"),
            image: Digest::from_content(b""),
            camera: Camera::pinhole(8, 8, 8.0),
            cam_from_world: Pose::identity(),
            held_out: index % 2 == 1,
            mask: None,
            error_px: None,
        };
        let scene = Scene {
            frames: ["a", "b", "c", "d"].into_iter().enumerate().map(frame).collect(),
            ..Scene::default()
        };
        let ids = |drawn: Option<&[&str]>| {
            let trained = train::Metrics {
                drawn: drawn.map(|ids| ids.iter().map(|id| (*id).to_owned()).collect()),
                ..marf_schema::example::train_metrics()
            };
            let (views, held_out) = views_of(&scene, &trained).unwrap();
            [views, held_out].map(|named| {
                named
                    .iter()
                    .map(|(frame, _)| frame.id.as_str())
                    .collect::<String>()
            })
        };
        assert_eq!(ids(None), ["ac", "bd"]);
        assert_eq!(ids(Some(&["c", "c"])), ["c", "bd"]);
        assert_eq!(
            ids(Some(&["a", "b"])),
            ["ab", "d"],
            "a fold trains on what the scene holds out"
        );
    }
}
