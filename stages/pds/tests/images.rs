//! Images behind labels: the pixels that GDAL shows.
#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "helpers of tests are not seen as tests"
)]

use std::path::{Path, PathBuf};

use marf_pds::raw::{Developed, develop, develop_within, head};
use marf_pds::{Label, pds4};

/// Rows of three pixels: 10, 20, 30, then 40, 50, 60.
const STORED: [u8; 6] = [10, 20, 30, 40, 50, 60];

/// A PDS4 label with these elements in its discipline area and its file areas.
fn pds4_label(discipline: &str, areas: &str) -> Label {
    let text = format!(
        r#"<?xml version="1.0"?>
<Product_Observational xmlns="http://pds.nasa.gov/pds4/pds/v1" xmlns:disp="http://pds.nasa.gov/pds4/disp/v1"
  xmlns:img="http://pds.nasa.gov/pds4/img/v1">
<Observation_Area><Discipline_Area>{discipline}</Discipline_Area></Observation_Area>{areas}</Product_Observational>"#
    );
    pds4::read(text.as_bytes()).unwrap()
}

fn directions(array: &str, vertical: &str, horizontal: &str) -> String {
    format!(
        "<disp:Display_Settings>{array}<disp:Display_Direction>\
         <disp:horizontal_display_axis>Sample</disp:horizontal_display_axis>\
         <disp:horizontal_display_direction>{horizontal}</disp:horizontal_display_direction>\
         <disp:vertical_display_axis>Line</disp:vertical_display_axis>\
         <disp:vertical_display_direction>{vertical}</disp:vertical_display_direction>\
         </disp:Display_Direction></disp:Display_Settings>"
    )
}

/// An array of two lines of three bytes at an offset, with elements before its offset.
fn array(head: &str, offset: usize) -> String {
    let axis = |name: &str, elements: u32, number: u32| {
        format!(
            "<Axis_Array><axis_name>{name}</axis_name><elements>{elements}</elements>\
             <sequence_number>{number}</sequence_number></Axis_Array>"
        )
    };
    format!(
        "<Array_2D_Image>{head}<offset unit='byte'>{offset}</offset>\
         <Element_Array><data_type>UnsignedByte</data_type></Element_Array>{}{}</Array_2D_Image>",
        axis("Line", 2, 1),
        axis("Sample", 3, 2)
    )
}

fn area(file: &str, arrays: &str) -> String {
    format!(
        "<File_Area_Observational><File><file_name>{file}</file_name></File>{arrays}</File_Area_Observational>"
    )
}

fn grays(developed: &Developed) -> Vec<u8> {
    developed.image.pixels.iter().map(|pixel| pixel[0]).collect()
}

#[test]
fn pixels_are_displayed_in_the_directions_of_the_label() {
    for (vertical, horizontal, expected) in [
        ("Top to Bottom", "Left to Right", [10, 20, 30, 40, 50, 60]),
        ("Bottom to Top", "Left to Right", [40, 50, 60, 10, 20, 30]),
        ("Top to Bottom", "Right to Left", [30, 20, 10, 60, 50, 40]),
        ("Bottom to Top", "Right to Left", [60, 50, 40, 30, 20, 10]),
    ] {
        let label = pds4_label(
            &directions("", vertical, horizontal),
            &area("A.IMG", &array("", 0)),
        );
        let made = develop(None, &STORED, Some(&label)).unwrap();
        assert_eq!(grays(&made), expected, "{vertical}, {horizontal}");
        let turned = made.notes.iter().any(|note| note.starts_with("displayed"));
        assert_eq!(turned, expected != STORED, "{:?}", made.notes);
    }
}

#[test]
fn settings_of_another_array_turn_nothing() {
    let of = |name: &str| {
        let reference = format!(
            "<Local_Internal_Reference><local_identifier_reference>{name}</local_identifier_reference>\
             </Local_Internal_Reference>"
        );
        let array = array("<local_identifier>photo</local_identifier>", 0);
        let settings = directions(&reference, "Bottom to Top", "Left to Right");
        let label = pds4_label(&settings, &area("A.IMG", &array));
        grays(&develop(None, &STORED, Some(&label)).unwrap())[0]
    };
    assert_eq!((of("photo"), of("quality")), (40, 10));
}

