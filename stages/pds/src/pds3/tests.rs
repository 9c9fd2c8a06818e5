use super::*;
use crate::odl;

const DEMO: &str = r#"PDS_VERSION_ID = PDS3
RECORD_BYTES   = 64
^IMAGE         = ("DEMO.IMG", 3)
PLANET_DAY_NUMBER = 12
IMAGE_TYPE = THUMBNAIL
ROVER_MOTION_COUNTER = (7, 42, 0)
GROUP = SUBFRAME_REQUEST_PARMS
 LINES = 64
END_GROUP
GROUP = GEOMETRIC_CAMERA_MODEL_PARMS
 MODEL_TYPE        = CAHVOR
 MODEL_COMPONENT_1 = ( 8.0e-01, 5.6e-01,
-1.92e+00 )
 MODEL_COMPONENT_2 = (1.0, 0.0, 0.0)
 MODEL_COMPONENT_3 = (823.5, 14800.0, 0.0)
 MODEL_COMPONENT_4 = (599.5, 0.0, 14800.0)
 MODEL_COMPONENT_5 = (0.9999000149975, 0.009999000149975, 0.009999000149975)
 MODEL_COMPONENT_6 = (0.0002, 0.39, 0.035)
 REFERENCE_COORD_SYSTEM_NAME = ROVER_NAV_FRAME
END_GROUP = GEOMETRIC_CAMERA_MODEL_PARMS
GROUP = RSM_COORDINATE_SYSTEM
 COORDINATE_SYSTEM_NAME = RSM_HEAD_FRAME
 REFERENCE_COORD_SYSTEM_NAME = ROVER_NAV_FRAME
 ORIGIN_OFFSET_VECTOR = (9, 9, 9)
 ORIGIN_ROTATION_QUATERNION = (1, 0, 0, 0)
END_GROUP
GROUP = ROVER_COORD_SYSTEM_PARMS
 COORDINATE_SYSTEM_NAME = ROVER_NAV_FRAME
 REFERENCE_COORD_SYSTEM_NAME = SITE_FRAME
 ORIGIN_OFFSET_VECTOR = (12.5 <m>, -3.25 <m>, 0.125 <m>)
 ORIGIN_ROTATION_QUATERNION = (0.8, 0, 0, 0.6)
 QUATERNION_MEASUREMENT_METHOD = TILT_ONLY
END_GROUP
GROUP = INSTRUMENT_STATE_PARMS
 BAYER_METHOD = RAW_BAYER
 CFA_TYPE = BAYER_RGGB
 FILTER_NUMBER = "0"
 FOCAL_LENGTH = 34.0 <mm>
END_GROUP
OBJECT = IMAGE
 LINES = 8
 LINE_SAMPLES = 6
 SAMPLE_BITS = 16
 SAMPLE_TYPE = MSB_INTEGER
 SAMPLE_BIT_MASK = 2#0000111111111111#
 FIRST_LINE = 5
 FIRST_LINE_SAMPLE = 1025
 MISSING_CONSTANT = "NULL"
END_OBJECT = IMAGE
END
"#;

fn read(text: &str) -> Label {
    label(&odl::parse(text.as_bytes()).unwrap())
}

#[test]
fn a_label_is_read_by_its_groups() {
    let label = read(DEMO);
    assert_eq!(
        (label.sol, label.size, label.thumbnail),
        (Some(12), Some((6, 8)), true)
    );
    assert_eq!((label.filter.as_deref(), label.focal_mm), (Some("0"), Some(34.0)));
    assert_eq!(
        label.mosaic,
        Some(BayerPhase {
            line: 4,
            sample: 1024
        })
    );
    let array = label.array.unwrap();
    assert_eq!(
        (array.offset, array.file.as_deref(), array.bits),
        (128, Some("DEMO.IMG"), Some(12))
    );
    assert_eq!((array.shape, array.missing), ([1, 8, 6], vec![]));
    let prior = label.prior.unwrap();
    assert_eq!(
        (prior.frame.as_str(), prior.motion_counter),
        ("ROVER_NAV_FRAME", vec![7, 42, 0])
    );
    assert_eq!(prior.model.c, [0.8, 0.56, -1.92]);
    let pose = prior.site_from_frame.unwrap();
    assert!(
        (pose.point(&nalgebra::Vector3::x()) - nalgebra::Vector3::new(12.78, -2.29, 0.125)).norm() < 1e-12
    );
    assert!(label.notes[0].contains("TILT_ONLY"), "{:?}", label.notes);
}

