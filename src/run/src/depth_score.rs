//! Scores depths of photos against ranges that JPL's programs measured in the same photos.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use marf_config::scenes::{node_of, scene_of};
use marf_depth::score::{Comparison, LabelledDepths, ScoreError, View};
use marf_engine::{NodeRun, RunRecord};
use marf_pds::{Label, ProductName, pds4, ranges};
use marf_scene::{Frame, Scene};
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

/// A photo of the run. Its depths are read when a product of it is.
struct ComparedPhoto<'a> {
    line: &'a PhotoLine,
    frame: Frame,
    node: &'a NodeRun,
    /// Base name of its pictures.
    name: String,
    /// Why it has no depth. Empty if it has.
    reason: String,
    is_used: bool,
}

/// Photos by camera and clock of their names.
type Photos<'a> = BTreeMap<String, Vec<ComparedPhoto<'a>>>;

/// Compares the depths of a run with products.
///
/// # Errors
/// Depths without metres, no product that shows what a photo shows.
pub(crate) fn score(session: &Session, record: &RunRecord, folder: &Products) -> Result<DepthScore, Error> {
    let lines = photos::lines(&session.store, record, "extract")?;
    let mut photos = Photos::new();
    let mut unnamed = Vec::new();
    for node in record
        .nodes
        .iter()
        .filter(|node| node.stage == DepthParams::STAGE)
    {
        if node.outputs.contains_key(Metrics::OUTPUT) {
            for photo in read_photos(session, record, node, &lines)? {
                match name_of_photo(photo.line) {
                    Some(name) => photos.entry(name.camera_and_clock()).or_default().push(photo),
                    None => unnamed.push(photo.line.facts.file.clone()),
                }
            }
        }
    }
    let mut all = Comparison::default();
    let mut products = Vec::new();
    for path in &folder.files {
        session.check()?;
        let file = path
            .strip_prefix(&folder.path)
            .unwrap_or(path)
            .display()
            .to_string();
        let (agreement, reason) = match compare(session, path, &lines, &mut photos)? {
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
    if let Some(first) = products
        .first()
        .filter(|_| products.iter().all(|one| one.agreement.is_none()))
    {
        return Err(none(&folder.path, format!("{}: {}", first.file, first.reason)));
    }
    let unused = photos.values().flatten().filter(|photo| !photo.is_used);
    let unused = unused.map(|photo| photo.line.facts.file.clone());
    Ok(DepthScore {
        all: all.agreement(),
        octaves: all.by_octave(),
        photos_without: unused.chain(unnamed).collect(),
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

/// Endings of files next to products that are none: labels and pictures to browse.
const NO_PRODUCTS: [&str; 8] = ["lbl", "xml", "json", "txt", "png", "jpg", "jpeg", "gif"];

/// Products of geometry in a folder.
#[derive(Debug, Clone)]
pub struct Products {
    path: PathBuf,
    /// In the order of their names.
    files: Vec<PathBuf>,
}

impl Products {
    /// Finds the files that are products of geometry by their names.
    ///
    /// # Errors
    /// A folder that cannot be read, or without such a file.
    pub fn new(path: &Path) -> Result<Self, Error> {
        let mut files = Vec::new();
        for entry in WalkDir::new(path).sort_by_file_name() {
            let entry = entry.map_err(|error| {
                Error::Failed(Diagnostic {
                    message: format!("cannot read {}", path.display()),
                    cause: Some(error.to_string()),
                    hint: None,
                })
            })?;
            let file = entry.path();
            let is_other = file
                .extension()
                .is_some_and(|ending| NO_PRODUCTS.iter().any(|other| ending.eq_ignore_ascii_case(other)));
            let is_geometry =
                name_of(file).is_some_and(|name| ranges::Geometry::from_type(&name.product_type).is_some());
            if file.is_file() && is_geometry && !is_other {
                files.push(file.to_owned());
            }
        }
        if files.is_empty() {
            return Err(none(path, "it has no product of type XYZ, RNG or DSP".to_owned()));
        }
        Ok(Self {
            path: path.to_owned(),
            files,
        })
    }
}

fn name_of(path: &Path) -> Option<ProductName> {
    ProductName::read(path.file_stem()?.to_str()?)
}

fn name_of_photo(line: &PhotoLine) -> Option<ProductName> {
    name_of(Path::new(&line.facts.file))
}

/// Returns the photos of a scene.
fn read_photos<'a>(
    session: &Session,
    record: &'a RunRecord,
    node: &'a NodeRun,
    lines: &'a [PhotoLine],
) -> Result<Vec<ComparedPhoto<'a>>, Error> {
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
    let photos = metrics.photos.into_iter().filter_map(|photo| {
        Some(ComparedPhoto {
            line: lines.iter().find(|line| line.product == photo.id)?,
            frame: scene.frame(&photo.id)?.clone(),
            node,
            name: photo.name,
            reason: photo.reason,
            is_used: false,
        })
    });
    Ok(photos.collect())
}

/// Compares one product, or says why it cannot be.
fn compare(
    session: &Session,
    path: &Path,
    lines: &[PhotoLine],
    photos: &mut Photos<'_>,
) -> Result<Result<Comparison, String>, Error> {
    let name = name_of(path);
    let shown = name
        .as_ref()
        .and_then(|name| photos.get_mut(&name.camera_and_clock()));
    let (Some(name), Some(shown)) = (&name, shown) else {
        return Ok(Err("no photo of its camera and time has a camera".to_owned()));
    };
    let bytes = match read(session, path)? {
        Ok(bytes) => bytes,
        Err(reason) => return Ok(Err(reason)),
    };
    let beside = label_beside(session, path)?;
    let product = match ranges::read(Some(name), &bytes, beside.as_ref()) {
        Ok(product) => product,
        Err(error) => return Ok(Err(error.to_string())),
    };
    let ranges = match ranges_of(&product, name, lines, shown) {
        Ok(ranges) => ranges,
        Err(error) => return Ok(Err(error.to_string())),
    };
    let (mut views, mut reason) = (Vec::new(), String::new());
    for photo in shown {
        match view(session, &product, photo)? {
            Ok(view) => {
                photo.is_used = true;
                views.push(view);
            }
            Err(why) => reason = why,
        }
    }
    if views.is_empty() {
        return Ok(Err(reason));
    }
    Ok(Ok(Comparison::new(&ranges, product.width, &views)))
}

/// Returns the ranges of a product. Those of disparities need the label of the other eye's photo.
fn ranges_of(
    product: &ranges::Product,
    name: &ProductName,
    lines: &[PhotoLine],
    shown: &[ComparedPhoto<'_>],
) -> Result<Vec<Option<f64>>, ranges::RangeError> {
    if product.geometry != ranges::Geometry::Disparities {
        return product.ranges(None);
    }
    let mut own = shown.iter().filter_map(|photo| photo.line.facts.prior.as_ref());
    own.try_for_each(|prior| product.check_grid(prior))?;
    let twin = name.twin_camera_and_clock();
    let partner = lines.iter().find_map(|line| {
        let is_twin = twin.is_some() && name_of_photo(line).map(|name| name.camera_and_clock()) == twin;
        line.facts.prior.as_ref().filter(|_| is_twin)
    });
    product.ranges(partner)
}

/// Reads the depths of a photo as a product sees them, or says why that cannot be.
fn view(
    session: &Session,
    product: &ranges::Product,
    photo: &ComparedPhoto<'_>,
) -> Result<Result<View, String>, Error> {
    if !photo.reason.is_empty() {
        return Ok(Err(format!("its photo has no depth: {}", photo.reason)));
    }
    let facts = &photo.line.facts;
    let picture = |folder: &str| session.output(photo.node, &format!("{folder}{}.png", photo.name));
    let (inverse, sigma) = (picture(INVERSE_DEPTH)?, picture(SIGMA)?);
    let depths = LabelledDepths::read(&photo.frame, facts, photo.line.image, [&inverse, &sigma]);
    let (depths, prior) = match (depths, &facts.prior) {
        (Ok(depths), Some(prior)) => (depths, prior),
        (Err(error), _) => return Ok(Err(error.to_string())),
        (Ok(_), None) => return Ok(Err(ScoreError::NoCamera.to_string())),
    };
    let camera = match product.camera_in(prior) {
        Ok(camera) => camera,
        Err(error) => return Ok(Err(error.to_string())),
    };
    Ok(View::new(camera, depths).map_err(|error| error.to_string()))
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

/// Returns the detached label of a product, PDS3 or PDS4, if it has one that can be read.
fn label_beside(session: &Session, path: &Path) -> Result<Option<Label>, Error> {
    for ending in ["LBL", "lbl", "xml", "XML"] {
        let label = path.with_extension(ending);
        if label.is_file()
            && let Ok(bytes) = read(session, &label)?
        {
            let read =
                ranges::label(&bytes).or_else(|_| pds4::read(&bytes).map_err(|error| error.to_string()));
            if let Ok(label) = read {
                return Ok(Some(label));
            }
        }
    }
    Ok(None)
}
