//! Real files of three missions.
#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "helpers of tests are not seen as tests"
)]

mod common;

use std::fs;
use std::path::Path;

use common::{Brought, bring, folder, real};
use marf_scene::{Cahvor, Image, Photo, PhotoFacts, encode_png};
use nalgebra::Vector3;

#[test]
fn every_navcam_record_becomes_a_photo_with_its_camera() {
    let Some(path) = real("m2020_navcam_feed") else {
        return;
    };
    let brought = bring(folder(&path)).unwrap();
    print_table(&brought);
    assert_eq!(brought.rows.len(), 36);
    assert!(
        brought.verdicts.iter().all(marf_stage::Verdict::keeps),
        "{:#?}",
        brought.verdicts
    );
    for (sol, row) in &brought.rows {
        let facts = brought.facts(&row.id);
        let prior = facts
            .prior
            .unwrap_or_else(|| panic!("{}: {:?}", row.id, facts.notes));
        assert_eq!(facts.sol, Some(*sol), "{}", row.id);
        assert!(
            prior.model.e.is_some() && prior.site_from_frame.is_some(),
            "{}",
            row.id
        );
        // The cameras are already in the grid of their tiles: focal lengths of scale factors 4, 2 and 1.
        let focal = focal_px(&prior.model);
        let near = [739.7, 1479.2, 2958.5]
            .iter()
            .any(|known| (focal / known - 1.0_f64).abs() < 0.01);
        assert!(near, "{}: {focal}", row.id);
    }
    let raw = brought.facts("NRE_0060_0672265209_237ECM_N0032046NCAM00410_00_0LLJ");
    assert!(raw.notes.iter().any(|note| note.contains("mosaic")), "{raw:?}");
    assert_eq!(brought.listing.shards.len(), 26);
}

#[test]
fn every_number_of_a_navcam_record_is_read() {
    let Some(path) = real("m2020_navcam_feed") else {
        return;
    };
    let sol_50 = bring(serde_json::json!({"kind": "folder", "path": path, "sols": "50"})).unwrap();
    let facts = sol_50.facts("NLF_0050_0671382174_448ECM_N0031950NCAM00500_01_295J");
    assert_eq!(
        (facts.width, facts.height, facts.bands, facts.thumbnail),
        (1280, 240, 3, false)
    );
    let prior = facts.prior.unwrap();
    assert_eq!(prior.motion_counter, [3, 1950]);
    assert_eq!(prior.model.c, [0.666_811, 0.772_01, -1.959_41]);
    assert_eq!(prior.model.r, Some([2e-6, 0.049_535, -0.015_973]));
    let e = prior.model.e.unwrap();
    assert_eq!((e.terms, e.linearity), ([-0.003_612, 0.013_016, -0.023_961], 0.0));
    let pose = prior.site_from_frame.unwrap();
    assert_eq!(pose.translation, Vector3::new(10.3131, 65.9943, 0.715_083));
    // The rover has turned by 180 degrees.
    assert!(
        pose.rotation[(0, 0)] < -0.999 && pose.rotation[(2, 2)] > 0.999,
        "{pose:?}"
    );
}

#[test]
fn every_img_of_three_missions_is_developed() {
    let sizes = [
        ("m2020_sol0709_img", 6),
        ("mer_img", 2),
        ("msl_img", 1),
        ("labels", 2),
    ];
    for (name, photos) in sizes {
        let Some(path) = real(name) else { continue };
        let brought = bring(folder(&path)).unwrap();
        print_table(&brought);
        assert_eq!(brought.rows.len(), photos, "{name}");
        for (_, row) in &brought.rows {
            let facts = brought.facts(&row.id);
            // The folder has no label for the compressed original.
            let is_labelled = !row.id.ends_with("_XXXX");
            assert_eq!(
                facts.prior.is_some_and(|prior| prior.site_from_frame.is_some()),
                is_labelled,
                "{}: {:?}",
                row.id,
                facts.notes
            );
            let image = brought.harness.get(&row.blobs["image"]).unwrap();
            let photo = Photo::decode(&image).unwrap();
            assert_eq!(
                (photo.image.width, photo.image.height),
                (facts.width, facts.height),
                "{}",
                row.id
            );
            assert_eq!(
                brought.harness.get(&row.blobs["raw"]).unwrap().len() as u64,
                facts.size_bytes,
                "{}",
                row.id
            );
        }
    }
}