/// GDAL takes the first array of the label, of two or of three dimensions. A mask is not a photo.
#[test]
fn of_several_arrays_the_first_that_is_no_mask_is_read() {
    let bytes = [&[255; 6][..], &STORED].concat();
    let named = |name: &str, offset| array(&format!("<name>{name}</name>"), offset);
    let first = |arrays: &str| {
        let label = pds4_label("", arrays);
        let made = develop(None, &bytes, Some(&label)).unwrap();
        (grays(&made)[0], label.notes.join("; "))
    };
    let two = |first: &str, second: &str| area("A.IMG", &[named(first, 0), named(second, 6)].concat());
    assert_eq!(first(&two("image", "other")).0, 255);
    let (gray, notes) = first(&two("Rover mask", "image"));
    assert_eq!(gray, 10);
    assert!(notes.contains("describes 2 arrays: image is read"), "{notes}");
    let masked = [area("A_mask.img", &named("a", 0)), area("A.img", &named("b", 6))].concat();
    assert_eq!(first(&masked).0, 10);
    assert_eq!(first(&area("A.IMG", &named("mask", 6))).0, 10, "nothing else");
    // A photo of three dimensions before a mask of two.
    let cube = named("image", 6)
        .replace("Array_2D", "Array_3D")
        .replace("<sequence_number>2", "<sequence_number>3")
        .replace("<sequence_number>1", "<sequence_number>2")
        .replace(
            "<Axis_Array><axis_name>Line",
            "<Axis_Array><axis_name>Band</axis_name><elements>1</elements><sequence_number>1</sequence_number>\
             </Axis_Array><Axis_Array><axis_name>Line",
        );
    assert_eq!(first(&area("A.IMG", &[cube, named("quality", 0)].concat())).0, 10);
}

#[test]
fn an_array_whose_first_index_is_fastest_is_not_read_as_another() {
    let order = "<axis_index_order>First Index Fastest</axis_index_order>";
    let label = pds4_label("", &area("A.IMG", &array(order, 0)));
    assert!(develop(None, &STORED, Some(&label)).is_err());
}

/// A PDS3 label of 8 bits in colour, with these keys of the image.
fn pds3_label(keys: &str) -> Label {
    let text = format!(
        "PDS_VERSION_ID = PDS3\n^IMAGE = \"A.IMG\"\nOBJECT = IMAGE\nLINES = 1\nLINE_SAMPLES = 3\nBANDS = 3\n\
         BAND_STORAGE_TYPE = SAMPLE_INTERLEAVED\nSAMPLE_TYPE = UNSIGNED_INTEGER\nSAMPLE_BITS = 8\n{keys}\
         END_OBJECT = IMAGE\nEND\n"
    );
    head(text.as_bytes()).unwrap()
}

/// A highlight holds the constant in one band: GDAL and pdr keep it.
#[test]
fn a_special_constant_in_one_band_is_light() {
    let stored = [255, 33, 25, 255, 255, 212, 255, 255, 255];
    let label = pds3_label("INVALID_CONSTANT = 255\nMISSING_CONSTANT = 255\n");
    let made = develop(None, &stored, Some(&label)).unwrap();
    assert_eq!(made.image.pixels, [[255, 33, 25], [255, 255, 212], [0; 3]]);
    let label = pds3_label("MISSING_CONSTANT = 0\n");
    let made = develop(None, &[0, 33, 25, 0, 0, 0, 9, 9, 0], Some(&label)).unwrap();
    assert_eq!(made.image.pixels, [[0, 33, 25], [0; 3], [9, 9, 0]]);
}

#[test]
fn an_image_in_an_object_file_is_read() {
    let image = "OBJECT = IMAGE\nLINES = 2\nLINE_SAMPLES = 3\nSAMPLE_TYPE = UNSIGNED_INTEGER\nSAMPLE_BITS = 8\n\
                 END_OBJECT = IMAGE\n";
    for (head_of, start) in [
        ("OBJECT = FILE\nRECORD_BYTES = 3\n^IMAGE = \"E.IMG\"\n", 0),
        ("OBJECT = FILE\nRECORD_BYTES = 3\n^IMAGE = (\"E.IMG\", 3)\n", 6),
        (
            "OBJECT = FILE\nFILE_NAME = \"E.IMG\"\nRECORD_BYTES = 3\n^IMAGE = 2\n",
            3,
        ),
        (
            "OBJECT = UNCOMPRESSED_FILE\nRECORD_BYTES = 3\n^IMAGE = \"E.IMG\"\n",
            0,
        ),
    ] {
        let name = head_of.lines().next().unwrap().trim_start_matches("OBJECT = ");
        let other = "OBJECT = COMPRESSED_FILE\n^IMAGE = \"E.IMZ\"\nEND_OBJECT = COMPRESSED_FILE\n";
        let text = format!("PDS_VERSION_ID = PDS3\n{other}{head_of}{image}END_OBJECT = {name}\nEND\n");
        let label = head(text.as_bytes()).unwrap();
        let bytes = [vec![0; start], STORED.to_vec()].concat();
        let made = develop(None, &bytes, Some(&label));
        let made = made.unwrap_or_else(|error| panic!("{head_of}: {error}"));
        assert_eq!(grays(&made), STORED, "{head_of}");
        let file = label.array.unwrap().file;
        assert_eq!(file.as_deref(), Some("E.IMG"), "{head_of}");
    }
}

