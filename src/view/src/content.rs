//! The content of a run: the live page, its files, and its fields. Each is read at the first request.

use std::collections::{BTreeSet, HashMap};
use std::sync::Arc;

use marf_cache::Digest;
use marf_field::Device;
use marf_report::{File, LinkedPage, sentence_page};
use marf_scene::{Photo, encode_jpeg, shrunk};
use parking_lot::Mutex;

use crate::events::is_output_of_running;
use crate::field::Field;
use crate::page::{live_parts, scene_parts};
use crate::source::{FieldSource, Source};
use crate::splats::SplatJob;

/// Longest side of a photo next to its render, pixels, and its JPEG quality.
const PHOTO_PX: u32 = 960;
const PHOTO_QUALITY: u8 = 88;

/// Text shown without a run.
const NO_RUN: &str =
    "No run of this store has ended with a report or a field yet. What runs now is shown here.";

const NO_FIELD: &str = "the run has no such field";

/// A run that is shown.
pub struct Content {
    /// Its number. `None` if there is no run yet.
    pub number: Option<u64>,
    /// The page.
    pub page: LinkedPage,
    /// Pages of scenes that were requested, by file name.
    opened: Mutex<HashMap<String, Arc<LinkedPage>>>,
    objects: BTreeSet<Digest>,
    fields: Vec<ContentField>,
}

/// A field of a run. It is read at the first request, and so are its splats.
struct ContentField {
    source: FieldSource,
    field: Mutex<Option<Arc<Field>>>,
    splats: Mutex<Option<Arc<SplatJob>>>,
}

impl Content {
    /// Reads a run.
    ///
    /// # Errors
    /// One sentence: no such run, or one that cannot be read.
    pub fn read(source: &dyn Source, number: Option<u64>) -> Result<Self, String> {
        let fields = number
            .map(|run| source.fields(run))
            .transpose()?
            .unwrap_or_default();
        let names: Vec<&str> = fields.iter().map(|field| field.label.as_str()).collect();
        let live = live_parts(number, &names);
        let page = match number {
            Some(run) => source.page(run, None, &live)?,
            None => sentence_page(NO_RUN, &live),
        };
        Ok(Self {
            number,
            page,
            opened: Mutex::default(),
            objects: number
                .map(|run| source.objects(run))
                .transpose()?
                .unwrap_or_default(),
            fields: fields
                .into_iter()
                .map(|source| ContentField {
                    source,
                    field: Mutex::default(),
                    splats: Mutex::default(),
                })
                .collect(),
        })
    }

    /// Returns a file of the page by its digest, or an object that the run names.
    pub fn file(&self, source: &dyn Source, digest: &Digest) -> Option<File> {
        let opened = self.opened.lock();
        let pages = || std::iter::once(&self.page).chain(opened.values().map(Arc::as_ref));
        if let Some(file) = pages().find_map(|page| page.files.get(digest)) {
            return Some(file.clone());
        }
        let is_named = self.objects.contains(digest) || pages().any(|page| page.objects.contains(digest));
        drop(opened);
        let bytes = is_named.then(|| source.object(digest))??;
        Some(File {
            media: media(&bytes),
            bytes,
        })
    }

    /// Returns the page of a scene, which is written at the first call.
    ///
    /// # Errors
    /// One sentence: a name without a page, or a run that cannot be read.
    pub fn scene_page(&self, source: &dyn Source, name: &str) -> Result<Arc<LinkedPage>, String> {
        const NO_PAGE: &str = "the shown run has no such page";
        if let Some(page) = self.opened.lock().get(name) {
            return Ok(Arc::clone(page));
        }
        let scene = name.strip_suffix(".html").ok_or(NO_PAGE)?;
        let page = Arc::new(source.page(self.number.ok_or(NO_PAGE)?, Some(scene), &scene_parts())?);
        self.opened.lock().insert(name.to_owned(), Arc::clone(&page));
        Ok(page)
    }

    /// Returns a photo of a field's scene as a JPEG that browsers show quickly.
    ///
    /// # Errors
    /// One sentence: a photo that is not of the scene, lost or damaged.
    pub fn photo(&self, source: &dyn Source, field: &Field, digest: &Digest) -> Result<File, String> {
        let bytes = source.object(&field.photo(digest)?.image);
        let bytes = bytes.ok_or("the store has lost this photo")?;
        let photo = Photo::decode_validated(&bytes).map_err(|error| error.to_string())?;
        let small = shrunk(&photo.image, PHOTO_PX).ok_or("the photo has no pixels")?;
        let jpeg = encode_jpeg(&small, PHOTO_QUALITY).map_err(|error| error.to_string())?;
        Ok(File {
            media: "image/jpeg",
            bytes: jpeg.into(),
        })
    }

    /// Returns a field, which is read at the first call.
    ///
    /// # Errors
    /// One sentence: a number without a field, or a field that is lost or damaged.
    pub fn field(&self, index: usize, source: &dyn Source, device: &Device) -> Result<Arc<Field>, String> {
        let of = self.fields.get(index).ok_or(NO_FIELD)?;
        let mut read = of.field.lock();
        if let Some(field) = read.as_ref() {
            return Ok(Arc::clone(field));
        }
        let field = Arc::new(Field::read(&of.source, source, device)?);
        *read = Some(Arc::clone(&field));
        Ok(field)
    }

    /// Returns the splats of a field, which the first call begins to make. A call after a failure begins again.
    ///
    /// # Errors
    /// One sentence: a number without a field.
    pub fn splats(&self, index: usize, source: &Arc<dyn Source>) -> Result<Arc<SplatJob>, String> {
        let of = self.fields.get(index).ok_or(NO_FIELD)?;
        let mut job = of.splats.lock();
        if let Some(job) = job.as_ref().filter(|job| !job.has_failed()) {
            return Ok(Arc::clone(job));
        }
        let begun = SplatJob::begin(Arc::clone(source), of.source.clone())?;
        *job = Some(Arc::clone(&begun));
        Ok(begun)
    }
}

/// Returns an object that a node of a program that runs now has made.
pub fn made_now(source: &dyn Source, digest: &Digest) -> Option<File> {
    let is_made = is_output_of_running(&source.event_folder(), digest);
    let bytes = is_made.then(|| source.object(digest))??;
    Some(File {
        media: media(&bytes),
        bytes,
    })
}

/// Returns the type of an object: pictures and films as such, all else as bytes that no browser opens.
fn media(bytes: &[u8]) -> &'static str {
    match bytes {
        [0x89, b'P', b'N', b'G', ..] => "image/png",
        [0xff, 0xd8, 0xff, ..] => "image/jpeg",
        [_, _, _, _, b'f', b't', b'y', b'p', ..] => "video/mp4",
        _ => BYTES,
    }
}

/// The type of bytes that a browser saves and does not open.
pub const BYTES: &str = "application/octet-stream";

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_pictures_and_films_have_a_type_that_a_browser_opens() {
        assert_eq!(media(b"\x89PNG\r\n"), "image/png");
        assert_eq!(media(b"\0\0\0 ftypisom"), "video/mp4");
        for bytes in [&b"<html>"[..], b"<svg onload=alert(1)>", b"", b"\xff\xd8"] {
            assert_eq!(media(bytes), BYTES);
        }
    }
}