#[test]
fn mastcam_z_has_the_focal_lengths_of_its_zooms() {
    let Some(path) = real("m2020_sol0709_img") else {
        return;
    };
    let brought = bring(folder(&path)).unwrap();
    for (id, zoom_mm, expected_px) in [
        (
            "ZL0_0709_0729888971_069RAD_N0332864ZCAM07114_0340LMA01",
            34,
            4664.0,
        ),
        (
            "ZR0_0709_0729888971_069RAD_N0332864ZCAM07114_0340LMA01",
            34,
            4664.0,
        ),
        (
            "ZL0_0711_0730060145_020RAD_N0332864ZCAM03552_0630LMA01",
            63,
            8583.0,
        ),
        (
            "ZR0_0711_0730060314_988RAD_N0332864ZCAM03552_0630LMA01",
            63,
            8583.0,
        ),
        (
            "ZL0_0711_0730054943_723RAD_N0332864ZCAM03014_048085A02",
            48,
            6611.0,
        ),
        (
            "ZR0_0711_0730054943_723RAD_N0332864ZCAM03014_048085A02",
            48,
            6611.0,
        ),
    ] {
        let facts = brought.facts(id);
        let prior = facts.prior.unwrap();
        let focal = focal_px(&prior.model);
        assert!(
            (focal / expected_px - 1.0_f64).abs() < 0.01,
            "{zoom_mm} mm: {focal}"
        );
        assert_eq!(prior.motion_counter[..3], [33, 2864, 12], "{id}");
        assert_eq!((facts.bands, facts.filter.as_deref()), (3, Some("0")), "{id}");
    }
    // A subframe's principal point lies outside its image, 133 px left of it, and stays there.
    let subframe = brought.facts("ZL0_0711_0730054943_723RAD_N0332864ZCAM03014_048085A02");
    let k = subframe.prior.unwrap().model.intrinsics().unwrap();
    assert!(k.hc < -100.0 && (0.0..688.0).contains(&k.vc), "{k:?}");
    // The stereo baseline of the 34 mm pair, metres.
    let centre = |id: &str| Vector3::from(brought.facts(id).prior.unwrap().model.c);
    let pair = ["ZL0", "ZR0"].map(|eye| {
        centre(&format!(
            "{eye}_0709_0729888971_069RAD_N0332864ZCAM07114_0340LMA01"
        ))
    });
    let baseline = (pair[0] - pair[1]).norm();
    assert!((0.2407..=0.2442).contains(&baseline), "{baseline}");
}

#[test]
fn sizes_of_the_opportunity_pair_are_those_of_the_image() {
    let Some(path) = real("mer_img") else { return };
    let brought = bring(folder(&path)).unwrap();
    let facts = brought.facts("1N491020834ILFCNY9P0706L0M1");
    // A first match of LINES would be the thumbnail's 64, of FILTER_NAME a filter of another camera.
    assert_eq!((facts.width, facts.height, facts.bands), (1024, 1024, 1));
    assert_eq!(
        (facts.sol, facts.filter.as_deref(), facts.thumbnail),
        (Some(4087), Some("0"), false)
    );
    let prior = facts.prior.unwrap();
    assert_eq!(
        (prior.frame.as_str(), prior.motion_counter),
        ("ROVER_FRAME", vec![195, 973, 5, 28, 59])
    );
    assert_eq!(
        prior.site_from_frame.unwrap().translation,
        Vector3::new(73.9193, 65.9703, 6.562_88)
    );
}

