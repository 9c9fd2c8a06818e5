//! How a PDS4 label scales the elements of its array to radiance or I/F.

use roxmltree::Node;

use super::node::{IMG, PDS, child, children, number_at, text_at};
use crate::label::{Array, Quantity};
use crate::sun;
use crate::units::{self, Unit};

/// Classes of radiometric corrections, in today's and in older dictionaries.
const CORRECTIONS: [&str; 2] = ["Radiometric_Correction", "Radiometric_Correction_Parameters"];

/// Scales by the unit of the elements, if they have one.
pub(super) fn apply_unit(element: Node<'_, '_>, array: &mut Array) {
    match text_at(element, &[(PDS, "unit")])
        .as_deref()
        .and_then(units::read)
    {
        Some(Unit::Radiance(size)) => scale_radiance(array, size),
        Some(Unit::Reflectance) => array.quantity = Quantity::Reflectance,
        None => {}
    }
}

fn scale_radiance(array: &mut Array, size: f64) {
    array.quantity = Quantity::Radiance;
    if array.scaling.is_empty() && size != 1.0 {
        array.scaling.push((1.0, 0.0));
    }
    for (factor, offset) in &mut array.scaling {
        (*factor, *offset) = (*factor * size, *offset * size);
    }
}

/// Sets quantity, scaling and sunlight by the observation, where the unit of the elements has not set them.
pub(super) fn apply(area: Option<Node<'_, '_>>, imaging: Option<Node<'_, '_>>, array: &mut Array) {
    let longitude =
        area.and_then(|area| number_at(area, &[(PDS, "Time_Coordinates"), (PDS, "solar_longitude")]));
    let filters = imaging
        .into_iter()
        .flat_map(|imaging| children(imaging, IMG, "Optical_Filter"));
    let wavelengths: Vec<f64> = filters
        .filter_map(|filter| number_at(filter, &[(IMG, "center_filter_wavelength")]))
        .collect();
    array.sunlight = match wavelengths.len() {
        1 | 3 => wavelengths,
        _ => vec![sun::BROAD_BAND_NM],
    };
    for wavelength in &mut array.sunlight {
        *wavelength = sun::white_radiance(*wavelength, longitude);
    }
    let correction =
        imaging.and_then(|imaging| CORRECTIONS.iter().find_map(|name| child(imaging, IMG, name)));
    let Some(correction) = correction else { return };
    let number = |name| number_at(correction, &[(IMG, name)]);
    array.from_zenith = number("radiometric_zenith_scaling_factor").filter(|factor| *factor > 0.0);
    if array.quantity != Quantity::Counts {
        return;
    }
    let kind = text_at(correction, &[(IMG, "radiometric_type")]).unwrap_or_default();
    if array.scaling.is_empty()
        && let Some(factor) = number("radiance_scaling_factor")
    {
        array
            .scaling
            .push((factor, number("radiance_offset").unwrap_or(0.0)));
        array.quantity = Quantity::Radiance;
    } else if kind.to_ascii_uppercase().contains("RADIANCE") {
        array.quantity = Quantity::Radiance;
    } else if units::read(&kind) == Some(Unit::Reflectance) {
        array.quantity = Quantity::Reflectance;
    }
}
