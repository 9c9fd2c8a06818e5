//! Scores depths of photos against ranges that JPL's programs measured in the same photos.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use marf_config::scenes::{node_of, scene_of};
use marf_depth::score::{Comparison, LabelledDepths, View};
use marf_engine::{NodeRun, RunRecord};
use marf_pds::{Label, ProductName, ranges};
use marf_scene::{PhotoFacts, Scene};
use marf_schema::calibrate::CalibrateParams;
use marf_schema::depth::{Agreement, DepthParams, Metrics, OctaveAgreement};
use marf_schema::output::{INVERSE_DEPTH, SCENE, SIGMA};
use marf_stage::{Document, Params};
use serde::Serialize;
use walkdir::WalkDir;

use crate::error::{Diagnostic, Error};
use crate::files;
use crate::photos::{self, PhotoLine};
use crate::session::{Session, node_named};

/// Depths against all products of a folder.
#[derive(Debug, Clone, Serialize)]
pub struct DepthScore {
    /// The products, in the order of their files.
    pub products: Vec<ProductScore>,
    /// All of them together.
    #[serde(flatten)]
    pub all: Agreement,
    /// All of them together, by octave of range.
    pub octaves: Vec<OctaveAgreement>,
    /// Files of the photos that no product was compared with.
    pub photos_without: Vec<String>,
}

/// Depths against a product.
#[derive(Debug, Clone, Serialize)]
pub struct ProductScore {
    /// The file, below the folder.
    pub file: String,
    /// Absent if it could not be compared.
    #[serde(flatten)]
    pub agreement: Option<Agreement>,
    /// Why it could not be compared. Empty if it was.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub reason: String,
}

/// A photo with depths.
struct PhotoWithDepths<'a> {
    line: &'a PhotoLine,
    depths: LabelledDepths,
    is_used: bool,
}

/// Photos with depths, by camera and clock of their names.
type Photos<'a> = BTreeMap<String, Vec<PhotoWithDepths<'a>>>;

/// Compares the depths of a run with the products of a folder.
///
/// # Errors
/// A folder that cannot be read, depths without metres, no product that shows what a photo shows.
pub(crate) fn score(session: &Session, record: &RunRecord, folder: &Path) -> Result<DepthScore, Error> {
    let files = products(folder)?;
    let lines = photos::lines(&session.store, record, "extract")?;
    let mut photos = Photos::new();
    for node in record
        .nodes
        .iter()
        .filter(|node| node.stage == DepthParams::STAGE)
    {
        if node.outputs.contains_key(Metrics::OUTPUT) {
            read_photos(session, record, node, &lines, &mut photos)?;
        }
    }
    let mut all = Comparison::default();
    let mut products = Vec::new();
    for path in files {
        session.check()?;
        let file = path.strip_prefix(folder).unwrap_or(&path).display().to_string();
        let (agreement, reason) = match compare(session, &path, &lines, &mut photos)? {
            Ok(found) => {
                let agreement = found.agreement();
                all.merge(found);
                (Some(agreement), String::new())
            }
            Err(reason) => (None, reason),
        };
        products.push(ProductScore {
            file,
            agreement,
            reason,
        });
    }
    let Some(first) = products.first() else {
        return Err(none(
            folder,
            "it has no product of type XYZ, RNG or DSP".to_owned(),
        ));
    };
    if products.iter().all(|product| product.agreement.is_none()) {
        return Err(none(folder, format!("{}: {}", first.file, first.reason)));
    }
    let unused = photos.values().flatten().filter(|photo| !photo.is_used);
    Ok(DepthScore {
        all: all.agreement(),
        octaves: all.by_octave(),
        photos_without: unused.map(|photo| photo.line.facts.file.clone()).collect(),
        products,
    })
}

fn none(folder: &Path, cause: String) -> Error {
    Error::Failed(Diagnostic {
        message: format!("no depth could be compared with {}", folder.display()),
        cause: Some(cause),
        hint: Some(
            "the products have to be of the photos in the folder, and keep the names that the Planetary Data System gives".to_owned(),
        ),
    })
}

/// Returns the files of a folder that are products of geometry by their names, in order.
fn products(folder: &Path) -> Result<Vec<PathBuf>, Error> {
    let mut found = Vec::new();
    for entry in WalkDir::new(folder).sort_by_file_name() {
        let entry = entry.map_err(|error| {
            Error::Failed(Diagnostic {
                message: format!("cannot read {}", folder.display()),
                cause: Some(error.to_string()),
                hint: None,
            })
        })?;
        let path = entry.path();
        let is_label = path.extension().is_some_and(|ending| {
            ["lbl", "xml"]
                .iter()
                .any(|label| ending.eq_ignore_ascii_case(label))
        });
        let is_geometry =
            name_of(path).is_some_and(|name| ranges::Geometry::from_type(&name.product_type).is_some());
        if entry.file_type().is_file() && is_geometry && !is_label {
            found.push(path.to_owned());
        }
    }
    Ok(found)
}

fn name_of(path: &Path) -> Option<ProductName> {
    ProductName::read(path.file_stem()?.to_str()?)
}