/// A folder with a label and a picture of its size.
fn labelled(label: &str, photo: &str, width: u32, height: u32) -> Option<PhotoFacts> {
    let path = real("labels")?;
    let dir = tempfile::tempdir().unwrap();
    fs::copy(path.join(label), dir.path().join(label)).unwrap();
    let picture = encode_png(&Image::from_fn(width, height, |x, y| [x as u8, y as u8, 9])).unwrap();
    fs::write(dir.path().join(photo), picture).unwrap();
    let brought = bring(folder(dir.path())).unwrap();
    Some(brought.facts(Path::new(photo).file_stem().unwrap().to_str().unwrap()))
}

#[test]
fn every_number_of_a_mastcam_z_label_is_read() {
    let name = "ZLF_1737_0821123689_910RAD_N0830000ZCAM00091_1100LMJ01";
    let Some(facts) = labelled(&format!("{name}.xml"), &format!("{name}.png"), 1648, 1200) else {
        return;
    };
    assert_eq!(
        (facts.sol, facts.instrument.as_deref(), facts.filter.as_deref()),
        (Some(1737), Some("ZL"), Some("F"))
    );
    assert!(facts.notes.is_empty(), "{:?}", facts.notes);
    let prior = facts.prior.unwrap();
    assert_eq!(prior.frame, "ROVER_NAV_FRAME");
    assert_eq!(prior.motion_counter, [83, 0, 62, 120, 0, 0, 2400, 1760, 0, 0]);
    let model = prior.model;
    assert_eq!(model.c, [0.871_707, 0.681_446, -1.9493]);
    assert_eq!(model.r, Some([0.000_184_038, 0.388_18, 0.035_168]));
    let length = Vector3::<f64>::new(-0.407_782, 0.568_771, 0.714_303).norm();
    let near = |found: [f64; 3], label: [f64; 3]| {
        let off = (Vector3::from(found) * length - Vector3::from(label)).norm();
        assert!(off < 1e-9, "{found:?} {label:?}");
    };
    near(model.a, [-0.407_782, 0.568_771, 0.714_303]);
    near(model.h, [-12_489.0, -7_959.55, 295.491]);
    near(model.v, [5_662.13, -8_551.97, 10_680.9]);
    let o = Vector3::from(model.o.unwrap());
    let label: Vector3<f64> = Vector3::new(-0.408_166, 0.557_56, 0.722_871);
    assert!((o - label.normalize()).norm() < 1e-15);
    assert!((focal_px(&model) - 14_792.0).abs() < 1.0, "{}", focal_px(&model));
    assert!(model.e.is_none());
    // Yaw of the rover, 2 atan(0.0110686 / 0.999907): the small rotation between the two azimuths of the label.
    let pose = prior.site_from_frame.unwrap();
    assert_eq!(pose.translation, Vector3::zeros());
    let length = (0.999_907_f64.powi(2)
        + 0.001_484_44_f64.powi(2)
        + 0.007_877_95_f64.powi(2)
        + 0.011_068_6_f64.powi(2))
    .sqrt();
    let (w, x, y, z) = (
        0.999_907 / length,
        0.001_484_44 / length,
        0.007_877_95 / length,
        0.011_068_6 / length,
    );
    assert!((pose.rotation[(1, 0)] - 2.0 * (x * y + w * z)).abs() < 1e-15);
    assert!((pose.rotation[(0, 2)] - 2.0 * (x * z + w * y)).abs() < 1e-15);
}

/// The thumbnail's model has the subframe shift in it, but not the factor of 8 of its pixels.
#[test]
fn a_thumbnail_of_curiosity_has_its_camera_reduced() {
    let Some(path) = real("labels") else { return };
    let brought = bring(folder(&path)).unwrap();
    let facts = brought.facts("3778ML1037770010808163I01_DXXX");
    assert!(
        facts.thumbnail && facts.notes.iter().any(|note| note.contains("reduced by 8")),
        "{facts:?}"
    );
    let prior = facts.prior.unwrap();
    assert!(
        (focal_px(&prior.model) - 4645.0 / 8.0).abs() < 1.0,
        "{}",
        focal_px(&prior.model)
    );
    assert_eq!(prior.motion_counter[..3], [100, 1586, 14]);
    // The label's second, mislabelled definition of the rover's frame has the offset (-147.0, 64.5, -4.5).
    let offset = prior.site_from_frame.unwrap().translation;
    assert!(
        (offset - Vector3::new(-150.833_74, 24.855_228, -10.143_73)).norm() < 1e-12,
        "{offset}"
    );
    let row = &brought
        .rows
        .iter()
        .find(|(_, row)| row.id.starts_with("3778"))
        .unwrap()
        .1;
    assert_eq!(row.blobs.keys().collect::<Vec<_>>(), ["image", "label", "raw"]);
}

