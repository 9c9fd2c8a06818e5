//! Real photos: verdicts of the default rules on the Navcam feed, and on the rover set with planted copies.

use std::{collections::BTreeMap, fs, path::PathBuf};

use crate::common::{Photos, defaults, dynamic, encoded, jpeg, narrow, png, smeared};
use image::ImageFormat;
use marf_filter::STAGES;
use marf_scene::{Image, Photo};

/// Returns the photos of a folder of shared data, sorted by name. `None` if it does not exist.
fn folder(test: &str, name: &str) -> Option<Vec<PathBuf>> {
    let relative = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/data");
    let data = std::env::var_os("MARF_SHARED_DATA").map_or_else(|| PathBuf::from(relative), PathBuf::from);
    let Ok(entries) = fs::read_dir(data.join(name)) else {
        println!("skipped: {test} needs ../shared/data/{name}");
        return None;
    };
    let mut paths: Vec<_> = entries.map(|entry| entry.unwrap().path()).collect();
    paths.retain(|path| path.extension().is_some_and(|end| end != "json"));
    paths.sort();
    Some(paths)
}

/// Runs the default chain and returns the filter that rejected each photo.
fn rejected(mut photos: Photos) -> BTreeMap<String, String> {
    let mut rejected = BTreeMap::new();
    for stage in STAGES {
        let verdicts = photos.judge(stage.name, defaults());
        photos.rows.retain(|row| verdicts[&row.id].keeps());
        let gone = verdicts.into_values().filter(|verdict| !verdict.keeps());
        rejected.extend(gone.map(|verdict| (verdict.id, verdict.verdict)));
    }
    rejected
}

fn id(path: &std::path::Path) -> String {
    path.file_stem().unwrap().to_string_lossy().into_owned()
}

/// Looked at one by one: the first is burnt out over most of its area, the second is a Bayer mosaic never
/// developed. Stereo partners, panorama neighbours, strips, sky and sun stay.
#[test]
fn of_the_navcam_feed_only_a_burnt_out_photo_and_a_raw_mosaic_go() {
    let Some(paths) = folder("of_the_navcam_feed", "m2020_navcam_feed") else {
        return;
    };
    let mut photos = Photos::default();
    for path in &paths {
        photos.add(&id(path), &fs::read(path).unwrap());
    }
    let expected = BTreeMap::from([
        (
            "NLF_0670_0726422025_222ECM_N0320604NCAM08111_01_195J".to_owned(),
            "histogram".to_owned(),
        ),
        (
            "NRE_0060_0672265209_237ECM_N0032046NCAM00410_00_0LLJ".to_owned(),
            "grayscale".to_owned(),
        ),
    ]);
    let found = rejected(photos);
    let short = |list: &BTreeMap<String, String>| -> Vec<(String, String)> {
        list.iter()
            .map(|(id, verdict)| (id[..19].to_owned(), verdict.clone()))
            .collect()
    };
    assert_eq!(short(&found), short(&expected));
}

#[test]
fn of_the_rover_set_only_planted_flaws_go() {
    let Some(paths) = folder("of_the_rover_set", "rover/images") else {
        return;
    };
    let mut photos = Photos::default();
    let mut planted = BTreeMap::new();
    for (at, path) in paths.iter().step_by(7).enumerate() {
        let bytes = fs::read(path).unwrap();
        photos.add(&id(path), &bytes);
        let image = Photo::decode(&bytes).unwrap().image;
        let (flaw, bytes) = match at {
            0 => (
                "duplicate",
                jpeg(&dynamic(&narrow(&image, 2, [0.45, 0.6, 1.0])), 92),
            ),
            1 => ("duplicate", jpeg(&dynamic(&image), 30)),
            _ => continue,
        };
        planted.insert(format!("planted-{at}"), flaw.to_owned());
        photos.add(&format!("planted-{at}"), &bytes);
    }
    for (at, path) in paths.iter().skip(3).step_by(21).enumerate() {
        let image = Photo::decode(&fs::read(path).unwrap()).unwrap().image;
        let (flaw, bytes) = match at {
            0 => ("blur", png(&smeared(&image, 15))),
            1 => (
                "grayscale",
                encoded(&dynamic(&image).to_luma8().into(), ImageFormat::Png),
            ),
            2 => ("shape", png(&image.box_reduced(2))),
            _ => {
                let lost = Image::from_fn(1440, 1920, |x, y| if y < 640 { image.at(x, y) } else { [0; 3] });
                ("histogram", jpeg(&dynamic(&lost), 92))
            }
        };
        planted.insert(format!("flaw-{at}"), flaw.to_owned());
        photos.add(&format!("flaw-{at}"), &bytes);
    }
    assert_eq!(rejected(photos), planted);
}
