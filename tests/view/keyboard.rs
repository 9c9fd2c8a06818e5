//! All of the page without a mouse.

use std::collections::BTreeSet;

use serde_json::json;

use super::devtools::Page;
use super::{Viewer, small_run};

/// Most presses of Tab: the page of the small run has some hundred stops.
const MOST_STOPS: usize = 2_000;

/// What the page shows that something can be done with, each marked by a number.
const CONTROLS: &str = "(() => { const all = [...document.querySelectorAll('a[href], button, select, input, summary, video, [tabindex]')] \
    .filter((one) => one.checkVisibility() && !one.disabled); \
    all.forEach((one, index) => { one.dataset.stop = index; }); return all.length; })()";
/// The number of what has the focus, whether that shows, and whether it is the page as a whole.
const FOCUSED: &str = "(() => { const one = document.activeElement, style = getComputedStyle(one); \
    return [one.dataset.stop ?? null, style.outlineStyle !== 'none' && parseFloat(style.outlineWidth) > 0, one === document.body]; })()";
/// The HTML that identifies a control to a reader of the test.
const NAMED: &str = "((index) => document.querySelector(`[data-stop='${index}']`).outerHTML.slice(0, 160))";

#[test]
fn tab_reaches_every_control_and_shows_where_it_is() {
    let viewer = Viewer::start(small_run(), &[]);
    let Some(mut page) = Page::open(&viewer.address) else {
        return;
    };
    page.waits_for("document.getElementById('view-stage').dataset.divisor === '1'");
    page.opens_all_sections();
    let controls = page.value(CONTROLS).as_u64().unwrap();
    assert!(controls > 40, "{controls}");
    let mut reached = BTreeSet::new();
    for _ in 0..MOST_STOPS {
        page.presses_key("Tab", "Tab", 9, "");
        let focused = page.value(FOCUSED);
        let Some(stop) = focused[0].as_str() else {
            // A part that scrolls has no number. At the end of the page, the next stop is its beginning.
            if reached.is_empty() || focused[2] != json!(true) {
                continue;
            }
            break;
        };
        assert_eq!(
            focused[1],
            json!(true),
            "no outline: {}",
            page.value(&format!("{NAMED}({stop})"))
        );
        if !reached.insert(stop.parse::<u64>().unwrap()) {
            break;
        }
    }
    let missed: Vec<u64> = (0..controls).filter(|stop| !reached.contains(stop)).collect();
    let names: Vec<String> = missed
        .iter()
        .map(|stop| page.value(&format!("{NAMED}({stop})")).to_string())
        .collect();
    assert!(
        missed.is_empty(),
        "{} of {controls} are not reached: {names:#?}",
        missed.len()
    );
}

#[test]
fn distances_photos_and_bookmarks_need_no_mouse() {
    let viewer = Viewer::start(small_run(), &[]);
    let Some(mut page) = Page::open(&viewer.address) else {
        return;
    };
    page.waits_for("document.getElementById('view-stage').dataset.divisor === '1'");
    page.value("document.getElementById('view-overlay').focus()");
    // The middle of the first view is the horizon: the ground is below. If a field so short trained has no surface, no point is
    // marked.
    let told = "document.getElementById('view-distance').textContent";
    for (key, code, begins) in [
        ("ArrowDown", 40, "Mark a second"),
        ("ArrowRight", 39, "Distance: "),
    ] {
        let is_marked = (0..12).any(|_| {
            page.holds(key, key, code, 120);
            page.value(&format!("{told} = ''"));
            page.presses_key("m", "KeyM", 77, "m");
            page.waits_for(&format!("{told} !== ''"));
            page.value(told).as_str().unwrap().starts_with(begins)
        });
        assert!(is_marked, "{key}: {}", page.value(told));
    }
    // Where the two points are depends on the machine's speed, and so does whether all retrainings have a surface there.
    let distance = page.value(told);
    assert_eq!(
        page.value(&format!("/^Distance: [0-9.e-]+ m[;.]/.test({told})")),
        json!(true),
        "{distance}"
    );
    page.value(
        "document.getElementById('view-bookmarks').closest('details').querySelector('summary').focus()",
    );
    page.presses_key("Enter", "Enter", 13, "\r");
    page.presses_key("Tab", "Tab", 9, "");
    assert_eq!(page.value("document.activeElement.id"), json!("view-bookmark"));
    page.presses_key("Enter", "Enter", 13, "\r");
    page.waits_for("document.querySelectorAll('#view-bookmarks button').length === 1");
    page.value("document.getElementById('view-photo').focus()");
    page.presses_key("ArrowDown", "ArrowDown", 40, "");
    page.waits_for("document.getElementById('view-photo-picture').naturalWidth > 0");
    page.keeps("keyboard.png");
    assert!(page.complaints().is_empty(), "{:?}", page.complaints());
}
