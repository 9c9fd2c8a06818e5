//! Names of mask files next to photos.

use marf_scene::PhotoFacts;

use crate::photos::{InputPhoto, without_extension};

/// Returns every folder above the file with its slash, the nearest first, the top ("") last.
fn above(file: &str) -> impl Iterator<Item = &str> {
    let slashes = file.rmatch_indices('/').map(|(at, _)| &file[..=at]);
    slashes.chain([""])
}

/// Returns the names that a photo's own mask may have, the likeliest first.
pub(crate) fn own_names(file: &str) -> Vec<String> {
    let base = file.rsplit('/').next().unwrap_or(file);
    let (mut names, mut rarer) = (Vec::new(), Vec::new());
    for folder in above(file) {
        let rest = &file[folder.len()..];
        for tail in [rest, rest.strip_prefix("images/").unwrap_or(rest), base] {
            let stem = without_extension(tail);
            names.push(format!("{folder}masks/{tail}.png"));
            names.push(format!("{folder}masks/{stem}.png"));
            for (masks, end) in rarer_places() {
                rarer.push(format!("{folder}{masks}/{tail}{end}"));
                rarer.push(format!("{folder}{masks}/{stem}{end}"));
            }
        }
        // The masks of `images_2` are in `masks_2`.
        if let Some((scale, tail)) = rest.strip_prefix("images_").and_then(|rest| rest.split_once('/')) {
            rarer.push(format!("{folder}masks_{scale}/{tail}.png"));
            rarer.push(format!("{folder}masks_{scale}/{}.png", without_extension(tail)));
        }
    }
    rarer.push(format!("{file}.png"));
    let beside = ["_mask.png", "_mask.jpg", "_mask.jpeg"];
    rarer.extend(beside.map(|end| format!("{}{end}", without_extension(file))));
    names.extend(rarer);
    names
}

/// Returns the other folders and ends that names of masks have.
fn rarer_places() -> impl Iterator<Item = (&'static str, &'static str)> {
    const ENDS: [&str; 8] = [
        ".png",
        ".jpg",
        ".jpeg",
        ".PNG",
        ".JPG",
        "_mask.png",
        "_mask.jpg",
        "_mask.jpeg",
    ];
    ["masks", "mask"]
        .into_iter()
        .flat_map(|masks| ENDS.into_iter().map(move |end| (masks, end)))
}

/// Returns the names that a mask for all photos of a camera may have.
pub(crate) fn camera_names(item: &InputPhoto) -> Vec<String> {
    let instrument = item.facts.instrument.as_deref();
    let names: Vec<String> = [Some(camera_name(&item.facts)), instrument.map(str::to_owned)]
        .into_iter()
        .flatten()
        .collect();
    let beside = above(&item.facts.file);
    beside
        .flat_map(|folder| names.iter().map(move |name| format!("{folder}masks/{name}.png")))
        .collect()
}

/// Returns the name of the camera of a photo: `<instrument>-<width>x<height>`, or the size alone. Characters other than letters, digits,
/// `-` and `_` become `_`.
pub(crate) fn camera_name(facts: &PhotoFacts) -> String {
    let size = format!("{}x{}", facts.width, facts.height);
    let plain = |letter: char| letter.is_ascii_alphanumeric() || letter == '-';
    match &facts.instrument {
        Some(instrument) => format!("{}-{size}", instrument.replace(|letter| !plain(letter), "_")),
        None => size,
    }
}
