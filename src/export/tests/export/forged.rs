//! Crates of runs that cannot have been: each is well-formed, and its lineage has a gap.

use marf_cache::Digest;
use marf_engine::Cancel;
use marf_export::CrateOptions;
use marf_export::verify::{Signature, verify};
use serde_json::json;

use super::fixture::{IDS, KEPT, World, check, options, public_key, signing_key, world};

fn faults(mut world: World) -> Vec<String> {
    let dir = tempfile::tempdir().unwrap();
    let folder = world.write(dir.path(), &options());
    check(&folder).faults
}

#[test]
fn an_input_that_nobody_made_is_found() {
    let mut world = world();
    let (foreign, made) = (world.put(b"foreign scene"), world.put(b"a picture"));
    world.node("render", json!({}), &[("scene", foreign)], &[("a.png", made)]);
    assert_eq!(faults(world), ["no node made input `scene` of `render`"]);
}

#[test]
fn a_photo_that_was_not_read_is_found() {
    let mut world = world();
    let (kept, more) = (world.set(&KEPT), world.set(&["a", "slipped in"]));
    world.node("blur", json!({}), &[("photos", kept)], &[("photos", more)]);
    assert_eq!(
        faults(world),
        ["`blur` lets `slipped in` through, which it did not read"]
    );
}

#[test]
fn a_photo_that_no_file_gave_is_found() {
    let mut world = world();
    let listing = world.put(b"");
    let photos = world.set(&["from nowhere"]);
    world.put(b"pixels of from nowhere");
    world.node("feed", json!({}), &[("listing", listing)], &[("photos", photos)]);
    world.read("feed", &IDS);
    assert_eq!(faults(world), ["no file of the archive gave `from nowhere`"]);
}

#[test]
fn a_crate_signed_by_another_or_by_nobody_is_found() {
    let dir = tempfile::tempdir().unwrap();
    let folder = world().write(dir.path(), &options());
    let report = verify(&folder, Some(&public_key()), &Cancel::default()).unwrap();
    assert_eq!((report.faults, report.signature), (vec![], Signature::Missing));

    // A signature that was taken from another crate is good, and about something else.
    let (other, key) = (tempfile::tempdir().unwrap(), signing_key());
    let signed = CrateOptions {
        key: Some(&key),
        ..options()
    };
    let mut with_more = world();
    let more = with_more.put(b"more");
    with_more.node("note", json!({}), &[], &[("note.txt", more)]);
    let signed = with_more.write(other.path(), &signed);
    std::fs::copy(
        signed.join("attestation.dsse.json"),
        folder.join("attestation.dsse.json"),
    )
    .unwrap();
    super::fixture::rebag(&folder);
    let faults = verify(&folder, Some(&public_key()), &Cancel::default())
        .unwrap()
        .faults;
    assert_eq!(
        faults,
        ["`attestation.dsse.json` is signed, but not about this `manifest-sha256.txt`"]
    );
    assert!(!faults.is_empty() && Digest::from_content(b"more") == more);
}
