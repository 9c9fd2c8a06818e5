//! Ranges of products of geometry, against values computed by hand.
//!
//! The rover is at (10, 20, 0.5) of site 3 and faces east, so that the camera at (1, 0, -2) of the rover is at (10, 21, -1.5). The
//! ground is the plane z = 1.5, 3 m below: points at (4, 0), (0, -1.25) and (12, 4) from below the camera are 5, 3.25 and 13 m away.
#![allow(clippy::unwrap_used, reason = "helpers of tests are not seen as tests")]

use marf_pds::ranges::{Geometry, Product, RangeError, label, read};
use marf_pds::{Label, ProductName, pds4};

/// Quaternions of labels have 11 digits here.
const TOLERANCE_M: f64 = 1e-9;
const POINTS: [[f32; 4]; 3] = [
    [14.0, 10.0, 0.0, 22.0],
    [21.0, 19.75, 0.0, 25.0],
    [1.5, 1.5, 0.0, 1.5],
];
const RANGES: [f32; 4] = [5.0, 3.25, 0.0, 13.0];
const YAW: &str = "(0.70710678119,0,0,0.70710678119)";
const AT_SITE: &str = "REFERENCE_COORD_SYSTEM_NAME=SITE_FRAME;REFERENCE_COORD_SYSTEM_INDEX=3";
const ORIGIN: &str = "RANGE_ORIGIN_VECTOR=(10,21,-1.5)";

/// The groups of a label: name, and keys with values.
fn groups(kind: &str, derived: &str, centre: &str) -> Vec<(&'static str, String)> {
    vec![
        (
            "DERIVED_IMAGE_PARMS",
            format!("DERIVED_IMAGE_TYPE={kind};{derived}"),
        ),
        (
            "ROVER_COORDINATE_SYSTEM",
            format!(
                "COORDINATE_SYSTEM_NAME=ROVER_NAV_FRAME;COORDINATE_SYSTEM_INDEX=(3,7,0);{AT_SITE};\
                 ORIGIN_OFFSET_VECTOR=(10,20,0.5);ORIGIN_ROTATION_QUATERNION={YAW}"
            ),
        ),
        (
            "GEOMETRIC_CAMERA_MODEL",
            format!(
                "MODEL_TYPE=CAHV;MODEL_COMPONENT_1={centre};MODEL_COMPONENT_2=(1,0,0);MODEL_COMPONENT_3=(0,100,0);\
                 MODEL_COMPONENT_4=(0,0,100);REFERENCE_COORD_SYSTEM_NAME=ROVER_NAV_FRAME;\
                 REFERENCE_COORD_SYSTEM_INDEX=(3,7,0)"
            ),
        ),
    ]
}

/// A PDS3 label of 2 x 2 floats a band, or of 31 x 1.
fn pds3(groups: &[(&str, String)], head: &str, image: &str) -> String {
    let group = |(name, keys): &(&str, String)| {
        let keys = keys.replace(';', "\n").replace('=', " = ");
        format!("GROUP = {name}\n{keys}\nEND_GROUP = {name}\n")
    };
    let groups: String = groups.iter().map(group).collect();
    format!(
        "PDS_VERSION_ID = PDS3\n{head}\nROVER_MOTION_COUNTER = (3,7,0)\n{groups}OBJECT = IMAGE\nSAMPLE_BITS = 32\n{image}\n\
         END_OBJECT = IMAGE\nEND\n"
    )
}

fn detached(groups: &[(&str, String)], image: &str) -> Label {
    label(pds3(groups, "^IMAGE = \"A.IMG\"", image).as_bytes()).unwrap()
}

fn image(bands: usize, more: &str) -> String {
    format!("LINES = 2\nLINE_SAMPLES = 2\nBANDS = {bands}\n{more}")
}

fn msb(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|value| value.to_be_bytes()).collect()
}

fn lsb(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|value| value.to_le_bytes()).collect()
}

