//! JPL's products of geometry: coordinates (`XYZ`), ranges (`RNG`) and disparities (`DSP`) of each pixel of a photo.
//!
//! All become ranges from the centre C of the photo's camera. JPL's programs write zeros where there is no value, whatever the
//! label says (VICAR: marsxyz, marsrange, marscor3).

use marf_scene::{Cahvor, CameraPrior, MAX_DECODED_BYTES, Pose, RoverPlace, TooLarge};
use nalgebra::{Vector2, Vector3};

use crate::label::{Array, Label};
use crate::names::ProductName;
use crate::pixels::{PixelError, Stored};
use crate::{pds3, raw};

/// Most bytes in memory of a pixel: three values and a range.
const PIXEL_BYTES: u64 = 32;
/// Largest distance of the point that ranges are measured from to the camera's centre, metres: labels write it with 6 digits.
const ORIGIN_TOLERANCE_M: f64 = 1e-3;
/// Largest distance of two rays at a point, as a share of the range and in metres: marsxyz takes the same.
const MISS_SHARE: f64 = 0.005;
const MISS_M: f64 = 0.05;
/// Smallest squared sine of the angle between two rays that meet: at 1e-6 rad, the range is a thousand times a baseline and far
/// more.
const LEAST_SINE2: f64 = 1e-12;
/// Pixels of two cameras are the same if points at this range are at most so far apart: labels round to a thousandth of a pixel.
const GRID_RANGE_M: f64 = 10.0;
const GRID_TOLERANCE_PX: f64 = 0.05;

/// What the values of a product are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Geometry {
    /// Three coordinates, metres.
    Points,
    /// Distance from a point, metres.
    Ranges,
    /// Line and sample of the same point in the other photo of the pair, from 1.
    Disparities,
}

impl Geometry {
    /// Returns what products of a type hold, by its name in a label or in the names of products. `None` for types without ranges.
    pub fn from_type(kind: &str) -> Option<Self> {
        match kind {
            "XYZ_MAP" | "XYZ" | "XYM" | "XYR" | "XYL" => Some(Self::Points),
            "RANGE_MAP" | "RNG" | "RNM" | "RNR" | "RNL" => Some(Self::Ranges),
            "DISPARITY_MAP" | "DSP" | "DSR" | "DIS" | "DIL" => Some(Self::Disparities),
            _ => None,
        }
    }
}

/// A product that gives no ranges.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum RangeError {
    /// No label, or one that describes no array.
    #[error("{0}")]
    NoArray(String),
    /// Another product.
    #[error("a product of type {0} has no ranges, XYZ, RNG and DSP have")]
    Kind(String),
    /// Bands that are not those of its type.
    #[error("its number of bands is {has}, its type has {needs}")]
    Bands {
        /// Bands of the array.
        has: u32,
        /// Bands of its type.
        needs: u32,
    },
    /// The array cannot be read.
    #[error(transparent)]
    Pixels(#[from] PixelError),
    /// No camera to measure from.
    #[error("its label has no usable camera to measure ranges from")]
    NoCamera,
    /// The frame of the values is not named.
    #[error("its label does not name the frame of its values")]
    NoFrame,
    /// The frame of the values cannot be related to the camera's.
    #[error(
        "its values are in {values} {values_counter:?}, its camera is in {camera} {camera_counter:?}, and its label does not relate the two"
    )]
    Frame {
        /// Frame of the values.
        values: String,
        /// Its counters.
        values_counter: Vec<i64>,
        /// Frame of the camera.
        camera: String,
        /// Its counters.
        camera_counter: Vec<i64>,
    },
    /// Ranges from another point.
    #[error("its ranges are measured from a point {distance_m:.3} m from its camera")]
    Origin {
        /// Distance of that point from the camera's centre.
        distance_m: f64,
    },
    /// Disparities alone.
    #[error("disparities become ranges by the label of the pair's other photo, which is missing")]
    NoPartner,
    /// Disparities of resampled photos.
    #[error("its photos were resampled, so that their labels do not tell where its disparities point")]
    OtherGrid,
}

/// A product of geometry.
#[derive(Debug, Clone, PartialEq)]
pub struct Product {
    /// What its values are.
    pub geometry: Geometry,
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// The camera of its photo.
    pub camera: CameraPrior,
    place: Option<RoverPlace>,
    origin: Option<[f64; 3]>,
    /// Values of each pixel, in rows. `None` where it has none.
    values: Vec<Option<[f64; 3]>>,
}

/// Reads a PDS3 label, attached or detached, of a product of any type.
///
/// # Errors
/// Why there is none.
pub fn label(bytes: &[u8]) -> Result<Label, String> {
    let group = raw::attached(bytes)?;
    match pds3::unread(&group) {
        Some(reason) => Err(reason),
        None => Ok(pds3::label(&group)),
    }
}

