//! Films in headless Chromium.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use marf_scene::Image;
use marf_video::{Encoder, Settings};
use serde_json::json;

use super::devtools::Page;

/// Largest difference of a channel, levels. If Chromium converts in software, blue follows its colour difference by 2.0 instead of
/// 2.112 (up to 5.1 levels here), and the codec rounds. Read as BT.601 the green is off by 13.
const TOLERANCE: u64 = 7;

/// Four colours, 64 x 64 pixels each.
const COLORS: [[u8; 3]; 4] = [[200, 120, 80], [40, 60, 160], [128, 128, 128], [40, 200, 60]];

fn film() -> Vec<u8> {
    let settings = Settings {
        frames_per_second: 24,
        quantizer: 12,
    };
    let mut encoder = Encoder::new(settings).unwrap();
    let picture = Image::from_fn(128, 128, |column, row| {
        COLORS[(column / 64 + 2 * (row / 64)) as usize]
    });
    (0..12).for_each(|_| encoder.push(&picture).unwrap());
    encoder.finish().unwrap()
}

/// Plays the film of an address and returns its size, its length and the pixels in the middle of the four colours.
const PLAY: &str = "(async (address) => {
    const video = document.createElement('video');
    video.muted = true;
    document.body.append(video);
    const ended = new Promise((done) => { video.onended = done; });
    const first = new Promise((done, failed) => {
        video.requestVideoFrameCallback(done);
        video.onerror = () => failed(new Error(video.error.message));
    });
    video.src = address;
    video.play().catch(() => {});
    await first;
    const canvas = document.createElement('canvas');
    [canvas.width, canvas.height] = [video.videoWidth, video.videoHeight];
    const context = canvas.getContext('2d');
    context.drawImage(video, 0, 0);
    const at = (x, y) => [...context.getImageData(x, y, 1, 1).data].slice(0, 3);
    const colors = [at(32, 32), at(96, 32), at(32, 96), at(96, 96)];
    await ended;
    return {size: [canvas.width, canvas.height], seconds: video.duration, colors};
})";

/// A picture has the right colours, and the film plays to its end.
#[test]
fn chromium_plays_films_in_their_colors() {
    let dir = tempfile::tempdir().unwrap();
    let empty = dir.path().join("empty.html");
    std::fs::write(&empty, "<!doctype html><title>film</title>").unwrap();
    let Some(mut page) = Page::open(&format!("file://{}", empty.display())) else {
        return;
    };
    let address = format!("data:video/mp4;base64,{}", STANDARD.encode(film()));
    let shown = page.value(&format!("{PLAY}('{address}')"));
    assert_eq!(
        (&shown["size"], &shown["seconds"]),
        (&json!([128, 128]), &json!(0.5))
    );
    let found: Vec<[u64; 3]> = serde_json::from_value(shown["colors"].clone()).unwrap();
    for (found, expected) in found.iter().zip(COLORS) {
        let is_near = found
            .iter()
            .zip(expected)
            .all(|(found, expected)| found.abs_diff(u64::from(expected)) <= TOLERANCE);
        assert!(is_near, "{found:?} in place of {expected:?}");
    }
}
