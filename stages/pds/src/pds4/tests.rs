use super::array::sample;
use super::*;
use crate::label::SampleKind;

/// The fragment of the reference, in a whole label with invented values.
fn document(camera: &str, definition: &str) -> String {
    format!(
        r#"<?xml version="1.0"?>
<Product_Observational xmlns="http://pds.nasa.gov/pds4/pds/v1" xmlns:g="http://pds.nasa.gov/pds4/geom/v1"
  xmlns:img="http://pds.nasa.gov/pds4/img/v1" xmlns:m="http://pds.nasa.gov/pds4/mission/mars2020/v1">
<Identification_Area><logical_identifier>urn:nasa:pds:demo:data:abc</logical_identifier></Identification_Area>
<Observation_Area>
 <Observing_System><Observing_System_Component><name>Rover</name><type>Host</type></Observing_System_Component>
  <Observing_System_Component><name>Navcam</name><type>Instrument</type></Observing_System_Component></Observing_System>
 <Mission_Area><m:Mars2020_Parameters><m:Observation_Information><m:sol_number>12</m:sol_number>
  </m:Observation_Information></m:Mars2020_Parameters></Mission_Area>
 <Discipline_Area>
  <img:Imaging><img:Commanded_Parameters><img:Optical_Filter><img:filter_number>7</img:filter_number></img:Optical_Filter>
   </img:Commanded_Parameters><img:Optical_Filter><img:filter_number>0</img:filter_number></img:Optical_Filter></img:Imaging>
  <g:Geometry><g:Geometry_Lander>{camera}{definition}
   <g:Motion_Counter><g:Motion_Counter_Index><g:index_id>SITE</g:index_id><g:index_value_number>7</g:index_value_number></g:Motion_Counter_Index>
   <g:Motion_Counter_Index><g:index_name>DRIVE</g:index_name><g:index_value_number>42</g:index_value_number></g:Motion_Counter_Index></g:Motion_Counter>
  </g:Geometry_Lander></g:Geometry>
 </Discipline_Area>
</Observation_Area>
</Product_Observational>"#
    )
}

const CAMERA: &str = r"<g:Camera_Model_Parameters><g:model_type>CAHVORE</g:model_type><g:CAHVORE_Model>
<g:cahvore_model_type>3</g:cahvore_model_type><g:cahvore_model_parameter>0.6</g:cahvore_model_parameter>
<g:Entrance_Terms><g:c0>-0.0036</g:c0><g:c1>0.013</g:c1><g:c2>-0.024</g:c2></g:Entrance_Terms>
<g:Vector_Center><g:x_position>0.9</g:x_position><g:y_position>0.4</g:y_position><g:z_position>-1.9</g:z_position></g:Vector_Center>
<g:Vector_Axis><g:x_unit>1</g:x_unit><g:y_unit>0</g:y_unit><g:z_unit>0</g:z_unit></g:Vector_Axis>
<g:Vector_Horizontal><g:x_pixel>640</g:x_pixel><g:y_pixel>740</g:y_pixel><g:z_pixel>0</g:z_pixel></g:Vector_Horizontal>
<g:Vector_Vertical><g:x_pixel>480</g:x_pixel><g:y_pixel>0</g:y_pixel><g:z_pixel>740</g:z_pixel></g:Vector_Vertical>
<g:Vector_Optical><g:x_unit>0.9999975</g:x_unit><g:y_unit>0.002</g:y_unit><g:z_unit>-0.001</g:z_unit></g:Vector_Optical>
<g:Radial_Terms><g:c0>0</g:c0><g:c1>0.05</g:c1><g:c2>-0.017</g:c2></g:Radial_Terms></g:CAHVORE_Model>
<g:Coordinate_Space_Reference><g:Coordinate_Space_Indexed><g:coordinate_space_frame_type>ROVER_NAV_FRAME</g:coordinate_space_frame_type>
<g:Coordinate_Space_Index><g:index_id>SITE</g:index_id><g:index_value_number>7</g:index_value_number></g:Coordinate_Space_Index>
<g:Coordinate_Space_Index><g:index_id>DRIVE</g:index_id><g:index_value_number>42</g:index_value_number></g:Coordinate_Space_Index>
</g:Coordinate_Space_Indexed></g:Coordinate_Space_Reference></g:Camera_Model_Parameters>";