#[test]
fn every_form_of_a_pointer_is_read() {
    for (text, expected) in [
        ("15", Some((None, 896))),
        ("8641 <BYTES>", Some((None, 8640))),
        ("(\"F.IMG\", 15)", Some((Some("F.IMG".to_owned()), 896))),
        (
            "(\"F.IMG\", 8641 <BYTES>)",
            Some((Some("F.IMG".to_owned()), 8640)),
        ),
        ("(\"F.IMG\")", Some((Some("F.IMG".to_owned()), 0))),
        ("\"F.IMG\"", Some((Some("F.IMG".to_owned()), 0))),
        ("0", None),
        ("-3", None),
        ("(\"F.IMG\", NULL)", None),
        ("(1, 2, 3)", None),
    ] {
        let group = odl::parse(format!("RECORD_BYTES = 64\n^IMAGE = {text}\n").as_bytes()).unwrap();
        assert_eq!(pointer(&group), expected, "{text}");
    }
}

#[test]
fn types_of_samples_are_read() {
    let read = |kind, bits| sample(kind, bits).map(|sample| (sample.kind, sample.bytes, sample.big_endian));
    assert_eq!(read("MSB_INTEGER", 16), Some((SampleKind::Signed, 2, true)));
    assert_eq!(read("UNSIGNED_INTEGER", 8), Some((SampleKind::Unsigned, 1, true)));
    assert_eq!(
        read("LSB_UNSIGNED_INTEGER", 16),
        Some((SampleKind::Unsigned, 2, false))
    );
    assert_eq!(read("IEEE_REAL", 32), Some((SampleKind::Float, 4, true)));
    assert_eq!(read("PC_REAL", 32), Some((SampleKind::Float, 4, false)));
    for (kind, bits) in [
        ("MSB_INTEGER", 12),
        ("VAX_REAL", 32),
        ("CHARACTER", 8),
        ("IEEE_REAL", 16),
        ("", 8),
    ] {
        assert_eq!(read(kind, bits), None, "{kind} {bits}");
    }
}

#[test]
fn labels_of_other_things_say_what_they_are() {
    let table = odl::parse(b"OBJECT = INDEX_TABLE\nROWS = 3\nEND_OBJECT\n").unwrap();
    assert!(no_photo(&table).unwrap().contains("INDEX_TABLE"));
    let map = DEMO.replace(
        "END\n",
        "GROUP = DERIVED_IMAGE_PARMS\nDERIVED_IMAGE_TYPE = REACHABILITY_MAP\nEND_GROUP\nEND\n",
    );
    assert!(
        no_photo(&odl::parse(map.as_bytes()).unwrap())
            .unwrap()
            .contains("REACHABILITY_MAP")
    );
    assert_eq!(no_photo(&odl::parse(DEMO.as_bytes()).unwrap()), None);
}

#[test]
fn a_vicar_label_alone_describes_its_array() {
    let mut bytes =
        b"LBLSIZE=400 FORMAT='HALF' EOL=0 RECSIZE=14 ORG='BSQ' NL=3 NS=6 NB=1 NBB=2 NLB=1 INTFMT='HIGH' \
        PROPERTY='IDENTIFICATION' PLANET_DAY_NUMBER=33 PRODUCT_ID='X' \
        PROPERTY='GEOMETRIC_CAMERA_MODEL' MODEL_TYPE='NONE'"
            .to_vec();
    bytes.resize(400, 0);
    let label = label(&crate::vicar::parse(&bytes).unwrap());
    let array = label.array.unwrap();
    assert_eq!(
        (label.sol, array.offset, array.prefix_bytes, array.shape),
        (Some(33), 414, 2, [1, 3, 6])
    );
    assert_eq!(
        (array.sample.kind, array.sample.bytes, array.sample.big_endian),
        (SampleKind::Signed, 2, true)
    );
    assert!(label.notes[0].contains("no usable camera"), "{:?}", label.notes);
}