/// Reads a product by its attached label, else by the detached one.
///
/// Its type is that of the label, else of the name.
///
/// # Errors
/// See [`RangeError`].
pub fn read(name: Option<&ProductName>, bytes: &[u8], beside: Option<&Label>) -> Result<Product, RangeError> {
    let attached = self::label(bytes);
    let own = attached.as_ref().ok().filter(|label| label.array.is_some());
    let Some((label, array)) = own
        .or(beside)
        .and_then(|label| Some((label, label.array.as_ref()?)))
    else {
        let described = "its label describes no array that is read".to_owned();
        return Err(RangeError::NoArray(attached.err().unwrap_or(described)));
    };
    let geometry = geometry(label, name)?;
    let values = values(array, geometry, bytes)?;
    Ok(Product {
        geometry,
        width: array.shape[2],
        height: array.shape[1],
        camera: label.prior.clone().ok_or(RangeError::NoCamera)?,
        place: label.derived.place.clone(),
        origin: label.derived.origin,
        values,
    })
}

fn geometry(label: &Label, name: Option<&ProductName>) -> Result<Geometry, RangeError> {
    let of_name = name.map(|name| name.product_type.as_str());
    let kind = label.derived.kind.as_deref().or(of_name).unwrap_or("unknown");
    Geometry::from_type(kind).ok_or_else(|| RangeError::Kind(kind.to_owned()))
}

/// Returns the values of all pixels, scaled as the label says.
fn values(array: &Array, geometry: Geometry, bytes: &[u8]) -> Result<Vec<Option<[f64; 3]>>, RangeError> {
    let [has, lines, samples] = array.shape;
    let needs = match geometry {
        Geometry::Points => 3,
        Geometry::Ranges => 1,
        Geometry::Disparities => 2,
    };
    if has != needs {
        return Err(RangeError::Bands { has, needs });
    }
    let stored = Stored::new(array, bytes)?;
    TooLarge::check(samples, lines, PIXEL_BYTES, MAX_DECODED_BYTES).map_err(PixelError::TooLarge)?;
    let bands = needs as usize;
    let scaling = |band: usize| array.scaling.get(band).or(array.scaling.first());
    let pixel = |line: usize, sample: usize| {
        let mut value = [0.0; 3];
        for (band, value) in value.iter_mut().enumerate().take(bands) {
            *value = stored.value(band, line, sample);
        }
        let own = &mut value[..bands];
        let missing = own.iter().all(|value| *value == 0.0)
            || own
                .iter()
                .any(|value| !value.is_finite() || array.missing.contains(value) && *value != 0.0);
        if missing {
            return None;
        }
        for (band, value) in own.iter_mut().enumerate() {
            if let Some((factor, offset)) = scaling(band) {
                *value = *value * factor + offset;
            }
        }
        Some(value)
    };
    let (lines, samples) = (lines as usize, samples as usize);
    Ok((0..lines)
        .flat_map(|line| (0..samples).map(move |sample| (line, sample)))
        .map(|(line, sample)| pixel(line, sample))
        .collect())
}

impl Product {
    /// Returns the range of each pixel, in rows: metres from the camera's centre C, above 0. `None` where the product has none.
    ///
    /// |R p + t - C| for coordinates p, with the pose R, t of their frame in the camera's. For disparities, the midpoint of the
    /// shortest line between the rays of both photos takes the place of R p + t, where the line is at most as long as marsxyz
    /// takes it: 5 mm a metre of range and 5 cm.
    ///
    /// - `partner`: camera of the pair's other photo, for disparities.
    ///
    /// # Errors
    /// See [`RangeError`]: a frame that the label does not relate to the camera's, ranges from another point, no partner.
    pub fn ranges(&self, partner: Option<&CameraPrior>) -> Result<Vec<Option<f64>>, RangeError> {
        let centre = Vector3::from(self.camera.model.c);
        let range = |point: Vector3<f64>| Some((point - centre).norm()).filter(|range| *range > 0.0);
        match self.geometry {
            Geometry::Points => {
                let place = self.place.as_ref().ok_or(RangeError::NoFrame)?;
                let pose = camera_from(place, &self.camera)?;
                let found = |value: &Option<[f64; 3]>| range(pose.point(&Vector3::from((*value)?)));
                Ok(self.values.iter().map(found).collect())
            }
            Geometry::Ranges => {
                self.check_origin(&centre)?;
                let found =
                    |value: &Option<[f64; 3]>| value.map(|[range, ..]| range).filter(|range| *range > 0.0);
                Ok(self.values.iter().map(found).collect())
            }
            Geometry::Disparities => {
                let partner = partner.ok_or(RangeError::NoPartner)?;
                let other = model_in(partner, &self.camera)?;
                let columns = self.width as usize;
                let found = |(index, value): (usize, &Option<[f64; 3]>)| {
                    let [line, sample, _] = (*value)?;
                    let here = Vector2::new((index % columns) as f64, (index / columns) as f64);
                    let there = Vector2::new(sample - 1.0, line - 1.0);
                    range(meeting(&self.camera.model, &here, &other, &there)?)
                };
                Ok(self.values.iter().enumerate().map(found).collect())
            }
        }
    }

