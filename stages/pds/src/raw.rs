//! Products of raw pixels, described by an attached or a detached label.

use marf_scene::{Image, MAX_DECODED_BYTES, Photo, Srgb, encode_png};

use crate::demosaic;
use crate::label::{Array, BayerPhase, Label, MAX_LABEL_BYTES, Quantity};
use crate::names::ProductName;
use crate::odl::Group;
use crate::pixels;
use crate::{companding, dat, describe, odl, pds3, vicar};

/// Reads the label at the head of a file: VICAR, or PDS3 / ODL.
///
/// # Errors
/// Why there is none, or why it is not of a photo.
pub fn head(bytes: &[u8]) -> Result<Label, String> {
    let group = attached(bytes)?;
    match pds3::no_photo(&group) {
        Some(reason) => Err(reason),
        None => Ok(pds3::label(&group)),
    }
}

/// Returns the groups of the label at the head of a file.
pub(crate) fn attached(bytes: &[u8]) -> Result<Group, String> {
    Ok(match vicar::parse(bytes) {
        Some(group) => group,
        None => {
            let start = &bytes[..bytes.len().min(MAX_LABEL_BYTES)];
            let known = [
                "PDS_VERSION_ID",
                "ODL_VERSION_ID",
                "CCSD3ZF",
                "NJPL",
                "XV_COMPATIBILITY",
                "FILE_TYPE",
            ];
            if !known
                .iter()
                .any(|word| start.trim_ascii_start().starts_with(word.as_bytes()))
            {
                return Err("no label at the head of the file".to_owned());
            }
            odl::parse(start).map_err(|error| error.to_string())?
        }
    })
}

