//! `report.html` as a browser opens it from disk.

use serde_json::json;

use super::devtools::Page;
use super::{hostile_run, small_run};

/// Opens the report of a folder. `None` without a browser.
fn open(folder: &std::path::Path) -> Option<Page> {
    Page::open(&format!("file://{}", folder.join("out/report.html").display()))
}

#[test]
fn the_report_needs_no_script_and_nothing_from_elsewhere() {
    let Some(mut page) = open(small_run()) else { return };
    assert_eq!(page.value("document.scripts.length"), json!(0));
    assert!(page.complaints().is_empty(), "{:?}", page.complaints());
    for address in page.asked_for() {
        assert!(
            address.starts_with("file://") || address.starts_with("data:"),
            "{address}"
        );
    }
    let broken = page
        .value("[...document.images].filter((picture) => !picture.complete || !picture.naturalWidth).length");
    assert_eq!(broken, json!(0));
    // Every picture says in words what it shows.
    assert_eq!(
        page.value("[...document.images].filter((picture) => !picture.alt).length"),
        json!(0)
    );
    assert_eq!(
        page.value("document.documentElement.scrollWidth <= innerWidth"),
        json!(true)
    );
}

/// Light and dark, and on paper: the text contrasts with its background.
#[test]
fn the_report_is_read_in_the_dark_and_on_paper() {
    let Some(mut page) = open(small_run()) else { return };
    let colors = "(() => { const style = getComputedStyle(document.body); return [style.color, style.backgroundColor]; })()";
    let light = page.value(colors);
    page.send(
        "Emulation.setEmulatedMedia",
        json!({"features": [{"name": "prefers-color-scheme", "value": "dark"}]}),
    );
    let dark = page.value(colors);
    assert_ne!(light, dark);
    page.keeps("report-dark.png");
    page.send(
        "Emulation.setEmulatedMedia",
        json!({"media": "print", "features": []}),
    );
    let printed = page.send("Page.printToPDF", json!({"printBackground": false}));
    use base64::Engine as _;
    let pdf = base64::engine::general_purpose::STANDARD
        .decode(printed["data"].as_str().unwrap())
        .unwrap();
    assert!(
        pdf.starts_with(b"%PDF") && pdf.len() > 50_000,
        "{} bytes",
        pdf.len()
    );
    let folder = std::path::Path::new(env!("CARGO_TARGET_TMPDIR")).join("view");
    std::fs::create_dir_all(&folder).unwrap();
    std::fs::write(folder.join("report.pdf"), pdf).unwrap();
}

#[test]
fn hostile_names_stay_text_in_the_report() {
    let dir = hostile_run();
    let Some(mut page) = open(dir.path()) else { return };
    assert_eq!(
        page.value("document.querySelectorAll('img[src=x], script').length"),
        json!(0)
    );
    assert_eq!(
        page.value("document.body.textContent.includes('<img src=x onerror')"),
        json!(true)
    );
    assert_ne!(page.value("document.title"), json!("hit"));
    assert!(page.complaints().is_empty(), "{:?}", page.complaints());
}
