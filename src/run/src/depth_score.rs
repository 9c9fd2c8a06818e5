//! Scores depths of photos against ranges that JPL's programs measured in the same photos.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use marf_config::scenes::{node_of, scene_of};
use marf_depth::score::{Comparison, LabelledDepths, ScoreError, View};
use marf_engine::{NodeRun, RunRecord};
use marf_pds::{Label, ProductName, pds4, ranges};
use marf_scene::Frame;
use marf_schema::calibrate::CalibrateParams;
use marf_schema::depth::{Agreement, DepthParams, Metrics, OctaveAgreement};
use marf_schema::output::{INVERSE_DEPTH, SIGMA};
use marf_stage::{Document, Params};
use serde::Serialize;
use walkdir::WalkDir;

use crate::error::{Diagnostic, Error};
use crate::files;
use crate::photos::{self, PhotoLine};
use crate::session::{Session, node_named, read_scene};

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
    let has_depths =
        |node: &&NodeRun| node.stage == DepthParams::STAGE && node.outputs.contains_key(Metrics::OUTPUT);
    for node in record.nodes.iter().filter(has_depths) {
        for photo in read_photos(session, record, node, &lines)? {
            match name_of_photo(photo.line) {
                Some(name) => photos.entry(name.camera_and_clock()).or_default().push(photo),
                None => unnamed.push(photo.line.facts.file.clone()),
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
        let (agreement, reason) = match compare(session, path, &lines, &mut photos) {
            Ok(found) => {
                let agreement = found.agreement();
                all.merge(found);
                (Some(agreement), String::new())
            }
            Err(Refused::Product(reason)) => (None, reason),
            Err(Refused::Stop(error)) => return Err(error),
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
            let entry =
                entry.map_err(|error| Error::failed(format!("cannot read {}: {error}", path.display())))?;
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

/// Returns the node that calibrated the photos of a node `depth`.
pub(crate) fn calibrate_of<'r>(record: &'r RunRecord, depth: &NodeRun) -> Result<&'r NodeRun, Error> {
    let stage = CalibrateParams::STAGE;
    let name = scene_of(&depth.name).map_or(stage.to_owned(), |scene| node_of(stage, scene));
    node_named(record, &name)
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
    let calibrate = calibrate_of(record, node)?;
    let scene = read_scene(&session.store, calibrate)?;
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

/// Why a product cannot be compared.
enum Refused {
    /// The run cannot go on.
    Stop(Error),
    /// The product is left out.
    Product(String),
}

impl From<Error> for Refused {
    fn from(error: Error) -> Self {
        Self::Stop(error)
    }
}

fn left_out(reason: impl ToString) -> Refused {
    Refused::Product(reason.to_string())
}

/// Compares one product.
fn compare(
    session: &Session,
    path: &Path,
    lines: &[PhotoLine],
    photos: &mut Photos<'_>,
) -> Result<Comparison, Refused> {
    let unknown = || left_out("no photo of its camera and time has a camera");
    let name = name_of(path).ok_or_else(unknown)?;
    let shown = photos.get_mut(&name.camera_and_clock()).ok_or_else(unknown)?;
    let bytes = read(session, path)?;
    let product =
        ranges::read(Some(&name), &bytes, label_beside(session, path)?.as_ref()).map_err(left_out)?;
    let ranges = ranges_of(&product, &name, lines, shown).map_err(left_out)?;
    let (mut views, mut reason) = (Vec::new(), String::new());
    for photo in shown {
        match view(session, &product, photo) {
            Ok(view) => {
                photo.is_used = true;
                views.push(view);
            }
            Err(Refused::Product(why)) => reason = why,
            Err(stop) => return Err(stop),
        }
    }
    if views.is_empty() {
        return Err(left_out(reason));
    }
    Ok(Comparison::new(&ranges, product.width, &views))
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
    let is_twin =
        |line: &&PhotoLine| twin.is_some() && name_of_photo(line).map(|name| name.camera_and_clock()) == twin;
    let mut twins = lines.iter().filter(is_twin);
    product.ranges(twins.find_map(|line| line.facts.prior.as_ref()))
}

/// Reads the depths of a photo as a product sees them.
fn view(session: &Session, product: &ranges::Product, photo: &ComparedPhoto<'_>) -> Result<View, Refused> {
    if !photo.reason.is_empty() {
        return Err(left_out(format!("its photo has no depth: {}", photo.reason)));
    }
    let facts = &photo.line.facts;
    let picture = |folder: &str| session.output(photo.node, &format!("{folder}{}.png", photo.name));
    let (inverse, sigma) = (picture(INVERSE_DEPTH)?, picture(SIGMA)?);
    let depths =
        LabelledDepths::read(&photo.frame, facts, photo.line.image, [&inverse, &sigma]).map_err(left_out)?;
    let prior = facts
        .prior
        .as_ref()
        .ok_or_else(|| left_out(ScoreError::NoCamera))?;
    let camera = product.camera_in(prior).map_err(left_out)?;
    View::new(camera, depths).map_err(left_out)
}

/// Reads a file.
fn read(session: &Session, path: &Path) -> Result<Vec<u8>, Refused> {
    let read = files::read_named(path, &session.context.cancel, |error| {
        Error::failed(error.to_string())
    });
    read.map_err(|error| match error {
        Error::Interrupted => Refused::Stop(error),
        error => left_out(error.message()),
    })
}

/// Returns the detached label of a product, PDS3 or PDS4, if it has one.
fn label_beside(session: &Session, path: &Path) -> Result<Option<Label>, Refused> {
    let labels = ["LBL", "lbl", "xml", "XML"].map(|ending| path.with_extension(ending));
    let Some(label) = labels.iter().find(|label| label.is_file()) else {
        return Ok(None);
    };
    let bytes = read(session, label)?;
    let read = ranges::label(&bytes).or_else(|pds3| pds4::read(&bytes).map_err(|_| pds3));
    read.map(Some)
        .map_err(|why| left_out(format!("{}: {why}", label.display())))
}