fn definition(drive: i64, yaw_sine: &str) -> String {
    format!(
        r"<g:Coordinate_Space_Definition><local_identifier>ROVER_{drive}</local_identifier>
<g:Coordinate_Space_Present><g:Coordinate_Space_Indexed><g:coordinate_space_frame_type>ROVER_NAV_FRAME</g:coordinate_space_frame_type>
<g:Coordinate_Space_Index><g:index_id>SITE</g:index_id><g:index_value_number>7</g:index_value_number></g:Coordinate_Space_Index>
<g:Coordinate_Space_Index><g:index_id>DRIVE</g:index_id><g:index_value_number>{drive}</g:index_value_number></g:Coordinate_Space_Index>
</g:Coordinate_Space_Indexed></g:Coordinate_Space_Present>
<g:Vector_Origin_Offset><g:x_position unit='m'>12.5</g:x_position><g:y_position>-3.25</g:y_position><g:z_position>0.125</g:z_position></g:Vector_Origin_Offset>
<g:Quaternion_Plus_Direction><g:qcos>0.8</g:qcos><g:qsin1>0</g:qsin1><g:qsin2>0</g:qsin2><g:qsin3>{yaw_sine}</g:qsin3><g:rotation_direction>Forward</g:rotation_direction></g:Quaternion_Plus_Direction>
<g:Coordinate_Space_Reference><g:Coordinate_Space_Indexed><g:coordinate_space_frame_type>SITE_FRAME</g:coordinate_space_frame_type></g:Coordinate_Space_Indexed></g:Coordinate_Space_Reference>
</g:Coordinate_Space_Definition>"
    )
}

fn label(camera: &str, definition: &str) -> Label {
    read(document(camera, definition).as_bytes()).unwrap()
}

#[test]
fn every_number_of_a_cahvore_label_is_read() {
    let label = label(CAMERA, &definition(42, "0.6"));
    assert_eq!((label.sol, label.product.as_deref()), (Some(12), Some("ABC")));
    assert_eq!(
        (label.instrument.as_deref(), label.filter.as_deref()),
        (Some("Navcam"), Some("0"))
    );
    let prior = label.prior.unwrap();
    assert_eq!(prior.frame, "ROVER_NAV_FRAME");
    assert_eq!(prior.motion_counter, [7, 42]);
    assert_eq!(
        (prior.model.c, prior.model.v),
        ([0.9, 0.4, -1.9], [480.0, 0.0, 740.0])
    );
    let e = prior.model.e.unwrap();
    assert_eq!((e.terms, e.linearity), ([-0.0036, 0.013, -0.024], 0.6));
    let site = prior.site_from_frame.unwrap().point(&nalgebra::Vector3::x());
    assert!(
        (site - nalgebra::Vector3::new(12.78, -2.29, 0.125)).norm() < 1e-12,
        "{site}"
    );
    assert!(label.notes.is_empty(), "{:?}", label.notes);
}

#[test]
fn a_definition_of_other_counters_is_not_taken() {
    let both = definition(41, "-0.6") + &definition(42, "0.6");
    let pose = label(CAMERA, &both).prior.unwrap().site_from_frame.unwrap();
    assert!(pose.rotation[(1, 0)] > 0.9, "{pose:?}");
    let other = label(CAMERA, &definition(41, "0.6"));
    assert!(other.prior.unwrap().site_from_frame.is_none());
    assert!(other.notes[0].contains("does not place"), "{:?}", other.notes);
}

