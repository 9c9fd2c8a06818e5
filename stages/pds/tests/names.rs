//! Properties of the grammar of product names, on names of the real data and on made ones.
#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "helpers of tests are not seen as tests"
)]

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use marf_pds::{ProductName, Scheme, join_key};
use proptest::prelude::*;

/// What must hold of any text.
fn check(text: &str) {
    let upper = text.to_ascii_uppercase();
    let name = ProductName::read(text);
    assert_eq!(join_key(text), join_key(&upper), "{text}: letter case");
    let Some(name) = name else {
        assert_eq!(join_key(text), upper, "{text}: follows no scheme");
        return;
    };
    assert!(text.starts_with(&name.id), "{text}: {}", name.id);
    let same = ProductName::read(&name.id).unwrap();
    assert_eq!(
        (&same.id, &same.version),
        (&name.id, &name.version),
        "{text}: its id is a name"
    );
    assert_eq!(join_key(&name.id), join_key(text), "{text}");
    if name.scheme == Scheme::M2020 {
        // A copy's name goes on after the product's.
        let copy = ProductName::read_start(&format!("{} (1).png", name.id)).unwrap();
        assert_eq!(copy.exposure(), name.exposure(), "{text}");
        assert!(
            name.planned_pointing().is_some() && name.clock_s().is_some(),
            "{text}"
        );
    }
}

fn stems(folder: &Path, found: &mut BTreeSet<String>) {
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        match path.file_stem() {
            Some(_) if path.is_dir() => stems(&path, found),
            Some(stem) => drop(found.insert(stem.to_string_lossy().into_owned())),
            None => {}
        }
    }
}

#[test]
fn names_of_the_real_data_have_the_properties() {
    let root = std::env::var_os("MARF_SHARED_DATA").map_or_else(
        || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data"),
        PathBuf::from,
    );
    if !root.is_dir() {
        println!("skipped: names need ../shared/data");
        return;
    }
    let mut all = BTreeSet::new();
    stems(&root, &mut all);
    all.iter().for_each(|stem| check(stem));
    let known: Vec<&String> = all
        .iter()
        .filter(|stem| ProductName::read(stem).is_some())
        .collect();
    println!("{} names, {} follow a scheme", all.len(), known.len());
    assert!(known.len() > 30, "{known:?}");
    for a in &known {
        for b in &known {
            let [first, second] = [a, b].map(|stem| ProductName::read(stem).unwrap());
            // Products of one exposure were planned with one pointing, at one time.
            let planned =
                first.planned_pointing() == second.planned_pointing() && first.clock_s() == second.clock_s();
            assert!(first.exposure() != second.exposure() || planned, "{a} {b}");
        }
    }
}

/// Fields of a Mars 2020 name that identify its exposure: instrument, filter, flag, sol, clock, site, drive,
/// sequence, camera settings.
fn exposure() -> impl Strategy<Value = (String, String)> {
    let head = "(ZL|ZR|NL|NR|FL|HN)[0-7EF_]_[0-9]{4}_[0-9]{10}_[0-9]{3}";
    let tail = "[TN][0-9]{3}[0-9]{4}[A-Z]{4}[0-9]{5}[0-9_]{4}";
    (head, tail)
}

/// Fields that identify only the product: type, geometry, and downsampling with compression and producer.
fn product() -> impl Strategy<Value = (String, String)> {
    ("(RAD|ECM|EBY|IOF|RZD|XYZ)[_L]", "[0-3](LM|01|85)[JA]")
}

proptest! {
    #[test]
    fn any_text_has_the_properties(text in "\\PC{0,60}") {
        check(&text);
    }

    #[test]
    fn a_changed_name_has_the_properties(
        (head, tail) in exposure(),
        (kind, end) in product(),
        version in "([0-9A-Z]{2})?(_1200)?",
        (at, letter) in (0..54_usize, any::<char>()),
    ) {
        let name = format!("{head}{kind}{tail}{end}{version}");
        check(&name);
        check(&name.to_ascii_lowercase());
        let changed: String = name.chars().enumerate().map(|(index, own)| if index == at { letter } else { own }).collect();
        check(&changed);
    }

    #[test]
    fn products_of_one_exposure_are_found_by_name(
        (head, tail) in exposure(),
        first in product(),
        second in product(),
        versions in ("[0-9]{2}", "[0-9]{2}"),
    ) {
        let of = |(kind, end): &(String, String), version: &str| format!("{head}{kind}{tail}{end}{version}");
        let names = [of(&first, &versions.0), of(&second, &versions.1)];
        let read = names.each_ref().map(|name| ProductName::read(name).unwrap());
        prop_assert_eq!(read[0].exposure(), read[1].exposure());
        prop_assert_eq!(read[0].planned_pointing(), read[1].planned_pointing());
        // Versions of one product share its key, products of one exposure may differ in it.
        prop_assert_eq!(join_key(&of(&first, &versions.0)), join_key(&of(&first, &versions.1)));
    }
}