#[test]
fn counters_have_the_promised_order_and_a_frame_of_other_counters_is_not_taken() {
    let named = DEMO.replace(
        "ROVER_MOTION_COUNTER = (7, 42, 0)",
        "ROVER_MOTION_COUNTER_NAME = (ARM, POSE, DRIVE, SITE)\nROVER_MOTION_COUNTER = (3, 0, 42, 7)",
    );
    assert_eq!(read(&named).prior.unwrap().motion_counter, [7, 42, 0, 3]);
    let placed = |own: &str, site: &str| {
        let index = format!(
            "COORDINATE_SYSTEM_NAME = ROVER_NAV_FRAME\n COORDINATE_SYSTEM_INDEX = {own}\n \
             REFERENCE_COORD_SYSTEM_INDEX = {site}\n"
        );
        let label = DEMO.replace("COORDINATE_SYSTEM_NAME = ROVER_NAV_FRAME\n", &index);
        read(&label).prior.unwrap().site_from_frame.is_some()
    };
    assert!(placed("(7, 42, 0)", "7") && placed("(7, 42)", "(7)"));
    assert!(!placed("(7, 41, 0)", "7") && !placed("(7, 42, 0)", "6"));
}

#[test]
fn special_constants_and_codes_are_read() {
    let with = |method: &str| {
        let label = DEMO
            .replace(
                "MISSING_CONSTANT = \"NULL\"",
                "MISSING_CONSTANT = 16#8000#\n HIGH_REPR_SATURATION = 32767",
            )
            .replace(
                "FILTER_NUMBER = \"0\"",
                &format!("SAMPLE_BIT_METHOD = {method}\n SAMPLE_BIT_MODE_ID = \"LUT2\""),
            );
        read(&label).array.unwrap()
    };
    let array = with("HARDWARE");
    assert_eq!(
        (array.missing, array.saturated),
        (vec![-32_768.0], vec![32_767.0])
    );
    assert_eq!(array.companded_by.as_deref(), Some("LUT2"));
    assert_eq!(with("HARDWARE_INVERTED").companded_by, None);
    assert_eq!(with("NONE").companded_by, None);
}

/// Site, drive and pose are the rover's: they hold whatever the camera is.
#[test]
fn a_label_without_a_usable_camera_keeps_site_drive_and_pose() {
    let group = DEMO.find("GROUP = GEOMETRIC").unwrap()..DEMO.find("GROUP = RSM_").unwrap();
    let absent = [&DEMO[..group.start], &DEMO[group.end..]].concat();
    for (what, text) in [
        (
            "a vector without a number",
            DEMO.replace("(823.5, 14800.0, 0.0)", "(823.5, UNK, 0.0)"),
        ),
        (
            "axes in one line",
            DEMO.replace("(599.5, 0.0, 14800.0)", "(599.5, 14800.0, 0.0)"),
        ),
        ("an unknown model", DEMO.replace("= CAHVOR", "= FISHEYE")),
        ("no model", absent),
    ] {
        let label = read(&text);
        assert!(label.prior.is_none() && !label.notes.is_empty(), "{what}");
        let place = label.place.unwrap_or_else(|| panic!("{what}: no place"));
        assert_eq!(
            (place.frame.as_str(), place.motion_counter),
            ("ROVER_NAV_FRAME", vec![7, 42, 0]),
            "{what}"
        );
        let offset = place.site_from_frame.map(|pose| pose.translation);
        assert_eq!(offset, Some(nalgebra::Vector3::new(12.5, -3.25, 0.125)), "{what}");
    }
    let label = read(DEMO);
    let (prior, place) = (label.prior.unwrap(), label.place.unwrap());
    assert_eq!(
        (prior.site_from_frame, prior.motion_counter),
        (place.site_from_frame, place.motion_counter)
    );
}

/// Cameras of Opportunity: a linearised Pancam whose lines were averaged in fours, and the Microscopic Imager, without radial
/// terms and with unequal focal lengths.
#[test]
fn pancam_and_microscopic_imager_have_cameras() {
    for (instrument, h, v) in [
        ("PANCAM_LEFT", "(511.5, 3580.0, 0.0)", "(127.5, 0.0, 895.0)"),
        ("MI", "(511.5, 2210.0, 0.0)", "(511.5, 0.0, 2050.0)"),
    ] {
        let text = DEMO
            .replace("= CAHVOR", "= CAHV")
            .replace("(823.5, 14800.0, 0.0)", h)
            .replace("(599.5, 0.0, 14800.0)", v)
            .replace("CFA_TYPE = BAYER_RGGB", "FILTER_NAME = NONE")
            .replace("BAYER_METHOD = RAW_BAYER", "FILTER_ID = NONE")
            .replace(
                "IMAGE_TYPE = THUMBNAIL",
                &format!("INSTRUMENT_HOST_ID = MER1\nINSTRUMENT_ID = {instrument}"),
            );
        let label = read(&text);
        let model = label
            .prior
            .unwrap_or_else(|| panic!("{instrument}: {:?}", label.notes))
            .model;
        let k = model.intrinsics().unwrap();
        let expected: Vec<f64> = [h, v]
            .iter()
            .flat_map(|text| crate::values::tuple::<3>(text).unwrap())
            .collect();
        assert_eq!((k.hs, k.vs), (expected[1], expected[5]), "{instrument}");
        assert!(model.exact_pinhole(1024, 256).unwrap().is_some(), "{instrument}");
        assert_eq!(label.sensor, Some(marf_scene::Sensor::Monochrome), "{instrument}");
    }
}

