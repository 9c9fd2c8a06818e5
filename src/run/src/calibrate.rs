//! Finds the cameras of a folder's photos, and writes them for other programs.

use std::path::{Path, PathBuf};

use marf_cache::{Digest, Store};
use marf_engine::RunRecord;
use marf_scene::Scene;
use marf_schema::calibrate::{CalibrateParams, Metrics};
use marf_schema::cameras::CamerasParams;
use marf_stage::{Document, Params};

use crate::context::Context;
use crate::error::{Diagnostic, Error};
use crate::execute::{execute, options};
use crate::export::cameras;
use crate::folder::{self, PhotoFolder};
use crate::session::{Session, digest, node_named, read_scene};
use crate::{copies, files, outputs};

/// A folder whose cameras are wanted.
#[derive(Debug, Clone)]
pub struct CalibrateRequest {
    /// The folder, or a transforms.json.
    pub dir: PathBuf,
    /// transforms.json to write. Models, metrics, points and resampled photos go next to it.
    pub out: PathBuf,
    /// Whether photos are written without the distortion of their lens.
    pub undistort: bool,
    /// Where cameras come from, as pipeline.toml names it.
    pub method: String,
}

/// The cameras of a folder's photos.
#[derive(Debug, Clone)]
pub struct CalibrateResult {
    /// How well they fit.
    pub metrics: Metrics,
    /// The cameras and points.
    pub scene: Scene,
    /// The files, photos aside.
    pub written: Vec<PathBuf>,
}

/// Writes transforms.json, and next to it metrics.json, COLMAP's model, the points, and the photos that are not the original files.
///
/// # Errors
/// A folder that cannot be read or written, photos whose cameras are not found.
pub fn calibrate(context: &Context, request: &CalibrateRequest) -> Result<CalibrateResult, Error> {
    let photos = PhotoFolder::new(&request.dir)?;
    let photos_at = files::relative(folder_of(&request.out), &photos.photos)?;
    let text = photos.cameras("calibrate", &request.method, &photos_at, request.undistort);
    let session = Session::implicit(context, &text, "calibrate", &request.dir).map_err(for_this_verb)?;
    let record = execute(&session, &options(&session))?
        .done()
        .map_err(for_this_verb)?;
    let written = write(&session.store, &record, request)?;
    let node = node_named(&record, CalibrateParams::STAGE)?;
    Ok(CalibrateResult {
        metrics: session.document(node)?,
        scene: read_scene(&session.store, node)?,
        written,
    })
}

/// Returns the folder of a file.
fn folder_of(file: &Path) -> &Path {
    file.parent()
        .filter(|folder| !folder.as_os_str().is_empty())
        .unwrap_or(Path::new("."))
}

/// Writes the files for other programs, and returns their paths. Photos are written last and not listed, because there are many.
fn write(store: &Store, record: &RunRecord, request: &CalibrateRequest) -> Result<Vec<PathBuf>, Error> {
    let node = node_named(record, CalibrateParams::STAGE)?;
    let cameras = node_named(record, CamerasParams::STAGE)?;
    let mut written = vec![request.out.clone(), request.out.with_file_name("metrics.json")];
    let files = cameras::CameraFiles::from_node(cameras);
    for (name, digest) in &files.models {
        let path = match *name {
            cameras::TRANSFORMS => request.out.clone(),
            name => request.out.with_file_name("").join(name),
        };
        outputs::one(store, record, digest, &path)?;
        written.extend((*name != cameras::TRANSFORMS).then_some(path));
    }
    outputs::one(store, record, &digest(node, Metrics::OUTPUT)?, &written[1])?;
    for (name, digest) in files.masks.iter().chain(&files.photos) {
        let path = request.out.with_file_name("").join(name);
        refuse_to_replace(&path, digest, &request.dir)?;
        outputs::one(store, record, digest, &path)?;
    }
    Ok(written)
}

/// Refuses to write over one of the photos that were read.
fn refuse_to_replace(path: &Path, digest: &Digest, dir: &Path) -> Result<(), Error> {
    let (Ok(file), Ok(dir)) = (path.canonicalize(), dir.canonicalize()) else {
        return Ok(()); // There is no such file.
    };
    if !file.starts_with(dir) || copies::is_copy(path, digest) {
        return Ok(());
    }
    let message = format!(
        "{} is one of the photos, and would be overwritten",
        path.display()
    );
    Err(Error::Usage(
        Diagnostic::new(message).hint("name a file in another folder with --out"),
    ))
}

/// Rewrites hints about pipeline.toml as arguments: this verb has no pipeline to edit.
fn for_this_verb(error: Error) -> Error {
    folder::for_folder(error).map_hint(as_arguments)
}

/// What stands between backquotes and is a key becomes the argument that sets it.
fn as_arguments(hint: &str) -> String {
    let argument = |(index, part): (usize, &str)| match part.split_once(" = ") {
        _ if index % 2 == 0 => part.to_owned(),
        Some(("method", value)) => format!("--method {}", value.trim_matches('"')),
        Some((key, value)) => format!("--set calibrate.{key}={}", value.trim_matches('"')),
        None if is_key(part) => format!("--set calibrate.{part}=…"),
        None => part.to_owned(),
    };
    hint.split('`')
        .enumerate()
        .map(argument)
        .collect::<Vec<_>>()
        .join("`")
}

fn is_key(word: &str) -> bool {
    let calibrate = marf_stages::stages()
        .iter()
        .find(|def| def.name == CalibrateParams::STAGE);
    let schema = calibrate.map(|def| (def.schema)().to_value());
    schema.is_some_and(|schema| schema["properties"].get(word).is_some())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hints_about_keys_are_said_as_arguments() {
        for (hint, said) in [
            (
                "choose one, for example `file = \"a/b.json\"`",
                "choose one, for example `--set calibrate.file=a/b.json`",
            ),
            (
                "set `hold_every = 0`, or name photos in `train_filenames`",
                "set `--set calibrate.hold_every=0`, or name photos in `train_filenames`",
            ),
            ("change `file`", "change `--set calibrate.file=…`"),
            ("use `method = \"sfm\"`", "use `--method sfm`"),
            (
                "widen `--set archive.folder.sols=…`",
                "widen `--set archive.folder.sols=…`",
            ),
            ("nothing of ours, `x/y.json`", "nothing of ours, `x/y.json`"),
        ] {
            assert_eq!(as_arguments(hint), said);
        }
    }
}