/// Label order ARM, POSE, DRIVE, SITE. The camera's frame counts site 7, drive 42.
#[test]
fn the_counters_are_those_of_the_cameras_frame_in_the_promised_order() {
    let with = |counters: &[(&str, i64)]| {
        let whole = document(CAMERA, &definition(42, "0.6"));
        let start = whole.find("<g:Motion_Counter>").unwrap();
        let end = whole.find("</g:Motion_Counter>").unwrap();
        let entry = |(name, value): &(&str, i64)| {
            format!(
                "<g:Motion_Counter_Index><g:index_id>{name}</g:index_id>\
                 <g:index_value_number>{value}</g:index_value_number></g:Motion_Counter_Index>"
            )
        };
        let entries: String = counters.iter().map(entry).collect();
        let label = format!("{}<g:Motion_Counter>{entries}{}", &whole[..start], &whole[end..]);
        let label = read(label.as_bytes()).unwrap();
        (label.prior.unwrap().motion_counter, label.notes)
    };
    assert_eq!(
        with(&[("ARM", 120), ("POSE", 62), ("DRIVE", 42), ("SITE", 7)]),
        (vec![7, 42, 62, 120], vec![])
    );
    assert_eq!(with(&[]), (vec![7, 42], vec![]));
    let (counter, notes) = with(&[("SITE", 7), ("DRIVE", 43), ("POSE", 1)]);
    assert_eq!(counter, [7, 42]);
    assert!(
        notes[0].contains("[7, 43, 1] is not that of its camera's frame [7, 42]"),
        "{notes:?}"
    );
}

#[test]
fn a_pose_in_another_site_is_not_taken() {
    let reference = "<g:coordinate_space_frame_type>SITE_FRAME</g:coordinate_space_frame_type>";
    let index = |site: i64| {
        format!(
            "{reference}<g:Coordinate_Space_Index><g:index_id>SITE</g:index_id>\
             <g:index_value_number>{site}</g:index_value_number></g:Coordinate_Space_Index>"
        )
    };
    for (site, placed) in [(7, true), (6, false)] {
        let definition = definition(42, "0.6").replace(reference, &index(site));
        let label = label(CAMERA, &definition);
        assert_eq!(
            label.prior.unwrap().site_from_frame.is_some(),
            placed,
            "site {site}"
        );
    }
}

/// Constants of every kind, codes and the copy under commanded parameters that says otherwise.
#[test]
fn an_array_says_which_values_are_special_and_whether_they_are_codes() {
    let with = |state: &str| {
        let array = "<File_Area_Observational><File><file_name>A.IMG</file_name></File><Array_2D_Image>\
            <offset unit='byte'>64</offset><Element_Array><data_type>IEEE754MSBSingle</data_type></Element_Array>\
            <Axis_Array><axis_name>Line</axis_name><elements>8</elements><sequence_number>1</sequence_number></Axis_Array>\
            <Axis_Array><axis_name>Sample</axis_name><elements>6</elements><sequence_number>2</sequence_number></Axis_Array>\
            <Special_Constants><saturated_constant>16#FF7FFFFE#</saturated_constant>\
            <missing_constant>-3.4028226550889045e+38</missing_constant><unknown_constant>-1</unknown_constant>\
            <high_instrument_saturation>9</high_instrument_saturation></Special_Constants>\
            </Array_2D_Image></File_Area_Observational></Product_Observational>";
        let companding = |state: &str| {
            format!(
                "<img:Sampling><img:Companding><img:processing_algorithm>MMM_LUT0</img:processing_algorithm>\
                 <img:companding_state>{state}</img:companding_state></img:Companding></img:Sampling>"
            )
        };
        let whole = document(CAMERA, &definition(42, "0.6"))
            .replace("</Product_Observational>", array)
            .replace(
                "<img:Commanded_Parameters>",
                &format!("<img:Commanded_Parameters>{}", companding("Companded")),
            )
            .replace("</img:Imaging>", &format!("{}</img:Imaging>", companding(state)));
        read(whole.as_bytes()).unwrap().array.unwrap()
    };
    let array = with("Companded");
    assert_eq!(array.missing, [f64::from(f32::from_bits(0xff7f_fffb)), -1.0]);
    assert_eq!(array.saturated, [f64::from(f32::from_bits(0xff7f_fffe)), 9.0]);
    assert_eq!(
        (array.companded_by.as_deref(), array.file.as_deref()),
        (Some("MMM_LUT0"), Some("A.IMG"))
    );
    assert_eq!(with("Expanded").companded_by, None);
}