    /// Returns the camera of the product in the frame of a photo's camera.
    ///
    /// # Errors
    /// [`RangeError::Frame`] if the labels do not relate the two frames.
    pub fn camera_in(&self, photo: &CameraPrior) -> Result<Cahvor, RangeError> {
        model_in(&self.camera, photo)
    }

    /// Checks that the pixels of the product are those of a photo, as its label has them. Only then do disparities point to pixels of the
    /// label of the pair's other photo: both photos of a linearised pair have other cameras than their labels.
    ///
    /// # Errors
    /// [`RangeError::OtherGrid`], or as [`Product::camera_in`].
    pub fn check_grid(&self, photo: &CameraPrior) -> Result<(), RangeError> {
        let photo = model_in(photo, &self.camera)?;
        let [right, bottom] = [self.width, self.height].map(|size| f64::from(size) - 1.0);
        let is_same = |pixel: Vector2<f64>| {
            let ray = self.camera.model.unproject(&pixel)?;
            let there = photo.project(&(ray.origin + ray.direction * GRID_RANGE_M))?;
            Some((there - pixel).norm() <= GRID_TOLERANCE_PX)
        };
        let corners = [[0.0, 0.0], [right, 0.0], [0.0, bottom], [right, bottom]];
        let are_same = corners
            .into_iter()
            .all(|corner| is_same(corner.into()) == Some(true));
        if are_same {
            Ok(())
        } else {
            Err(RangeError::OtherGrid)
        }
    }

    /// Checks that ranges are measured from the camera's centre. A label without a point means the centre.
    fn check_origin(&self, centre: &Vector3<f64>) -> Result<(), RangeError> {
        let Some(origin) = self.origin else {
            return Ok(());
        };
        let place = self.place.as_ref().ok_or(RangeError::NoFrame)?;
        let origin = camera_from(place, &self.camera)?.point(&Vector3::from(origin));
        let distance_m = (origin - centre).norm();
        if distance_m > ORIGIN_TOLERANCE_M {
            return Err(RangeError::Origin { distance_m });
        }
        Ok(())
    }
}

/// Returns the pose of a frame in the camera's.
///
/// A site's frame has one counter, SITE. That of the rover is another at each SITE, DRIVE and POSE.
fn camera_from(place: &RoverPlace, camera: &CameraPrior) -> Result<Pose, RangeError> {
    let compared = if place.frame == "SITE_FRAME" { 1 } else { 3 };
    let (own, other) = (&place.motion_counter, &camera.motion_counter);
    let mut both = own.iter().zip(other).take(compared);
    let is_same = place.frame == camera.frame && both.all(|(own, other)| own == other);
    if is_same && !own.is_empty() && !other.is_empty() {
        return Ok(Pose::identity());
    }
    let same_site = !own.is_empty() && own.first() == other.first();
    match (place.site_from_frame, camera.site_from_frame) {
        (Some(values), Some(camera)) if same_site => Ok(camera.inverse() * values),
        _ => Err(RangeError::Frame {
            values: place.frame.clone(),
            values_counter: own.clone(),
            camera: camera.frame.clone(),
            camera_counter: other.clone(),
        }),
    }
}

/// Returns the model of a camera in the frame of another.
fn model_in(camera: &CameraPrior, other: &CameraPrior) -> Result<Cahvor, RangeError> {
    let place = RoverPlace {
        frame: camera.frame.clone(),
        site_from_frame: camera.site_from_frame,
        motion_counter: camera.motion_counter.clone(),
    };
    Ok(camera.model.transformed(&camera_from(&place, other)?))
}

/// Returns the midpoint of the shortest line between the rays of two pixels, in front of both cameras. `None` where the rays are
/// parallel, or farther apart than the limits.
///
/// With w = o2 - o1 and unit directions d1, d2: t1 = (w d1 - (w d2)(d1 d2)) / (1 - (d1 d2)²), t2 = t1 (d1 d2) - w d2.
fn meeting(
    camera: &Cahvor,
    here: &Vector2<f64>,
    other: &Cahvor,
    there: &Vector2<f64>,
) -> Option<Vector3<f64>> {
    let (one, two) = (camera.unproject(here)?, other.unproject(there)?);
    let between = two.origin - one.origin;
    let cosine = one.direction.dot(&two.direction);
    let sine2 = one.direction.cross(&two.direction).norm_squared();
    if sine2 < LEAST_SINE2 {
        return None;
    }
    let along = between.dot(&two.direction);
    let first_m = (between.dot(&one.direction) - along * cosine) / sine2;
    let second_m = first_m * cosine - along;
    let (first, second) = (
        one.origin + one.direction * first_m,
        two.origin + two.direction * second_m,
    );
    let miss_m = (second - first).norm();
    let meets = miss_m <= (MISS_SHARE * first_m).min(MISS_M);
    (first_m > 0.0 && second_m > 0.0 && meets).then(|| (first + second) / 2.0)
}
