//! How a label scales the samples of its image to radiance or I/F.

use super::keys::{text, top};
use crate::label::{Array, Quantity};
use crate::odl::{Group, Value};
use crate::units::{self, Unit};
use crate::{sun, values};

/// Largest relative difference of two factors that are the same number, written twice.
const SAME_FACTOR: f64 = 1e-4;

/// Sets quantity, scaling and sunlight of an array.
///
/// `RADIANCE_SCALING_FACTOR` and `RADIANCE_OFFSET`, of any group, give radiance. `REFLECTANCE_SCALING_FACTOR` gives I/F.
/// Otherwise `SCALING_FACTOR` and `OFFSET` of the image give what `UNITS` says, and counts without a unit.
pub(super) fn apply(odl: &Group, array: &mut Array, notes: &mut Vec<String>) {
    let units = odl
        .find(&["DERIVED_IMAGE_PARMS"])
        .and_then(|group| text(group, "UNITS"))
        .or_else(|| text(odl, "UNITS"));
    let unit = units.as_deref().and_then(units::read);
    let image = odl.find(&["IMAGE", "IMAGE_DATA"]);
    let own = image.and_then(|image| scaling(image, "SCALING_FACTOR", "OFFSET"));
    let own_factors = own.map(|own| own.factors).unwrap_or_default();
    let derived = |factor, offset| measured(odl).find_map(|group| scaling(group, factor, offset));
    let radiance =
        derived("RADIANCE_SCALING_FACTOR", "RADIANCE_OFFSET").filter(|_| unit != Some(Unit::Reflectance));
    let reflectance = derived("REFLECTANCE_SCALING_FACTOR", "REFLECTANCE_OFFSET");
    let (quantity, size, factors) = match (radiance, reflectance, unit) {
        (Some(radiance), ..) => match radiance.size(unit) {
            Ok(size) => {
                if !own_factors.is_empty() && differ(&own_factors, &radiance.factors) {
                    notes.push(
                        "SCALING_FACTOR is not RADIANCE_SCALING_FACTOR: the latter is taken".to_owned(),
                    );
                }
                (Quantity::Radiance, size, radiance.factors)
            }
            Err(unknown) => {
                notes.push(format!(
                    "the unit `{unknown}` of RADIANCE_SCALING_FACTOR is not one of radiance: its values are taken as counts"
                ));
                (Quantity::Counts, 1.0, Vec::new())
            }
        },
        (None, Some(reflectance), _) => (Quantity::Reflectance, 1.0, reflectance.factors),
        (None, None, Some(Unit::Radiance(size))) => (Quantity::Radiance, size, or_one(own_factors, size)),
        (None, None, Some(Unit::Reflectance)) => (Quantity::Reflectance, 1.0, own_factors),
        (None, None, None) => (Quantity::Counts, 1.0, own_factors),
    };
    array.quantity = quantity;
    array.scaling = factors
        .into_iter()
        .map(|(factor, offset)| (factor * size, offset * size))
        .collect();
    array.sunlight = sunlight(odl, array.shape[0]);
    let zenith = measured(odl).find_map(|group| values::number(group.text("RAD_ZENITH_SCALING_FACTOR")?));
    array.from_zenith = zenith.filter(|factor| *factor > 0.0);
}

/// Floating samples of another unit than W / (m2 sr nm) need a factor too.
fn or_one(factors: Vec<(f64, f64)>, size: f64) -> Vec<(f64, f64)> {
    if factors.is_empty() && size != 1.0 {
        return vec![(1.0, 0.0)];
    }
    factors
}

/// Returns all groups but those of requests.
fn measured(odl: &Group) -> impl Iterator<Item = &Group> {
    let groups = std::iter::once(odl).chain(odl.descendants());
    groups.filter(|group| !group.name.contains("REQUEST"))
}

/// Factors and offsets of an image, one for each band or one for all, and the unit of the factors.
struct Scaling {
    factors: Vec<(f64, f64)>,
    unit: Option<String>,
}

impl Scaling {
    /// Returns the size of its unit in W / (m2 sr nm), which it has without a unit.
    fn size(&self, units: Option<Unit>) -> Result<f64, String> {
        let Some(own) = &self.unit else {
            return Ok(match units {
                Some(Unit::Radiance(size)) => size,
                _ => 1.0,
            });
        };
        match units::read(own) {
            Some(Unit::Radiance(size)) => Ok(size),
            _ => Err(own.clone()),
        }
    }
}

/// Reads the scaling of a group. `None` without a factor other than 1, or if one is not a number (`N/A`).
fn scaling(group: &Group, factor: &str, offset: &str) -> Option<Scaling> {
    let factors = numbers(group.get(factor)?)?;
    let offsets = group.get(offset).and_then(numbers).unwrap_or_default();
    let offset_of = |band: usize| offsets.get(band).or(offsets.first()).copied().unwrap_or(0.0);
    let unit = match group.get(factor)?.items().first() {
        Some(Value::Unit(_, unit)) => values::known(unit),
        // VICAR has the unit in a key of its own.
        _ => text(group, &format!("{factor}__UNIT")),
    };
    let factors: Vec<(f64, f64)> = factors
        .into_iter()
        .enumerate()
        .map(|(band, factor)| (factor, offset_of(band)))
        .collect();
    let scales = factors.iter().any(|pair| *pair != (1.0, 0.0)) || unit.is_some();
    (scales && matches!(factors.len(), 1 | 3)).then_some(Scaling { factors, unit })
}

fn numbers(value: &Value) -> Option<Vec<f64>> {
    value
        .items()
        .iter()
        .map(|item| values::number(item.text()?))
        .collect()
}

fn differ(a: &[(f64, f64)], b: &[(f64, f64)]) -> bool {
    let other = |a: f64, b: f64| (a - b).abs() > SAME_FACTOR * a.abs().max(b.abs());
    a.len() != b.len() || a.iter().zip(b).any(|(a, b)| other(a.0, b.0) || other(a.1, b.1))
}

/// Returns the radiance of a white surface at the wavelengths of the label's filter, at its solar longitude.
fn sunlight(odl: &Group, bands: u32) -> Vec<f64> {
    let longitude = top(odl, "SOLAR_LONGITUDE").and_then(values::number);
    let state = odl.find(&["INSTRUMENT_STATE_PARMS"]);
    let wavelengths = state
        .and_then(|state| numbers(state.get("CENTER_FILTER_WAVELENGTH")?))
        .filter(|wavelengths| matches!(wavelengths.len(), 1 | 3))
        .unwrap_or_else(|| vec![sun::BROAD_BAND_NM]);
    // A mosaic in one band has three wavelengths: that of green is in the middle.
    let wavelengths = match (bands, wavelengths.as_slice()) {
        (1, [_, green, _]) => vec![*green],
        _ => wavelengths,
    };
    let light = |wavelength: f64| sun::white_radiance(wavelength, longitude);
    wavelengths.into_iter().map(light).collect()
}