#[test]
fn a_reverse_rotation_is_turned_round() {
    let reverse = definition(42, "0.6").replace("Forward", "Reverse");
    let pose = label(CAMERA, &reverse).prior.unwrap().site_from_frame.unwrap();
    assert!((pose.rotation[(1, 0)] + 0.96).abs() < 1e-12, "{pose:?}");
}

#[test]
fn aliases_of_old_dictionaries_are_read() {
    let cahvor = CAMERA
        .replace("CAHVORE_Model", "CAHVOR_Model")
        .replace("CAHVORE</g:model_type>", "CAHVOR</g:model_type>")
        .replace("Vector_Optical", "Optical_Terms");
    let old = cahvor.replace(
        "<g:Optical_Terms><g:x_unit>0.9999975</g:x_unit><g:y_unit>0.002</g:y_unit><g:z_unit>-0.001</g:z_unit>",
        "<g:Optical_Terms><g:c0>0.9999975</g:c0><g:c1>0.002</g:c1><g:c2>-0.001</g:c2>",
    );
    let quaternion = definition(42, "0.6").replace("Quaternion_Plus_Direction", "Quaternion_1");
    let read = label(&old, &quaternion);
    let prior = read.prior.unwrap();
    assert!((prior.model.o.unwrap()[1] - 0.002).abs() < 1e-8 && prior.model.e.is_none());
    assert!(prior.site_from_frame.is_some());
}

#[test]
fn a_cahvore_without_e_is_refused() {
    let bad = CAMERA.replace("CAHVORE_Model", "CAHVOR_Model");
    let label = label(&bad, &definition(42, "0.6"));
    assert!(
        label.prior.is_none() && label.notes[0].contains("E of a CAHVORE"),
        "{:?}",
        label.notes
    );
}

#[test]
fn hostile_numbers_leave_the_photo_without_a_camera() {
    for bad in [
        "NaN", "INF", "-inf", "1e999", "0x10", "1_5", "", "1.0e+30", "999999", "1,5",
    ] {
        let camera = CAMERA.replace("<g:x_unit>1</g:x_unit>", &format!("<g:x_unit>{bad}</g:x_unit>"));
        let label = label(&camera, &definition(42, "0.6"));
        assert!(label.prior.is_none(), "{bad}");
        assert!(
            label.notes[0].contains("no usable camera"),
            "{bad}: {:?}",
            label.notes
        );
    }
}

#[test]
fn other_documents_are_refused() {
    let dtd = "<?xml version=\"1.0\"?><!DOCTYPE l [<!ENTITY x \"y\">]><l>&x;</l>";
    let deep = "<a>".repeat(100_000) + &"</a>".repeat(100_000);
    let wide = format!("<a>{}</a>", "<b/>".repeat(300_000));
    for bad in [
        "",
        "<a/>",
        "no xml",
        dtd,
        &deep,
        &wide,
        "<Product_Observational/>",
    ] {
        assert!(read(bad.as_bytes()).is_err(), "{:.30}", bad);
    }
    assert!(matches!(
        read(&vec![b' '; MAX_LABEL_BYTES + 1]),
        Err(Pds4Error::TooLarge(_))
    ));
    assert!(matches!(read(b"<a>\xff</a>"), Err(Pds4Error::Encoding)));
}

#[test]
fn types_of_samples_are_read() {
    let read = |name| sample(name).map(|sample| (sample.kind, sample.bytes, sample.big_endian));
    assert_eq!(read("SignedMSB2"), Some((SampleKind::Signed, 2, true)));
    assert_eq!(read("UnsignedByte"), Some((SampleKind::Unsigned, 1, true)));
    assert_eq!(read("UnsignedLSB4"), Some((SampleKind::Unsigned, 4, false)));
    assert_eq!(read("IEEE754MSBSingle"), Some((SampleKind::Float, 4, true)));
    assert_eq!(read("IEEE754LSBDouble"), Some((SampleKind::Float, 8, false)));
    for bad in [
        "ComplexMSB16",
        "SignedMSB3",
        "Signed",
        "",
        "IEEE754MSB2",
        "SignedMSBByte2",
    ] {
        assert_eq!(read(bad), None, "{bad}");
    }
}