/// The reason why there is no image.
#[derive(Debug, thiserror::Error)]
pub enum DevelopError {
    /// No label describes an array.
    #[error("{0}")]
    NoArray(String),
    /// A compressed product cannot be decompressed.
    #[error(transparent)]
    Compressed(#[from] dat::DatError),
    /// The array cannot be converted.
    #[error(transparent)]
    Pixels(#[from] pixels::PixelError),
}

impl DevelopError {
    /// Whether a larger limit of memory would help.
    pub fn is_limit(&self) -> bool {
        matches!(self, Self::Pixels(pixels::PixelError::TooLarge(_)))
    }
}

/// The image of a file of raw pixels.
pub struct Developed {
    /// The image.
    pub image: Image<Srgb>,
    /// Bands: 1 or 3, a mosaic counts as 3.
    pub bands: u8,
    /// How stored values were converted to codes.
    pub notes: Vec<String>,
    /// The label at its head, if it has one.
    pub attached: Option<Label>,
}

/// Returns the image of a file's pixels by its attached label, else by the detached one, of at most
/// [`MAX_DECODED_BYTES`].
///
/// # Errors
/// See [`DevelopError`].
pub fn develop(
    name: Option<&ProductName>,
    bytes: &[u8],
    beside: Option<&Label>,
) -> Result<Developed, DevelopError> {
    develop_within(name, bytes, beside, MAX_DECODED_BYTES)
}

/// As [`develop`], for an image of at most `limit_bytes` in memory.
///
/// # Errors
/// See [`DevelopError`].
pub fn develop_within(
    name: Option<&ProductName>,
    bytes: &[u8],
    beside: Option<&Label>,
    limit_bytes: u64,
) -> Result<Developed, DevelopError> {
    if let Some(made) = dat::decompress(bytes, limit_bytes) {
        let dat::Decompressed { array, bytes, phase } = made?;
        let mut label = beside.cloned().unwrap_or_default();
        label.phase = Some(phase);
        return render(name, &label, array, &bytes, limit_bytes);
    }
    let (attached, reason) = match head(bytes) {
        Ok(label) => (
            Some(label),
            "its label describes no array that is read".to_owned(),
        ),
        Err(reason) => (None, reason),
    };
    let own = attached.as_ref().filter(|label| label.array.is_some());
    let Some((label, array)) = own
        .or(beside)
        .and_then(|label| Some((label, label.array.as_ref()?)))
    else {
        return Err(DevelopError::NoArray(reason));
    };
    let mut array = array.clone();
    // Processed products are counts again, though their labels still state how the camera stored them.
    if !name.is_some_and(ProductName::is_as_received) {
        array.companded_by = None;
    }
    let developed = render(name, label, array, bytes, limit_bytes)?;
    Ok(Developed {
        attached,
        ..developed
    })
}

/// Returns the image of an array, as label and name describe it.
fn render(
    name: Option<&ProductName>,
    label: &Label,
    mut array: Array,
    bytes: &[u8],
    limit_bytes: u64,
) -> Result<Developed, DevelopError> {
    if let Some(quantity) = name.and_then(|name| quantity(name, &array)) {
        array.quantity = quantity;
    }
    if name.is_some_and(|name| name.product_type.starts_with("RZ"))
        && let Some(factor) = array.from_zenith
    {
        if array.scaling.is_empty() {
            array.scaling.push((1.0, 0.0));
        }
        let scaled = array
            .scaling
            .iter()
            .map(|(own, offset)| (own * factor, offset * factor));
        array.scaling = scaled.collect();
    }
    let by_name = name.is_some_and(|name| name.is_mosaic(label.filter.as_deref())) && !label.interpolated;
    let mosaic = label
        .mosaic
        .or(by_name.then(|| label.phase.unwrap_or_default()))
        .filter(|_| array.shape[0] == 1 && label.averaged <= 1);
    let scheme = name.map(|name| name.scheme);
    let codes = array.companded_by.as_deref();
    let table = codes.and_then(|codes| companding::table(codes, scheme));
    let mut made = pixels::render(&array, mosaic, table, bytes, limit_bytes)?;
    made.notes
        .insert(0, format!("samples {}", describe::array(&array)));
    if label.mosaic.is_none() && mosaic.is_some() {
        made.notes
            .push("the name says colour mosaic, the label does not: interpolated by the name".to_owned());
    }
    Ok(Developed {
        image: made.image,
        bands: made.bands,
        notes: made.notes,
        attached: None,
    })
}

/// Returns the quantity of an array without unit by the product's type: RA? and RZ? are radiance, IO? is I/F.
fn quantity(name: &ProductName, array: &Array) -> Option<Quantity> {
    if array.quantity != Quantity::Counts {
        return None;
    }
    match name.product_type.get(..2)? {
        "RA" | "RZ" => Some(Quantity::Radiance),
        "IO" => Some(Quantity::Reflectance),
        _ => None,
    }
}

/// Returns the interpolated photo of a picture that is a colour mosaic by its name: one band, or three equal ones.
/// `None` if the bands differ, or the photo is too small.
pub fn develop_mosaic(photo: &Photo, phase: Option<BayerPhase>) -> Option<Photo> {
    let grey = photo
        .image
        .pixels
        .iter()
        .all(|[red, green, blue]| red == green && green == blue);
    if !grey {
        return None;
    }
    let plane: Vec<f32> = photo
        .image
        .pixels
        .iter()
        .map(|pixel| f32::from(pixel[0]) / 255.0)
        .collect();
    let (width, height) = (photo.image.width as usize, photo.image.height as usize);
    let rgb = demosaic::rggb(&plane, width, height, phase.unwrap_or_default())?;
    let mut developed = photo.clone();
    developed.image.pixels = rgb
        .into_iter()
        .map(|pixel| pixel.map(pixels::stored_code))
        .collect();
    developed.bands = 3;
    developed
        .notes
        .push("colour mosaic (RGGB) interpolated after Malvar, He and Cutler".to_owned());
    if phase.is_none() {
        developed
            .notes
            .push("where on the detector it starts is not known: taken as its first pixel".to_owned());
    }
    Some(developed)
}

/// Encodes an image as PNG, for later stages.
///
/// # Errors
/// An image of zero pixels.
pub fn png(image: &Image<Srgb>) -> Result<Vec<u8>, String> {
    encode_png(image).map_err(|error| error.to_string())
}
