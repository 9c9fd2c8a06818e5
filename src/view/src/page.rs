//! The live parts of the page: what a running program does, and the 3-D view.

use marf_report::LiveParts;
use maud::{Markup, html};

/// Returns the live parts of a run: what a running program does, and the 3-D view if there are fields.
pub fn live_parts(number: Option<u64>, fields: &[&str]) -> LiveParts {
    LiveParts {
        up: "",
        head: html! {
            (links(""))
            script type="module" src="live.js" {}
            script type="module" src="view.js" {}
        },
        navigation: html! { a href="#live" { "Live" } " " a href="#view" { "3-D view" } " " },
        main: main(number, fields),
    }
}

/// Returns the parts of a page in the folder next to the live page, which has nothing live.
pub fn scene_parts() -> LiveParts {
    LiveParts {
        up: "../",
        head: links("../"),
        navigation: html! {},
        main: html! {},
    }
}

fn links(up: &str) -> Markup {
    html! {
        link rel="icon" href={ (up) "icon.svg" };
        link rel="stylesheet" href={ (up) "view.css" };
    }
}

fn main(number: Option<u64>, fields: &[&str]) -> Markup {
    html! {
        section #live data-run=(number.map(|number| number.to_string()).unwrap_or_default()) {
            h2 { "Live" }
            p #live-state role="status" { "Connecting." }
            div.scroll { table #live-nodes hidden {
                thead { tr { th { "Node" } th { "State" } th { "Progress" } th { "Note" } } }
                tbody {}
            } }
            div #live-results.row {}
            div #live-curves.charts {}
        }
        section #view {
            h2 { "3-D view" }
            @if fields.is_empty() { p.missing { "No run has a trained field yet." } } @else { (view(fields)) }
        }
    }
}

fn view(fields: &[&str]) -> Markup {
    let choice = |id: &str, label: &str, options: &[(&str, &str)]| {
        html! {
            label { (label) " " select id=(id) {
                @for (value, text) in options { option value=(value) { (text) } }
            } }
        }
    };
    let indices: Vec<String> = (0..fields.len()).map(|index| index.to_string()).collect();
    let fields: Vec<(&str, &str)> = indices
        .iter()
        .map(String::as_str)
        .zip(fields.iter().copied())
        .collect();
    html! {
        noscript { p.missing { "The 3-D view needs scripts. Everything below does not." } }
        div.tools {
            (choice("view-field", "Field", &fields))
            (choice("view-mode", "Show", &[("color", "colour"), ("depth", "depth"), ("uncertainty", "uncertainty"), ("difference", "difference from a photo")]))
            (choice("view-size", "Width", &["320", "640", "960", "1280"].map(|width| (width, width))))
            (choice("view-photo", "Go to photo", &[]))
            label { input #view-frusta type="checkbox" checked; " Photos" }
            button #view-start type="button" { "First view" }
            button #view-measure type="button" aria-pressed="false" { "Measure" }
        }
        div.stage #view-stage {
            canvas #view-splats {}
            canvas #view-picture {}
            canvas #view-overlay tabindex="0" role="application" aria-label="3-D view of the field" aria-describedby="view-help" {}
        }
        p #view-legend.legend hidden { span #view-low {} span #view-scale.scale {} span #view-high {} }
        p.quiet #view-state {}
        p.quiet #view-splats-state {}
        p #view-distance role="status" {}
        p.quiet #view-help {
            "Drag turns, with Shift or the right button it moves, the wheel zooms. Keys: W A S D fly, Q and E down and up, arrows turn, "
            "+ and - zoom, M marks the point in the middle for a distance, 0 returns to the start. Two fingers move and zoom."
        }
        div.row #view-compare hidden {
            figure { img #view-photo-picture alt=""; figcaption #view-photo-name {} }
            figure { canvas #view-photo-render {} figcaption { "the field from its pose" } }
        }
        details {
            summary { "Bookmarks" }
            div.tools {
                button #view-bookmark type="button" { "Add this view" }
                button #view-download type="button" disabled { "Download as JSON" }
            }
            ul.plain #view-bookmarks {}
        }
    }
}

#[cfg(test)]
mod tests {
    use marf_report::sentence_page;

    use super::*;

    #[test]
    fn nothing_is_inline_and_what_is_linked_is_a_file_or_a_route() {
        for (parts, up) in [(live_parts(Some(3), &["train"]), ""), (scene_parts(), "../")] {
            let page = sentence_page("<b>", &parts);
            for gone in [
                "Content-Security-Policy",
                "<style",
                "data:",
                "http://",
                "https://",
                "<b>",
            ] {
                assert!(!page.html.contains(gone), "{gone}");
            }
            for part in page
                .html
                .split("<link ")
                .chain(page.html.split("<script "))
                .skip(1)
            {
                let Some((_, address)) = part.split_once("href=\"").or_else(|| part.split_once("src=\""))
                else {
                    continue;
                };
                let address = address.split('"').next().unwrap().strip_prefix(up).unwrap();
                match address.strip_prefix("object/") {
                    Some(digest) => assert!(page.files.contains_key(&digest.parse().unwrap()), "{address}"),
                    None => assert!(
                        ["icon.svg", "view.css", "live.js", "view.js", "#live"].contains(&address),
                        "{address}"
                    ),
                }
            }
        }
    }

    #[test]
    fn names_of_nodes_are_escaped() {
        let parts = live_parts(None, &["<img src=x onerror=alert(1)>"])
            .main
            .into_string();
        assert!(!parts.contains("<img src=x"), "{parts}");
    }
}
