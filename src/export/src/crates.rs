//! A run as a folder: a BagIt bag whose payload is an RO-Crate.

use std::collections::BTreeSet;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use marf_cache::{Digest, Sha256};
use marf_engine::RunRecord;

use crate::bag::{BagWriter, FileDigest, MANIFEST};
use crate::contents::{Content, Contents, File, OBJECTS, Photos, Purpose, contents, object};
use crate::dsse::Envelope;
use crate::error::ExportError;
use crate::graph::{Described, GraphInput, METADATA, graph, root_name};
use crate::run::check_finished;
use crate::statement::{Subject, statement_on_run};
use marf_keys::SigningKey;
use marf_model::Run;

/// Name of the signed statement on a crate, next to the payload.
pub const ATTESTATION: &str = "attestation.dsse.json";

/// Whether the bytes of photos and results are included.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Data {
    /// They do.
    Included,
    /// They are named by their digests.
    Named,
}

/// Contents and options of a crate.
pub struct CrateOptions<'a> {
    /// Whether data are included.
    pub data: Data,
    /// Photos whose bytes are included.
    pub photos: Photos,
    /// Returns the file name of an output elsewhere. `None` for sets, which are many files.
    pub file_name: fn(&str) -> Option<&str>,
    /// Licence of the crate: an SPDX id or a URL.
    pub license: Option<&'a str>,
    /// Signs the crate.
    pub key: Option<&'a SigningKey>,
}

/// Summary of a written crate.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Written {
    /// Files of the payload.
    pub files: u64,
    /// Their bytes.
    pub bytes: u64,
    /// Files that are named by their digests and not included: results, and objects of photos.
    pub named: u64,
    /// Digest of the manifest of the payload, and so of every byte of it.
    pub manifest: Sha256,
}

/// Writes a run as a crate in a new folder. The same run and options give the same bytes.
///
/// # Errors
/// An object that cannot be read, a photo that the run does not have, or a place that cannot be written.
/// Nothing is left there after an error.
pub fn write_crate(run: &Run<'_>, options: &CrateOptions<'_>, folder: &Path) -> Result<Written, ExportError> {
    check_finished(&run.record)?;
    if folder.exists() {
        return Err(ExportError::Exists {
            path: folder.to_owned(),
        });
    }
    let contents = contents(run, &options.photos, options.file_name)?;
    let partial = beside(folder);
    let written = write_bag(run, options, &contents, &partial).and_then(|written| {
        fs::rename(&partial, folder)
            .map(|()| written)
            .map_err(failed(folder))
    });
    if written.is_err() {
        let _ = fs::remove_dir_all(&partial); // it may not exist; the first error is returned
    }
    written
}

/// Returns the temporary name, next to a folder, under which it is first written.
fn beside(folder: &Path) -> PathBuf {
    let name = folder.file_name().unwrap_or_default().to_string_lossy();
    folder.with_file_name(format!(".{name}.{}.part", std::process::id()))
}

fn failed(path: &Path) -> impl Fn(io::Error) -> ExportError {
    move |cause| ExportError::Write {
        path: path.to_owned(),
        cause,
    }
}

fn write_bag(
    run: &Run<'_>,
    options: &CrateOptions<'_>,
    contents: &Contents,
    folder: &Path,
) -> Result<Written, ExportError> {
    let failed = failed(folder);
    if let Some(parent) = folder.parent().filter(|parent| !parent.as_os_str().is_empty()) {
        fs::create_dir_all(parent).map_err(&failed)?;
    }
    let mut bag = BagWriter::create(folder).map_err(&failed)?;
    let mut described = Vec::new();
    for file in contents.files.values() {
        described.push(add_file(&mut bag, file, run, options.data, &failed)?);
    }
    for (digest, purpose) in &contents.objects {
        if is_included(*purpose, options.data) {
            let bytes = object(run, digest, || "an object of a set".to_owned())?;
            bag.add(&format!("{OBJECTS}{digest}"), &bytes).map_err(&failed)?;
        }
    }
    let graph = graph(&GraphInput {
        run,
        contents,
        files: &described,
        license: options.license,
    });
    // Strings and sorted maps always serialise.
    let mut metadata = serde_json::to_vec_pretty(&graph).unwrap_or_default();
    metadata.push(b'\n');
    bag.add(METADATA, &metadata).map_err(&failed)?;
    let manifest = bag.seal().map_err(&failed)?;
    if let Some(key) = options.key {
        let subjects = [
            Subject::new(MANIFEST, manifest),
            Subject::new(crate::contents::RUN_ROOT, FileDigest::new(&run.root()?)),
        ];
        let envelope = Envelope::sign(&statement_on_run(run, &subjects)?, key);
        bag.tag(ATTESTATION, &envelope.encode()).map_err(&failed)?;
    }
    let is_named = |described: &&Described<'_>| described.id != described.file.path;
    let named = described.iter().filter(is_named);
    let mut named: BTreeSet<Digest> = named.map(|described| described.digest.blake3).collect();
    let goes_along = |photo: &Digest| match contents.objects.get(photo) {
        Some(purpose) => is_included(*purpose, options.data),
        None => contents.paths.contains_key(photo),
    };
    named.extend(contents.photos.iter().filter(|photo| !goes_along(photo)));
    let (files, bytes) = bag.payload_size();
    bag.finish(&info(&run.record)).map_err(&failed)?;
    Ok(Written {
        files,
        bytes,
        named: named.len() as u64,
        manifest: manifest.sha256,
    })
}

fn info(run: &RunRecord) -> [(&'static str, String); 3] {
    let one_line = |text: &str| text.replace(['\r', '\n'], " ");
    [
        ("Bag-Software-Agent", one_line(&run.program)),
        ("External-Identifier", root_name(run)),
        (
            "External-Description",
            one_line(&format!("marf run {} of {}", run.id, run.pipeline)),
        ),
    ]
}

fn is_included(purpose: Purpose, data: Data) -> bool {
    purpose == Purpose::Record || data == Data::Included
}

/// Adds a file to the bag, or finds its digests only.
fn add_file<'a>(
    bag: &mut BagWriter,
    file: &'a File,
    run: &Run<'_>,
    data: Data,
    failed: impl Fn(io::Error) -> ExportError,
) -> Result<Described<'a>, ExportError> {
    let stored;
    let bytes: &[u8] = match &file.content {
        Content::Bytes(bytes) => bytes,
        Content::Object(digest) => {
            stored = object(run, digest, || file.name.clone())?;
            &stored
        }
    };
    if !is_included(file.purpose, data) {
        let digest = FileDigest::new(bytes);
        let id = name_of(&digest.sha256);
        return Ok(Described { file, digest, id });
    }
    let digest = bag.add(&file.path, bytes).map_err(failed)?;
    let id = file.path.clone();
    Ok(Described { file, digest, id })
}

/// Returns the URI of bytes that are named by their SHA-256 (RFC 6920).
pub(crate) fn name_of(digest: &Sha256) -> String {
    use base64::{Engine as _, engine::general_purpose::URL_SAFE_NO_PAD};
    format!("ni:///sha-256;{}", URL_SAFE_NO_PAD.encode(digest.as_bytes()))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The example of RFC 6920, section 8.1.
    #[test]
    fn bytes_are_named_as_the_standard_names_them() {
        let digest = Sha256::from_content(b"Hello World!");
        assert_eq!(
            name_of(&digest),
            "ni:///sha-256;f4OxZX_x_FO5LcGBSKHWXfwtSx-j1ncoSt3SABJtkGk"
        );
    }
}