#[track_caller]
fn assert_ranges(product: Result<Product, RangeError>, what: &str) {
    let product = product.unwrap_or_else(|error| panic!("{what}: {error}"));
    let found = product
        .ranges(None)
        .unwrap_or_else(|error| panic!("{what}: {error}"));
    for (found, expected) in found.iter().zip(RANGES) {
        let same = match found {
            Some(found) => (found - f64::from(expected)).abs() < TOLERANCE_M,
            None => expected == 0.0,
        };
        assert!(same, "{what}: {found:?}, not {expected}");
    }
}

#[test]
fn coordinates_and_ranges_of_pds3_are_read_in_every_layout() {
    let points = groups("XYZ_MAP", AT_SITE, "(1,0,-2)");
    let [x, y, z] = POINTS;
    let sequential = POINTS.concat();
    let lines = [&x[..2], &y[..2], &z[..2], &x[2..], &y[2..], &z[2..]].concat();
    let pixels: Vec<f32> = (0..4).flat_map(|at| [x[at], y[at], z[at]]).collect();
    for (order, values) in [
        ("BAND_SEQUENTIAL", sequential),
        ("LINE_INTERLEAVED", lines),
        ("SAMPLE_INTERLEAVED", pixels),
    ] {
        for (kind, bytes) in [("IEEE_REAL", msb(&values)), ("PC_REAL", lsb(&values))] {
            let image = image(3, &format!("SAMPLE_TYPE = {kind}\nBAND_STORAGE_TYPE = {order}"));
            let what = format!("{order}, {kind}");
            assert_ranges(read(None, &bytes, Some(&detached(&points, &image))), &what);
            let mut file = pds3(&points, "RECORD_BYTES = 4096\n^IMAGE = 2", &image).into_bytes();
            file.resize(4096, b' ');
            file.extend(&bytes);
            assert_ranges(read(None, &file, None), &format!("{what}, attached"));
        }
    }
    let ranges = groups("RANGE_MAP", &format!("{AT_SITE};{ORIGIN}"), "(1,0,-2)");
    let image = image(1, "SAMPLE_TYPE = IEEE_REAL");
    assert_ranges(
        read(None, &msb(&RANGES), Some(&detached(&ranges, &image))),
        "ranges",
    );
}

#[test]
fn a_vicar_label_is_read() {
    for (format, bytes) in [("IEEE", msb(&POINTS.concat())), ("RIEEE", lsb(&POINTS.concat()))] {
        let mut text = format!(
            "LBLSIZE=2048  FORMAT='REAL'  TYPE='IMAGE'  EOL=0  RECSIZE=8  ORG='BSQ'  NL=2  NS=2  NB=3  NLB=0  NBB=0  \
             REALFMT='{format}'  PROPERTY='IDENTIFICATION'  ROVER_MOTION_COUNTER=(3,7,0)  "
        );
        for (name, keys) in groups("XYZ_MAP", AT_SITE, "(1,0,-2)") {
            text += &format!("PROPERTY='{name}'  ");
            for (key, value) in keys.split(';').map(|key| key.split_once('=').unwrap()) {
                let bare = value.starts_with(|first: char| first == '(' || first.is_ascii_digit());
                let quote = if bare { "" } else { "'" };
                text += &format!("{key}={quote}{value}{quote}  ");
            }
        }
        let mut file = text.into_bytes();
        file.resize(2048, 0);
        file.extend(bytes);
        assert_ranges(read(None, &file, None), format);
    }
}

