//! `changes`: one place photographed at two times. Each time is trained separately, several times, and maps
//! of their surfaces are compared.
//!
//! Rounds of nodes:
//! 1. the first field of each time,
//! 2. its retrainings and, if no cell is given, the surfaces of the first fields,
//! 3. the surfaces of all fields with one cell.

mod cells;
mod compare;
mod drawing;
mod noise;
mod outputs;
mod patches;
mod rounds;
#[cfg(test)]
mod tests;

use std::collections::{BTreeMap, BTreeSet};

use marf_scene::{Frame, PosedPhoto, Scene, hold_out_places};
use marf_schema::changes::{ChangesParams, ChangesReport, Time};
use marf_schema::output::{CHANGE_MAPS, SCENE};
use marf_schema::train::Metrics;
use marf_stage::{
    ChildStage, Ctx, Document, Expand, Inputs, NodeSpec, Outputs, PHOTOS, Port, Sols, StageError, Threads,
    TypedOutputs, rows_of, stage,
};

use crate::SurfaceError;
use crate::frame::ExportFrame;
use cells::Grid;
use compare::Comparison;
use outputs::document;
use rounds::Rounds;

/// Fewest photos of a time. Fewer give no usable surface.
const LEAST_PHOTOS: usize = 4;
/// One photo in this many, approximately, is held out of a time without held-out photos of the whole scene.
/// The same as in `calibrate`.
const HOLD_EVERY: u32 = 8;
/// Compares a place at two times.
///
/// - In: a scene of photos of both times, and the set of photos, which gives their sols.
/// - Out: the changes, as a list of patches and as maps. Nothing is reported if one of the times shows no
///   ground.
/// - The noise is how far the trainings of a time and the views of a field differ, scaled to what the ground
///   shows: nine tenths of it are taken for unchanged. If more changed, the noise is overestimated and less
///   is found.
/// - Brightness alone is never reported as a change of the ground: a shadow does the same.
#[derive(Debug)]
pub struct FindChanges {
    params: ChangesParams,
}

stage! {
    FindChanges { params: ChangesParams },
    Expand,
    Threads::All,
    about: "trains a place at two times apart and maps what changed on the ground",
    version: 3,
    ports: [Port::required("input", SCENE), Port::required("photos", PHOTOS)],
    outputs: [ChangesReport::OUTPUT, CHANGE_MAPS],
    device: device,
}

impl Expand for FindChanges {
    fn children(&self) -> Vec<ChildStage> {
        vec![
            ChildStage::new(&rounds::training(&self.params, 0)),
            ChildStage::new(&rounds::surface(&self.params, None)),
        ]
    }

    fn expand(&self, ctx: &Ctx<'_>, inputs: &Inputs) -> Result<Vec<NodeSpec>, StageError> {
        self.rounds(ctx, inputs)?.next(ctx, &[])
    }

    fn further(&self, ctx: &Ctx<'_>, inputs: &Inputs, done: &[Outputs]) -> Result<Vec<NodeSpec>, StageError> {
        self.rounds(ctx, inputs)?.next(ctx, done)
    }

    fn reduce(&self, ctx: &Ctx<'_>, inputs: &Inputs, children: &[Outputs]) -> Result<Outputs, StageError> {
        let scene = scene(ctx, inputs)?;
        let frame = ExportFrame::new(&scene);
        let (axes, _) = frame.metric_map("the map of changes")?;
        let rounds = self.rounds(ctx, inputs)?;
        let (trained, surfaces) = rounds.results(children)?;
        let members =
            surfaces.map(|of_time| of_time.iter().map(|outputs| Grid::read(ctx, outputs)).collect());
        let [before, after]: [Result<Vec<Grid>, StageError>; 2] = members;
        let comparison = Comparison::new(&before?, &after?, &self.params)?;
        let [before, after] = self.times(ctx, inputs, &scene, trained)?;
        let report = comparison.report(&frame, &axes, [before, after]);
        let mut outputs = Outputs::new();
        for (name, png) in drawing::pictures(&comparison, &report)? {
            outputs.put_bytes(ctx, format!("{CHANGE_MAPS}{name}.png"), &png)?;
            outputs.put_bytes(
                ctx,
                format!("{CHANGE_MAPS}{name}.pgw"),
                comparison.world_file().as_bytes(),
            )?;
        }
        outputs.put(ctx, &report)?;
        Ok(outputs)
    }
}

