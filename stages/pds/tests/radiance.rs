//! Products of one exposure come out in the same tones, and two exposures keep the ratio of their light.
#![allow(clippy::unwrap_used, reason = "helpers of tests are not seen as tests")]

use marf_pds::raw::{Developed, develop, head};
use marf_pds::{ProductName, pds4};

/// Largest difference of two tones: 2 %, or one code.
const MAX_SHARE: f64 = 0.02;
/// Names of versions of one exposure.
const RAD: &str = "1N491020834RADCNY9P0706L0M1";
const RZS: &str = "ZL0_0709_0729888971_069RZS_N0332864ZCAM07114_0340LMA01";

/// Radiance of a photo of 100 x 10 pixels, W / (m2 sr nm): dark ground to a bright rock.
fn scene(light: f64) -> Vec<f64> {
    (0..1000)
        .map(|at| light * (0.004 + 0.05 * f64::from(at) / 1000.0))
        .collect()
}

/// Samples of 16 bits, the most significant byte first.
fn stored(values: &[f64]) -> Vec<u8> {
    let sample = |value: &f64| (value.round() as i16).to_be_bytes();
    values.iter().flat_map(sample).collect()
}

/// A label with these groups, and these keys of its image.
fn label(groups: &str, image: &str) -> String {
    format!(
        "PDS_VERSION_ID = PDS3\n^IMAGE = \"A.IMG\"\nSOLAR_LONGITUDE = 25.4\n\
         GROUP = DERIVED_IMAGE_PARMS\n{groups}\nEND_GROUP\n\
         GROUP = INSTRUMENT_STATE_PARMS\nCENTER_FILTER_WAVELENGTH = 600 <nm>\nEND_GROUP\n\
         OBJECT = IMAGE\nLINES = 10\nLINE_SAMPLES = 100\nSAMPLE_TYPE = MSB_INTEGER\nSAMPLE_BITS = 16\n\
         SAMPLE_BIT_MASK = 2#0111111111111111#\n{image}\nEND_OBJECT = IMAGE\nEND\n"
    )
}

fn developed(name: Option<&str>, label: &str, bytes: &[u8]) -> Developed {
    let name = name.map(|name| ProductName::read(name).unwrap());
    let label = head(label.as_bytes()).unwrap();
    develop(name.as_ref(), bytes, Some(&label)).unwrap()
}

/// Codes at the 5th, 50th and 95th percentile.
fn tones(made: &Developed) -> [f64; 3] {
    let mut codes: Vec<u8> = made.image.pixels.iter().map(|pixel| pixel[1]).collect();
    codes.sort_unstable();
    [50, 500, 950].map(|at| f64::from(codes[at]))
}

#[track_caller]
fn assert_same_tones(found: [f64; 3], expected: [f64; 3], what: &str) {
    for (found, expected) in found.into_iter().zip(expected) {
        let most = (MAX_SHARE * expected).max(1.0);
        assert!(
            (found - expected).abs() <= most,
            "{what}: {found}, not {expected}"
        );
    }
}

/// Tones of the scene as radiance in 32-bit floats, which need no scaling.
fn expected(light: f64) -> [f64; 3] {
    let floats: Vec<u8> = scene(light)
        .iter()
        .flat_map(|value| (*value as f32).to_be_bytes())
        .collect();
    let text = label("UNITS = \"W/M**2/SR/NM\"", "")
        .replace("MSB_INTEGER", "IEEE_REAL")
        .replace("SAMPLE_BITS = 16", "SAMPLE_BITS = 32");
    tones(&developed(None, &text, &floats))
}

/// By hand: 0.029 of 0.125 is 0.232 of white, sRGB 132.4.
#[test]
fn the_middle_of_the_scene_is_as_computed_by_hand() {
    assert_eq!(expected(1.0)[1], 132.0);
}

#[test]
fn products_of_one_exposure_have_equal_tones() {
    let radiance = scene(1.0);
    let scaled = |factor: f64, offset: f64| {
        let values: Vec<f64> = radiance.iter().map(|value| (value - offset) / factor).collect();
        stored(&values)
    };
    // JPL's programs (MER, PHX, MSL, InSight), with the unit in a key of its own in VICAR, and Cornell's (Mars 2020).
    let derived = |factor: f64, offset: f64, unit: &str| {
        format!("RADIANCE_SCALING_FACTOR = {factor} <{unit}>\nRADIANCE_OFFSET = {offset} <{unit}>")
    };
    let mipl = "WATT*M**-2*SR**-1*NM**-1";
    for (what, groups, image, bytes) in [
        ("RAD", derived(1e-5, 0.0, mipl), "", scaled(1e-5, 0.0)),
        (
            "RSL",
            derived(3.1e-6, 0.002, "W.m**-2.sr**-1.nm**-1"),
            "",
            scaled(3.1e-6, 0.002),
        ),
        (
            "micrometres",
            derived(5e-3, 0.0, "W/m**2/sr/um"),
            "",
            scaled(5e-6, 0.0),
        ),
        (
            "no unit",
            "RADIANCE_SCALING_FACTOR = 5e-06\nRADIANCE_OFFSET = 0.0".to_owned(),
            "",
            scaled(5e-6, 0.0),
        ),
        (
            "MSL, by band",
            "RADIANCE_SCALING_FACTOR = (4e-06, 4e-06, 4e-06)\nRADIANCE_OFFSET = (0.001, 0.001, 0.001)"
                .to_owned(),
            "",
            scaled(4e-6, 0.001),
        ),
        (
            "Mars 2020, in both places",
            format!(
                "UNITS = \"W/M**2/SR/NM\"\n{}",
                derived(1.9e-6, 0.0007, "W/M**2/NM/SR")
            ),
            "SCALING_FACTOR = 1.9e-06\nOFFSET = 0.0007",
            scaled(1.9e-6, 0.0007),
        ),
        (
            "scaling of the image",
            "UNITS = \"W/M**2/SR/NM\"".to_owned(),
            "SCALING_FACTOR = 1.9e-06\nOFFSET = 0.0007",
            scaled(1.9e-6, 0.0007),
        ),
    ] {
        let made = developed(Some(RAD), &label(&groups, image), &bytes);
        assert_same_tones(tones(&made), expected(1.0), what);
    }
}

