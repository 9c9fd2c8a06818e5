use maud::Markup;

use super::embed::{Form, words};
use super::page::Page;

/// Returns the file name of a photo, or its id if no manifest names it.
pub(super) fn name_of<'p>(page: &'p Page<'_>, id: &'p str) -> &'p str {
    page.photos.get(id).map_or(id, |photo| photo.file.as_str())
}

/// Shows a photo as a thumbnail, or the reason why not.
pub(super) fn thumb(page: &Page<'_>, id: &str, what: &str) -> Markup {
    let Some(photo) = page.photos.get(id) else {
        return words("This photo is in no manifest of the run.");
    };
    let alt = format!("{what}: {}", photo.file);
    match &photo.image {
        Some(image) => page.pictures.stored(page.report, image, Form::Thumb, &alt),
        None => words("The manifest names no image."),
    }
}
