//! Pictures as data URIs, small enough that the whole page stays light.

use std::cell::{Cell, RefCell};
use std::collections::BTreeMap;

use base64::{Engine, engine::general_purpose::STANDARD};
use marf_cache::Digest;
use marf_scene::{Image, Photo, Srgb, encode_jpeg, encode_png};
use maud::{Markup, html};
use serde::{Deserialize, Serialize};

use super::format::megabytes;
use super::input::ReportInput;
use super::read::not_stored;

/// Most bytes the data URIs of all pictures take together, and those of all films: with both, and half a
/// megabyte of text and drawings, the file stays below 15 MB.
const PICTURE_BYTES: usize = 8_300_000;
const FILM_BYTES: usize = 6_000_000;
/// A map that takes more than this as PNG becomes a JPEG.
const MAP_BYTES: usize = 120_000;

/// How a picture is embedded.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Form {
    /// JPEG of at most 160 px a side.
    Thumb,
    /// JPEG of at most 480 px a side.
    Photo,
    /// PNG of at most 480 px a side, since colours carry numbers; JPEG where noise makes it too large.
    Map,
}

/// A picture ready for an `img`; kept in the store, so that a report after a new threshold decodes nothing.
#[derive(Debug, Clone, Serialize, Deserialize)]
struct Embedded {
    uri: String,
    width: u32,
    height: u32,
}

/// Makes data URIs, each once, and keeps count of what they take.
#[derive(Debug, Default)]
pub(super) struct Pictures {
    picture_bytes: Cell<usize>,
    film_bytes: Cell<usize>,
    made: RefCell<BTreeMap<(Digest, Form), Result<Embedded, String>>>,
}

impl Pictures {
    /// Shows a stored picture, or the reason why not.
    pub(super) fn stored(&self, input: &ReportInput<'_>, digest: &Digest, form: Form, alt: &str) -> Markup {
        let key = (*digest, form);
        let known = self.made.borrow().get(&key).cloned();
        let made = known.unwrap_or_else(|| {
            let made = embed_stored(input, digest, form);
            self.made.borrow_mut().insert(key, made.clone());
            made
        });
        self.shown(made, alt)
    }

    /// Shows a picture made for the page.
    pub(super) fn own(&self, image: &Image<Srgb>, form: Form, alt: &str) -> Markup {
        self.shown(embed(image, form), alt)
    }

    /// Shows a film (MP4) as it is stored.
    ///
    /// # Errors
    /// The sentence that stands in its place.
    pub(super) fn film(&self, input: &ReportInput<'_>, digest: &Digest, alt: &str) -> Result<Markup, String> {
        let bytes = (input.read)(digest).ok_or_else(|| not_stored("The film", digest))?;
        if bytes.get(4..8) != Some(b"ftyp".as_slice()) {
            return Err("The film is no MP4 and is not shown.".to_owned());
        }
        let used = self.film_bytes.get() + bytes.len() / 3 * 4;
        if used > FILM_BYTES {
            let (size, digest) = (megabytes(bytes.len()), digest.short());
            return Err(format!(
                "The film has {size}, too much for this page; it is object {digest} of the store."
            ));
        }
        self.film_bytes.set(used);
        let uri = data_uri("video/mp4", &bytes);
        Ok(html! { video src=(uri) controls loop muted playsinline aria-label=(alt) {} })
    }

    fn shown(&self, made: Result<Embedded, String>, alt: &str) -> Markup {
        let picture = match made {
            Ok(picture) => picture,
            Err(why) => return words(&why),
        };
        let used = self.picture_bytes.get() + picture.uri.len();
        if used > PICTURE_BYTES {
            return words("Not shown: this page holds as many pictures as it can.");
        }
        self.picture_bytes.set(used);
        html! { img src=(picture.uri) alt=(alt) width=(picture.width) height=(picture.height); }
    }
}

/// Version of the memos: to be raised when the same picture would be embedded as other bytes.
const VERSION: u32 = 1;