/// By hand: at Ls 25.4 Mars is 1.6160 AU from the sun, so a white surface has 1.765 / (π 1.6160²) = 0.21514 W / (m2 sr nm) at
/// 600 nm.
#[test]
fn i_over_f_has_the_tones_of_the_radiance() {
    let reflectance: Vec<f64> = scene(1.0).iter().map(|value| value / 0.215_14 / 2e-5).collect();
    for (groups, image) in [
        ("UNITS = \"I/F\"", "SCALING_FACTOR = 2e-05"),
        ("REFLECTANCE_SCALING_FACTOR = 2e-05", ""),
    ] {
        let made = developed(None, &label(groups, image), &stored(&reflectance));
        assert_same_tones(tones(&made), expected(1.0), groups);
    }
}

/// Products scaled to the sun in the zenith are multiplied by the factor of their label (RZS).
#[test]
fn radiance_scaled_to_the_zenith_is_scaled_back() {
    let values: Vec<f64> = scene(1.0).iter().map(|value| value / 0.5 / 5e-6).collect();
    let groups = "RADIANCE_SCALING_FACTOR = 5e-06\nRAD_ZENITH_SCALING_FACTOR = 0.5";
    let made = developed(Some(RZS), &label(groups, ""), &stored(&values));
    assert_same_tones(tones(&made), expected(1.0), "RZS");
    let rad = RZS.replace("RZS", "RAD");
    let plain = developed(Some(&rad), &label(groups, ""), &stored(&values));
    assert_same_tones(tones(&plain), expected(2.0), "a RAD is not scaled to the zenith");
}

#[test]
fn two_exposures_keep_the_ratio_of_their_light() {
    let light = |light: f64| {
        let values: Vec<f64> = scene(light).iter().map(|value| value / 1e-5).collect();
        let made = developed(
            Some(RAD),
            &label("RADIANCE_SCALING_FACTOR = 1e-05", ""),
            &stored(&values),
        );
        let linear = |code: f64| ((code / 255.0 + 0.055) / 1.055).powf(2.4);
        tones(&made).map(linear)
    };
    for (twice, once) in light(2.0).into_iter().zip(light(1.0)) {
        assert!((twice / once - 2.0).abs() < 0.06, "{twice} / {once}");
    }
}

/// A unit that is not one of radiance is not taken for one, and a factor that the label does not know is no factor.
#[test]
fn what_a_label_does_not_scale_stays_counts() {
    for (groups, note) in [
        ("RADIANCE_SCALING_FACTOR = 1e-05 <DN/S>", "the unit `DN/S`"),
        ("RADIANCE_SCALING_FACTOR = (\"N/A\", \"N/A\", \"N/A\")", ""),
    ] {
        let label = head(label(groups, "").as_bytes()).unwrap();
        assert!(label.notes.join("; ").contains(note), "{:?}", label.notes);
        let made = develop(None, &stored(&scene(1e5)), Some(&label)).unwrap();
        assert!(
            made.notes.join("; ").contains("counts to sRGB, white at 32767"),
            "{:?}",
            made.notes
        );
    }
}

#[test]
fn a_pds4_label_scales_by_its_unit_or_its_correction() {
    let values: Vec<f64> = scene(1.0).iter().map(|value| value / 5e-6).collect();
    for (unit, correction, factor) in [
        ("<unit>W/m**2/sr/nm</unit>", "", "5e-6"),
        ("<unit>W*m**-2*sr**-1*um**-1</unit>", "", "5e-3"),
        (
            "",
            "<img:radiometric_type>Spectral Radiance</img:radiometric_type>",
            "5e-6",
        ),
        (
            "",
            "<img:radiance_scaling_factor>5e-6</img:radiance_scaling_factor><img:radiance_offset>0</img:radiance_offset>",
            "1",
        ),
    ] {
        let axis = |name: &str, elements: u32, number: u32| {
            format!(
                "<Axis_Array><axis_name>{name}</axis_name><elements>{elements}</elements>\
                 <sequence_number>{number}</sequence_number></Axis_Array>"
            )
        };
        let text = format!(
            "<Product_Observational xmlns=\"http://pds.nasa.gov/pds4/pds/v1\" xmlns:img=\"http://pds.nasa.gov/pds4/img/v1\">\
             <Observation_Area><Discipline_Area><img:Imaging><img:Radiometric_Correction>{correction}\
             </img:Radiometric_Correction></img:Imaging></Discipline_Area></Observation_Area>\
             <File_Area_Observational><File><file_name>A.IMG</file_name></File><Array_2D_Image><offset>0</offset>\
             <Element_Array><data_type>SignedMSB2</data_type>{unit}<scaling_factor>{factor}</scaling_factor>\
             </Element_Array>{}{}</Array_2D_Image></File_Area_Observational></Product_Observational>",
            axis("Line", 10, 1),
            axis("Sample", 100, 2)
        );
        let label = pds4::read(text.as_bytes()).unwrap();
        let made = develop(None, &stored(&values), Some(&label)).unwrap();
        assert_same_tones(tones(&made), expected(1.0), &format!("{unit}{correction}"));
    }
}