impl FindChanges {
    fn rounds<'s>(&'s self, ctx: &Ctx<'_>, inputs: &Inputs) -> Result<Rounds<'s>, StageError> {
        let scene = scene(ctx, inputs)?;
        ExportFrame::new(&scene).metric_map("the map of changes")?;
        let sols = sols_of_photos(ctx, inputs)?;
        let scene_of = |key: &str, chosen: &Sols| -> Result<_, StageError> {
            let part = part(&scene, &sols, chosen);
            if part.frames.len() < LEAST_PHOTOS {
                return Err(too_few(key, chosen, &part, &scene, &sols));
            }
            let bytes = part.encode().map_err(SurfaceError::from)?;
            ctx.put(&bytes)
        };
        let scenes = [
            scene_of("before", &self.params.before)?,
            scene_of("after", &self.params.after)?,
        ];
        Ok(Rounds {
            params: &self.params,
            scenes,
        })
    }

    fn times(
        &self,
        ctx: &Ctx<'_>,
        inputs: &Inputs,
        scene: &Scene,
        trained: [&Outputs; 2],
    ) -> Result<[Time; 2], StageError> {
        let sols = sols_of_photos(ctx, inputs)?;
        let time = |chosen: &Sols, outputs: &Outputs| -> Result<Time, StageError> {
            let part = part(scene, &sols, chosen);
            let metrics: Metrics = document(ctx, outputs)?;
            let found: BTreeSet<u32> = part
                .frames
                .iter()
                .filter_map(|frame| sols.get(&frame.id).copied())
                .collect();
            Ok(Time {
                sols: found.into_iter().collect(),
                photos: part.frames.len(),
                psnr: metrics.scores.psnr,
                area_m2: 0.0,
            })
        };
        let [before, after] = trained;
        Ok([
            time(&self.params.before, before)?,
            time(&self.params.after, after)?,
        ])
    }
}

fn scene(ctx: &Ctx<'_>, inputs: &Inputs) -> Result<Scene, StageError> {
    Ok(Scene::decode(&ctx.get(inputs.required(SCENE)?)?).map_err(SurfaceError::from)?)
}

/// Returns the sol of each photo.
fn sols_of_photos(ctx: &Ctx<'_>, inputs: &Inputs) -> Result<BTreeMap<String, u32>, StageError> {
    let rows = rows_of(ctx, inputs.required(PHOTOS)?)?;
    Ok(rows.into_iter().map(|(sol, row)| (row.id, sol)).collect())
}

/// Returns the scene of the photos of some sols, in the same world. Where the places that are held out of the whole are all of the other time,
/// or all places of this one are, places of its own are held out.
fn part(scene: &Scene, sols: &BTreeMap<String, u32>, chosen: &Sols) -> Scene {
    let present: BTreeSet<u32> = sols.values().copied().collect();
    let chosen = chosen.choose(&present);
    let is_of = |id: &String| sols.get(id).is_some_and(|sol| chosen.contains(sol));
    let frames = scene.frames.iter().filter(|frame| is_of(&frame.id));
    let mut frames: Vec<Frame> = frames.cloned().collect();
    let held_out = frames.iter().filter(|frame| frame.held_out).count();
    if held_out == 0 || held_out == frames.len() {
        let photos: Vec<PosedPhoto<'_>> = frames.iter().map(PosedPhoto::from).collect();
        let held_out = hold_out_places(&photos, &scene.points, HOLD_EVERY);
        for (frame, held_out) in frames.iter_mut().zip(held_out) {
            frame.held_out = held_out;
        }
    }
    Scene {
        frames,
        unplaced: Vec::new(),
        ..scene.clone()
    }
}

fn too_few(
    key: &str,
    chosen: &Sols,
    part: &Scene,
    scene: &Scene,
    sols: &BTreeMap<String, u32>,
) -> StageError {
    let placed: BTreeSet<u32> = scene
        .frames
        .iter()
        .filter_map(|frame| sols.get(&frame.id).copied())
        .collect();
    let placed: Vec<String> = placed.iter().map(u32::to_string).collect();
    StageError::new(format!(
        "{key} = \"{chosen}\": {} photos of these sols have a camera, a surface needs {LEAST_PHOTOS}",
        part.frames.len()
    ))
    .hint(format!("sols with placed photos: {}", placed.join(", ")))
}
