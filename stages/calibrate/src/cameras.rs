//! `cameras`: a calibrated scene as a folder that other programs read unchanged.

use std::collections::{BTreeMap, BTreeSet};

use marf_cache::{Digest, manifest::Row};
use marf_scene::{Camera, Frame, Photo, Scene, encode_png};
use marf_schema::cameras::CamerasParams;
use marf_schema::output::{CAMERAS, MASKS, POINTS, SCENE, SPARSE, SPARSE_IMAGES, SPARSE_POINTS};
use marf_stage::{
    Ctx, Inputs, Outputs, PHOTOS, Port, Set, StageError, Threads, TypedOutputs, rows_of, stage,
};
use nalgebra::Vector2;
use rayon::prelude::*;

use crate::export::{Tracks, write_colmap, write_colmap_text, write_ply, write_transforms};
use crate::import::{Distortion, Undistorter, read_tracks};
use crate::mask_files::blackened;
use crate::photos::{as_png, with_other_grid};

/// Writes a calibrated scene as a folder: photos, masks, transforms.json, COLMAP's model as binary and text, points.
///
/// - In: the scene, and COLMAP's model of it for the observations. With `photos_at`, also the set of photos in that folder.
/// - Out: `cameras/transforms.json` and the files it names, `cameras/masks/<photo>.png` of each photo with a mask, as COLMAP and nerfstudio
///   read them, `cameras/sparse/0/*.bin` and `*.txt`, and `cameras/points.ply`. Photos are named in `photos_at` if all of them are there.
///   Otherwise all are in `cameras/`.
/// - Cost: without `undistort` no photo is decoded or stored twice. With it each photo with a lens is decoded, resampled (bicubic, as for
///   labels) and encoded as PNG: about 0.4 s a megapixel and core.
/// - Bad input: a lens without inverse at the rim of its photo stops the node with the photo's name.
#[derive(Debug)]
pub struct ExportCameras(CamerasParams);

stage! {
    ExportCameras { 0: CamerasParams },
    Set,
    Threads::All,
    about: "writes cameras and photos as a folder for nerfstudio, instant-ngp and COLMAP, optionally undistorted",
    version: 4,
    ports: [
        Port::required("input", SCENE),
        Port::required("input", SPARSE_IMAGES),
        Port::required("input", SPARSE_POINTS),
        Port::optional("photos", PHOTOS),
    ],
    outputs: [CAMERAS],
}

impl Set for ExportCameras {
    fn run(&self, ctx: &Ctx<'_>, inputs: &Inputs) -> Result<Outputs, StageError> {
        let scene = Scene::decode(&ctx.get(inputs.required(SCENE)?)?).map_err(|error| failed(&error))?;
        let images = ctx.get(inputs.required(SPARSE_IMAGES)?)?;
        let points = ctx.get(inputs.required(SPARSE_POINTS)?)?;
        let tracks = read_tracks(&scene, [SPARSE_IMAGES, SPARSE_POINTS], &images, &points);
        let tracks = tracks.map_err(|error| failed(&error))?;
        let (scene, tracks) = if self.0.undistort {
            undistorted(ctx, &scene, tracks)?
        } else {
            (scene, tracks)
        };
        let there = self.photos_there(ctx, inputs, &scene)?;
        let mut outputs = Outputs::new();
        put_pictures(&scene, there, &mut outputs)?;
        let path_of = |frame: &Frame| match there {
            Some(folder) => format!("{folder}/{}", frame.file),
            None => frame.file.clone(),
        };
        let mask_of = |frame: &Frame| frame.mask.map(|_| mask_name(frame));
        let mut put = |name: String, bytes: &[u8]| outputs.put_bytes(ctx, CAMERAS.to_owned() + &name, bytes);
        let transforms = write_transforms(&scene, &path_of, &mask_of);
        put("transforms.json".to_owned(), transforms.as_bytes())?;
        put(POINTS.to_owned(), &write_ply(&tracks))?;
        for (name, bytes) in write_colmap(&scene, &tracks) {
            put(format!("{SPARSE}0/{name}"), &bytes)?;
        }
        for (name, text) in write_colmap_text(&scene, &tracks) {
            put(format!("{SPARSE}0/{name}"), text.as_bytes())?;
        }
        Ok(outputs)
    }
}

impl ExportCameras {
    /// Returns the folder `photos_at` if it has all photos of a scene with these very bytes.
    fn photos_there(
        &self,
        ctx: &Ctx<'_>,
        inputs: &Inputs,
        scene: &Scene,
    ) -> Result<Option<&str>, StageError> {
        let (folder, set) = match (&self.0.photos_at, inputs.optional(PHOTOS)) {
            (None, _) => return Ok(None),
            (Some(folder), Some(set)) => (folder, set),
            (Some(folder), None) => {
                let error = StageError::new(format!("the photos in `photos_at` ({folder}) are not known"));
                return Err(error.hint("name the node that read them: `photos = \"extract\"`"));
            }
        };
        let rows = rows_of(ctx, set)?;
        // A photo developed from raw numbers or from a mosaic has no file.
        let is_file = |row: &&Row| !row.blobs.contains_key("raw");
        let images: BTreeMap<&str, Option<&Digest>> = rows
            .iter()
            .map(|(_, row)| row)
            .filter(is_file)
            .map(|row| (row.id.as_str(), row.blobs.get("image")))
            .collect();
        let is_there = |frame: &Frame| images.get(frame.id.as_str()) == Some(&Some(&frame.image));
        Ok(scene.frames.iter().all(is_there).then_some(folder))
    }
}

