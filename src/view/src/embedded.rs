//! The 3-D view of a report that needs no server: splats, scene and scripts in the page.

use std::sync::Arc;

use base64::{Engine as _, engine::general_purpose::STANDARD};
use marf_cache::Digest;
use marf_numeric::grouped;
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
    let kept = thinned(splats, MOST_SPLATS);
    let number = if kept.len() < all {
        format!(
            "{} of {} splats of `{label}`, enlarged to cover as much",
            grouped(kept.len()),
            grouped(all)
        )
    } else {
        format!("{} splats of `{label}`", grouped(all))
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

/// Returns `most` splats or fewer, spread evenly over all of them. Each is enlarged to the area of those that it replaces.
fn thinned(mut splats: Vec<Splat>, most: usize) -> Vec<Splat> {
    let all = splats.len();
    if all <= most {
        return splats;
    }
    let factor = (all as f64 / most as f64).sqrt();
    let mut index = 0;
    splats.retain(|_| {
        index += 1;
        index * most / all > (index - 1) * most / all
    });
    splats.iter_mut().for_each(|splat| splat.sigma *= factor);
    splats
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

    /// Two of eight have four times the area, hence twice the deviation.
    #[test]
    fn fewer_splats_are_spread_evenly_and_cover_as_much() {
        let splats: Vec<Splat> = (1..=8).map(|sigma| splat(f64::from(sigma), 0.9)).collect();
        let kept: Vec<f64> = thinned(splats.clone(), 2)
            .iter()
            .map(|splat| splat.sigma)
            .collect();
        assert_eq!(kept, [8.0, 16.0]);
        assert_eq!(thinned(splats.clone(), 8), splats);
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
        assert!(
            most.contains("150,000 of 150,001 splats of `train`, enlarged to cover as much, in this file.")
        );
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
