//! PDS4 labels: XML, read by namespace and explicit path, never by a search through the whole document (which
//! would find the copies under commanded parameters).

mod array;
mod display;
mod guard;
mod mosaic;
mod node;
mod scaling;

use marf_scene::{Cahvor, RoverPlace};
use roxmltree::{Document, Node, ParsingOptions};

use crate::camera::{CameraError, entrance};
use crate::label::{Derived, FramePose, Label, MAX_LABEL_BYTES, ordered_counter, same_place};
use crate::values;
pub use guard::TooMuchWork;
use node::{IMG, PDS, at, child, children, number_at, text_at};

const GEOM: &str = "http://pds.nasa.gov/pds4/geom/v1";
const SURFACE: &str = "http://pds.nasa.gov/pds4/img_surface/v1";
const MSN: &str = "http://pds.nasa.gov/pds4/msn/v1";
const MARS2020: &str = "http://pds.nasa.gov/pds4/mission/mars2020/v1";
/// Real labels have up to 4,000 nodes.
const MAX_NODES: u32 = 200_000;

/// XML that is not a PDS4 label of an observation.
#[derive(Debug, thiserror::Error)]
pub enum Pds4Error {
    /// Larger than any label.
    #[error("{0} bytes of XML, at most {MAX_LABEL_BYTES} are read")]
    TooLarge(usize),
    /// Not UTF-8.
    #[error("XML that is not UTF-8")]
    Encoding,
    /// Not well-formed, with a document type, or of too many nodes.
    #[error("XML is refused: {0}")]
    Malformed(#[from] roxmltree::Error),
    /// More work for the parser than any label.
    #[error("XML is refused: {0}")]
    TooMuchWork(#[from] TooMuchWork),
    /// Another document.
    #[error("XML whose root is not `Product_Observational` of PDS4")]
    NoLabel,
}

/// Reads a PDS4 label.
///
/// # Errors
/// See [`Pds4Error`]. A label without a usable camera is not an error but a note.
pub fn read(bytes: &[u8]) -> Result<Label, Pds4Error> {
    if bytes.len() > MAX_LABEL_BYTES {
        return Err(Pds4Error::TooLarge(bytes.len()));
    }
    let text = std::str::from_utf8(bytes).map_err(|_| Pds4Error::Encoding)?;
    guard::check(bytes)?;
    let options = ParsingOptions {
        nodes_limit: MAX_NODES,
        ..ParsingOptions::default()
    };
    let document = Document::parse_with_options(text, options)?;
    let root = document.root_element();
    if !root.has_tag_name((PDS, "Product_Observational")) {
        return Err(Pds4Error::NoLabel);
    }
    Ok(label(root))
}

fn label(root: Node<'_, '_>) -> Label {
    let area = child(root, PDS, "Observation_Area");
    let discipline = area.and_then(|area| child(area, PDS, "Discipline_Area"));
    let imaging = discipline.and_then(|area| child(area, IMG, "Imaging"));
    let mut label = Label {
        product: product(root),
        sol: area.and_then(sol),
        instrument: area.and_then(instrument),
        filter: imaging.and_then(filter),
        focal_mm: imaging
            .and_then(|node| number_at(node, &[(IMG, "Optical_Properties"), (IMG, "focal_length")]))
            .filter(|focal| *focal > 0.0),
        averaged: imaging.and_then(averaged).unwrap_or(1),
        sensor: imaging.and_then(mosaic::sensor),
        interpolated: imaging
            .is_some_and(|imaging| mosaic::is(imaging, "color_filter_array_state", "Decoded")),
        ..Label::default()
    };
    label.array = array::read(root, &mut label.notes);
    if let Some(array) = &mut label.array {
        label.file = array::whole_file(root, array);
        array.bits = imaging.and_then(bits);
        array.companded_by = imaging.and_then(companded_by);
        scaling::apply(area, imaging, array);
    }
    label.size = label.array.as_ref().map(|array| (array.shape[2], array.shape[1]));
    label.mosaic = imaging.and_then(|node| mosaic::phase(node, &mut label.notes));
    label.derived = discipline.and_then(derived).unwrap_or_default();
    match discipline.and_then(geometry) {
        Some(lander) => add_camera(lander, &mut label),
        None => label.notes.push("label has no camera".to_owned()),
    }
    if let Some(lander) = discipline.and_then(lander).filter(|_| label.place.is_none()) {
        add_place(lander, &mut label);
    }
    label.drop_camera_of_turned_pixels();
    label
}

/// Returns the bits of a sample that are used.
fn bits(imaging: Node<'_, '_>) -> Option<u32> {
    let number = number_at(imaging, &[(IMG, "Sampling"), (IMG, "sample_bits")])
        .filter(|bits| (1.0..=32.0).contains(bits))
        .map(|bits| bits as u32);
    number.or_else(|| values::mask_bits(&text_at(imaging, &[(IMG, "Sampling"), (IMG, "sample_bit_mask")])?))
}

fn product(root: Node<'_, '_>) -> Option<String> {
    let identification = child(root, PDS, "Identification_Area")?;
    text_at(
        identification,
        &[(PDS, "Alias_List"), (PDS, "Alias"), (PDS, "alternate_id")],
    )
    .or_else(|| {
        let lid = text_at(identification, &[(PDS, "logical_identifier")])?;
        Some(lid.rsplit(':').next()?.to_ascii_uppercase())
    })
}

fn sol(area: Node<'_, '_>) -> Option<u32> {
    let mission = [
        (PDS, "Mission_Area"),
        (MARS2020, "Mars2020_Parameters"),
        (MARS2020, "Observation_Information"),
        (MARS2020, "sol_number"),
    ];
    let surface = [
        (PDS, "Discipline_Area"),
        (MSN, "Mission_Information"),
        (MSN, "Surface_Mission"),
        (MSN, "start_sol_number"),
    ];
    text_at(area, &mission)
        .or_else(|| text_at(area, &surface))
        .and_then(|text| values::sol(&text))
}

fn instrument(area: Node<'_, '_>) -> Option<String> {
    let system = child(area, PDS, "Observing_System")?;
    let component = children(system, PDS, "Observing_System_Component")
        .find(|component| text_at(*component, &[(PDS, "type")]).as_deref() == Some("Instrument"))?;
    text_at(component, &[(PDS, "name")])
}

fn filter(imaging: Node<'_, '_>) -> Option<String> {
    let filter = child(imaging, IMG, "Optical_Filter")?;
    text_at(filter, &[(IMG, "filter_number")]).or_else(|| text_at(filter, &[(IMG, "filter_name")]))
}

fn averaged(imaging: Node<'_, '_>) -> Option<u32> {
    let box_size = at(
        imaging,
        &[(IMG, "Downsampling"), (IMG, "Pixel_Averaging_Dimensions")],
    )?;
    let [height, width] = ["height_pixels", "width_pixels"].map(|name| number_at(box_size, &[(IMG, name)]));
    (height == width)
        .then_some(width?)
        .filter(|side| (1.0..=64.0).contains(side))
        .map(|side| side as u32)
}

/// Returns the look-up table whose codes the pixels are. Copies under commanded parameters are ignored.
fn companded_by(imaging: Node<'_, '_>) -> Option<String> {
    let companding = at(imaging, &[(IMG, "Sampling"), (IMG, "Companding")])?;
    let state = text_at(companding, &[(IMG, "companding_state")])?;
    state
        .eq_ignore_ascii_case("Companded")
        .then(|| text_at(companding, &[(IMG, "processing_algorithm")]))?
}

/// Returns the first geometry of a lander that has a camera model. Further ones are refined solutions.
fn geometry<'a, 'd>(discipline: Node<'a, 'd>) -> Option<Node<'a, 'd>> {
    let geometry = child(discipline, GEOM, "Geometry")?;
    children(geometry, GEOM, "Geometry_Lander")
        .find(|lander| child(*lander, GEOM, "Camera_Model_Parameters").is_some())
}

/// Returns the first geometry of a lander.
fn lander<'a, 'd>(discipline: Node<'a, 'd>) -> Option<Node<'a, 'd>> {
    child(child(discipline, GEOM, "Geometry")?, GEOM, "Geometry_Lander")
}

/// Returns what the values are, and in which frame.
fn derived(discipline: Node<'_, '_>) -> Option<Derived> {
    let node = at(
        discipline,
        &[
            (SURFACE, "Surface_Imaging"),
            (SURFACE, "Derived_Product_Parameters"),
        ],
    )?;
    let definitions: Vec<_> = lander(discipline)
        .map(|lander| children(lander, GEOM, "Coordinate_Space_Definition").collect())
        .unwrap_or_default();
    let reference =
        child(node, GEOM, "Coordinate_Space_Reference").and_then(|node| space(node, &definitions));
    let place = reference.map(|space| RoverPlace {
        site_from_frame: frame_pose(&space, &definitions).resolve(&mut Vec::new()),
        motion_counter: ordered_counter(&space.index),
        frame: space.frame,
    });
    let part = |name| number_at(node, &[(SURFACE, "Vector_Range_Origin"), (SURFACE, name)]);
    Some(Derived {
        kind: text_at(node, &[(SURFACE, "derived_image_type_name")]),
        place,
        origin: ["x_position", "y_position", "z_position"]
            .into_iter()
            .map(part)
            .collect::<Option<Vec<f64>>>()
            .and_then(|parts| parts.try_into().ok()),
    })
}

/// Adds where the rover stood, which does not need the camera.
fn add_place(lander: Node<'_, '_>, label: &mut Label) {
    let definitions: Vec<_> = children(lander, GEOM, "Coordinate_Space_Definition").collect();
    let rover = |space: &Space| space.frame.starts_with("ROVER");
    let Some(frame) = definitions.iter().filter_map(|node| present(*node)).find(rover) else {
        return;
    };
    let pose = frame_pose(&frame, &definitions);
    let counter = counter(lander, &frame, &mut label.notes);
    if !counter.is_empty() {
        label.set_place(frame.frame, pose, counter);
    }
}

fn add_camera(lander: Node<'_, '_>, label: &mut Label) {
    let Some(parameters) = child(lander, GEOM, "Camera_Model_Parameters") else {
        return;
    };
    let model = match model(parameters) {
        Ok(model) => model,
        Err(error) => return label.refuse_camera(&error),
    };
    let definitions: Vec<_> = children(lander, GEOM, "Coordinate_Space_Definition").collect();
    let reference =
        child(parameters, GEOM, "Coordinate_Space_Reference").and_then(|node| space(node, &definitions));
    let Some(reference) = reference else {
        label
            .notes
            .push("label has no usable camera: its frame is not named".to_owned());
        return;
    };
    let pose = frame_pose(&reference, &definitions);
    let counter = counter(lander, &reference, &mut label.notes);
    label.set_place(reference.frame, pose, counter);
    label.set_camera(&model);
}

/// Reads the model by the elements that are present: old dictionaries say CAHVORE above a CAHVOR.
fn model(parameters: Node<'_, '_>) -> Result<Cahvor, CameraError> {
    let named = |name| child(parameters, GEOM, name);
    let says_cahvore = text_at(parameters, &[(GEOM, "model_type")]).as_deref() == Some("CAHVORE");
    if let Some(node) = named("CAHVORE_Model") {
        let kind = number_at(node, &[(GEOM, "cahvore_model_type")]);
        let kind = kind.ok_or(CameraError::Number("cahvore_model_type"))? as i64;
        let parameter = number_at(node, &[(GEOM, "cahvore_model_parameter")]);
        let parameter = parameter.or((kind != 3).then_some(0.0));
        let parameter = parameter.ok_or(CameraError::Number("cahvore_model_parameter"))?;
        let terms = vector(node, "Entrance_Terms", "c0 c1 c2", "E")?;
        return Ok(Cahvor {
            e: Some(entrance(terms, kind, parameter)?),
            ..cahvor(node)?
        });
    }
    if says_cahvore {
        return Err(CameraError::Number("E of a CAHVORE"));
    }
    match (named("CAHVOR_Model"), named("CAHV_Model")) {
        (Some(node), _) => cahvor(node),
        (None, Some(node)) => cahv(node),
        (None, None) => Err(CameraError::Number("a CAHV, CAHVOR or CAHVORE model")),
    }
}

fn cahv(node: Node<'_, '_>) -> Result<Cahvor, CameraError> {
    Ok(Cahvor {
        c: vector(node, "Vector_Center", "x_position y_position z_position", "C")?,
        a: vector(node, "Vector_Axis", "x_unit y_unit z_unit", "A")?,
        h: vector(node, "Vector_Horizontal", "x_pixel y_pixel z_pixel", "H")?,
        v: vector(node, "Vector_Vertical", "x_pixel y_pixel z_pixel", "V")?,
        o: None,
        r: None,
        e: None,
    })
}

/// Reads O under its new or its old name, and R.
fn cahvor(node: Node<'_, '_>) -> Result<Cahvor, CameraError> {
    let o = vector(node, "Vector_Optical", "x_unit y_unit z_unit", "O")
        .or_else(|_| vector(node, "Optical_Terms", "c0 c1 c2", "O"))?;
    Ok(Cahvor {
        o: Some(o),
        r: Some(vector(node, "Radial_Terms", "c0 c1 c2", "R")?),
        ..cahv(node)?
    })
}

fn vector(
    node: Node<'_, '_>,
    name: &str,
    parts: &str,
    letter: &'static str,
) -> Result<[f64; 3], CameraError> {
    let node = child(node, GEOM, name).ok_or(CameraError::Number(letter))?;
    let numbers: Option<Vec<f64>> = parts
        .split(' ')
        .map(|part| number_at(node, &[(GEOM, part)]))
        .collect();
    numbers
        .and_then(|numbers| numbers.try_into().ok())
        .ok_or(CameraError::Number(letter))
}

/// A frame with the counters it is valid for.
struct Space {
    frame: String,
    index: Vec<(String, i64)>,
}

/// Reads a reference to a frame: by type and index, or by the identifier of a definition.
fn space(reference: Node<'_, '_>, definitions: &[Node<'_, '_>]) -> Option<Space> {
    if let Some(indexed) = child(reference, GEOM, "Coordinate_Space_Indexed") {
        return Some(Space {
            frame: text_at(indexed, &[(GEOM, "coordinate_space_frame_type")])?,
            index: index(indexed, "Coordinate_Space_Index"),
        });
    }
    let local = child(reference, PDS, "Local_Internal_Reference")
        .or_else(|| child(reference, GEOM, "Local_Internal_Reference"))?;
    let wanted = text_at(local, &[(PDS, "local_identifier_reference")])?;
    let names = |node: &Node<'_, '_>| {
        children(*node, PDS, "local_identifier")
            .any(|name| name.text().map(str::trim) == Some(wanted.as_str()))
    };
    present(*definitions.iter().find(|node| names(node))?)
}

fn present(definition: Node<'_, '_>) -> Option<Space> {
    let indexed = at(
        definition,
        &[
            (GEOM, "Coordinate_Space_Present"),
            (GEOM, "Coordinate_Space_Indexed"),
        ],
    )?;
    Some(Space {
        frame: text_at(indexed, &[(GEOM, "coordinate_space_frame_type")])?,
        index: index(indexed, "Coordinate_Space_Index"),
    })
}

/// Returns counters by name. Older labels call the name `index_name`.
fn index(node: Node<'_, '_>, element: &str) -> Vec<(String, i64)> {
    let read = |entry: Node<'_, '_>| {
        let name =
            text_at(entry, &[(GEOM, "index_id")]).or_else(|| text_at(entry, &[(GEOM, "index_name")]))?;
        Some((
            name,
            values::integer(&text_at(entry, &[(GEOM, "index_value_number")])?)?,
        ))
    };
    node.children()
        .filter(|child| child.has_tag_name((GEOM, element)))
        .filter_map(read)
        .collect()
}

/// Returns the definition of exactly this frame and these counters, relative to a site.
///
/// MSL labels hold a second, mislabelled definition of ROVER_NAV_FRAME: hence every counter must be there.
fn frame_pose(reference: &Space, definitions: &[Node<'_, '_>]) -> FramePose {
    if reference.frame == "SITE_FRAME" {
        return FramePose::IsSite;
    }
    let fits = |node: &&Node<'_, '_>| {
        present(**node).is_some_and(|space| {
            // Definitions without counters are matched by frame alone.
            let counters =
                space.index.is_empty() || reference.index.iter().all(|entry| space.index.contains(entry));
            space.frame == reference.frame && counters
        }) && child(**node, GEOM, "Coordinate_Space_Reference")
            .and_then(|node| space(node, definitions))
            .is_some_and(|space| space.frame == "SITE_FRAME" && same_place(&space.index, &reference.index))
    };
    definitions
        .iter()
        .find(fits)
        .and_then(|node| definition_pose(*node))
        .unwrap_or(FramePose::Unknown)
}

fn definition_pose(definition: Node<'_, '_>) -> Option<FramePose> {
    let offset = vector(
        definition,
        "Vector_Origin_Offset",
        "x_position y_position z_position",
        "offset",
    )
    .ok()?;
    let node = child(definition, GEOM, "Quaternion_Plus_Direction")
        .or_else(|| child(definition, GEOM, "Quaternion_1"))?;
    let part = |name| number_at(node, &[(GEOM, name)]);
    let [w, x, y, z] = [part("qcos")?, part("qsin1")?, part("qsin2")?, part("qsin3")?];
    let reverse = text_at(node, &[(GEOM, "rotation_direction")]).is_some_and(|word| word != "Forward");
    let quaternion = if reverse { [w, -x, -y, -z] } else { [w, x, y, z] };
    Some(FramePose::Given { quaternion, offset })
}

/// Returns the rover's counters at the photo, or those of the camera's frame if they differ.
fn counter(lander: Node<'_, '_>, reference: &Space, notes: &mut Vec<String>) -> Vec<i64> {
    let whole = child(lander, GEOM, "Motion_Counter").map(|node| index(node, "Motion_Counter_Index"));
    let whole = whole.unwrap_or_default();
    if !same_place(&whole, &reference.index) {
        notes.push(format!(
            "label's motion counter {:?} is not that of its camera's frame {:?}: the latter is taken",
            ordered_counter(&whole),
            ordered_counter(&reference.index)
        ));
        return ordered_counter(&reference.index);
    }
    let counter = ordered_counter(&whole);
    if counter.is_empty() {
        return ordered_counter(&reference.index);
    }
    counter
}

#[cfg(test)]
mod tests;
