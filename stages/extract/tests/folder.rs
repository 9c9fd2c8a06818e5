//! A folder of photos as an archive.
#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "helpers of tests are not seen as tests"
)]

mod common;

use std::fs;
use std::path::Path;

use common::{bring, folder, stage};
use marf_scene::{Image, PhotoFacts, encode_png};
use marf_stage::Listing;

fn png(seed: u32) -> Vec<u8> {
    let image = Image::from_fn(16, 12, |x, y| {
        [(x * 9 + seed) as u8, (y * 11) as u8, (x * y + 3 * seed) as u8]
    });
    encode_png(&image).unwrap()
}

fn write(root: &Path, name: &str, bytes: &[u8]) {
    let path = root.join(name);
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    fs::write(path, bytes).unwrap();
}

const SOL_7: &str = "NLF_0007_0671382174_448ECM_N0031950NCAM00500_01_095J";

fn record() -> Vec<u8> {
    let components = "(0.9,0.4,-1.9);(1,0,0);(8,20,0);(6,0,20)";
    serde_json::json!({
        "imageid": SOL_7, "sol": 7, "site": 3, "drive": 1950, "attitude": "(0.8,0.0,0.0,0.6)",
        "camera": {"instrument": "NAVCAM_LEFT", "camera_model_component_list": components},
        "extended": {"xyz": "(12.5,-3.25,0.125)", "dimension": "(16,12)"},
    })
    .to_string()
    .into_bytes()
}

/// An attached label and 6 x 4 samples of a mosaic, 12 bits in 16.
fn img() -> Vec<u8> {
    let mut bytes = b"ODL_VERSION_ID = ODL3\r\nRECORD_BYTES = 512\r\n^IMAGE = 2\r\nPLANET_DAY_NUMBER = 9\r\n\
        GROUP = INSTRUMENT_STATE_PARMS\r\nBAYER_METHOD = RAW_BAYER\r\nCFA_TYPE = BAYER_RGGB\r\nEND_GROUP\r\n\
        OBJECT = IMAGE\r\nLINES = 4\r\nLINE_SAMPLES = 6\r\nSAMPLE_BITS = 16\r\nSAMPLE_TYPE = MSB_INTEGER\r\n\
        SAMPLE_BIT_MASK = 2#0000111111111111#\r\nEND_OBJECT\r\nEND\r\n"
        .to_vec();
    bytes.resize(512, b' ');
    bytes.extend((0..24_u16).flat_map(|index| (index * 170).to_be_bytes()));
    bytes
}

/// A folder with a bit of everything.
fn sample(root: &Path) {
    write(root, "raw/mosaic.IMG", &img());
    write(root, "images/a.png", &png(1));
    write(root, "images/b.png", &png(2));
    write(root, &format!("{SOL_7}01.png"), &png(3));
    write(root, &format!("{SOL_7}.json"), &record());
    write(root, "transforms.json", b"{\"frames\": []}");
    write(root, "sparse/0/cameras.txt", b"# none\n");
    write(root, "notes.txt", b"hello");
    write(root, ".hidden/c.png", &png(4));
}

#[test]
fn a_folder_becomes_rows_verdicts_and_companions() {
    let dir = tempfile::tempdir().unwrap();
    sample(dir.path());
    let brought = bring(folder(dir.path())).unwrap();
    let mut ids = brought.ids();
    ids.sort_unstable();
    let product = format!("{SOL_7}01");
    assert_eq!(
        ids,
        [product.as_str(), "images/a.png", "images/b.png", "raw/mosaic.IMG"]
    );
    assert_eq!(
        brought.listing.companions.keys().collect::<Vec<_>>(),
        ["sparse/0/cameras.txt", "transforms.json"]
    );
    let facts = brought.facts(&product);
    assert_eq!(
        (facts.sol, facts.width, facts.height, facts.thumbnail),
        (Some(7), 16, 12, false)
    );
    assert_eq!(facts.prior.unwrap().model.h, [8.0, 20.0, 0.0]);
    assert_eq!(brought.verdict("notes.txt").verdict, "skipped");
    assert!(brought.verdict(".hidden").reason.contains("hidden folder"));
    assert_eq!(brought.verdicts.len(), 6, "{:#?}", brought.verdicts);
    for (_, row) in &brought.rows {
        assert!(brought.harness.get(&row.blobs["image"]).is_some(), "{}", row.id);
    }
}

