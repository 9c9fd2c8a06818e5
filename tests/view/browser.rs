//! The page in headless Chromium.

use std::time::Duration;

use serde_json::json;

use super::common::{SMALL_DEMO, copy, marf};
use super::devtools::Page;
use super::{Viewer, hostile_run, small_run};

const FINISHED: &str = "document.getElementById('view-stage')?.dataset.divisor === '1'";
const PICTURE: &str = "document.getElementById('view-picture').toDataURL()";

/// Opens the 3-D view of the small run, its finest picture shown. `None` without a browser.
fn open(viewer: &Viewer) -> Option<Page> {
    let mut page = Page::open(&viewer.address)?;
    page.waits_for(FINISHED);
    page.value("document.getElementById('view').scrollIntoView()");
    Some(page)
}

/// Chooses an option of a list and waits for the finest picture.
fn choose(page: &mut Page, list: &str, option: &str) {
    page.value(&format!(
        "(() => {{ delete document.getElementById('view-stage').dataset.divisor; const list = document.getElementById('{list}'); \
         list.value = '{option}'; list.dispatchEvent(new Event('change')); }})()"
    ));
    page.waits_for(FINISHED);
}

/// Returns the middle of the 3-D view in the window.
fn middle(page: &mut Page) -> [f64; 2] {
    let place = page.value(
        "(() => { const box = document.getElementById('view-overlay').getBoundingClientRect(); \
         return [box.left + box.width / 2, box.top + box.height / 2]; })()",
    );
    serde_json::from_value(place).unwrap()
}

#[track_caller]
fn is_clean(page: &Page, viewer: &Viewer) {
    assert!(page.complaints().is_empty(), "{:?}", page.complaints());
    let own = format!("http://{}/", viewer.authority);
    // Chromium's own controls of videos have their icons as data.
    for address in page.asked_for() {
        assert!(
            address.starts_with(&own) || address.starts_with("data:"),
            "{address}"
        );
    }
}

#[test]
fn the_page_loads_without_a_complaint_or_an_outside_request() {
    let viewer = Viewer::start(small_run(), &["--prefix", "/mars"]);
    let Some(mut page) = open(&viewer) else { return };
    page.waits_for("document.getElementById('live-state').textContent === 'Nothing runs in this store.'");
    // All pictures of the report, those beyond the window too.
    page.value("document.querySelectorAll('img').forEach((picture) => { picture.loading = 'eager'; })");
    page.waits_for("[...document.querySelectorAll('main img[src]')].every((picture) => picture.complete)");
    let broken = page.value(
        "[...document.querySelectorAll('main img[src]')].filter((picture) => !picture.naturalWidth).length",
    );
    assert_eq!(broken, json!(0));
    is_clean(&page, &viewer);
}

#[test]
fn the_picture_changes_after_a_drag_and_stays_still_without_one() {
    let viewer = Viewer::start(small_run(), &[]);
    let Some(mut page) = open(&viewer) else { return };
    let middle = middle(&mut page);
    let before = page.value(PICTURE);
    std::thread::sleep(Duration::from_millis(600));
    assert_eq!(page.value(PICTURE), before, "nobody touched it");
    page.value("delete document.getElementById('view-stage').dataset.divisor");
    page.drags(middle, [60.0, 0.0]);
    page.waits_for(FINISHED);
    let after = page.value(PICTURE);
    assert_ne!(after, before, "it was dragged");
    std::thread::sleep(Duration::from_millis(600));
    assert_eq!(page.value(PICTURE), after, "nobody touched it again");
    page.keeps("dragged.png");
    is_clean(&page, &viewer);
}

