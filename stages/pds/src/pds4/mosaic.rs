//! The colour mosaic of a label's detector.

use marf_scene::Sensor;
use roxmltree::Node;

use super::node::{IMG, at, child, number_at};
use crate::label::BayerPhase;

/// Whether an element on the colour filter array has this value.
pub(super) fn is(imaging: Node<'_, '_>, name: &str, word: &str) -> bool {
    // Read as it is: `None` is a type of array.
    let node = at(imaging, &[(IMG, "Color_Filter_Array"), (IMG, name)]);
    node.and_then(|node| node.text())
        .is_some_and(|text| text.trim().eq_ignore_ascii_case(word))
}

/// Returns whether the camera sees colour, where the label describes its colour filter array.
pub(super) fn sensor(imaging: Node<'_, '_>) -> Option<Sensor> {
    if is(imaging, "color_filter_array_type", "None") {
        return Some(Sensor::Monochrome);
    }
    child(imaging, IMG, "Color_Filter_Array").map(|_| Sensor::Color)
}

/// Returns the phase of the colour mosaic, if by the label the pixels are not interpolated.
pub(super) fn phase(imaging: Node<'_, '_>, notes: &mut Vec<String>) -> Option<BayerPhase> {
    let says = |name, word| is(imaging, name, word);
    if !(says("color_filter_array_state", "Encoded") && says("color_filter_array_type", "Bayer RGGB")) {
        return None;
    }
    let first = |name| number_at(imaging, &[(IMG, "Detector"), (IMG, name)]).filter(|first| *first >= 1.0);
    match (first("first_line"), first("first_sample")) {
        (Some(line), Some(sample)) => Some(BayerPhase {
            line: line as u32 - 1,
            sample: sample as u32 - 1,
        }),
        _ => {
            notes.push(
                "label does not say where on the detector the mosaic starts: taken as its first pixel".into(),
            );
            Some(BayerPhase::default())
        }
    }
}
