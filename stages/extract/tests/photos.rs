//! Photos as people have them: large ones, of other formats, and between files of systems.
#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "helpers of tests are not seen as tests"
)]

mod common;

use std::fs;
use std::path::Path;

use common::{bring, folder, real, source};
use marf_extract::Extract;
use marf_scene::{Image, Photo, encode_jpeg, encode_png};
use marf_stage::harness::Harness;
use marf_stage::{ArchiveContext, Verdict, define};
use serde_json::json;

fn photo() -> Image<marf_scene::Srgb> {
    Image::from_fn(40, 30, |x, y| [(x * 6) as u8, (y * 8) as u8, 77])
}

fn write(folder: &Path, name: &str, bytes: &[u8]) {
    let path = folder.join(name);
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    fs::write(path, bytes).unwrap();
}

/// The verdicts of a folder under parameters of the node.
fn verdicts(params: serde_json::Value) -> Vec<Verdict> {
    let stage = (define::<Extract>().bind_archive)(params, ArchiveContext::default()).unwrap();
    let harness = Harness::default();
    let source = source(stage.as_ref());
    let listing = source.list(&harness.ctx()).unwrap();
    let fetched = listing
        .shards
        .iter()
        .map(|shard| source.fetch(&harness.ctx(), shard.shard).unwrap());
    fetched.flat_map(|fetched| fetched.verdicts).collect()
}

/// Each limit is one key, and the reason names it.
#[test]
fn a_photo_beyond_a_limit_says_which_key_raises_it() {
    let dir = tempfile::tempdir().unwrap();
    let large = Image::from_fn(700, 500, |x, y| [(x * y) as u8, y as u8, x as u8]);
    write(dir.path(), "large.png", &encode_png(&large).unwrap());
    write(dir.path(), "huge.png", &vec![7; 1_000_001]);
    write(dir.path(), "small.png", &encode_png(&photo()).unwrap());
    let archive =
        |max_file_mb: u64| json!({"kind": "folder", "path": dir.path(), "max_file_mb": max_file_mb});
    let found = verdicts(json!({"archive": archive(1), "max_decoded_mb": 1}));
    let reason = |file: &str| {
        found
            .iter()
            .find(|verdict| verdict.file == file)
            .unwrap()
            .reason
            .clone()
    };
    assert_eq!(
        reason("large.png"),
        "700 x 500 pixels take 2 MB in memory, above the limit of 1 MB: raise `max_decoded_mb` of the extract node"
    );
    assert_eq!(
        reason("huge.png"),
        "more than 1 MB: raise `max_file_mb` of the archive in pipeline.toml"
    );
    assert_eq!(reason("small.png"), "");
    let found = verdicts(json!({"archive": archive(2), "max_decoded_mb": 2}));
    let kept = found.iter().filter(|verdict| verdict.keeps());
    assert_eq!(
        kept.map(|verdict| verdict.file.as_str()).collect::<Vec<_>>(),
        ["large.png", "small.png"]
    );
}

/// A file that a system left next to photos is not a photo, even if its bytes are: it gets a row with the reason.
#[test]
fn files_of_systems_are_skipped_with_the_reason() {
    let dir = tempfile::tempdir().unwrap();
    let picture = encode_jpeg(&photo(), 80).unwrap();
    let left = [
        ("@eaDir/a.jpg/SYNOPHOTO_THUMB_M.jpg", "Synology"),
        ("b/.@__thumb/s800a.jpg", "QNAP"),
        (".thumbnails/normal/1.png", "thumbnail of the desktop"),
        ("Thumbs.db", "thumbnails of Windows"),
        ("b/desktop.ini", "Windows"),
        ("._a.jpg", "macOS"),
        (".DS_Store", "macOS"),
        ("__MACOSX/a.jpg", "macOS"),
    ];
    for (name, _) in left {
        write(dir.path(), name, &picture);
    }
    for name in ["a.jpg", "b/c.jpg", ".hidden.jpg", ".cache/d.jpg", ".marf/e.jpg"] {
        write(dir.path(), name, &picture);
    }
    let brought = bring(folder(dir.path())).unwrap();
    assert_eq!(brought.ids(), ["a.jpg", "b/c.jpg"]);
    for (name, part) in left {
        let verdict = brought.verdict(name);
        assert_eq!(verdict.verdict, "skipped", "{verdict:?}");
        assert!(verdict.reason.contains(part), "{verdict:?}");
    }
    for (name, reason) in [
        (".hidden.jpg", "a hidden file"),
        (".cache", "a hidden folder, in which nothing is read"),
    ] {
        assert_eq!(brought.verdict(name).reason, reason);
    }
    assert_eq!(brought.verdicts.len(), left.len() + 4, "{:#?}", brought.verdicts);
}

/// Files are read down to 32 levels, and the folder below them is named.
#[test]
fn a_folder_that_is_too_deep_has_a_row() {
    let dir = tempfile::tempdir().unwrap();
    let picture = encode_png(&photo()).unwrap();
    let folders = |count: usize| "d/".repeat(count);
    let deepest = format!("{}deepest.png", folders(31));
    write(dir.path(), &deepest, &picture);
    write(dir.path(), &format!("{}lost.png", folders(33)), &picture);
    let brought = bring(folder(dir.path())).unwrap();
    assert_eq!(brought.ids(), [deepest.as_str()]);
    let below = folders(32);
    let verdict = brought.verdict(below.trim_end_matches('/'));
    assert_eq!(verdict.verdict, "decode", "{verdict:?}");
    assert!(verdict.reason.contains("at most 31 are entered"), "{verdict:?}");
    assert_eq!(brought.verdicts.len(), 2);
}