fn name_of_photo(line: &PhotoLine) -> Option<ProductName> {
    name_of(Path::new(&line.facts.file))
}

/// Adds the photos of a scene that have depths.
fn read_photos<'a>(
    session: &Session,
    record: &RunRecord,
    node: &NodeRun,
    lines: &'a [PhotoLine],
    photos: &mut Photos<'a>,
) -> Result<(), Error> {
    let metrics: Metrics = session.document(node)?;
    if metrics.unit != "metres" {
        return Err(Error::Failed(
            Diagnostic::new("the depths have no metres, so that no range can be compared with them")
                .hint("labels or feed records next to the photos give the scale"),
        ));
    }
    let calibrate = CalibrateParams::STAGE;
    let calibrate = scene_of(&node.name).map_or(calibrate.to_owned(), |scene| node_of(calibrate, scene));
    let scene = Scene::decode(&session.output(node_named(record, &calibrate)?, SCENE)?)
        .map_err(|error| Error::failed(format!("scene of `{calibrate}`: {error}")))?;
    for photo in metrics.photos.iter().filter(|photo| photo.share > 0.0) {
        let line = lines.iter().find(|line| line.product == photo.id);
        let (Some(line), Some(frame)) = (line, scene.frame(&photo.id)) else {
            continue;
        };
        let Some(name) = name_of_photo(line) else { continue };
        let picture = |folder: &str| session.output(node, &format!("{folder}{}.png", photo.name));
        let (inverse, sigma) = (picture(INVERSE_DEPTH)?, picture(SIGMA)?);
        match LabelledDepths::read(frame, &line.facts, line.image, [&inverse, &sigma]) {
            Ok(depths) => photos
                .entry(name.camera_and_clock())
                .or_default()
                .push(PhotoWithDepths {
                    line,
                    depths,
                    is_used: false,
                }),
            Err(error) => session.context.warn(format!("{}: {error}", line.facts.file)),
        }
    }
    Ok(())
}

/// Compares one product, or says why it cannot be.
fn compare(
    session: &Session,
    path: &Path,
    lines: &[PhotoLine],
    photos: &mut Photos<'_>,
) -> Result<Result<Comparison, String>, Error> {
    let Some(name) = name_of(path) else {
        return Ok(Err("its name follows no scheme".to_owned()));
    };
    let Some(shown) = photos.get_mut(&name.camera_and_clock()) else {
        return Ok(Err("no photo of its camera and time has a depth".to_owned()));
    };
    let bytes = match read(session, path)? {
        Ok(bytes) => bytes,
        Err(reason) => return Ok(Err(reason)),
    };
    let twin = name.twin_camera_and_clock();
    let is_partner =
        |line: &&PhotoLine| name_of_photo(line).map(|name| name.camera_and_clock()) == twin && twin.is_some();
    let partner = lines
        .iter()
        .filter(is_partner)
        .find_map(|line| line.facts.prior.as_ref());
    let beside = label_beside(session, path)?;
    let compared = ranges::read(Some(&name), &bytes, beside.as_ref()).and_then(|product| {
        if product.geometry == ranges::Geometry::Disparities {
            let mut own = shown.iter().filter_map(|photo| photo.line.facts.prior.as_ref());
            own.try_for_each(|prior| product.check_grid(prior))?;
        }
        let ranges = product.ranges(partner)?;
        Ok((product, ranges))
    });
    let (product, ranges) = match compared {
        Ok(read) => read,
        Err(error) => return Ok(Err(error.to_string())),
    };
    let mut views = Vec::new();
    for photo in shown {
        match view(&product, &photo.line.facts, &photo.depths) {
            Ok(view) => {
                photo.is_used = true;
                views.push(view);
            }
            Err(reason) => return Ok(Err(reason)),
        }
    }
    Ok(Ok(Comparison::new(&ranges, product.width, &views)))
}

fn view(product: &ranges::Product, facts: &PhotoFacts, depths: &LabelledDepths) -> Result<View, String> {
    let prior = facts
        .prior
        .as_ref()
        .ok_or("the label of its photo has no usable camera")?;
    let camera = product.camera_in(prior).map_err(|error| error.to_string())?;
    View::new(camera, depths.clone()).map_err(|error| error.to_string())
}

/// Reads a file, or says why it cannot be read.
fn read(session: &Session, path: &Path) -> Result<Result<Vec<u8>, String>, Error> {
    let mut reason = String::new();
    let bytes = files::read_named(path, &session.context.cancel, |error| {
        reason = error.to_string();
        Error::failed(reason.clone())
    });
    match bytes {
        Err(Error::Interrupted) => Err(Error::Interrupted),
        Err(_) => Ok(Err(reason)),
        Ok(bytes) => Ok(Ok(bytes)),
    }
}

/// Returns the detached label of a product, if it has one that can be read.
fn label_beside(session: &Session, path: &Path) -> Result<Option<Label>, Error> {
    for ending in ["LBL", "lbl"] {
        let label = path.with_extension(ending);
        if label.is_file()
            && let Ok(bytes) = read(session, &label)?
        {
            return Ok(ranges::label(&bytes).ok());
        }
    }
    Ok(None)
}
