//! PDS4 labels like those of the archive, with the elements that readers of camera models need.

use super::{
    encode::EncodedImage,
    lens::{Lens, Quaternion},
    math::V3,
    plan::{self, Product, View},
    tour::{Capture, Eye, MAST, Stop},
};

const HEAD: &str = r#"<?xml version="1.0" encoding="UTF-8"?>
<Product_Observational xmlns="http://pds.nasa.gov/pds4/pds/v1"
    xmlns:geom="http://pds.nasa.gov/pds4/geom/v1"
    xmlns:img="http://pds.nasa.gov/pds4/img/v1"
    xmlns:mars2020="http://pds.nasa.gov/pds4/mission/mars2020/v1">
"#;
/// Names of the rover motion counter's parts.
const COUNTERS: [&str; 10] = [
    "SITE", "DRIVE", "POSE", "ARM", "SHA", "DRILL", "RSM", "HGA", "BITCAR", "SEAL",
];

/// Input of a label.
pub struct Facts<'a> {
    pub sol: u32,
    pub view: &'a View,
    pub product: &'a Product,
    pub stop: &'a Stop,
    pub taken: &'a Capture,
    /// The camera model that the label states, in pixels of this file.
    pub labelled_lens: Lens,
    pub image: &'a EncodedImage,
}

/// Returns the label's XML.
pub fn xml(facts: &Facts<'_>) -> String {
    [
        HEAD.to_owned(),
        identification(facts),
        observation(facts),
        geometry(facts),
        imaging(facts),
        "    </Discipline_Area>\n  </Observation_Area>\n".to_owned(),
        file_area(facts),
        "</Product_Observational>\n".to_owned(),
    ]
    .concat()
}

fn identification(facts: &Facts<'_>) -> String {
    let id = &facts.product.id;
    let tail = id[..52].to_lowercase();
    format!(
        "  <Identification_Area>
    <logical_identifier>urn:nasa:pds:marf_demo:data:{tail}</logical_identifier>
    <version_id>1.0</version_id>
    <title>Procedural Mars of marf, not a photograph - {tail}</title>
    <information_model_version>1.16.0.0</information_model_version>
    <product_class>Product_Observational</product_class>
    <Alias_List>
      <Alias>
        <alternate_id>{id}</alternate_id>
        <comment>VICAR PRODUCT_ID</comment>
      </Alias>
    </Alias_List>
  </Identification_Area>
"
    )
}

fn observation(facts: &Facts<'_>) -> String {
    let eye = if facts.view.eye == Eye::Left {
        "Left"
    } else {
        "Right"
    };
    let (sol, clock) = (facts.sol, facts.product.clock_s);
    format!(
        "  <Observation_Area>
    <Primary_Result_Summary>
      <purpose>Science</purpose>
      <processing_level>Raw</processing_level>
    </Primary_Result_Summary>
    <Observing_System>
      <Observing_System_Component>
        <name>Mars 2020</name>
        <type>Host</type>
      </Observing_System_Component>
      <Observing_System_Component>
        <name>Mast Camera Zoom {eye}</name>
        <type>Instrument</type>
      </Observing_System_Component>
    </Observing_System>
    <Target_Identification>
      <name>Mars</name>
      <type>Planet</type>
    </Target_Identification>
    <Mission_Area>
      <mars2020:Mars2020_Parameters>
        <mars2020:Observation_Information>
          <mars2020:mission_phase_name>Surface Mission</mars2020:mission_phase_name>
          <mars2020:spacecraft_clock_start>{clock}.000</mars2020:spacecraft_clock_start>
          <mars2020:spacecraft_clock_stop>{clock}.010</mars2020:spacecraft_clock_stop>
          <mars2020:sol_number>{sol}</mars2020:sol_number>
        </mars2020:Observation_Information>
      </mars2020:Mars2020_Parameters>
    </Mission_Area>
    <Discipline_Area>
"
    )
}

fn geometry(facts: &Facts<'_>) -> String {
    let (attitude, offset) = (facts.stop.labelled.attitude, facts.stop.labelled.place);
    let identifier = counters(facts).map(|count| count.to_string()).join("_");
    format!(
        "      <geom:Geometry>
        <geom:Geometry_Lander>
{camera}          <geom:Coordinate_Space_Definition>
            <local_identifier>ROVER_NAV_FRAME_{identifier}</local_identifier>
            <geom:positive_azimuth_direction>Clockwise</geom:positive_azimuth_direction>
            <geom:positive_elevation_direction>Up</geom:positive_elevation_direction>
            <geom:Coordinate_Space_Present>
{present}            </geom:Coordinate_Space_Present>
{offset}            <geom:Quaternion_Plus_Direction>
{turn}              <geom:rotation_direction>Forward</geom:rotation_direction>
            </geom:Quaternion_Plus_Direction>
            <geom:Coordinate_Space_Reference>
{reference}            </geom:Coordinate_Space_Reference>
          </geom:Coordinate_Space_Definition>
          <geom:Motion_Counter>
            <geom:name>RMC</geom:name>
{motion}          </geom:Motion_Counter>
        </geom:Geometry_Lander>
      </geom:Geometry>
",
        camera = camera(facts),
        present = space("ROVER_NAV_FRAME", &indices(facts, "Coordinate_Space_Index", 10)),
        offset = position("Vector_Origin_Offset", offset),
        turn = quaternion(attitude),
        reference = space("SITE_FRAME", &indices(facts, "Coordinate_Space_Index", 1)),
        motion = indices(facts, "Motion_Counter_Index", 10),
    )
}

