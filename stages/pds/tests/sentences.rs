//! Sentences about what is not read have the numbers of the input.
#![allow(clippy::unwrap_used, reason = "helpers of tests are not seen as tests")]

use marf_pds::{ProductName, feed, listing};

#[test]
fn an_error_has_the_numbers_of_the_bytes() {
    let feed = |bytes: &[u8]| feed::read(bytes).unwrap_err().to_string();
    assert_eq!(
        feed(br#"{"images": [{}, {}, {}]}"#),
        "a page of 3 feed records: one record a file is read, named like its photo"
    );
    // 2 MiB and one more.
    assert_eq!(
        feed(&vec![b' '; 2_097_153]),
        "2097153 bytes of JSON, at most 2097152 are read"
    );
    assert!(feed(&vec![b' '; 2_097_152]).starts_with("no JSON"));
    let cut = "<h1>Index of /x</h1><pre><a href='?C=N;O=D'>Name</a> <a href='a/'>a/</a>";
    assert_eq!(
        listing::read(cut.as_bytes()).unwrap_err().to_string(),
        format!(
            "a folder listing of {} bytes that is cut short: its table does not end",
            cut.len()
        )
    );
    assert_eq!(
        listing::read(format!("{cut}</pre>").as_bytes()).map(|found| found.len()),
        Ok(1)
    );
}

#[test]
fn a_record_that_gives_no_camera_says_why() {
    let notes = |attitude: &str, components: &str| {
        let record = format!(
            r#"{{"imageid": "NLF_0050", "sol": 50, "site": 3, "drive": "1950", "attitude": "{attitude}",
            "camera": {{"instrument": "NAVCAM_LEFT", "camera_model_component_list": "{components}"}},
            "extended": {{"xyz": "(12.5,-3.25,0.125)", "dimension": "(1280,240)"}}}}"#
        );
        feed::read(record.as_bytes()).unwrap().notes
    };
    let four = "(0.8,0.56,-1.92);(1,0,0);(823.5,14800,0);(599.5,0,14800)";
    let turned = "(0.8,0.0,0.0,0.6)";
    assert_eq!(notes(turned, four), [""; 0]);
    let five = notes(turned, &format!("{four};(1,0,0)"));
    assert!(
        five.iter()
            .any(|note| note.contains("a model of 4, 6 or 9 components")),
        "{five:?}"
    );
    assert_eq!(
        notes("(0.8,0.0,0.0,0.7)", four),
        ["quaternion [0.8, 0.0, 0.0, 0.7] is not of length 1: no pose"]
    );
}

#[test]
fn products_without_a_photo_are_named_by_their_type() {
    let reason = |name: &str| ProductName::read(name).unwrap().no_photo();
    // A mesh of the ground, and the photo that it was made of.
    assert_eq!(
        reason("NLA_399620372XYZLD0030266TRAV00004M1").as_deref(),
        Some("product type XYZ holds no photo")
    );
    assert_eq!(reason("NLA_399620372RAD_D0030266TRAV00004M1"), None);
}