#[test]
fn the_rows_follow_the_version() {
    let dir = tempfile::tempdir().unwrap();
    sample(dir.path());
    let brought = bring(folder(dir.path())).unwrap();
    let rows: Vec<_> = brought.rows.iter().map(|(shard, row)| (*shard, row)).collect();
    let text = serde_json::to_string(&(&rows, &brought.verdicts)).unwrap();
    let digest = marf_cache::Digest::from_content(text.as_bytes()).short();
    let version = marf_stage::define::<marf_extract::Extract>().version;
    // If this fails and the rows were meant to change, raise `Extract::VERSION` and put both numbers here.
    assert_eq!((version, digest.as_str()), (9, "71a85ab41b5e"), "{text}");
}

/// A set in parts, as the synthetic scenes of NeRF come.
#[test]
fn cameras_of_a_set_in_parts_are_companions() {
    let dir = tempfile::tempdir().unwrap();
    write(dir.path(), "train/r_0.png", &png(1));
    let parts = [
        "transforms_test.json",
        "transforms_train.json",
        "transforms_val.json",
    ];
    for part in parts {
        write(dir.path(), part, b"{\"frames\": []}");
    }
    let brought = bring(folder(dir.path())).unwrap();
    assert_eq!(brought.ids(), ["train/r_0.png"]);
    assert_eq!(brought.listing.companions.keys().collect::<Vec<_>>(), parts);
}

#[test]
fn pictures_below_masks_are_companions_and_no_photos() {
    let dir = tempfile::tempdir().unwrap();
    write(dir.path(), "images/a.jpg.png", &png(1));
    write(dir.path(), "masks/a.jpg.png", &png(2));
    write(dir.path(), "sol7/masks/left/b.png", &png(3));
    write(dir.path(), "masks/readme.txt", b"black hides");
    write(dir.path(), "masks.png", &png(4));
    let brought = bring(folder(dir.path())).unwrap();
    assert_eq!(brought.ids(), ["images/a.jpg.png", "masks.png"]);
    assert_eq!(
        brought.listing.companions.keys().collect::<Vec<_>>(),
        ["masks/a.jpg.png", "sol7/masks/left/b.png"]
    );
    assert_eq!(brought.verdict("masks/readme.txt").verdict, "skipped");
}

/// Masks for photos that an archive on a server has: no photo is missing from a folder of masks.
#[test]
fn a_folder_of_masks_alone_has_companions_and_no_photo() {
    let dir = tempfile::tempdir().unwrap();
    write(dir.path(), "masks/ZL-640x480.png", &png(2));
    let brought = bring(folder(dir.path())).unwrap();
    assert_eq!(brought.ids(), [""; 0]);
    assert_eq!(
        brought.listing.companions.keys().collect::<Vec<_>>(),
        ["masks/ZL-640x480.png"]
    );
}

#[test]
fn points_beside_the_photos_are_companions() {
    let dir = tempfile::tempdir().unwrap();
    write(dir.path(), "images/a.png", &png(1));
    write(dir.path(), "points.ply", b"ply\n");
    write(dir.path(), "sparse/0/sparse_pc.ply", b"ply\n");
    write(dir.path(), "images/points.ply", b"ply\n");
    let brought = bring(folder(dir.path())).unwrap();
    assert_eq!(
        brought.listing.companions.keys().collect::<Vec<_>>(),
        ["points.ply", "sparse/0/sparse_pc.ply"]
    );
    assert_eq!(brought.verdict("images/points.ply").verdict, "skipped");
}

