//! The live page: a report with the live parts, its pictures as addresses.

use std::collections::HashMap;

use base64::{Engine as _, engine::general_purpose::STANDARD};
use marf_cache::Digest;
use maud::{Markup, html};

use crate::file::File;

/// A report as it is served.
pub struct LivePage {
    /// The page.
    pub html: String,
    /// What it shows, by digest.
    pub files: HashMap<Digest, File>,
}

/// Turns a report into the live page: what it holds as data URIs becomes files with addresses of their own, so that the page
/// itself stays small, and the live parts are added. None if it is no report of the known form.
///
/// Whatever came from outside is escaped in a report: the marks that are sought here stand in no text.
pub fn live(report: &str, live: &Markup) -> Option<LivePage> {
    served(report, "", Some(live))
}

/// As [`live`], of a page in a folder beside the report: nothing on it lives.
pub fn below(report: &str) -> Option<LivePage> {
    served(report, "../", None)
}

/// Returns a page whose addresses begin with `up`, with what lives on it.
fn served(report: &str, up: &str, live: Option<&Markup>) -> Option<LivePage> {
    let mut files = HashMap::new();
    let (head, rest) = report.split_once("<meta http-equiv=\"Content-Security-Policy\"")?;
    let (_, rest) = rest.split_once('>')?;
    let (between, rest) = rest.split_once("<style>")?;
    let (style, rest) = rest.split_once("</style>")?;
    let (header, main) = rest.split_once("<main>")?;
    let style = add(&mut files, "text/css; charset=utf-8", style.as_bytes().to_vec());
    let links = html! {
        link rel="icon" href={ (up) "icon.svg" };
        link rel="stylesheet" href={ (up) "object/" (style) };
        link rel="stylesheet" href={ (up) "view.css" };
        @if live.is_some() {
            script type="module" src="live.js" {}
            script type="module" src="view.js" {}
        }
    };
    let header = match live {
        Some(_) => header.replacen(
            NAVIGATION,
            &format!("{NAVIGATION}{}", navigation().into_string()),
            1,
        ),
        None => header.replacen(UP_ON_DISK, UP, 1),
    };
    let live = live.cloned().unwrap_or_default();
    let page = [
        head,
        &links.into_string(),
        between,
        &header,
        "<main>",
        &live.into_string(),
        main,
    ];
    let html = addressed(&page.concat(), up, &mut files)?;
    Some(LivePage { html, files })
}

const NAVIGATION: &str = "<nav aria-label=\"Contents\">";

/// The way from the page of a scene to that of all, on disk and here.
const UP_ON_DISK: &str = "href=\"../report.html\"";
const UP: &str = "href=\"../\"";

fn navigation() -> Markup {
    html! { a href="#live" { "Live" } " " a href="#view" { "3-D view" } " " }
}

/// Puts addresses in the place of data URIs.
fn addressed(page: &str, up: &str, files: &mut HashMap<Digest, File>) -> Option<String> {
    const BEGIN: &str = " src=\"data:";
    let mut parts = page.split(BEGIN);
    let mut html = parts.next()?.to_owned();
    for part in parts {
        let (uri, rest) = part.split_once('"')?;
        let (media, bytes) = uri.split_once(";base64,")?;
        let media = MEDIA.iter().find(|known| **known == media)?;
        let digest = add(files, media, STANDARD.decode(bytes).ok()?);
        let lazily = if html.ends_with("<img") {
            " loading=\"lazy\""
        } else {
            ""
        };
        html.push_str(&format!("{lazily} src=\"{up}object/{digest}\""));
        html.push_str(rest);
    }
    Some(html)
}

/// What a report holds.
const MEDIA: [&str; 3] = ["image/jpeg", "image/png", "video/mp4"];

fn add(files: &mut HashMap<Digest, File>, media: &'static str, bytes: Vec<u8>) -> Digest {
    let digest = Digest::from_content(&bytes);
    let bytes = bytes.into();
    files.insert(digest, File { media, bytes });
    digest
}

/// Returns the live parts: what a running program does, and the 3-D view if there are fields.
pub fn live_parts(number: Option<u64>, fields: &[&str]) -> Markup {
    html! {
        section #live data-run=(number.map(|number| number.to_string()).unwrap_or_default()) {
            h2 { "Live" }
            p #live-state role="status" { "Connecting." }
            div.scroll { table #live-nodes hidden {
                thead { tr { th { "Node" } th { "State" } th { "Progress" } th { "Note" } } }
                tbody {}
            } }
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
        noscript { p.missing { "The 3-D view needs scripts; everything below does not." } }
        div.tools {
            (choice("view-field", "Field", &fields))
            (choice("view-mode", "Show", &[("color", "colour"), ("depth", "depth"), ("uncertainty", "uncertainty"), ("difference", "difference from a photo")]))
            (choice("view-size", "Width", &["320", "640", "960", "1280"].map(|width| (width, width))))
            (choice("view-photo", "Go to photo", &[]))
            label { input #view-frusta type="checkbox" checked; " Photos" }
            button #view-start type="button" { "Start" }
            button #view-measure type="button" aria-pressed="false" { "Measure" }
        }
        div.stage #view-stage {
            canvas #view-picture {}
            canvas #view-overlay tabindex="0" role="application" aria-label="3-D view of the field" aria-describedby="view-help" {}
        }
        p #view-legend.legend hidden { span #view-low {} span #view-scale.scale {} span #view-high {} }
        p.quiet #view-state {}
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
    use super::*;

    const REPORT: &str = "<head><meta charset=\"utf-8\"><meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'\">\
        <title>a</title><style>b { color: red }</style></head><body><header><nav aria-label=\"Contents\"></nav></header>\
        <main><img src=\"data:image/png;base64,AAEC\" alt=\"x\"><p>src=&quot;data:&quot; &lt;main&gt;</p></main>";

    #[test]
    fn pictures_and_style_become_files_and_nothing_stays_inline() {
        let page = live(REPORT, &live_parts(Some(3), &["train"])).unwrap();
        let picture = Digest::from_content(&[0, 1, 2]);
        assert!(
            page.html
                .contains(&format!("<img loading=\"lazy\" src=\"object/{picture}\"")),
            "{}",
            page.html
        );
        assert_eq!(page.files[&picture].media, "image/png");
        for gone in [
            "Content-Security-Policy",
            "<style",
            "\"data:",
            "http://",
            "https://",
        ] {
            assert!(!page.html.contains(gone), "{gone}");
        }
        assert!(page.html.contains("<p>src=&quot;data:&quot; &lt;main&gt;</p>"));
        assert_eq!(page.files.len(), 2);
    }

    #[test]
    fn what_is_no_report_is_not_shown() {
        for text in [
            "",
            "<main>",
            &REPORT.replace("image/png", "text/html"),
            &REPORT.replace("AAEC", "A"),
        ] {
            assert!(live(text, &html! {}).is_none(), "{text}");
        }
    }

    #[test]
    fn names_of_nodes_are_escaped() {
        let parts = live_parts(None, &["<img src=x onerror=alert(1)>"]).into_string();
        assert!(!parts.contains("<img src=x"), "{parts}");
    }
}
