//! Entry points of fuzzers: one function per reader of bytes that strangers may have made. Those of labels and pages are in
//! `marf_pds::fuzzing`.
//!
//! Each returns how much it read, so that nothing is optimised away.

use marf_cache::manifest::{Leaf, Root};
use marf_cache::{Action, Digest};
use marf_calibrate::import::{Model, read_colmap_binary, read_colmap_text, read_transforms};
use marf_cluster::{BackendQuestion, Site};
use marf_config::GlobalOptions;
use marf_engine::RunRecord;
use marf_export::dsse::Envelope;
use marf_export::subjects_in;
use marf_field::Field;
use marf_keys::{PublicKey, SigningKey};
use marf_provenance::stamp::Stamp;
use marf_scene::{Photo, Scene, ply};
use marf_stage::{Origin, Sols};

/// A reader of untrusted bytes.
pub type Target = fn(&[u8]) -> usize;

/// All targets with the names of their corpora.
pub const TARGETS: [(&str, Target); 13] = [
    ("photo", photo),
    ("exif", exif),
    ("ply", points),
    ("transforms", transforms),
    ("colmap", colmap),
    ("pipeline", pipeline),
    ("keys", keys),
    ("envelope", envelope),
    ("documents", documents),
    ("stamp", stamp),
    ("lock", marf_extract::fuzzing::lock),
    ("site", site),
    ("pack", marf_remote::fuzzing::pack),
];

/// Most bytes of a decoded photo.
const MOST_DECODED: u64 = 10_000_000;

/// Decodes a photo of any format.
pub fn photo(bytes: &[u8]) -> usize {
    Photo::decode_within(bytes, MOST_DECODED).map_or(0, |photo| photo.image.pixels.len())
}

/// Reads the EXIF of a photo. A photo without it has no facts.
pub fn exif(bytes: &[u8]) -> usize {
    let lens = marf_pds::exif::read(bytes, 640);
    usize::from(lens.focal_px.is_some()) + lens.notes.len()
}

/// Reads a point cloud.
pub fn points(bytes: &[u8]) -> usize {
    ply::read_points(bytes).map_or(0, |points| 1 + points.len())
}

/// Reads a transforms.json.
pub fn transforms(bytes: &[u8]) -> usize {
    read_transforms("transforms.json", bytes).map_or(0, |transforms| 1 + transforms.views.len())
}

/// Reads a model of COLMAP, as text and as binary: its three files, with a line of `=` between.
pub fn colmap(bytes: &[u8]) -> usize {
    const BETWEEN: &[u8] = b"\n=====\n";
    let mut parts = [&bytes[..0]; 3];
    let mut rest = bytes;
    for part in &mut parts {
        let end = rest.windows(BETWEEN.len()).position(|window| window == BETWEEN);
        *part = &rest[..end.unwrap_or(rest.len())];
        rest = end.map_or(&[][..], |end| &rest[end + BETWEEN.len()..]);
    }
    let model = Model {
        names: ["cameras", "images", "points"],
        cameras: parts[0],
        images: parts[1],
        points: Some(parts[2]),
    };
    [read_colmap_text(&model), read_colmap_binary(&model)]
        .iter()
        .flatten()
        .map(|cameras| 1 + cameras.views.len())
        .sum()
}

/// Checks a pipeline.
pub fn pipeline(bytes: &[u8]) -> usize {
    let text = String::from_utf8_lossy(bytes);
    let checked = marf_config::check(&text, &[], &GlobalOptions::default(), "".as_ref());
    checked.map_or(0, |pipeline| 1 + pipeline.nodes.len())
}

/// Reads keys in PEM.
pub fn keys(bytes: &[u8]) -> usize {
    let text = String::from_utf8_lossy(bytes);
    usize::from(PublicKey::from_pem(&text).is_ok()) + usize::from(SigningKey::from_pem(&text).is_ok())
}

/// Reads a signed statement, and the subjects of an unsigned one.
pub fn envelope(bytes: &[u8]) -> usize {
    usize::from(Envelope::decode(bytes).is_ok()) + subjects_in(bytes).map_or(0, |subjects| 1 + subjects.len())
}

/// Reads what a store or a crate holds: actions, manifests, run roots, scenes, fields, questions to other machines, sols.
pub fn documents(bytes: &[u8]) -> usize {
    let text = String::from_utf8_lossy(bytes);
    [
        Action::decode(bytes).is_ok(),
        Leaf::decode(bytes).is_ok(),
        Root::decode_leaves(bytes).is_ok(),
        RunRecord::decode(bytes).is_ok(),
        Scene::decode(bytes).is_ok(),
        Field::decode(bytes).is_ok(),
        Origin::decode(bytes).is_ok(),
        BackendQuestion::decode(bytes).is_some(),
        Sols::parse(&text).is_ok(),
        text.parse::<Digest>().is_ok(),
    ]
    .iter()
    .filter(|is_read| **is_read)
    .count()
}

/// Takes the mark from a copy of a result.
pub fn stamp(bytes: &[u8]) -> usize {
    Stamp::take_from(bytes).map_or(0, |(object, _)| 1 + object.len())
}

/// Reads a site file.
pub fn site(bytes: &[u8]) -> usize {
    let text = String::from_utf8_lossy(bytes);
    usize::from(Site::from_text(&text, "site.toml".as_ref()).is_ok())
}
