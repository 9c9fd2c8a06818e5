//! A run as it is served: the live page, its files, and its fields, each read when it is first asked for.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::sync::Arc;

use marf_cache::Digest;
use marf_field::Device;
use marf_scene::{Photo, encode_jpeg, shrunk};
use parking_lot::Mutex;

use crate::field::Field;
use crate::file::File;
use crate::page::{LivePage, below, live, live_parts};
use crate::source::{FieldSource, RunContent, Source};

/// Longest side of a photo beside its render, pixels, and its JPEG quality.
const PHOTO_PX: u32 = 960;
const PHOTO_QUALITY: u8 = 88;

/// A run that is shown.
pub struct Content {
    /// Its number; none if there is no run yet.
    pub number: Option<u64>,
    /// The page.
    pub html: String,
    files: HashMap<Digest, File>,
    /// Pages of scenes by file name, and those that were asked for.
    pages: BTreeMap<String, Digest>,
    opened: Mutex<HashMap<String, Arc<LivePage>>>,
    objects: BTreeSet<Digest>,
    fields: Vec<(FieldSource, Mutex<Option<Arc<Field>>>)>,
}

impl Content {
    /// Prepares a run.
    ///
    /// # Errors
    /// A report of another form.
    pub fn new(run: RunContent) -> Result<Self, String> {
        let names: Vec<&str> = run.fields.iter().map(|field| field.node.as_str()).collect();
        let page = live(&run.report, &live_parts(run.number, &names)).ok_or_else(|| {
            let number = run.number.unwrap_or_default();
            format!("the report of run {number} has another form than this program writes; `marf report` writes it as it is")
        })?;
        Ok(Self {
            number: run.number,
            html: page.html,
            files: page.files,
            pages: run.pages,
            opened: Mutex::default(),
            objects: run.objects,
            fields: run
                .fields
                .into_iter()
                .map(|field| (field, Mutex::default()))
                .collect(),
        })
    }

    /// Returns what the page shows under a digest, or an object that the run names.
    pub fn file(&self, source: &dyn Source, digest: &Digest) -> Option<File> {
        if let Some(file) = self.files.get(digest) {
            return Some(file.clone());
        }
        let opened = self
            .opened
            .lock()
            .values()
            .find_map(|page| page.files.get(digest).cloned());
        if opened.is_some() {
            return opened;
        }
        let bytes = self.objects.contains(digest).then(|| source.object(digest))??;
        Some(File {
            media: media(&bytes),
            bytes,
        })
    }

    /// Returns the page of a scene, which is read at the first call.
    ///
    /// # Errors
    /// One sentence: a name without a page, or a page that is lost.
    pub fn page(&self, source: &dyn Source, name: &str) -> Result<Arc<LivePage>, String> {
        if let Some(page) = self.opened.lock().get(name) {
            return Ok(Arc::clone(page));
        }
        let digest = self.pages.get(name).ok_or("the shown run has no such page")?;
        let bytes = source.object(digest).ok_or("the store has lost this page")?;
        let page = std::str::from_utf8(&bytes).ok().and_then(below);
        let page = Arc::new(page.ok_or("this page has another form than this program writes")?);
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
        let (of, read) = self.fields.get(index).ok_or("the run has no such field")?;
        let mut read = read.lock();
        if let Some(field) = read.as_ref() {
            return Ok(Arc::clone(field));
        }
        let field = Arc::new(Field::read(of, source, device)?);
        *read = Some(Arc::clone(&field));
        Ok(field)
    }
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
