//! Pictures and films of the page, small enough that the whole page stays light.

use std::cell::{Cell, RefCell};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use marf_cache::Digest;
use marf_scene::picture::draw_titled;
use marf_scene::{Image, Photo, Srgb, encode_jpeg, encode_png};
use maud::{Markup, html};

use super::format::size;
use super::media::Media;
use super::read::not_stored;
use super::report::Report;

/// Most bytes the data URIs of all pictures of a page take together, and those of all films: with both, and half a
/// megabyte of text and drawings, the file stays below 15 MB.
const PICTURE_BYTES: usize = 8_300_000;
const FILM_BYTES: usize = 6_000_000;
/// Most bytes of a 3-D view. Pictures have as much less.
const VIEW_BYTES: usize = 5_000_000;
/// A map that takes more than this as PNG becomes a JPEG.
const MAP_BYTES: usize = 120_000;

/// Form of an embedded picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Form {
    /// JPEG of at most 160 px a side.
    Thumb,
    /// JPEG of at most 480 px a side.
    Photo,
    /// As a photo, below a title, with the space that a map of that size has for its scale: a point is at one place in both.
    Panel(&'static str),
    /// PNG of at most 480 px a side, since colours carry numbers. JPEG if noise makes it too large.
    Map,
}

/// A picture ready for an `img`. It is kept in the store, so that a report after a new threshold decodes
/// nothing.
#[derive(Debug, Clone, PartialEq)]
struct Picture {
    width: u32,
    height: u32,
    /// A JPEG or PNG.
    bytes: Arc<[u8]>,
}

impl Picture {
    fn media(&self) -> &'static str {
        if self.bytes.starts_with(b"\x89PNG") {
            "image/png"
        } else {
            "image/jpeg"
        }
    }

    /// Returns the memo: width and height, little-endian, then the picture.
    fn encode(&self) -> Vec<u8> {
        let size = [self.width.to_le_bytes(), self.height.to_le_bytes()];
        [&size.concat()[..], &self.bytes[..]].concat()
    }

    fn decode(memo: &[u8]) -> Option<Self> {
        let (width, rest) = memo.split_first_chunk()?;
        let (height, bytes) = rest.split_first_chunk()?;
        Some(Self {
            width: u32::from_le_bytes(*width),
            height: u32::from_le_bytes(*height),
            bytes: bytes.into(),
        })
    }
}

/// Makes the pictures of a page, each once, and keeps count of what those in the page take.
pub(super) struct Pictures<'a> {
    media: &'a Media<'a>,
    picture_bytes: Cell<usize>,
    film_bytes: Cell<usize>,
    made: RefCell<BTreeMap<(Digest, Form), Result<Picture, String>>>,
    films: RefCell<BTreeSet<Digest>>,
}

impl<'a> Pictures<'a> {
    pub(super) fn new(media: &'a Media<'a>) -> Self {
        Self {
            media,
            picture_bytes: Cell::default(),
            film_bytes: Cell::default(),
            made: RefCell::default(),
            films: RefCell::default(),
        }
    }

    /// Shows a stored picture, or the reason why not.
    pub(super) fn stored(&self, report: &Report<'_>, digest: &Digest, form: Form, alt: &str) -> Markup {
        let key = (*digest, form);
        let known = self.made.borrow().get(&key).cloned();
        let made = known.unwrap_or_else(|| {
            let made = scaled_of(report, digest, form);
            self.made.borrow_mut().insert(key, made.clone());
            made
        });
        self.shown(made, alt)
    }

    /// Shows a picture made for the page.
    pub(super) fn own(&self, image: &Image<Srgb>, form: Form, alt: &str) -> Markup {
        self.shown(scaled(image, form), alt)
    }

    /// Shows a film (MP4) as it is stored.
    ///
    /// # Errors
    /// The sentence shown instead of it.
    pub(super) fn film(&self, report: &Report<'_>, digest: &Digest, alt: &str) -> Result<Markup, String> {
        let bytes = (report.read)(digest).ok_or_else(|| not_stored("The film", digest))?;
        if bytes.get(4..8) != Some(b"ftyp".as_slice()) {
            return Err("The film is not an MP4 and is not shown.".to_owned());
        }
        if !self.fits(&self.film_bytes, bytes.len() / 3 * 4, FILM_BYTES) {
            let (size, digest) = (size(bytes.len() as u64), digest.short());
            return Err(format!(
                "The film has {size}, too much for this page. It is object {digest} of the store."
            ));
        }
        let address = self.media.stored("video/mp4", digest, &bytes);
        self.films.borrow_mut().insert(*digest);
        Ok(html! { video src=(address) controls loop muted playsinline aria-label=(alt) {} })
    }

    /// Returns true if a film is on the page already.
    pub(super) fn has_film(&self, digest: &Digest) -> bool {
        self.films.borrow().contains(digest)
    }

    fn shown(&self, made: Result<Picture, String>, alt: &str) -> Markup {
        let picture = match made {
            Ok(picture) => picture,
            Err(why) => return words(&why),
        };
        let address = self.media.made(picture.media(), &picture.bytes);
        let most = self
            .media
            .view()
            .map_or(PICTURE_BYTES, |_| PICTURE_BYTES - VIEW_BYTES);
        if !self.fits(&self.picture_bytes, address.len(), most) {
            return words("Not shown: this page holds as many pictures as it can.");
        }
        let loading = self.media.live().map(|_| "lazy");
        html! { img loading=[loading] src=(address) alt=(alt) width=(picture.width) height=(picture.height); }
    }