/// A PDS4 label of 2 x 2 floats a band.
fn pds4_label(kind: &str, data_type: &str, bands: usize) -> Label {
    let space = |frame: &str, counters: &str| {
        format!(
            "<geom:Coordinate_Space_Indexed><geom:coordinate_space_frame_type>{frame}</geom:coordinate_space_frame_type>\
             {counters}</geom:Coordinate_Space_Indexed>"
        )
    };
    let index = |element: &str, name: &str, value: u32| {
        format!(
            "<geom:{element}><geom:index_id>{name}</geom:index_id><geom:index_value_number>{value}</geom:index_value_number>\
             </geom:{element}>"
        )
    };
    let counters = |element: &str| {
        [("SITE", 3), ("DRIVE", 7), ("POSE", 0)]
            .map(|(name, value)| index(element, name, value))
            .concat()
    };
    let site = space("SITE_FRAME", &index("Coordinate_Space_Index", "SITE", 3));
    let rover = space("ROVER_NAV_FRAME", &counters("Coordinate_Space_Index"));
    let vector = |name: &str, parts: &str, values: [f64; 3]| {
        let values: String = parts
            .split(' ')
            .zip(values)
            .map(|(part, value)| format!("<{part}>{value}</{part}>"))
            .collect();
        format!("<{name}>{values}</{name}>")
    };
    let position = "geom:x_position geom:y_position geom:z_position";
    let unit = "geom:x_unit geom:y_unit geom:z_unit";
    let pixel = "geom:x_pixel geom:y_pixel geom:z_pixel";
    let origin = vector(
        "img_surface:Vector_Range_Origin",
        "img_surface:x_position img_surface:y_position img_surface:z_position",
        [10.0, 21.0, -1.5],
    );
    let axes: String = [("Band", bands), ("Line", 2), ("Sample", 2)]
        .iter()
        .zip(1..)
        .map(|((name, elements), number)| {
            format!(
                "<Axis_Array><axis_name>{name}</axis_name><elements>{elements}</elements>\
                 <sequence_number>{number}</sequence_number></Axis_Array>"
            )
        })
        .collect();
    let text = [
        "<?xml version=\"1.0\"?><Product_Observational xmlns=\"http://pds.nasa.gov/pds4/pds/v1\" \
         xmlns:geom=\"http://pds.nasa.gov/pds4/geom/v1\" xmlns:img_surface=\"http://pds.nasa.gov/pds4/img_surface/v1\">\
         <Observation_Area><Discipline_Area><geom:Geometry><geom:Geometry_Lander><geom:Motion_Counter>",
        &counters("Motion_Counter_Index"),
        "</geom:Motion_Counter><geom:Camera_Model_Parameters><geom:CAHV_Model>",
        &vector("geom:Vector_Center", position, [1.0, 0.0, -2.0]),
        &vector("geom:Vector_Axis", unit, [1.0, 0.0, 0.0]),
        &vector("geom:Vector_Horizontal", pixel, [0.0, 100.0, 0.0]),
        &vector("geom:Vector_Vertical", pixel, [0.0, 0.0, 100.0]),
        "</geom:CAHV_Model><geom:Coordinate_Space_Reference>",
        &rover,
        "</geom:Coordinate_Space_Reference></geom:Camera_Model_Parameters><geom:Coordinate_Space_Definition>\
         <geom:Coordinate_Space_Present>",
        &rover,
        "</geom:Coordinate_Space_Present>",
        &vector("geom:Vector_Origin_Offset", position, [10.0, 20.0, 0.5]),
        "<geom:Quaternion_Plus_Direction><geom:qcos>0.70710678119</geom:qcos><geom:qsin1>0</geom:qsin1>\
         <geom:qsin2>0</geom:qsin2><geom:qsin3>0.70710678119</geom:qsin3>\
         <geom:rotation_direction>Forward</geom:rotation_direction></geom:Quaternion_Plus_Direction>\
         <geom:Coordinate_Space_Reference>",
        &site,
        "</geom:Coordinate_Space_Reference></geom:Coordinate_Space_Definition></geom:Geometry_Lander></geom:Geometry>\
         <img_surface:Surface_Imaging><img_surface:Derived_Product_Parameters><img_surface:derived_image_type_name>",
        kind,
        "</img_surface:derived_image_type_name>",
        &origin,
        "<geom:Coordinate_Space_Reference>",
        &site,
        "</geom:Coordinate_Space_Reference></img_surface:Derived_Product_Parameters></img_surface:Surface_Imaging>\
         </Discipline_Area></Observation_Area><File_Area_Observational><File><file_name>A.IMG</file_name></File>\
         <Array_3D_Image><offset unit=\"byte\">0</offset><axis_index_order>Last Index Fastest</axis_index_order>\
         <Element_Array><data_type>",
        data_type,
        "</data_type><unit>m</unit></Element_Array>",
        &axes,
        "</Array_3D_Image></File_Area_Observational></Product_Observational>",
    ]
    .concat();
    pds4::read(text.as_bytes()).unwrap()
}

