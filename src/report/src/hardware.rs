//! Static parts of the pictures of a camera: proposed masks, and how to use one.

use marf_model::RunNode;
use marf_schema::masks::{CameraReport, Metrics};
use marf_schema::output;
use maud::{Markup, html};

use super::embed::{Form, words};
use super::format::{count, number};
use super::page::Page;

/// The proposals of every node that made some. Empty without one.
pub(super) fn body(page: &Page<'_>) -> Markup {
    html! { @for node in page.with_document::<Metrics>() { h3 { (node.run.name) } (of_node(page, node)) } }
}

fn of_node(page: &Page<'_>, node: &RunNode) -> Markup {
    let metrics: Metrics = match page.document(node) {
        Ok(metrics) => metrics,
        Err(missing) => return html! { (missing) },
    };
    html! { @for camera in &metrics.cameras { (of_camera(page, node, camera)) } }
}

fn of_camera(page: &Page<'_>, node: &RunNode, camera: &CameraReport) -> Markup {
    let photos = count(camera.photos as usize, "photo");
    let moved = format!("{} of {} pairs", camera.moved, number(f64::from(camera.pairs)));
    html! {
        p { strong { (camera.name) } ", " (photos) ", moved in " (moved) ": " (camera.found) "." }
        @if camera.share > 0.0 {
            div.row { figure {
                @match node.digest(&format!("{}{}.png", output::OVERLAY, camera.name)) {
                    Some(digest) => (page.pictures.stored(page.report, digest, Form::Photo, "what stands still")),
                    None => (words("The node has no picture of it.")),
                }
                figcaption { "in red: what stands still" }
            } }
            p {
                "If this is a part of the rover, hide it: copy " code { (output::MASKS) (camera.name) ".png" } " of the folder "
                code { (node.run.name) } " into a folder " code { "masks" } " beside the photos (or in a folder of its own, if they come from a server), change it with any editor (black is \
                hidden), and run again. Nothing is hidden before."
            }
        }
    }
}