#[test]
fn a_detached_pds3_label_is_read() {
    let name = "2264ML0121141200805116C00_DRCL";
    let Some(facts) = labelled(&format!("{name}.LBL"), &format!("{name}.png"), 1338, 1193) else {
        return;
    };
    assert_eq!(
        (facts.sol, facts.instrument.as_deref(), facts.filter.as_deref()),
        (Some(2264), Some("ML"), Some("0"))
    );
    let prior = facts.prior.unwrap();
    assert!(prior.model.o.is_none(), "a linearised product is CAHV");
    assert_eq!(prior.motion_counter[..3], [73, 1206, 52]);
    assert_eq!(prior.model.c[..2], [0.782_047_6, 0.421_564_7]);
    // The azimuth and elevation of A in the site's frame are the label's FIXED_INSTRUMENT ones.
    let axis = prior
        .site_from_frame
        .unwrap()
        .direction(&Vector3::from(prior.model.a));
    let (azimuth, elevation) = (
        axis.y.atan2(axis.x).to_degrees() + 360.0,
        (-axis.z).asin().to_degrees(),
    );
    assert!(
        (azimuth - 199.1465).abs() < 1e-3 && (elevation + 56.2743).abs() < 1e-3,
        "{azimuth} {elevation}"
    );
    assert!(
        facts.notes.iter().any(|note| note.contains("TILT_ONLY")),
        "{:?}",
        facts.notes
    );
}

#[test]
fn the_rover_mock_up_brings_its_cameras_along() {
    let Some(path) = real("rover") else { return };
    let brought = bring(folder(&path)).unwrap();
    assert_eq!(brought.rows.len(), 98);
    assert_eq!(
        brought.listing.companions.keys().collect::<Vec<_>>(),
        ["transforms.json"]
    );
    let facts = brought.facts("images/frame_00003.jpg");
    assert_eq!(
        (facts.file.as_str(), facts.width, facts.height),
        ("images/frame_00003.jpg", 1440, 1920)
    );
    assert!(facts.prior.is_none());
}

/// |A x H|.
fn focal_px(model: &Cahvor) -> f64 {
    Vector3::from(model.a).cross(&Vector3::from(model.h)).norm()
}

fn print_table(brought: &Brought) {
    println!("| product | size | bands | sol | filter | model | frame, pose | counter | notes |");
    for (_, row) in &brought.rows {
        let facts = brought.facts(&row.id);
        let camera = facts.prior.as_ref().map_or_else(
            || "none | - | -".to_owned(),
            |prior| {
                let kind = match (prior.model.o, prior.model.e) {
                    (_, Some(_)) => "CAHVORE",
                    (Some(_), None) => "CAHVOR",
                    _ => "CAHV",
                };
                let pose = if prior.site_from_frame.is_some() {
                    "posed"
                } else {
                    "no pose"
                };
                let counter = &prior.motion_counter;
                format!(
                    "{kind} {:.1} px | {}, {pose} | {counter:?}",
                    focal_px(&prior.model),
                    prior.frame
                )
            },
        );
        println!(
            "| {} | {}x{} | {} | {:?} | {:?} | {camera} | {:?} |",
            facts.file, facts.width, facts.height, facts.bands, facts.sol, facts.filter, facts.notes
        );
    }
    for verdict in brought.verdicts.iter().filter(|verdict| !verdict.keeps()) {
        println!("| {} | {} | {} |", verdict.file, verdict.verdict, verdict.reason);
    }
}