/// By hand: 2048 of 4095 is half the light, sRGB 188.
#[test]
fn bits_of_counts_come_from_the_mask_and_their_lack_is_reported() {
    let made = |mask: &str| {
        let text = format!(
            "PDS_VERSION_ID = PDS3\n^IMAGE = \"A.IMG\"\nOBJECT = IMAGE\nLINES = 1\nLINE_SAMPLES = 2\n\
             SAMPLE_TYPE = MSB_UNSIGNED_INTEGER\nSAMPLE_BITS = 16\n{mask}END_OBJECT = IMAGE\nEND\n"
        );
        let label = head(text.as_bytes()).unwrap();
        let made = develop(None, &[8, 0, 0x0f, 0xff], Some(&label)).unwrap();
        (grays(&made), made.notes.join("; "))
    };
    for mask in ["2#0000111111111111#", "16#0FFF#", "4095"] {
        let (codes, notes) = made(&format!("SAMPLE_BIT_MASK = {mask}\n"));
        assert_eq!(codes, [188, 255], "{mask}");
        assert!(!notes.contains("doubtful"), "{notes}");
    }
    let (codes, notes) = made("");
    assert_eq!(codes, [49, 71]);
    assert!(
        notes.contains("doubtful tones: the largest count is 4095"),
        "{notes}"
    );
}

#[test]
fn an_image_beyond_the_limit_is_refused_with_both_numbers() {
    let label = pds4_label("", &area("A.IMG", &array("", 0)));
    assert!(develop_within(None, &STORED, Some(&label), 18).is_ok());
    let error = develop_within(None, &STORED, Some(&label), 17).err().unwrap();
    assert!(error.is_limit(), "{error}");
    assert_eq!(
        error.to_string(),
        "3 x 2 pixels take 1 MB in memory, above the limit of 0 MB"
    );
}

/// A folder of the reported faults. `None`, with a line of output, if it is absent.
fn shared(name: &str) -> Option<PathBuf> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data/input-faults");
    let path = path.join(name);
    if !path.is_dir() {
        println!("skipped: {name} needs ../shared/data/input-faults");
        return None;
    }
    Some(path)
}

/// Values by GDAL 3.10 and pdr.
#[test]
fn real_labels_give_the_pixels_that_gdal_reads() {
    let read = |folder: &Path, name: &str| std::fs::read(folder.join(name)).unwrap();
    if let Some(folder) = shared("msl-drcl-255") {
        let name = "2264ML0121141200805116C00_DRCL";
        let label = head(&read(&folder, &format!("{name}.LBL"))).unwrap();
        let made = develop(None, &read(&folder, &format!("{name}.IMG")), Some(&label)).unwrap();
        assert_eq!(made.image.at(5, 4), [255, 33, 25]);
        assert_eq!(made.image.at(75, 50), [255, 255, 212]);
    }
    if let Some(folder) = shared("pds4-bottom-to-top") {
        let label = pds4::read(&read(&folder, "x_bottom.xml")).unwrap();
        let made = develop(None, &read(&folder, "x_bottom.img"), Some(&label)).unwrap();
        assert_eq!((made.image.at(0, 0)[0], made.image.at(0, 95)[0]), (91, 174));
    }
    if let Some(folder) = shared("pds3-object-file") {
        let label = head(&read(&folder, "e_file.lbl")).unwrap();
        let made = develop(None, &read(&folder, "e_file.img"), Some(&label)).unwrap();
        assert_eq!(made.image.at(0, 0)[0], 91);
    }
}

/// The file as the camera sent it, and the array that the archive made of it.
#[test]
fn a_compressed_product_gives_the_pixels_of_its_decompressed_twin() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data/labels");
    let read = |name: &str| std::fs::read(folder.join(name));
    let stem = "3778ML1037770010808163I01";
    let files = [format!("{stem}_XXXX.DAT"), format!("{stem}_DXXX.IMG")].map(|name| read(&name));
    let [Ok(compressed), Ok(array)] = files else {
        println!("skipped: a_compressed_product_gives_the_pixels needs ../shared/data/labels");
        return;
    };
    let name = |kind: &str| marf_pds::ProductName::read(&format!("{stem}_{kind}")).unwrap();
    let made = develop(Some(&name("XXXX")), &compressed, None).unwrap();
    let twin = develop(Some(&name("DXXX")), &array, None).unwrap();
    assert_eq!((made.image.width, made.image.height, made.bands), (16, 16, 3));
    // JPEG decoders may round differently: the twin was made by the decoder of the mission.
    let bytes = made
        .image
        .pixels
        .iter()
        .flatten()
        .zip(twin.image.pixels.iter().flatten());
    let largest = bytes.map(|(made, twin)| made.abs_diff(*twin)).max();
    assert!(largest.is_some_and(|largest| largest <= 4), "{largest:?}");
}
