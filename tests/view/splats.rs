//! Splats in the browser: the same pictures as those of our rasteriser, and pictures a second.

use std::path::Path;

use image::RgbImage;
use serde_json::json;

use super::common::{copy, marf};
use super::devtools::Page;
use super::{Viewer, small_run};

/// Blending in 8 bits rounds at each of some tens of layers. PSNR, dB.
const LEAST_PSNR_DB: f64 = 35.0;

/// Splats on a canvas of their own, by WebGL2 or by the thread. `drawn(view, isMoving)` is done when they are drawn.
const SPLATS: &str = "(async () => { const { Splats } = await import('./splats.js'); \
    globalThis.begin = (isSoftware) => { const canvas = document.body.appendChild(document.createElement('canvas')); let done; \
    const splats = globalThis.splats = new Splats(canvas, () => { \
    splats.gl?.readPixels(0, 0, 1, 1, splats.gl.RGBA, splats.gl.UNSIGNED_BYTE, new Uint8Array(4)); done(canvas); }, { isSoftware }); \
    globalThis.load = (buffer) => splats.load(buffer); \
    globalThis.drawn = (view, isMoving) => new Promise((resolve) => { done = resolve; splats.show(view, isMoving); }); }; })()";

#[test]
fn the_browser_draws_splats_as_our_rasteriser_does() {
    let dir = tempfile::tempdir().unwrap();
    copy(small_run(), dir.path());
    let viewer = Viewer::start(dir.path(), &[]);
    let Some(mut page) = Page::open(&viewer.address) else {
        return;
    };
    page.waits_for("document.getElementById('view-stage')?.dataset.divisor === '1'");
    let splats = "(async () => { for (;;) { const response = await fetch('splats/1/0'); if (response.status !== 202) \
        return response.ok ? (globalThis.made = await response.arrayBuffer()).byteLength / 24 : await response.text(); \
        await new Promise((resolve) => setTimeout(resolve, 200)); } })()";
    let count = page.value(splats);
    assert!(count.as_u64().is_some_and(|count| count > 1000), "{count}");
    assert_eq!(
        page.value("document.getElementById('live-state').textContent"),
        json!("Nothing runs in this store."),
        "splats of a page are no run of the user"
    );
    // The same splats, from the store that the page has put them in, next to the field's pictures.
    let printed = marf(
        dir.path(),
        &[
            "export",
            "splats",
            "--out",
            "splats.ply",
            "--pictures",
            "pictures",
        ],
    );
    printed.exits(0);
    page.value(SPLATS);
    for (is_software, way) in [("false", "WebGL2"), ("true", "the thread")] {
        page.value(&format!("begin({is_software}); load(made.slice())"));
        compare(&mut page, &viewer, dir.path(), way);
    }
}

/// Compares pictures of the browser with those that were exported.
fn compare(page: &mut Page, viewer: &Viewer, folder: &Path, way: &str) {
    let scene = viewer.get("/scene/1/0").is(200).json();
    let mut compared = 0;
    for photo in scene["photos"].as_array().unwrap() {
        let stem = photo["file"].as_str().unwrap().split('.').next().unwrap();
        let Ok(pair) = image::open(folder.join(format!("pictures/{stem}.png"))) else {
            continue;
        };
        let pair = pair.to_rgb8();
        let factor = photo["camera"]["width"].as_f64().unwrap() / f64::from(pair.width() / 2);
        let mut camera = photo["camera"].clone();
        for key in ["fx_px", "fy_px", "cx_px", "cy_px"] {
            camera[key] = json!(camera[key].as_f64().unwrap() / factor);
        }
        (camera["width"], camera["height"]) = (json!(pair.width() / 2), json!(pair.height()));
        let view = json!({"camera": camera, "pose": photo["cam_from_world"]});
        let drawn = picture(&page.value(&format!("drawn({view}).then((canvas) => canvas.toDataURL())")));
        let psnr_db = psnr_of_left_half(&drawn, &pair);
        println!("{stem} by {way}: {psnr_db:.1} dB");
        assert!(psnr_db >= LEAST_PSNR_DB, "{stem} by {way}: {psnr_db}");
        compared += 1;
    }
    assert!(compared > 0, "no photo is held out");
}

