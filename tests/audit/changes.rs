//! What changed between two runs: `marf diff` and the section of the report.

use std::path::Path;

use serde_json::Value;

use super::common::marf;
use super::ran;

/// The section of out/report.html.
fn section(folder: &Path) -> String {
    let page = std::fs::read_to_string(folder.join("out/report.html")).unwrap();
    let start = page.find("<section id=\"changes\">").unwrap();
    let end = start + page[start..].find("</section>").unwrap();
    page[start..end].to_owned()
}

#[test]
fn a_parameter_is_told_with_what_followed_by_the_verb_and_in_the_report() {
    let dir = ran();
    assert!(
        section(dir.path())
            .contains("No earlier run of this pipeline with the same archives had other results."),
        "{}",
        section(dir.path())
    );
    marf(dir.path(), &["run", "--set", "train.steps=3"]).exits(0);
    let told = marf(dir.path(), &["diff", "1", "2"]).exits(0).stdout;
    assert!(told.contains("  params.steps: 2 -> 3\n"), "{told}");
    assert!(
        told.contains("1 of 4 nodes differ between run 1 and run 2"),
        "{told}"
    );
    let json = marf(dir.path(), &["diff", "1", "2", "--json"]).exits(0).stdout;
    let json: Value = serde_json::from_str(&json).unwrap();
    let pictures = json["nodes"][0]["pictures"].as_array().unwrap();
    assert!(
        !pictures.is_empty() && pictures.iter().all(|one| one["share"].as_f64().unwrap() > 0.0),
        "{json}"
    );

    let picture = &pictures[0];
    let line = format!(
        "{}: {:.1} % of the pixels differ, by at most {} of 255",
        picture["output"].as_str().unwrap(),
        100.0 * picture["share"].as_f64().unwrap(),
        picture["most"]
    );
    assert!(told.contains(&line), "{line}: {told}");

    let shown = section(dir.path());
    assert!(shown.contains("Differs from run 1 in 1 node."), "{shown}");
    // Every line of the verb is in the report, in the same words.
    let lines: Vec<&str> = told.lines().filter(|line| line.starts_with("  ")).collect();
    for line in &lines {
        let line = line.trim().replace('>', "&gt;").replace('"', "&quot;");
        assert!(
            shown.contains(&format!("<li class=\"file\">{line}</li>")),
            "{line}: {shown}"
        );
    }
    assert_eq!(lines.len(), shown.matches("<li").count());
}

/// A run that does nothing differs from the same run as the one before it, even if its page is written again.
#[test]
fn a_run_that_does_nothing_tells_the_same_changes() {
    let dir = ran();
    let change = ["run", "--set", "train.steps=3"];
    marf(dir.path(), &change).exits(0);
    let shown = section(dir.path());
    let status = marf(dir.path(), &["status", "--json"]).exits(0).stdout;
    let status: Value = serde_json::from_str(&status).unwrap();
    let report = status["documents"]["report.html"]["digest"]
        .as_str()
        .unwrap()
        .to_owned();
    let object = dir.path().join(".marf/cas").join(&report[..2]).join(&report[2..]);
    std::fs::remove_file(object).unwrap();
    marf(dir.path(), &change).exits(0);
    let status = marf(dir.path(), &["status", "--json"]).exits(0).stdout;
    assert!(
        !status.contains(&report),
        "the page is another one: it tells when its run started"
    );
    assert_eq!(section(dir.path()), shown);
    // Back to the first parameters: nothing runs, and the reported changes are against the run between.
    marf(dir.path(), &["run"]).exits(0);
    assert!(
        section(dir.path()).contains("Differs from run 3 in 1 node."),
        "{}",
        section(dir.path())
    );
}