#[test]
fn a_jpeg_brings_the_focal_length_and_the_device_of_its_exif() {
    let dir = tempfile::tempdir().unwrap();
    let mut jpeg = Vec::new();
    let encoder = image::codecs::jpeg::JpegEncoder::new(&mut jpeg);
    image::ImageEncoder::write_image(
        encoder,
        &[90; 48 * 72 * 3],
        48,
        72,
        image::ExtendedColorType::Rgb8,
    )
    .unwrap();
    // TIFF, big-endian: Make "Mars", and an EXIF table with FocalLengthIn35mmFilm 50.
    let tiff =
        b"MM\0*\0\0\0\x08\0\x02\x01\x0f\0\x02\0\0\0\x05\0\0\0\x26\x87\x69\0\x04\0\0\0\x01\0\0\0\x2c\0\0\0\0\
        Mars\0\0\0\x01\xa4\x05\0\x03\0\0\0\x01\0\x32\0\0\0\0\0\0";
    let mut segment = vec![0xff, 0xe1];
    segment.extend((tiff.len() as u16 + 8).to_be_bytes());
    segment.extend(b"Exif\0\0");
    segment.extend(tiff);
    jpeg.splice(2..2, segment);
    write(dir.path(), "a.jpg", &jpeg);
    let facts = bring(folder(dir.path())).unwrap().facts("a.jpg");
    // 50 / 36 of the longer side of 72 px.
    assert_eq!(
        (facts.focal_px, facts.device.as_deref()),
        (Some(100.0), Some("Mars"))
    );
    assert!(facts.notes.is_empty(), "{:?}", facts.notes);
}

#[test]
fn a_moved_folder_lists_the_same() {
    let (one, two) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    sample(one.path());
    sample(two.path());
    let (one, two) = (
        bring(folder(one.path())).unwrap(),
        bring(folder(two.path())).unwrap(),
    );
    let items = |listing: &Listing| (listing.shards.clone(), listing.companions.clone());
    assert_eq!(items(&one.listing), items(&two.listing));
    assert_eq!(one.rows, two.rows);
    let key = |path: &str| stage(folder(Path::new(path))).unwrap().params();
    assert_eq!(key("/a"), key("/b"));
}

#[test]
fn only_the_shard_of_a_changed_file_changes() {
    let dir = tempfile::tempdir().unwrap();
    sample(dir.path());
    let before = bring(folder(dir.path())).unwrap().listing;
    write(dir.path(), "images/a.png", &png(9));
    let after = bring(folder(dir.path())).unwrap().listing;
    assert_eq!(
        before.shards.iter().map(|shard| shard.shard).collect::<Vec<_>>(),
        [0, 7, 9]
    );
    assert_ne!(before.shards[0], after.shards[0]);
    assert_eq!(before.shards[1], after.shards[1]);
    write(dir.path(), "transforms.json", b"{}");
    let third = bring(folder(dir.path())).unwrap().listing;
    assert_eq!(third.shards, after.shards);
    assert_ne!(third.companions, after.companions);
}

#[test]
fn a_choice_of_sols_is_part_of_the_listing() {
    let dir = tempfile::tempdir().unwrap();
    sample(dir.path());
    let choose = |sols: &str| bring(serde_json::json!({"kind": "folder", "path": dir.path(), "sols": sols}));
    assert_eq!(choose("latest").unwrap().ids(), ["raw/mosaic.IMG"]);
    for sols in ["7", "1..=8", "2,7"] {
        assert_eq!(choose(sols).unwrap().ids(), [format!("{SOL_7}01")], "{sols}");
    }
    let error = choose("8").err().unwrap();
    let marf_stage::StageError::Failed { message, hint, .. } = error else {
        panic!("{error:?}");
    };
    assert!(message.contains("0 to 9 (3 in all)"), "{message}");
    assert_eq!(
        hint.as_deref(),
        Some("change `sols` of the archive, or leave it out for all")
    );
}