#[test]
fn coordinates_and_ranges_of_pds4_are_read_in_both_byte_orders() {
    for (kind, values) in [("XYZ_MAP", POINTS.concat()), ("RANGE_MAP", RANGES.to_vec())] {
        let bands = values.len() / 4;
        for (data_type, bytes) in [
            ("IEEE754MSBSingle", msb(&values)),
            ("IEEE754LSBSingle", lsb(&values)),
        ] {
            let label = pds4_label(kind, data_type, bands);
            assert_ranges(read(None, &bytes, Some(&label)), &format!("{kind}, {data_type}"));
        }
    }
}

/// Two eyes 0.5 m apart with a focal length of 100 px see a wall 10 m ahead with a disparity of 5 px. Column 30 is 3 m aside at
/// that distance. The last pixel's rays miss each other by far.
#[test]
fn disparities_become_ranges_by_both_cameras() {
    let wide = "LINES = 1\nLINE_SAMPLES = 31\nBANDS = 2\nSAMPLE_TYPE = IEEE_REAL";
    let left = detached(&groups("DISPARITY_MAP", AT_SITE, "(1,0,-2)"), wide);
    let right = detached(&groups("DISPARITY_MAP", AT_SITE, "(1,0.5,-2)"), wide);
    let mut values = [0.0; 62];
    (values[0], values[31]) = (1.0, -4.0); // line 0 and column -5, from 1
    (values[30], values[61]) = (1.0, 26.0); // line 0 and column 25
    (values[29], values[60]) = (9.0, 25.0); // line 8
    (values[28], values[59]) = (1.0, 29.0); // parallel
    let product = read(None, &msb(&values), Some(&left)).unwrap();
    assert_eq!(product.geometry, Geometry::Disparities);
    let partner = right.prior.unwrap();
    let found = product.ranges(Some(&partner)).unwrap();
    for (at, expected) in [(0, 10.0), (30, 109.0_f64.sqrt())] {
        let range = found[at].unwrap();
        assert!((range - expected).abs() < TOLERANCE_M, "{range}, not {expected}");
    }
    assert!(found[1..30].iter().all(Option::is_none), "{found:?}");
    assert_eq!(
        product.ranges(None).unwrap_err().to_string(),
        "disparities become ranges by the label of the pair's other photo, which is missing"
    );
    // The label of its own photo has these pixels, and that of a photo from another place has others.
    product.check_grid(&left.prior.unwrap()).unwrap();
    assert_eq!(
        product.check_grid(&partner).unwrap_err().to_string(),
        "its photos were resampled, so that their labels do not tell where its disparities point"
    );
}

#[test]
fn constants_of_the_label_mean_no_value() {
    let constants = image(
        1,
        "SAMPLE_TYPE = IEEE_REAL\nMISSING_CONSTANT = -1.0\nINVALID_CONSTANT = (9999.0)",
    );
    let label = detached(&groups("RANGE_MAP", AT_SITE, "(1,0,-2)"), &constants);
    let product = read(None, &msb(&[-1.0, 9999.0, f32::NAN, 2.0]), Some(&label)).unwrap();
    assert_eq!(product.ranges(None), Ok(vec![None, None, None, Some(2.0)]));
}