    /// Counts bytes of the page and returns true if they are still within a limit. Linked files take none.
    fn fits(&self, used: &Cell<usize>, bytes: usize, most: usize) -> bool {
        let sum = used.get() + bytes;
        let fits = self.media.live().is_some() || sum <= most;
        if fits {
            used.set(sum);
        }
        fits
    }
}

/// Version of the memos: to be raised when the same picture would be shown as other bytes.
const VERSION: u32 = 2;

/// Scales a stored picture for the page, or takes the result of an earlier report.
fn scaled_of(report: &Report<'_>, digest: &Digest, form: Form) -> Result<Picture, String> {
    let key = Digest::from_content(format!("picture {VERSION} {form:?} {digest}").as_bytes());
    let known = report.memos.load(&key);
    if let Some(known) = known.and_then(|memo| Picture::decode(&memo)) {
        return Ok(known);
    }
    let made = decode(report, digest).and_then(|image| scaled(&image, form))?;
    report.memos.save(&key, &made.encode());
    Ok(made)
}

/// Decodes a stored picture.
pub(super) fn decode(report: &Report<'_>, digest: &Digest) -> Result<Image<Srgb>, String> {
    let bytes = (report.read)(digest).ok_or_else(|| not_stored("The picture", digest))?;
    let photo =
        Photo::decode_validated(&bytes).map_err(|error| format!("The picture cannot be shown: {error}."))?;
    Ok(photo.image)
}

/// Shrinks to the shown size, never enlarges.
pub(super) fn shrunk(image: &Image<Srgb>, most_px: u32) -> Result<Image<Srgb>, String> {
    marf_scene::shrunk(image, most_px).ok_or_else(|| "The picture has no pixels.".to_owned())
}

/// The place of a picture that cannot be shown.
pub(super) fn words(why: &str) -> Markup {
    html! { span.missing { (why) } }
}

fn scaled(image: &Image<Srgb>, form: Form) -> Result<Picture, String> {
    let (most_px, quality) = match form {
        Form::Thumb => (160, 80),
        Form::Photo | Form::Panel(_) => (480, 85),
        Form::Map => (480, 92),
    };
    let mut small = shrunk(image, most_px)?;
    if let Form::Panel(title) = form {
        small = draw_titled(&small, title);
    }
    let jpeg = || encode_jpeg(&small, quality).map_err(|error| error.to_string());
    let bytes = match form {
        Form::Thumb | Form::Photo | Form::Panel(_) => jpeg()?,
        Form::Map => match encode_png(&small) {
            Ok(bytes) if bytes.len() <= MAP_BYTES => bytes,
            Ok(_) => jpeg()?,
            Err(error) => return Err(error.to_string()),
        },
    };
    Ok(Picture {
        width: small.width,
        height: small.height,
        bytes: bytes.into(),
    })
}

#[cfg(test)]
mod tests {
    use marf_scene::picture::{ColorScale, Palette, draw_map};

    use super::*;

    #[test]
    fn a_picture_without_pixels_is_said_in_words() {
        let empty = Image::<Srgb>::from_fn(0, 4, |_, _| [0; 3]);
        assert_eq!(shrunk(&empty, 160).unwrap_err(), "The picture has no pixels.");
    }

    #[test]
    fn a_noisy_map_becomes_a_jpeg_and_a_plain_one_stays_exact() {
        let noise = |x: u32, y: u32| ((x * 7919 + y * 104_729).wrapping_mul(2_654_435_761) >> 13) as u8;
        let shown = |image| scaled(&image, Form::Map).unwrap();
        let plain = shown(Image::from_fn(480, 360, |x, _| [(x / 2) as u8; 3]));
        assert_eq!(plain.media(), "image/png", "{} bytes", plain.bytes.len());
        let noisy = shown(Image::from_fn(480, 360, |x, y| {
            [noise(x, y), noise(y, x), noise(x + 9, y)]
        }));
        assert_eq!(noisy.media(), "image/jpeg", "{} bytes", noisy.bytes.len());
        assert_eq!(Picture::decode(&noisy.encode()), Some(noisy));
        assert_eq!(Picture::decode(&[0; 7]), None);
    }

    /// 480 x 360 becomes 480 x 486, and a map of 640 x 480 that is 640 x 648 becomes 475 x 480: one shape.
    #[test]
    fn a_photo_has_the_shape_of_a_map_next_to_it() {
        let photo = Image::from_fn(960, 720, |x, _| [x as u8; 3]);
        let panel = scaled(&photo, Form::Panel("photo")).unwrap();
        assert_eq!((panel.width, panel.height), (480, 486));
        let scale = ColorScale::linear("error", "gray levels", 20.0, Palette::Inferno);
        let map = scaled(&draw_map(&[0.0; 640 * 480], 640, 480, &scale), Form::Map).unwrap();
        assert_eq!((map.width, map.height), (475, 480));
    }

    #[test]
    fn a_full_page_takes_no_further_picture() {
        let pictures = Pictures::new(&Media::Embedded);
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
