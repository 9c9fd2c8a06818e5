//! The 3-D view of a report that needs no server: splats, scene and scripts in the page.

use std::sync::Arc;

use base64::{Engine as _, engine::general_purpose::STANDARD};
use marf_cache::Digest;
use marf_report::EmbeddedView;
use marf_scene::Scene;
use marf_scene::path::{focus_point, orbit, typical_camera};
use marf_surface::splats::Splat;
use maud::{PreEscaped, html};
use nalgebra::Vector3;
use serde_json::json;

use crate::source::{FieldSource, Source};
use crate::splat_progress::SplatProgress;
use crate::splats::{pack, splats_of_field};

/// Most splats in a page: 4.8 MB as text.
const MOST_SPLATS: usize = 150_000;
/// Width of the camera that the page scales, pixels.
const CAMERA_PX: u32 = 640;
/// The scripts of the view, each after those that it imports.
const SCRIPTS: [&str; 3] = [
    include_str!("page/mover.js"),
    include_str!("page/splats.js"),
    include_str!("page/standalone.js"),
];
const STYLE: &str = include_str!("page/standalone.css");

/// Returns the 3-D view of a field for a page in one file. Its splats are made unless the store has them, which takes minutes.
///
/// # Errors
/// One sentence: a field without a surface, or a lost object.
pub fn embedded_view(source: &dyn Source, field: &FieldSource) -> Result<EmbeddedView, String> {
    let progress = Arc::new(SplatProgress::default());
    let (scene, splats) = splats_of_field(source, field, &progress)?;
    view_of(&field.label, &scene, splats)
}

fn view_of(label: &str, scene: &Scene, splats: Vec<Splat>) -> Result<EmbeddedView, String> {
    let start = orbit(scene, 1, CAMERA_PX)
        .first()
        .map(|place| place.cam_from_world);
    let start = start.ok_or_else(|| format!("the scene of `{label}` has no photo"))?;
    let up = scene.up.map(Vector3::from);
    let up = up.unwrap_or_else(|| -start.rotation.row(1).transpose());
    let facts = json!({
        "start": start,
        "up": <[f64; 3]>::from(up),
        "focus": <[f64; 3]>::from(focus_point(scene)),
        "camera": typical_camera(scene, CAMERA_PX),
    });
    let all = splats.len();
    let kept = largest(splats, MOST_SPLATS);
    let number = if kept.len() < all {
        format!("The {} of {all} splats of `{label}` that cover most", kept.len())
    } else {
        format!("{all} splats of `{label}`")
    };
    let data = STANDARD.encode(pack(&kept));
    let script = bundled();
    let nonce = Digest::from_content(format!("{script}{data}").as_bytes()).to_string();
    let main = html! {
        section #view {
            h2 { "3-D view" }
            style { (PreEscaped(STYLE)) }
            noscript { p.missing { "The 3-D view needs scripts. Everything below does not." } }
            canvas #view-canvas tabindex="0" role="application" aria-label="3-D view of the field" aria-describedby="view-help" {}
            p.quiet { (number) ", in this file. `marf view` also shows depth, uncertainty and distances." }
            p.quiet #view-help {
                "Drag turns, with Shift or the right button it moves, the wheel zooms. Keys: W A S D fly, Q and E down and up, arrows turn, "
                "+ and - zoom, 0 returns to the start. Two fingers move and zoom."
            }
            script #view-scene type="application/json" { (PreEscaped(facts.to_string())) }
            script #view-data type="text/plain" { (PreEscaped(data)) }
            script #view-projector type="text/plain" { (PreEscaped(include_str!("page/projector.js"))) }
            script type="module" nonce=(nonce) { (PreEscaped(script)) }
        }
    };
    Ok(EmbeddedView { main, nonce })
}

/// Returns the splats that cover most, opacity times area, in their order.
fn largest(splats: Vec<Splat>, most: usize) -> Vec<Splat> {
    if splats.len() <= most {
        return splats;
    }
    let covered = |splat: &Splat| f64::from(splat.opacity) * splat.sigma * splat.sigma;
    let mut order: Vec<usize> = (0..splats.len()).collect();
    order.sort_by(|a, b| covered(&splats[*b]).total_cmp(&covered(&splats[*a])));
    order.truncate(most);
    order.sort_unstable();
    order.into_iter().map(|index| splats[index]).collect()
}

/// Returns the scripts as one, without what joins files.
fn bundled() -> String {
    let lines = SCRIPTS.iter().flat_map(|script| script.lines());
    let lines = lines.filter(|line| !line.starts_with("import "));
    let lines: Vec<&str> = lines
        .map(|line| line.strip_prefix("export ").unwrap_or(line))
        .collect();
    lines.join("\n")
}

#[cfg(test)]
mod tests {
    use marf_scene::{Camera, Frame, Pose};

    use super::*;

    fn splat(sigma: f64, opacity: f32) -> Splat {
        Splat {
            position: Vector3::zeros(),
            normal: Vector3::z(),
            sigma,
            color: [0.5; 3],
            opacity,
        }
    }

    /// Opacity times area: 0.9 x 1, 0.1 x 4, 0.5 x 4, 1 x 0.25.
    #[test]
    fn the_splats_that_cover_most_are_kept_in_their_order() {
        let splats = vec![splat(1.0, 0.9), splat(2.0, 0.1), splat(2.0, 0.5), splat(0.5, 1.0)];
        let kept: Vec<f64> = largest(splats, 2).iter().map(|splat| splat.sigma).collect();
        assert_eq!(kept, [1.0, 2.0]);
    }

    #[test]
    fn the_page_says_how_many_splats_it_has() {
        let frame = Frame {
            id: "a".to_owned(),
            file: "a.png".to_owned(),
            image: Digest::from_content(b"a"),
            camera: Camera::pinhole(64, 48, 50.0),
            cam_from_world: Pose::identity(),
            held_out: false,
            mask: None,
            error_px: None,
        };
        let scene = Scene {
            frames: vec![frame],
            ..Scene::default()
        };
        let said = |count: usize| {
            let view = view_of("train", &scene, vec![splat(1.0, 0.5); count]).unwrap();
            let page = view.main.into_string();
            assert!(page.contains(&format!("nonce=\"{}\"", view.nonce)), "{count}");
            page
        };
        assert!(said(2).contains("<p class=\"quiet\">2 splats of `train`, in this file."));
        let most = said(MOST_SPLATS + 1);
        assert!(most.contains("The 150000 of 150001 splats of `train` that cover most, in this file."));
        assert!(most.len() < 5_000_000, "{} bytes", most.len());
        let none = view_of("train", &Scene::default(), Vec::new());
        assert_eq!(none.err().unwrap(), "the scene of `train` has no photo");
    }

    #[test]
    fn the_script_is_whole_and_ends_nowhere_early() {
        let script = bundled();
        assert!(
            !script.contains("export ") && !script.contains("from \"./"),
            "{script}"
        );
        for text in [&script[..], include_str!("page/projector.js")] {
            assert!(!text.contains("</"), "the end of an element");
        }
    }
}