/// Returns the name of a photo's mask: that of the photo with `.png` behind it, in `masks/`, as COLMAP's `mask_path` has it.
fn mask_name(frame: &Frame) -> String {
    format!("{MASKS}{}.png", frame.file)
}

fn failed(error: &dyn std::fmt::Display) -> StageError {
    StageError::new(error.to_string())
}

/// Lists each mask, and each photo unless all are elsewhere, under the name that transforms.json names.
fn put_pictures(scene: &Scene, there: Option<&str>, outputs: &mut Outputs) -> Result<(), StageError> {
    let mut known = BTreeSet::new();
    for frame in &scene.frames {
        let is_plain = frame.file.split('/').all(|part| !matches!(part, "" | "." | ".."));
        if !is_plain || !known.insert(&frame.file) {
            return Err(StageError::new(format!(
                "the photo `{}` cannot be written as `{}`: the name leads out of the folder, or another photo has it",
                frame.id, frame.file
            ))
            .hint("rename one of the photos"));
        }
        if there.is_none() {
            outputs.insert(format!("{CAMERAS}{}", frame.file), frame.image);
        }
        if let Some(mask) = frame.mask {
            outputs.insert(format!("{CAMERAS}{}", mask_name(frame)), mask);
        }
    }
    Ok(())
}

/// Returns the scene and the observations with ideal pinholes, and stores the photos that these would have taken.
fn undistorted(ctx: &Ctx<'_>, scene: &Scene, mut tracks: Tracks) -> Result<(Scene, Tracks), StageError> {
    let total = scene.frames.len() as u64;
    let done = std::sync::atomic::AtomicU64::new(0);
    let frame = |frame: &Frame| {
        let straight = straight_frame(ctx, frame);
        let done = 1 + done.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
        ctx.progress.at(done, total, &frame.file);
        straight
    };
    let frames: Result<Vec<Frame>, StageError> = scene.frames.par_iter().map(frame).collect();
    let straight = Scene {
        frames: frames?,
        ..scene.clone()
    };
    for point in &mut tracks.points {
        point.observations.retain_mut(|observation| {
            let index = observation.frame as usize;
            let moved = moved(&scene.frames[index], &straight.frames[index], &observation.pixel);
            observation.pixel = moved.unwrap_or(observation.pixel);
            moved.is_some()
        });
    }
    tracks.measure(&straight);
    Ok((straight, tracks))
}

/// Returns the pixel of an observation in the undistorted photo, or `None` outside it.
fn moved(frame: &Frame, straight: &Frame, pixel: &[f64; 2]) -> Option<[f64; 2]> {
    let at = straight
        .camera
        .project(&frame.camera.unproject(&Vector2::from(*pixel))?)?;
    let inside = |x: f64, side: u32| (0.0..=f64::from(side)).contains(&x);
    let is_inside = inside(at.x, straight.camera.width) && inside(at.y, straight.camera.height);
    is_inside.then(|| at.into())
}

/// Returns a frame with an ideal pinhole. A photo without distortion is unchanged.
fn straight_frame(ctx: &Ctx<'_>, frame: &Frame) -> Result<Frame, StageError> {
    ctx.check()?;
    let named = |what: String| StageError::new(format!("photo `{}`: {what}", frame.id));
    let refused = |problem: String| {
        named(problem).hint("export without `undistort`: the lens is in transforms.json then")
    };
    let Camera { k1, k2, p1, p2, .. } = frame.camera;
    let lens = [k1, k2, p1, p2];
    if lens == [0.0; 4] {
        return Ok(frame.clone());
    }
    let plain = Camera {
        k1: 0.0,
        k2: 0.0,
        p1: 0.0,
        p2: 0.0,
        ..frame.camera
    };
    let undistorter = Undistorter::new(plain, Distortion::Brown(lens)).map_err(refused)?;
    let photo = Photo::decode_validated(&ctx.get(&frame.image)?).map_err(|error| named(error.to_string()))?;
    let size = (photo.image.width, photo.image.height);
    if size != (frame.camera.width, frame.camera.height) {
        return Err(named(format!(
            "{} x {} pixels, its camera has others",
            size.0, size.1
        )));
    }
    let straight = with_other_grid(photo, |pixels| undistorter.resample(pixels, ctx.cancel));
    let straight = straight.map_err(|pixel| match pixel {
        Some(at) => refused(format!("its lens does not show ({}, {})", at.x, at.y)),
        None => StageError::Cancelled,
    })?;
    let png = straight.to_png().map_err(|error| named(error.to_string()))?;
    let digest: Digest = ctx.put(&png)?;
    Ok(Frame {
        file: as_png(&frame.file),
        image: digest,
        mask: straight_mask(ctx, frame, &undistorter)?,
        camera: undistorter.pinhole,
        error_px: None,
        ..frame.clone()
    })
}

/// Returns the mask of a frame as the pinhole has it, black where a part of it is.
fn straight_mask(
    ctx: &Ctx<'_>,
    frame: &Frame,
    undistorter: &Undistorter,
) -> Result<Option<Digest>, StageError> {
    let Some(mask) = frame.mask else {
        return Ok(None);
    };
    let named = |what: String| StageError::new(format!("the mask of photo `{}`: {what}", frame.id));
    let mask = Photo::decode(&ctx.get(&mask)?).map_err(|error| named(error.to_string()))?;
    let straight = undistorter.resample(&mask.image, ctx.cancel);
    let mut straight = straight.map_err(|_| StageError::Cancelled)?;
    blackened(&mut straight);
    let png = encode_png(&straight).map_err(|error| named(error.to_string()))?;
    Ok(Some(ctx.put(&png)?))
}