/// Labels of rovers say DOWN and RIGHT, or nothing. Then the camera is for the pixels that are shown.
#[test]
fn an_image_is_displayed_in_the_directions_of_its_label() {
    let default = (false, false);
    for (keys, expected) in [
        ("", default),
        ("LINE_DISPLAY_DIRECTION = DOWN", default),
        (
            "LINE_DISPLAY_DIRECTION = DOWN\n SAMPLE_DISPLAY_DIRECTION = RIGHT",
            default,
        ),
        (
            "LINE_DISPLAY_DIRECTION = UP\n SAMPLE_DISPLAY_DIRECTION = RIGHT",
            (true, false),
        ),
        ("SAMPLE_DISPLAY_DIRECTION = \"LEFT\"", (false, true)),
        (
            "LINE_DISPLAY_DIRECTION = UP\n SAMPLE_DISPLAY_DIRECTION = LEFT",
            (true, true),
        ),
    ] {
        let label = read(&DEMO.replace(" LINES = 8\n", &format!(" LINES = 8\n {keys}\n")));
        let array = label.array.unwrap();
        assert_eq!((array.upside_down, array.mirrored), expected, "{keys}");
        assert_eq!(label.prior.is_some(), expected == default, "{keys}");
        assert!(label.place.is_some(), "{keys}");
        let noted = label
            .notes
            .iter()
            .any(|note| note.contains("displayed in another direction"));
        assert_eq!(noted, expected != default, "{:?}", label.notes);
    }
    let side = " LINES = 8\n LINE_DISPLAY_DIRECTION = RIGHT\n SAMPLE_DISPLAY_DIRECTION = DOWN\n";
    let label = read(&DEMO.replace(" LINES = 8\n", side));
    assert!(label.array.unwrap().is_upright() && label.prior.is_some());
    assert!(
        label
            .notes
            .iter()
            .any(|note| note.contains("pixels are as stored")),
        "{:?}",
        label.notes
    );
}

#[test]
fn vicar_pixels_that_are_compressed_or_have_prefixes_are_refused_by_name() {
    let file = |items: &str| {
        let mut bytes =
            format!("LBLSIZE=200 FORMAT='BYTE' EOL=0 NL=2 NS=3 NLB=0 INTFMT='LOW' {items}").into_bytes();
        bytes.resize(200, 0);
        bytes.extend([9; 64]);
        bytes
    };
    for (items, expected) in [
        (
            "RECSIZE=3 ORG='BSQ' NB=1 NBB=0 COMPRESS='BASIC'",
            "compressed, by `COMPRESS=BASIC`",
        ),
        (
            "RECSIZE=3 ORG='BSQ' NB=1 NBB=0 COMPRESS='BASIC2'",
            "compressed, by `COMPRESS=BASIC2`",
        ),
        (
            "RECSIZE=5 ORG='BIP' NB=3 NBB=2 COMPRESS='NONE'",
            "each of its pixels has a prefix of 2 bytes",
        ),
    ] {
        let bytes = file(items);
        let photo = crate::raw::develop(None, &bytes, None).err().unwrap().to_string();
        assert!(photo.contains(expected), "{photo}");
        let ranges = crate::ranges::read(None, &bytes, None).err().unwrap().to_string();
        assert!(ranges.contains(expected), "{ranges}");
        assert_eq!(label(&crate::vicar::parse(&bytes).unwrap()).array, None);
    }
    for items in [
        "RECSIZE=9 ORG='BIP' NB=3 NBB=0 COMPRESS='NONE'",
        "RECSIZE=5 ORG='BIL' NB=3 NBB=2",
    ] {
        let made = crate::raw::develop(None, &file(items), None);
        let image = made.unwrap_or_else(|error| panic!("{items}: {error}")).image;
        assert!(
            image.pixels == [[9; 3]; 6],
            "{items}: {} x {}",
            image.width,
            image.height
        );
    }
}