/// Pictures a second while the camera turns: printed, never judged. What is drawn at rest is judged: all of it, also after a move.
#[test]
fn a_moving_camera_draws_less_and_one_at_rest_leaves_nothing_out() {
    let viewer = Viewer::start(small_run(), &[]);
    let Some(mut page) = Page::open(&viewer.address) else {
        return;
    };
    page.value(SPLATS);
    page.value("begin(true)");
    // Discs a pixel or two wide on a wall that fills the picture.
    page.value(
        "{ const count = 100000, buffer = new ArrayBuffer(24 * count), places = new Float32Array(buffer, 0, 4 * count), words = new Uint32Array(buffer, 16 * count); \
         for (let index = 0; index < count; index += 1) { \
         places.set([(index % 400) / 100 - 2, Math.floor(index / 400) / 83 - 1.5, 3 + (index % 7) / 10, 0.01], 4 * index); \
         words.set([0, 0xf0000000 + index % 0xffffff], 2 * index); } load(buffer); }",
    );
    page.value(
        "globalThis.turned = (angle) => ({ camera: { width: 640, height: 480, fx_px: 480, fy_px: 480, cx_px: 320, cy_px: 240, k1: 0, k2: 0, p1: 0, p2: 0 }, \
         pose: [[Math.cos(angle), 0, Math.sin(angle), 0], [0, 1, 0, 0], [-Math.sin(angle), 0, Math.cos(angle), 0]] })",
    );
    let at_rest = "drawn(turned(0)).then((canvas) => canvas.toDataURL())";
    let before = page.value(at_rest);
    let rate = "(async () => { const began = performance.now(); for (let at = 0; at < 60; at += 1) await drawn(turned(at / 300), true); \
        return 60000 / (performance.now() - began); })()";
    let rate = page.value(rate).as_f64().unwrap();
    let level = page.value("splats.level");
    println!("100,000 splats at 640 x 480: {rate:.1} pictures a second at level {level}");
    let sizes = page.value(
        "(async () => { const size = (canvas) => [canvas.width, canvas.height]; splats.level = 2; \
        return [size(await drawn(turned(0), true)), size(await drawn(turned(0)))]; })()",
    );
    assert_eq!(sizes, json!([[320, 240], [640, 480]]));
    let after = page.value(at_rest);
    assert_eq!(before, after, "a picture at rest after a move");
    let [before, moved] = [
        picture(&before),
        picture(&page.value("drawn(turned(0.05)).then((canvas) => canvas.toDataURL())")),
    ];
    assert_ne!(before, moved);
    assert!(page.complaints().is_empty(), "{:?}", page.complaints());
}

/// Reads a picture that is given as data.
fn picture(data: &serde_json::Value) -> RgbImage {
    use base64::Engine as _;
    let text = data
        .as_str()
        .unwrap()
        .strip_prefix("data:image/png;base64,")
        .unwrap();
    let bytes = base64::engine::general_purpose::STANDARD.decode(text).unwrap();
    image::load_from_memory(&bytes).unwrap().to_rgb8()
}

/// Returns the PSNR of a picture against the left half of a pair.
fn psnr_of_left_half(drawn: &RgbImage, pair: &RgbImage) -> f64 {
    assert_eq!([drawn.width(), drawn.height()], [pair.width() / 2, pair.height()]);
    let squares = drawn.enumerate_pixels().flat_map(|(x, y, found)| {
        let wanted = pair.get_pixel(x, y).0;
        (0..3).map(move |channel| (f64::from(found.0[channel]) - f64::from(wanted[channel])).powi(2))
    });
    let count = f64::from(3 * drawn.width() * drawn.height());
    10.0 * (255.0_f64.powi(2) * count / squares.sum::<f64>()).log10()
}
