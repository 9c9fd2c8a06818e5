//! `report.html` as a browser opens it from disk.

use serde_json::json;

use super::common::{copy, marf};
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

/// Splats, scene and scripts are in the file: it is opened from disk, drawn, and turned, and asks nobody for anything.
#[test]
fn a_report_with_a_3_d_view_is_one_file_that_loads_nothing() {
    let dir = tempfile::tempdir().unwrap();
    copy(small_run(), dir.path());
    marf(dir.path(), &["report", "--with-3d", "--out", "with-3d.html"]).exits(0);
    let file = dir.path().join("with-3d.html");
    let size = std::fs::metadata(&file).unwrap().len();
    assert!(size <= 15_000_000, "{size} bytes");
    let Some(mut page) = Page::open(&format!("file://{}", file.display())) else {
        return;
    };
    let frames = "Number(document.getElementById('view-canvas').dataset.frames ?? 0)";
    page.waits_for(&format!("{frames} > 0"));
    page.value("document.getElementById('view').scrollIntoView()");
    let picture = "document.getElementById('view-canvas').toDataURL()";
    let colors = "(() => { const canvas = document.getElementById('view-canvas'); const small = document.createElement('canvas'); \
        const shown = small.getContext('2d'); shown.drawImage(canvas, 0, 0, small.width, small.height); \
        return new Set(shown.getImageData(0, 0, small.width, small.height).data).size; })()";
    let (before, colors) = (page.value(picture), page.value(colors));
    assert!(
        colors.as_u64().is_some_and(|colors| colors > 50),
        "{colors} values"
    );
    page.keeps("report-3d.png");
    let place = page.value("(() => { const box = document.getElementById('view-canvas').getBoundingClientRect(); return [box.left + box.width / 2, box.top + box.height / 2]; })()");
    let [x, y] = [0, 1].map(|axis| place[axis].as_f64().unwrap());
    page.drags([x, y], [120.0, 0.0]);
    page.waits_for(&format!("{picture} !== '{}'", before.as_str().unwrap()));
    page.value("document.getElementById('view-canvas').focus()");
    page.presses_key("0", "Digit0", 48, "0");
    page.waits_for(&format!("{picture} === '{}'", before.as_str().unwrap()));
    let text = std::fs::read_to_string(&file).unwrap();
    assert!(text.contains(
        "<noscript><p class=\"missing\">The 3-D view needs scripts. Everything below does not.</p></noscript>"
    ));
    assert!(page.complaints().is_empty(), "{:?}", page.complaints());
    for address in page.asked_for() {
        let is_own = ["file://", "data:", "blob:"]
            .iter()
            .any(|own| address.starts_with(own));
        assert!(is_own, "{address}");
    }
}

#[test]
fn a_run_without_a_field_has_no_3_d_view_and_says_so() {
    let dir = hostile_run();
    let printed = marf(dir.path(), &["report", "--with-3d"]).exits(1);
    assert!(
        printed
            .stderr
            .contains("run 1 has no trained field for a 3-D view"),
        "{}",
        printed.stderr
    );
    assert!(!dir.path().join("report.html").exists());
}
