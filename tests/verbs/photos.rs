//! `marf photos`, and filters that reject every photo.

use crate::common::marf;
use crate::with_pipeline;

fn gray(seed: u32) -> image::DynamicImage {
    image::GrayImage::from_fn(64, 48, |x, y| image::Luma([(x * 3 + y * (seed + 2)) as u8])).into()
}

#[test]
fn the_table_has_the_format_of_the_bytes_and_every_file_that_is_not_read() {
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path().join("photos");
    std::fs::create_dir(&folder).unwrap();
    gray(1)
        .save_with_format(folder.join("a.jpg"), image::ImageFormat::Png)
        .unwrap();
    gray(2)
        .to_luma16()
        .save_with_format(folder.join("b.tif"), image::ImageFormat::Tiff)
        .unwrap();
    gray(3)
        .save_with_format(folder.join("c.pgm"), image::ImageFormat::Pnm)
        .unwrap();
    for (name, bytes) in [
        ("d.cr2", &b"II*\0"[..]),
        ("e|f.jpg", b"<html>"),
        ("notes", b"x"),
        ("g.xyz", b"?"),
    ] {
        std::fs::write(folder.join(name), bytes).unwrap();
    }
    let said = marf(dir.path(), &["photos", "photos"]).exits(0);
    for row in [
        "| a.jpg | PNG | 64 x 48 x 1 |",
        "| b.tif | TIFF | 64 x 48 x 1 |",
        "16 bits reduced to 8",
        "| c.pgm | PNM | 64 x 48 x 1 |",
        "| file without a photo | why |",
        "| d.cr2 | undeveloped pixels of a camera",
        "| e\\|f.jpg | not a JPEG, PNG, WebP, GIF, TIFF or PNM",
        "| notes | no photo and no label",
        "| g.xyz | no photo and no label: `.xyz` |",
    ] {
        assert!(said.stdout.contains(row), "{row}\n{}", said.stdout);
    }
    let told = marf(dir.path(), &["photos", "photos", "--json"]).exits(0);
    let table: serde_json::Value = serde_json::from_str(&told.stdout).unwrap();
    assert_eq!(table["photos"][1]["format"], "TIFF");
    assert_eq!(table["not_read"].as_array().unwrap().len(), 4);

    let csv = marf(dir.path(), &["photos", "photos", "--csv"]).exits(0).stdout;
    let mut reader = csv::Reader::from_reader(csv.as_bytes());
    let heads = reader.headers().unwrap().clone();
    let column = |name: &str| heads.iter().position(|head| head == name).unwrap();
    let lines: Vec<csv::StringRecord> = reader.records().map(Result::unwrap).collect();
    assert_eq!(lines.len(), 3 + 4, "{csv}");
    for (line, name, value) in [
        (0, "product", "a.jpg"),
        (1, "format", "TIFF"),
        (2, "width_px", "64"),
        (3, "product", ""),
    ] {
        assert_eq!(&lines[line][column(name)], value, "{csv}");
    }
    let unread = lines
        .iter()
        .find(|line| &line[column("file")] == "e|f.jpg")
        .unwrap();
    assert!(unread[column("not_read")].starts_with("not a JPEG"), "{csv}");

    // Without a pipeline file the newest run of a verb on a folder is meant.
    assert_eq!(marf(dir.path(), &["photos"]).exits(0).stdout, said.stdout);
    let none = marf(dir.path(), &["report"]).exits(1);
    assert!(none.stderr.contains("keeps no report"), "{}", none.stderr);
    marf(dir.path(), &["filter", "photos"]).exits(0);
    marf(dir.path(), &["report"]).exits(0);
    let report = |name: &str| std::fs::read(dir.path().join(name)).unwrap();
    assert_eq!(report("report.html"), report("verdicts.html"));
}

#[test]
fn a_filter_that_rejects_every_photo_says_once_what_keeps_them() {
    let text = "name = \"gray\"\n[archive.a]\nkind = \"folder\"\npath = \"photos\"\n[node.extract]\narchive = \"a\"\n\
        [node.grayscale]\ninput = \"extract\"\nkeep = \"color\"\n";
    let dir = with_pipeline(text);
    std::fs::create_dir(dir.path().join("photos")).unwrap();
    for seed in 0..3 {
        gray(seed)
            .save(dir.path().join(format!("photos/{seed}.png")))
            .unwrap();
    }
    let absent = marf(dir.path(), &["filter", "nowhere"]).exits(1);
    assert!(
        absent
            .stderr
            .contains("hint: set DIR to the folder that holds the photos"),
        "{}",
        absent.stderr
    );
    let warning = "`grayscale` rejects all 3 photos that it is given: `keep = \"all\"`";
    let said = marf(dir.path(), &["run"]).exits(0);
    assert_eq!(said.stderr.matches(warning).count(), 1, "{}", said.stderr);
    let report = std::fs::read_to_string(dir.path().join("out/report.html")).unwrap();
    assert!(report.contains("rejects all 3 photos"), "the report says it too");
    let kept = marf(dir.path(), &["run", "--set", "grayscale.keep=all"]).exits(0);
    assert!(!kept.stderr.contains("rejects all"), "{}", kept.stderr);
    let line = "kept as monochrome: 3 photos of an unnamed camera";
    let usual = marf(dir.path(), &["run", "--set", "grayscale.keep=auto"]).exits(0);
    assert_eq!(usual.stderr.matches(line).count(), 1, "{}", usual.stderr);
    let report = std::fs::read_to_string(dir.path().join("out/report.html")).unwrap();
    assert!(report.contains(line), "the report says it too");
}
