//! File names of the pictures of a scene.

use std::collections::BTreeSet;

use crate::Scene;

/// Returns the base name of the pictures of each frame, in the order of the frames.
///
/// It is the stem of the frame's file, with every character outside `[A-Za-z0-9._-]` turned into `_`. A stem that is taken gets `-2`, `-3`,
/// … in the order of the frames, so that a frame has one name in every stage. Extremes: a file without a stem is `frame`.
pub fn picture_names(scene: &Scene) -> Vec<String> {
    let mut taken = BTreeSet::new();
    let frames = scene.frames.iter();
    frames
        .map(|frame| free_name(&stem(&frame.file), &mut taken))
        .collect()
}

/// Returns the stem of a file's name with unsafe characters replaced.
fn stem(file: &str) -> String {
    let base = file.rsplit('/').next().unwrap_or(file);
    let stem = base.rsplit_once('.').map_or(base, |(stem, _)| stem);
    let safe = |letter: char| letter.is_ascii_alphanumeric() || matches!(letter, '.' | '_' | '-');
    let name: String = stem
        .chars()
        .map(|letter| if safe(letter) { letter } else { '_' })
        .collect();
    if name.is_empty() { "frame".to_owned() } else { name }
}

/// Returns the stem, or the stem with the first number that is not taken, and marks it as taken.
fn free_name(stem: &str, taken: &mut BTreeSet<String>) -> String {
    let numbered = (2..).map(|number| format!("{stem}-{number}"));
    let mut candidates = std::iter::once(stem.to_owned()).chain(numbered);
    let name = candidates.find(|name| !taken.contains(name)).unwrap_or_default();
    taken.insert(name.clone());
    name
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Camera, Frame, Pose};

    fn scene(files: &[&str]) -> Scene {
        let frame = |file: &&str| Frame {
            id: (*file).to_owned(),
            file: (*file).to_owned(),
            image: marf_cache::Digest::from_content(b""),
            camera: Camera::pinhole(2, 2, 1.0),
            cam_from_world: Pose::identity(),
            held_out: false,
            mask: None,
            error_px: None,
        };
        Scene {
            frames: files.iter().map(frame).collect(),
            ..Scene::default()
        }
    }

    #[test]
    fn names_are_safe_stems_and_never_twice_the_same() {
        let names = picture_names(&scene(&[
            "left/a b.jpg",
            "right/a b.png",
            "<img>.jpg",
            ".png",
            "a_b-2.jpg",
        ]));
        assert_eq!(names, ["a_b", "a_b-2", "_img_", "frame", "a_b-2-2"]);
    }
}
