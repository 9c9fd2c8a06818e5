use std::path::Path;
use std::time::{Duration, Instant};

use super::*;
use crate::pds4::{Pds4Error, read};
use crate::testing::real;

/// Reads a text, and checks that it takes no cubic time: such a label of 90 KB took over 100 s.
fn fault(text: &str) -> Pds4Error {
    let start = Instant::now();
    let error = read(text.as_bytes()).unwrap_err();
    let limit = Duration::from_secs(20).mul_f64(text.len() as f64 / 1e6 + 0.5);
    let taken = start.elapsed();
    assert!(taken < limit, "{taken:?} for {} bytes", text.len());
    error
}

fn joined(count: usize, part: impl Fn(usize) -> String) -> String {
    (0..count).map(part).collect()
}

fn attributes(count: usize) -> String {
    joined(count, |index| format!(" a{index}='>\"--'"))
}

fn namespaces(first: usize, count: usize) -> String {
    joined(count, |index| format!(" xmlns:n{0}='u{0}'", first + index))
}

#[test]
fn tags_are_measured_outside_quotes_comments_and_characters() {
    let skipped = "<!-- it's = <a --><?p '<a ?><![CDATA['<a]]>";
    for (element, length, attributes, declared, empty) in [
        ("<b/>", 4, 0, 0, true),
        ("<b c='=' d=\"'>/>\" >", 19, 2, 0, false),
        ("<b xmlns='u' xmlns:c='xmlns'>", 29, 2, 2, false),
    ] {
        let text = format!("{element}{skipped}</b>");
        let tag = tag(text.as_bytes());
        assert_eq!(
            (tag.length, tag.attributes, tag.declared, tag.empty),
            (length, attributes, declared, empty),
            "{element}"
        );
    }
    assert_eq!(super::skipped(skipped.as_bytes()), Some(18));
    for cut in [
        "<",
        "<!",
        "<!--",
        "<!-->",
        "<?",
        "<a b='",
        "<a b=",
        "<![CDATA[",
        "</",
        "<>",
    ] {
        assert!(check(cut.as_bytes()).is_ok(), "{cut}");
    }
}

#[test]
fn what_is_nested_or_repeated_too_much_is_refused_before_it_is_parsed() {
    let nested = |depth: usize| format!("{}{}", "<a>".repeat(depth), "</a>".repeat(depth));
    assert!(matches!(fault(&nested(MAX_DEPTH)), Pds4Error::NoLabel));
    assert!(matches!(
        fault(&nested(MAX_DEPTH + 1)),
        Pds4Error::TooMuchWork(TooMuchWork::Depth)
    ));
    let element = |count: usize| format!("<l{}/>", attributes(count));
    assert!(matches!(fault(&element(MAX_ATTRIBUTES)), Pds4Error::NoLabel));
    assert!(matches!(
        fault(&element(MAX_ATTRIBUTES + 1)),
        Pds4Error::TooMuchWork(TooMuchWork::Attributes)
    ));
    // Ten levels with 90 namespaces each are 900 in scope of every element within.
    let levels = joined(10, |level| format!("<a{}>", namespaces(level * 90, 90)));
    let within = format!("{levels}{}", "<b xmlns:c='u'/>".repeat(50_000));
    assert!(matches!(
        fault(&within),
        Pds4Error::TooMuchWork(TooMuchWork::Namespaces)
    ));
}

#[test]
fn the_slowest_xml_within_the_limits_is_read_within_a_second_for_a_megabyte() {
    let end = |text: String| format!("<l>{text}</l>");
    let root = |count: usize, element: &str, times: usize| {
        format!("<l{}>{}</l>", namespaces(0, count), element.repeat(times))
    };
    for text in [
        end(format!("<a{}/>", attributes(MAX_ATTRIBUTES)).repeat(19)),
        root(19, "<b xmlns:c='u'/>", 45_000),
        root(190, "<n189:b/>", 100_000),
        root(900, "<n899:b/>", 19_000),
        end("<![CDATA[x]]>&amp;".repeat(60_000)),
        end("<a/>".repeat(190_000)),
    ] {
        assert!(check(text.as_bytes()).is_ok(), "{}", &text[..40]);
        assert!(matches!(fault(&text), Pds4Error::NoLabel), "{}", &text[..40]);
    }
}

/// Checks all XML below a folder, and returns how many files there are.
fn check_folder(folder: &Path) -> usize {
    let entries = std::fs::read_dir(folder).unwrap();
    let count = |path: std::path::PathBuf| {
        if path.is_dir() {
            return check_folder(&path);
        }
        if path
            .extension()
            .is_none_or(|extension| !extension.eq_ignore_ascii_case("xml"))
        {
            return 0;
        }
        let checked = check(&std::fs::read(&path).unwrap());
        assert!(checked.is_ok(), "{}: {checked:?}", path.display());
        1
    };
    entries.map(|entry| count(entry.unwrap().path())).sum()
}

#[test]
fn no_real_label_is_refused() {
    for (folder, least) in [("labels", 2), ("input-faults", 5)] {
        let Some(folder) = real(folder) else { return };
        let count = check_folder(&folder);
        assert!(count >= least, "{count} labels in {}", folder.display());
    }
}

#[test]
fn nested_namespaces_of_a_hostile_label_are_refused() {
    let Some(folder) = real("fault-inputs/xml_ns/photos") else {
        return;
    };
    let text = std::fs::read_to_string(folder.join("2264ML0121141200805116C00_DRCL.xml")).unwrap();
    assert!(matches!(fault(&text), Pds4Error::TooMuchWork(TooMuchWork::Depth)));
}