/// Embeds a stored picture, or takes what an earlier report made of it.
fn embed_stored(input: &ReportInput<'_>, digest: &Digest, form: Form) -> Result<Embedded, String> {
    let key = Digest::from_content(format!("picture {VERSION} {form:?} {digest}").as_bytes());
    let known = input.memos.load(&key);
    if let Some(known) = known.and_then(|bytes| serde_json::from_slice(&bytes).ok()) {
        return Ok(known);
    }
    let made = decode(input, digest).and_then(|image| embed(&image, form))?;
    // Strings and numbers always serialise; a table that is empty is made anew.
    input
        .memos
        .save(&key, &serde_json::to_vec(&made).unwrap_or_default());
    Ok(made)
}

/// Decodes a stored picture.
pub(super) fn decode(input: &ReportInput<'_>, digest: &Digest) -> Result<Image<Srgb>, String> {
    let bytes = (input.read)(digest).ok_or_else(|| not_stored("The picture", digest))?;
    let photo =
        Photo::decode_validated(&bytes).map_err(|error| format!("The picture cannot be shown: {error}."))?;
    Ok(photo.image)
}

/// Shrinks to what is shown, never enlarges.
pub(super) fn shrunk(image: &Image<Srgb>, most_px: u32) -> Result<Image<Srgb>, String> {
    marf_scene::shrunk(image, most_px).ok_or_else(|| "The picture has no pixels.".to_owned())
}

/// The place of a picture that cannot be shown.
pub(super) fn words(why: &str) -> Markup {
    html! { span.missing { (why) } }
}

fn embed(image: &Image<Srgb>, form: Form) -> Result<Embedded, String> {
    let (most_px, quality) = match form {
        Form::Thumb => (160, 80),
        Form::Photo => (480, 85),
        Form::Map => (480, 92),
    };
    let small = shrunk(image, most_px)?;
    let jpeg = || {
        let bytes = encode_jpeg(&small, quality).map_err(|error| error.to_string())?;
        Ok::<_, String>(data_uri("image/jpeg", &bytes))
    };
    let uri = match form {
        Form::Thumb | Form::Photo => jpeg()?,
        Form::Map => match encode_png(&small) {
            Ok(bytes) if bytes.len() <= MAP_BYTES => data_uri("image/png", &bytes),
            Ok(_) => jpeg()?,
            Err(error) => return Err(error.to_string()),
        },
    };
    let (width, height) = (small.width, small.height);
    Ok(Embedded { uri, width, height })
}

fn data_uri(media: &str, bytes: &[u8]) -> String {
    format!("data:{media};base64,{}", STANDARD.encode(bytes))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_picture_without_pixels_is_said_in_words() {
        let empty = Image::<Srgb>::from_fn(0, 4, |_, _| [0; 3]);
        assert_eq!(shrunk(&empty, 160).unwrap_err(), "The picture has no pixels.");
    }

    #[test]
    fn a_noisy_map_becomes_a_jpeg_and_a_plain_one_stays_exact() {
        let noise = |x: u32, y: u32| ((x * 7919 + y * 104_729).wrapping_mul(2_654_435_761) >> 13) as u8;
        let uri = |image| embed(&image, Form::Map).unwrap().uri;
        let plain = uri(Image::from_fn(480, 360, |x, _| [(x / 2) as u8; 3]));
        assert!(plain.starts_with("data:image/png"), "{} bytes", plain.len());
        let noisy = uri(Image::from_fn(480, 360, |x, y| {
            [noise(x, y), noise(y, x), noise(x + 9, y)]
        }));
        assert!(noisy.starts_with("data:image/jpeg"), "{} bytes", noisy.len());
    }

    #[test]
    fn a_full_page_takes_no_further_picture() {
        let pictures = Pictures::default();
        let image = Image::from_fn(8, 8, |x, _| [x as u8; 3]);
        assert!(
            pictures
                .own(&image, Form::Thumb, "a")
                .into_string()
                .contains("<img")
        );
        pictures.picture_bytes.set(PICTURE_BYTES);
        let full = pictures.own(&image, Form::Thumb, "a").into_string();
        assert!(full.contains("as many pictures as it can"), "{full}");
    }
}