#[test]
fn modes_photos_distances_and_keys_do_what_they_say() {
    let viewer = Viewer::start(small_run(), &[]);
    let Some(mut page) = open(&viewer) else { return };
    let color = page.value(PICTURE);
    for mode in ["depth", "uncertainty"] {
        choose(&mut page, "view-mode", mode);
        assert_ne!(page.value(PICTURE), color, "{mode}");
        page.keeps(&format!("{mode}.png"));
    }
    // Without a photo at this pose there is no difference: the nearest photo's pose is taken, and left again with the mode.
    choose(&mut page, "view-mode", "difference");
    page.keeps("difference.png");
    assert_ne!(
        page.value("document.getElementById('view-photo').value"),
        json!("")
    );
    let shown = middle(&mut page);
    page.value("delete document.getElementById('view-stage').dataset.divisor");
    page.drags(shown, [40.0, 0.0]);
    page.waits_for(FINISHED);
    assert_eq!(
        page.value("document.getElementById('view-mode').value"),
        json!("color")
    );
    let middle = middle(&mut page);
    page.value("document.getElementById('view-measure').click()");
    page.drags([middle[0] - 150.0, middle[1] + 200.0], [0.0, 0.0]);
    page.waits_for("document.getElementById('view-distance').textContent.startsWith('Mark a second')");
    page.drags([middle[0] + 150.0, middle[1] + 200.0], [0.0, 0.0]);
    // Two places are held out, so that the retrainings have intervals.
    page.waits_for("/^Distance: [0-9.]+ m; .*(90 % interval|2 retrainings)/.test(document.getElementById('view-distance').textContent)");
    choose(&mut page, "view-photo", "0");
    page.waits_for("document.getElementById('view-photo-picture').naturalWidth > 0");
    page.keeps("photo.png");
    page.value("document.getElementById('view-overlay').focus()");
    let before = page.value(PICTURE);
    page.presses_key("w", "KeyW", 87, "w");
    page.waits_for(&format!("{PICTURE} !== {before}"));
    is_clean(&page, &viewer);
}

/// How long the first, coarsest picture takes after a drag, at 160 pixels: printed, never judged.
#[test]
fn the_first_change_after_a_drag_is_measured() {
    let viewer = Viewer::start(small_run(), &[]);
    let Some(mut page) = open(&viewer) else { return };
    choose(&mut page, "view-size", "1280");
    let middle = middle(&mut page);
    let mut times_ms: Vec<u64> = (0..6)
        .map(|turn| {
            page.value("delete document.getElementById('view-stage').dataset.firstMs");
            page.drags(middle, [if turn % 2 == 0 { 9.0 } else { -9.0 }, 3.0]);
            page.waits_for("document.getElementById('view-stage').dataset.firstMs !== undefined");
            let first = page.value("document.getElementById('view-stage').dataset.firstMs");
            first.as_str().unwrap().parse().unwrap()
        })
        .collect();
    times_ms.sort_unstable();
    println!(
        "first change after a drag, n = {}: median {} ms, 95 % {} ms, most {} ms",
        times_ms.len(),
        times_ms[times_ms.len() / 2],
        times_ms[times_ms.len() * 19 / 20],
        times_ms[times_ms.len() - 1]
    );
}

/// A page stays that of its run when another page has loaded a newer one.
#[test]
fn an_older_page_keeps_its_field() {
    let dir = tempfile::tempdir().unwrap();
    copy(small_run(), dir.path());
    let viewer = Viewer::start(dir.path(), &[]);
    let Some(mut page) = open(&viewer) else { return };
    let before = page.value(PICTURE);
    let small = SMALL_DEMO.iter().flat_map(|set| ["--set", set]);
    let args: Vec<&str> = ["run", "--to", "size"].into_iter().chain(small).collect();
    marf(dir.path(), &args).exits(0);
    page.waits_for("document.getElementById('live-state').textContent.includes('Run 2 is done')");
    assert!(viewer.get("/").is(200).text().contains("data-run=\"2\""));
    choose(&mut page, "view-mode", "depth");
    choose(&mut page, "view-mode", "color");
    assert_eq!(page.value(PICTURE), before);
    is_clean(&page, &viewer);
}

/// A photo whose name is a script, in a run without a field.
#[test]
fn hostile_names_stay_text() {
    let dir = hostile_run();
    let viewer = Viewer::start(dir.path(), &[]);
    let Some(mut page) = Page::open(&viewer.address) else {
        return;
    };
    page.waits_for("document.getElementById('live-state').textContent === 'Nothing runs in this store.'");
    assert_eq!(
        page.value("document.querySelectorAll('img[src=x], main script').length"),
        json!(0)
    );
    assert_eq!(
        page.value("document.body.textContent.includes('<img src=x onerror')"),
        json!(true)
    );
    assert_ne!(page.value("document.title"), json!("hit"));
    is_clean(&page, &viewer);
}