/// A label inside `OBJECT = FILE` that names a file of another name than its own.
#[test]
fn a_label_belongs_to_the_file_that_it_names() {
    let dir = tempfile::tempdir().unwrap();
    let label = "PDS_VERSION_ID = PDS3\nOBJECT = FILE\n^IMAGE = \"DATA_7.IMG\"\nOBJECT = IMAGE\nLINES = 2\nLINE_SAMPLES = 3\n\
                 SAMPLE_TYPE = UNSIGNED_INTEGER\nSAMPLE_BITS = 8\nEND_OBJECT\nEND_OBJECT\nEND\n";
    write(dir.path(), "label_7.lbl", label.as_bytes());
    write(dir.path(), "data_7.img", &[91, 20, 30, 40, 50, 60]);
    let brought = bring(folder(dir.path())).unwrap();
    let (_, row) = brought
        .rows
        .first()
        .unwrap_or_else(|| panic!("{:#?}", brought.verdicts));
    let image = Photo::decode(&brought.harness.get(&row.blobs["image"]).unwrap())
        .unwrap()
        .image;
    assert_eq!((image.width, image.at(0, 0)), (3, [91; 3]));
}

#[test]
fn a_photo_renamed_from_heic_is_named() {
    let dir = tempfile::tempdir().unwrap();
    write(dir.path(), "a.jpg", b"\0\0\0\x18ftypheic\0\0\0\0mif1heic");
    write(dir.path(), "b.png", &encode_png(&photo()).unwrap());
    let brought = bring(folder(dir.path())).unwrap();
    let verdict = brought.verdict("a.jpg");
    assert_eq!(verdict.verdict, "decode");
    assert_eq!(verdict.reason, "HEIC is not read: save it as JPEG, PNG or TIFF");
}

/// The files that were reported: each is read, or named with what to do.
#[test]
fn reported_files_are_read_or_named() {
    for (name, kept) in [
        (
            "trailing-data",
            &["j_base.jpg", "j_motion.jpg", "j_zerotail.jpg"][..],
        ),
        ("large-tiff", &["canon_45mp_16bit.tif"]),
        ("tiff-premultiplied", &["assoc8.tif", "unassoc8.tif"]),
        ("unclear-refusals", &["gdal_jpeg_ycbcr.tif", "t_big.tif"]),
        ("pds3-object-file", &["e_file.img"]),
        ("pds4-bottom-to-top", &["x_bottom.img"]),
    ] {
        let Some(path) = real(&format!("input-faults/{name}")) else {
            continue;
        };
        let brought = bring(folder(&path)).unwrap();
        assert_eq!(brought.ids(), kept, "{:#?}", brought.verdicts);
        if name == "unclear-refusals" {
            let reason = &brought.verdict("x_heic.heic").reason;
            assert!(
                reason.starts_with("HEI") && reason.contains("save it as"),
                "{reason}"
            );
        }
        let image = |id: &str| {
            let (_, row) = brought.rows.iter().find(|(_, row)| row.id == id).unwrap();
            Photo::decode(&brought.harness.get(&row.blobs["image"]).unwrap()).unwrap()
        };
        if name == "trailing-data" {
            assert!(kept.iter().all(|id| image(id).image == image("j_base.jpg").image));
        }
        if name == "tiff-premultiplied" {
            let (stored, straight) = (image("assoc8.tif"), image("unassoc8.tif"));
            assert_eq!(stored.alpha, straight.alpha);
            let pairs = stored
                .image
                .pixels
                .as_flattened()
                .iter()
                .zip(straight.image.pixels.as_flattened());
            assert!(pairs.into_iter().all(|(a, b)| a.abs_diff(*b) <= 1));
        }
    }
}

#[test]
fn folders_without_photos_are_one_clear_error() {
    let dir = tempfile::tempdir().unwrap();
    let fail = |path: &Path, part: &str| {
        let error = bring(folder(path)).err().unwrap();
        assert!(error.to_string().contains(part), "{error}");
        assert!(
            matches!(&error, marf_stage::StageError::Failed { hint: Some(_), .. }),
            "{error:?}"
        );
    };
    fail(&dir.path().join("absent"), "does not exist");
    fail(dir.path(), "is empty");
    write(dir.path(), "readme.md", b"#");
    fail(dir.path(), "has 1 file, which is not a photo");
    fail(&dir.path().join("readme.md"), "is a file, not a folder");
    write(dir.path(), "notes.txt", b"x");
    fail(dir.path(), "has 2 files, and none is a photo");
}

/// The number that the reason names is the number of folders that are entered.
#[test]
fn folders_below_the_deepest_are_named_with_the_limit() {
    let dir = tempfile::tempdir().unwrap();
    let path = |depth: usize| format!("{}photo.png", "a/".repeat(depth));
    for depth in 0..40 {
        let seed = depth as u8;
        let image = Image::from_fn(16, 12, |x, y| [(x * 9) as u8, (y * 11) as u8, seed]);
        write(dir.path(), &path(depth), &encode_png(&image).unwrap());
    }
    let brought = bring(folder(dir.path())).unwrap();
    let said = "a folder in which nothing is read: at most ";
    let mut reasons = brought
        .verdicts
        .iter()
        .filter_map(|verdict| verdict.reason.strip_prefix(said));
    let reason = reasons
        .next()
        .unwrap_or_else(|| panic!("{:#?}", brought.verdicts));
    assert!(reason.ends_with(" are entered within each other"), "{reason}");
    let most: usize = reason.split(' ').next().unwrap().parse().unwrap();
    let ids = brought.ids();
    assert!(ids.contains(&path(most).as_str()), "{most}: {ids:?}");
    assert!(!ids.contains(&path(most + 1).as_str()), "{most}: {ids:?}");
}