fn camera(facts: &Facts<'_>) -> String {
    let lens = &facts.labelled_lens;
    let unit = |name, v| vector(name, v, ["x_unit", "y_unit", "z_unit"], "");
    let pixel = |name, v| vector(name, v, ["x_pixel", "y_pixel", "z_pixel"], "");
    let [r0, r1, r2] = lens.r;
    [
        "          <geom:Camera_Model_Parameters>
            <geom:model_type>CAHVOR</geom:model_type>
            <geom:CAHVOR_Model>
"
        .to_owned(),
        position("Vector_Center", lens.c),
        unit("Vector_Axis", lens.a),
        pixel("Vector_Horizontal", lens.h),
        pixel("Vector_Vertical", lens.v),
        unit("Vector_Optical", lens.o),
        format!(
            "            <geom:Radial_Terms><geom:c0>{r0}</geom:c0><geom:c1>{r1}</geom:c1><geom:c2>{r2}</geom:c2></geom:Radial_Terms>
            </geom:CAHVOR_Model>
            <geom:Coordinate_Space_Reference>
{reference}            </geom:Coordinate_Space_Reference>
            <geom:Quaternion_Model_Transform>
{turn}            </geom:Quaternion_Model_Transform>
            <geom:Vector_Model_Transform><geom:x>{x}</geom:x><geom:y>{y}</geom:y><geom:z>{z}</geom:z></geom:Vector_Model_Transform>
          </geom:Camera_Model_Parameters>
",
            reference = space("ROVER_NAV_FRAME", &indices(facts, "Coordinate_Space_Index", 3)),
            turn = quaternion(facts.taken.mast),
            x = MAST.x,
            y = MAST.y,
            z = MAST.z,
        ),
    ]
    .concat()
}

fn counters(facts: &Facts<'_>) -> [u32; 10] {
    let mut counters = [0; 10];
    counters[0] = plan::site(facts.sol);
    counters[1] = facts.stop.drive;
    counters[6] = facts.view.pointing.rsm;
    counters
}

fn indices(facts: &Facts<'_>, element: &str, count: usize) -> String {
    let counters = counters(facts);
    let line = |index: usize| {
        let (name, value) = (COUNTERS[index], counters[index]);
        format!(
            "                <geom:{element}><geom:index_id>{name}</geom:index_id>\
             <geom:index_value_number>{value}</geom:index_value_number></geom:{element}>\n"
        )
    };
    (0..count).map(line).collect()
}

fn space(frame: &str, indices: &str) -> String {
    format!(
        "              <geom:Coordinate_Space_Indexed>
                <geom:coordinate_space_frame_type>{frame}</geom:coordinate_space_frame_type>
{indices}              </geom:Coordinate_Space_Indexed>
"
    )
}

fn position(element: &str, v: V3) -> String {
    let names = ["x_position", "y_position", "z_position"];
    vector(element, v, names, " unit=\"m\"")
}

/// Returns a number with nine decimals: a nanometre, and far below a pixel.
fn vector(element: &str, v: V3, names: [&str; 3], unit: &str) -> String {
    let parts = names.iter().zip(&v);
    let parts: String = parts
        .map(|(name, number)| format!("<geom:{name}{unit}>{number:.9}</geom:{name}>"))
        .collect();
    format!("              <geom:{element}>{parts}</geom:{element}>\n")
}

fn quaternion(q: Quaternion) -> String {
    let names = ["qcos", "qsin1", "qsin2", "qsin3"];
    let parts = names.iter().zip([q.w, q.i, q.j, q.k]);
    let parts: String = parts
        .map(|(name, number)| format!("<geom:{name}>{number:.12}</geom:{name}>"))
        .collect();
    format!("              {parts}\n")
}

fn imaging(facts: &Facts<'_>) -> String {
    let eye = if facts.view.eye == Eye::Left { 'L' } else { 'R' };
    let filter = facts.product.filter;
    let (name, wavelength) = match filter {
        1 => (format!("ZCAM_{eye}1_800NM"), 800),
        5 => (format!("ZCAM_{eye}5_528NM"), 528),
        _ => (format!("ZCAM_{eye}0_RGB"), 544),
    };
    format!(
        "      <img:Imaging>
        <img:Detector>
          <img:first_line>1</img:first_line>
          <img:first_sample>1</img:first_sample>
          <img:lines>{lines}</img:lines>
          <img:samples>{samples}</img:samples>
        </img:Detector>
        <img:Exposure><img:exposure_duration unit=\"ms\">10</img:exposure_duration></img:Exposure>
        <img:Optical_Filter>
          <img:filter_name>{name}</img:filter_name>
          <img:filter_number>{filter}</img:filter_number>
          <img:center_filter_wavelength unit=\"nm\">{wavelength}</img:center_filter_wavelength>
        </img:Optical_Filter>
      </img:Imaging>
",
        lines = facts.image.height,
        samples = facts.image.width,
    )
}

fn file_area(facts: &Facts<'_>) -> String {
    let axis = |number: u32, name: &str, elements: u32| {
        format!(
            "      <Axis_Array><axis_name>{name}</axis_name><elements>{elements}</elements>\
             <sequence_number>{number}</sequence_number></Axis_Array>\n"
        )
    };
    let axes = [
        axis(1, "Band", facts.image.bands),
        axis(2, "Line", facts.image.height),
        axis(3, "Sample", facts.image.width),
    ]
    .concat();
    format!(
        "  <File_Area_Observational>
    <File>
      <file_name>{file}</file_name>
      <comment>The array is what the image file decodes to.</comment>
    </File>
    <Array_3D_Image>
      <offset unit=\"byte\">0</offset>
      <axes>3</axes>
      <axis_index_order>Last Index Fastest</axis_index_order>
      <Element_Array><data_type>UnsignedByte</data_type></Element_Array>
{axes}    </Array_3D_Image>
  </File_Area_Observational>
",
        file = facts.product.file(),
    )
}
