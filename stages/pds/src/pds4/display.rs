//! Directions in which a PDS4 label displays an array.

use roxmltree::Node;

use super::node::{PDS, at, children, text_at};
use crate::label::Array;

const DISP: &str = "http://pds.nasa.gov/pds4/disp/v1";

/// Sets the directions of the array of this identifier: those of the first display settings that name it, or that name
/// no array.
pub(super) fn set_directions(root: Node<'_, '_>, identifier: Option<String>, array: &mut Array) {
    let area = at(root, &[(PDS, "Observation_Area"), (PDS, "Discipline_Area")]);
    let settings = area
        .into_iter()
        .flat_map(|area| children(area, DISP, "Display_Settings"))
        .find(|settings| {
            let named = reference(*settings);
            named.is_none() || identifier.is_none() || named == identifier
        });
    let says = |name, word: &str| {
        settings
            .and_then(|settings| text_at(settings, &[(DISP, "Display_Direction"), (DISP, name)]))
            .is_some_and(|text| text.eq_ignore_ascii_case(word))
    };
    array.upside_down = says("vertical_display_direction", "Bottom to Top");
    array.mirrored = says("horizontal_display_direction", "Right to Left");
}

/// Returns the identifier of the array that display settings are for.
fn reference(settings: Node<'_, '_>) -> Option<String> {
    [PDS, DISP].into_iter().find_map(|namespace| {
        [PDS, DISP].into_iter().find_map(|inner| {
            let path = [
                (namespace, "Local_Internal_Reference"),
                (inner, "local_identifier_reference"),
            ];
            text_at(settings, &path)
        })
    })
}
