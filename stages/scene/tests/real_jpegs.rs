//! Real JPEGs: whole ones are decoded, cut and damaged ones are refused.
#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "helpers of tests are not seen as tests"
)]

use std::path::{Path, PathBuf};

use marf_scene::Photo;

/// Returns a folder of the real data. `None`, with a line of output, if it is absent.
fn real(name: &str) -> Option<PathBuf> {
    let root = std::env::var_os("MARF_SHARED_DATA").map_or_else(
        || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data"),
        PathBuf::from,
    );
    let path = root.join(name);
    if !path.is_dir() {
        println!("skipped: {name} needs ../shared/data");
        return None;
    }
    Some(path)
}

/// A real JPEG of a rover, cut at 400 places, as it is and closed with an end marker.
#[test]
fn a_real_jpeg_that_was_cut_is_refused() {
    let Some(path) = real("m2020_navcam_feed") else {
        return;
    };
    let name = "NLF_0123_0677861657_409ECM_N0041422NCAM00509_01_295J.jpg";
    let whole = std::fs::read(path.join(name)).unwrap();
    assert_eq!(Photo::decode(&whole).unwrap().image.width, 1280);
    let steps = 400;
    let mut taken = Vec::new();
    for step in 0..steps {
        let cut = step * whole.len() / steps;
        assert!(
            Photo::decode(&whole[..cut]).is_err(),
            "cut at {cut} of {}",
            whole.len()
        );
        let mut closed = whole[..cut].to_vec();
        closed.extend_from_slice(&[0xff, 0xd9]);
        if Photo::decode(&closed).is_ok() {
            taken.push(cut);
        }
    }
    println!("cut and closed with FF D9: {} of {steps} are taken", taken.len());
    assert_eq!(taken, [0; 0]);
}

/// Every real JPEG is whole. Eight overwritten bytes of its scan are noticed if they change the number of blocks, which is every other
/// time.
#[test]
fn real_jpegs_are_whole_and_damage_is_noticed() {
    let (mut whole, mut compared, mut damaged, mut noticed) = (0, 0, 0, 0);
    for folder in ["m2020_navcam_feed", "rover/images", "fox/images", "dedup_mixed"] {
        let Some(path) = real(folder) else { continue };
        for entry in std::fs::read_dir(&path).unwrap() {
            let path = entry.unwrap().path();
            let bytes = std::fs::read(&path).unwrap();
            if !bytes.starts_with(&[0xff, 0xd8]) {
                continue;
            }
            let photo = Photo::decode(&bytes).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
            whole += 1;
            if photo.notes.is_empty() {
                // The lenient decoder makes the same pixels of a whole file.
                let lenient = image::load_from_memory(&bytes).unwrap().to_rgb8();
                assert!(
                    photo.image.pixels.as_flattened() == lenient.as_raw().as_slice(),
                    "{}",
                    path.display()
                );
                compared += 1;
            }
            if whole % 10 > 0 {
                continue;
            }
            for step in 1..10 {
                let mut bent = bytes.clone();
                let at = bent.len() / 10 * step;
                bent[at..at + 8].fill(0x5a);
                damaged += 1;
                noticed += usize::from(Photo::decode(&bent).is_err());
            }
        }
    }
    println!("{whole} JPEGs are whole, {compared} compared; damage is noticed in {noticed} of {damaged}");
    assert!(noticed * 3 >= damaged, "{noticed} of {damaged}");
}