#[test]
fn files_of_one_product_give_one_row() {
    let dir = tempfile::tempdir().unwrap();
    let archive = "ZL0_0001_0667035659_559EBY_N0010052AUT_04096_0260LMJ";
    write(dir.path(), &format!("x/{archive}01.png"), &png(1));
    write(dir.path(), &format!("x/{archive}02.png"), &png(2));
    write(dir.path(), &format!("y/{archive}02_1200.png"), &png(3));
    let brought = bring(folder(dir.path())).unwrap();
    assert_eq!(brought.ids(), [format!("{archive}02")]);
    assert_eq!(
        brought.facts(&format!("{archive}02")).file,
        format!("x/{archive}02.png")
    );
    let reason = |file: &str| brought.verdict(file).reason.clone();
    assert!(reason(&format!("x/{archive}01.png")).contains("superseded by 02"));
    assert!(reason(&format!("y/{archive}02_1200.png")).contains("another file of product"));
}

#[test]
fn files_that_are_no_photo_get_a_verdict_each() {
    let dir = tempfile::tempdir().unwrap();
    write(dir.path(), "good.png", &png(1));
    write(dir.path(), "cut.png", &png(1)[..40]);
    write(dir.path(), "page.jpg", b"<html>404</html>");
    write(dir.path(), "old.tif", b"II*\0");
    write(dir.path(), "jpeg_in_disguise.bin", &png(2));
    write(
        dir.path(),
        "evil.xml",
        b"<!DOCTYPE l [<!ENTITY x SYSTEM \"file:///etc/passwd\">]><l>&x;</l>",
    );
    write(dir.path(), "alone.json", &record());
    write(dir.path(), "bad.json", b"{");
    let brought = bring(folder(dir.path())).unwrap();
    for (file, verdict) in [
        ("good.png", "keep"),
        ("jpeg_in_disguise.bin", "keep"),
        ("cut.png", "decode"),
        ("page.jpg", "decode"),
        ("old.tif", "decode"),
        ("evil.xml", "skipped"),
        ("alone.json", "skipped"),
        ("bad.json", "skipped"),
    ] {
        let found = brought.verdict(file);
        assert_eq!(found.verdict, verdict, "{found:?}");
        assert_eq!(found.reason.is_empty(), verdict == "keep", "{found:?}");
    }
}

#[test]
fn tiff_and_pnm_are_photos_by_their_bytes_and_undeveloped_pixels_are_none() {
    let dir = tempfile::tempdir().unwrap();
    let picture = image::RgbImage::from_fn(16, 12, |x, y| image::Rgb([(x * 9) as u8, (y * 11) as u8, 7]));
    let written = |format| {
        let mut bytes = std::io::Cursor::new(Vec::new());
        picture.write_to(&mut bytes, format).unwrap();
        bytes.into_inner()
    };
    let tiff = written(image::ImageFormat::Tiff);
    write(dir.path(), "a.tif", &tiff);
    write(dir.path(), "b.scan", &tiff);
    write(dir.path(), "c.ppm", &written(image::ImageFormat::Pnm));
    write(dir.path(), "d.dng", &tiff);
    write(dir.path(), "e.bmp", &written(image::ImageFormat::Tiff)[..3]);
    write(dir.path(), "f.txt", b"P5 is a format of pictures");
    let brought = bring(folder(dir.path())).unwrap();
    assert_eq!(brought.ids(), ["a.tif", "b.scan", "c.ppm"]);
    assert_eq!(brought.facts("c.ppm").width, 16);
    for (file, verdict, word) in [
        ("d.dng", "skipped", "undeveloped"),
        ("e.bmp", "decode", "not a JPEG"),
        ("f.txt", "skipped", "`.txt`"),
    ] {
        let found = brought.verdict(file);
        assert_eq!(found.verdict, verdict, "{found:?}");
        assert!(found.reason.contains(word), "{found:?}");
    }
}

