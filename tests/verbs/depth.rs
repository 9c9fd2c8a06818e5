//! `marf depth` on real stereo pairs of a rover.

use std::path::Path;

use serde_json::Value;

use crate::common::{marf, shared};

/// Navcam pairs of two sites.
const PAIRS: [&str; 4] = [
    "NLF_0340_0697121914_417ECM_N0090364NCAM00420_01_195J",
    "NRF_0340_0697121914_417ECM_N0090364NCAM00420_01_195J",
    "NLF_0718_0730679543_043ECM_N0342098NCAM03717_01_195J",
    "NRF_0718_0730679543_043ECM_N0342098NCAM03717_01_195J",
];

fn document(path: &Path) -> Value {
    serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap()
}

#[test]
fn stereo_pairs_of_two_sites_are_metric_without_a_key_each_in_its_own_frame() {
    let Some(data) = shared("m2020_navcam_feed") else {
        return;
    };
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path().join("photos");
    std::fs::create_dir(&folder).unwrap();
    for name in PAIRS {
        for ending in ["jpg", "json"] {
            let file = format!("{name}.{ending}");
            std::fs::copy(data.join(&file), folder.join(&file)).unwrap();
        }
    }
    let said = marf(dir.path(), &["depth", "photos", "--out", "out"]).exits(0);
    assert!(
        said.stdout
            .contains("so the 4 photos of stereo pairs have the cameras of their labels"),
        "{}",
        said.stdout
    );
    for (stop, least) in [("site9-364", 0.05), ("site34-2098", 0.6)] {
        let metrics = document(&dir.path().join("out").join(stop).join("depth.json"));
        assert_eq!(metrics["unit"], "metres", "{stop}");
        assert_eq!(metrics["pairs"].as_array().unwrap().len(), 1, "{stop}");
        // 0.424 m between the eyes of Navcam.
        let baseline = metrics["pairs"][0]["baseline"].as_f64().unwrap();
        assert!((baseline - 0.424).abs() < 0.002, "{stop}: {baseline}");
        // Most of the first pair is sky.
        let share = metrics["share"].as_f64().unwrap();
        assert!(share > least, "{stop}: {share}");
        assert!(
            said.stdout.contains(&format!("{stop:<12} 2 photos, 1 pair, ")),
            "{}",
            said.stdout
        );
    }
}