#[test]
fn a_product_that_gives_no_ranges_says_why() {
    let floats = |bands| image(bands, "SAMPLE_TYPE = IEEE_REAL");
    let of = |kind: &str, derived: &str, bands: usize| {
        let label = detached(&groups(kind, derived, "(1,0,-2)"), &floats(bands));
        let product = read(None, &msb(&vec![1.0; 4 * bands]), Some(&label));
        product
            .and_then(|product| product.ranges(None))
            .unwrap_err()
            .to_string()
    };
    let site =
        |number: u32| format!("REFERENCE_COORD_SYSTEM_NAME=SITE_FRAME;REFERENCE_COORD_SYSTEM_INDEX={number}");
    assert_eq!(
        of("XYZ_MAP", &site(4), 3),
        "its values are in SITE_FRAME [4], its camera is in ROVER_NAV_FRAME [3, 7, 0], and its label does not relate the two"
    );
    assert_eq!(
        of("XYZ_MAP", "UNITS=METERS", 3),
        "its label does not name the frame of its values"
    );
    assert_eq!(
        of(
            "RANGE_MAP",
            &format!("{AT_SITE};RANGE_ORIGIN_VECTOR=(10,21,-1)"),
            1
        ),
        "its ranges are measured from a point 0.500 m from its camera"
    );
    assert_eq!(
        of("XYZ_MAP", AT_SITE, 1),
        "its number of bands is 1, its type has 3"
    );
    assert_eq!(
        of("REACHABILITY_MAP", AT_SITE, 1),
        "a product of type REACHABILITY_MAP has no ranges, XYZ, RNG and DSP have"
    );
    let whole = detached(&groups("XYZ_MAP", AT_SITE, "(1,0,-2)"), &floats(3));
    assert_eq!(
        read(None, &[0; 47], Some(&whole)).unwrap_err().to_string(),
        "the file is cut short: its label describes 48 bytes, it has 47"
    );
    let bare = detached(&groups("XYZ_MAP", AT_SITE, "(1,0,-2)")[..1], &floats(3));
    assert_eq!(
        read(None, &[0; 48], Some(&bare)).unwrap_err().to_string(),
        "its label has no usable camera to measure ranges from"
    );
    assert_eq!(
        read(None, &[0; 48], None).unwrap_err().to_string(),
        "no label at the head of the file"
    );
}

#[test]
fn without_a_type_in_the_label_the_name_decides() {
    let mut points = groups("XYZ_MAP", AT_SITE, "(1,0,-2)");
    points[0].1 = AT_SITE.to_owned();
    let label = detached(&points, &image(3, "SAMPLE_TYPE = IEEE_REAL"));
    let name = ProductName::read("NLB_586004185XYZ_F0721234NCAM00295M1");
    assert_ranges(
        read(name.as_ref(), &msb(&POINTS.concat()), Some(&label)),
        "by name",
    );
}

fn name(stem: &str) -> ProductName {
    ProductName::read(stem).unwrap()
}

#[test]
fn what_is_computed_from_a_photo_shares_its_camera_and_clock() {
    for (photo, product, partner) in [
        (
            "NLF_0718_0730679543_043ECM_N0342098NCAM03717_01_195J",
            "NLM_0718_0730679543_043XYZLN0342098NCAM03717_00_0LLJ02",
            "NRM_0718_0730679543_043RASLN0342098NCAM03717_00_0LLJ01",
        ),
        (
            "NLB_586004185EDR_F0721234NCAM00295M1",
            "NLB_586004185XYZLF0721234NCAM00295M2",
            "NRB_586004185DSPLF0721234NCAM00295M1",
        ),
        (
            "2N292280938EFFB100P0703L0M1",
            "2n292280938xylb100p0703l0m1",
            "2N292280938DILB100P0703R0M1",
        ),
    ] {
        let [photo, product, partner] = [photo, product, partner].map(name);
        assert_eq!(
            photo.camera_and_clock(),
            product.camera_and_clock(),
            "{}",
            photo.id
        );
        assert_ne!(
            photo.camera_and_clock(),
            partner.camera_and_clock(),
            "{}",
            photo.id
        );
        assert_eq!(
            product.twin_camera_and_clock(),
            Some(partner.camera_and_clock()),
            "{}",
            photo.id
        );
    }
    let arm = name("SI1_0709_0729888971_069RAD_N0332864ZCAM07114_0340LMA01");
    assert_eq!(arm.twin_camera_and_clock(), None);
    assert_eq!(
        name("2264ML0121141200805116C00_DRCL").twin_camera_and_clock(),
        None
    );
}