#[test]
fn raw_pixels_are_developed_by_the_label_at_their_head_or_beside_them() {
    let dir = tempfile::tempdir().unwrap();
    let whole = img();
    write(dir.path(), "one.IMG", &whole);
    let label = String::from_utf8(whole[..512].to_vec()).unwrap();
    write(
        dir.path(),
        "two.lbl",
        label.replace("^IMAGE = 2", "^IMAGE = (\"TWO.IMG\")").as_bytes(),
    );
    write(dir.path(), "two.img", &whole[512..]);
    write(dir.path(), "three.img", &whole[512..]);
    write(dir.path(), "four.img", &whole[..540]);
    let brought = bring(folder(dir.path())).unwrap();
    assert_eq!(brought.ids(), ["one.IMG", "two.img"]);
    let image = |id: &str| {
        let row = &brought.rows.iter().find(|(_, row)| row.id == id).unwrap().1;
        marf_scene::Photo::decode(&brought.harness.get(&row.blobs["image"]).unwrap())
            .unwrap()
            .image
    };
    assert_eq!(image("one.IMG"), image("two.img"));
    // Stored 170 at column 1, line 0: light 170 / 4095, sRGB 57, in the green it was seen through.
    assert_eq!(image("one.IMG").at(1, 0)[1], 57);
    let facts = brought.facts("two.img");
    assert_eq!(
        (facts.width, facts.height, facts.bands, facts.sol),
        (6, 4, 3, Some(9))
    );
    let reason = |file: &str| brought.verdict(file).reason.clone();
    assert!(
        reason("three.img").contains("no label"),
        "{}",
        reason("three.img")
    );
    assert!(
        reason("four.img").contains("describes 560 bytes, it has 540"),
        "{}",
        reason("four.img")
    );
}

#[test]
fn a_scaled_photo_has_a_scaled_camera_and_a_cut_one_none() {
    let dir = tempfile::tempdir().unwrap();
    let name = format!("{SOL_7}01.png");
    let prior = |width, height| {
        write(
            dir.path(),
            &name,
            &encode_png(&Image::from_fn(width, height, |x, y| [x as u8, y as u8, 7])).unwrap(),
        );
        write(dir.path(), &format!("{SOL_7}.json"), &record());
        let facts: PhotoFacts = bring(folder(dir.path())).unwrap().facts(&format!("{SOL_7}01"));
        (facts.prior.map(|prior| prior.model.h), facts.notes)
    };
    assert_eq!(prior(16, 12).0, Some([8.0, 20.0, 0.0]));
    // x = 8 is the centre of pixel 8. At half the size its corner 8.5 becomes 4.25, its centre 3.75.
    let (half, notes) = prior(8, 6);
    assert_eq!(half, Some([3.75, 10.0, 0.0]));
    assert!(notes[0].contains("scaled from 16x12"), "{notes:?}");
    let (none, notes) = prior(16, 9);
    assert_eq!(none, None);
    assert!(notes[0].contains("16x12 pixels, the photo has 16x9"), "{notes:?}");
}

#[test]
fn a_file_that_changes_after_the_listing_stops_the_shard() {
    let dir = tempfile::tempdir().unwrap();
    sample(dir.path());
    let harness = marf_stage::harness::Harness::default();
    let stage = stage(folder(dir.path())).unwrap();
    let source = common::source(stage.as_ref());
    source.list(&harness.ctx()).unwrap();
    write(dir.path(), "images/a.png", &png(77));
    let error = source.fetch(&harness.ctx(), 0).unwrap_err().to_string();
    assert!(error.contains("`images/a.png` changed"), "{error}");
}

#[cfg(unix)]
#[test]
fn links_in_circles_and_unreadable_files_are_verdicts() {
    use std::os::unix::fs::{PermissionsExt, symlink};
    let dir = tempfile::tempdir().unwrap();
    write(dir.path(), "a.png", &png(1));
    symlink(dir.path(), dir.path().join("again")).unwrap();
    symlink("nowhere", dir.path().join("broken.png")).unwrap();
    write(dir.path(), "secret.png", &png(2));
    fs::set_permissions(dir.path().join("secret.png"), fs::Permissions::from_mode(0o000)).unwrap();
    let readable_anyway = fs::read(dir.path().join("secret.png")).is_ok(); // as root
    let brought = bring(folder(dir.path())).unwrap();
    let reason = |file: &str| brought.verdict(file).reason.as_str();
    assert!(reason("again").contains("leads back"), "{}", reason("again"));
    assert_eq!(brought.verdict("broken.png").verdict, "decode");
    let why = reason("secret.png");
    assert!(readable_anyway || why.contains("permission"), "{why}");
}
