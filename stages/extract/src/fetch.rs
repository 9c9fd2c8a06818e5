//! From the files of a shard to rows, verdicts and measures.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering};

use marf_cache::{Digest, manifest::Row};
use marf_pds::exif::{self, Lens};
use marf_pds::{Label, raw};
use marf_scene::{DecodeError, Photo, PhotoFacts, thumbnail};
use marf_stage::{Ctx, Fetched, FetchedMeasure, OriginKind, StageError, Table, Verdict};
use rayon::prelude::*;

use crate::archive::{ArchiveFile, ReadFile};
use crate::products::{Product, Sorted, left, sort};

/// Smallest image that gets a thumbnail, in bytes. A smaller one is shown as it is.
const MIN_THUMBNAIL_BYTES: usize = 64 << 10;

/// Decodes the files of one shard and stores them. Each photo gets a row with the requested measures, each file gets
/// a verdict and its origin.
///
/// # Errors
/// The store, a requested stop, or a file that changed. A bad file is a verdict.
pub(crate) fn fetch(
    ctx: &Ctx<'_>,
    files: &[ArchiveFile],
    shard: u32,
    wanted: &[Table],
    limit_bytes: u64,
) -> Result<Fetched, StageError> {
    let Sorted {
        products,
        left_out,
        mut read,
    } = sort(ctx, files)?;
    let (done, total) = (AtomicU64::new(0), products.len() as u64);
    let outcomes: Result<Vec<_>, StageError> = products
        .par_iter()
        .map(|product| {
            ctx.check()?;
            let outcome = one_product(ctx, product, shard, wanted, limit_bytes)?;
            ctx.progress
                .at(done.fetch_add(1, Ordering::Relaxed) + 1, total, "");
            Ok(outcome)
        })
        .collect();
    let mut fetched = Fetched {
        rows: Vec::new(),
        verdicts: left_out,
        ..Fetched::default()
    };
    for outcome in outcomes? {
        fetched.rows.extend(outcome.row);
        fetched.verdicts.extend(outcome.verdicts);
        fetched.measures.extend(outcome.measures);
        read.extend(outcome.read);
    }
    let read: BTreeMap<&str, &ReadFile> = read.iter().map(|file| (file.name.as_str(), file)).collect();
    let origins = files
        .iter()
        .map(|file| file.origin(read.get(file.name.as_str()).copied()));
    fetched.origins = origins.collect();
    fetched.verdicts.sort_by(|a, b| a.file.cmp(&b.file));
    Ok(fetched)
}

/// What came of a product.
#[derive(Default)]
struct Outcome {
    row: Option<Row>,
    verdicts: Vec<Verdict>,
    measures: Vec<FetchedMeasure>,
    read: Vec<ReadFile>,
}

/// Takes the first file of a product that can be decoded. Each of the others gets a verdict.
fn one_product(
    ctx: &Ctx<'_>,
    product: &Product,
    shard: u32,
    wanted: &[Table],
    limit_bytes: u64,
) -> Result<Outcome, StageError> {
    let mut outcome = Outcome::default();
    for file in &product.files {
        if let Some(row) = &outcome.row {
            let reason = format!("another file of product {}: a better one is taken", row.id);
            outcome.verdicts.push(left(&file.name, "skipped", reason));
            continue;
        }
        let bytes = file.keep(ctx)?;
        outcome.read.push(ReadFile::new(file, &bytes));
        match decode(product, file, &bytes, limit_bytes) {
            Ok(decoded) => {
                outcome.verdicts.push(Verdict {
                    id: product.id.clone(),
                    ..left(&file.name, Verdict::KEEP, String::new())
                });
                outcome.measures = measures(ctx, product, &decoded.photo, wanted)?;
                outcome.row = Some(Row {
                    id: product.id.clone(),
                    blobs: blobs(ctx, product, file, bytes.len(), &decoded)?,
                    facts: facts(product, file, bytes.len(), decoded, shard).to_json(),
                });
            }
            Err(reason) => outcome.verdicts.push(left(&file.name, "decode", reason)),
        }
    }
    Ok(outcome)
}

/// Measures a photo for each table that is wanted.
fn measures(
    ctx: &Ctx<'_>,
    product: &Product,
    photo: &Photo,
    wanted: &[Table],
) -> Result<Vec<FetchedMeasure>, StageError> {
    let measured = marf_filter::measure_photo(ctx, photo, wanted)?;
    let named = wanted
        .iter()
        .zip(measured)
        .map(|(table, measure)| FetchedMeasure {
            id: product.id.clone(),
            table: *table,
            measure,
        });
    Ok(named.collect())
}

/// A decoded photo, and what its own file says of it.
struct Decoded {
    /// The photo as later stages decode it.
    photo: Photo,
    /// Bands of the file: those of the photo, unless it was made of the file.
    bands: u8,
    notes: Vec<String>,
    lens: Lens,
    /// The picture that later stages decode, if it is not the file itself.
    made: Option<Vec<u8>>,
    /// The label at the head of the file.
    attached: Option<Label>,
}

fn decode(product: &Product, file: &ArchiveFile, bytes: &[u8], limit_bytes: u64) -> Result<Decoded, String> {
    let (name, beside) = (
        product.name.as_ref(),
        product.label.as_ref().map(|label| &label.label),
    );
    if file.kind == OriginKind::Raw {
        let developed = raw::develop_within(name, bytes, beside, limit_bytes);
        let developed = developed.map_err(|error| with_key(&error, error.is_limit()))?;
        return Ok(Decoded {
            made: Some(raw::png(&developed.image)?),
            photo: developed.image.into(),
            bands: developed.bands,
            notes: developed.notes,
            lens: Lens::default(),
            attached: developed.attached,
        });
    }
    let photo = Photo::decode_within(bytes, limit_bytes)
        .map_err(|error| with_key(&error, matches!(error, DecodeError::TooLarge(_))))?;
    let filter = beside.and_then(|label| label.filter.as_deref());
    let mosaic = name.is_some_and(|name| name.is_mosaic(filter));
    let phase = beside.and_then(|label| label.mosaic.or(label.phase));
    let developed = if mosaic {
        raw::develop_mosaic(&photo, phase)
    } else {
        None
    };
    let made = developed
        .as_ref()
        .map(|photo| raw::png(&photo.image))
        .transpose()?;
    let photo = developed.unwrap_or(photo);
    let (bands, notes) = (photo.bands, photo.notes.clone());
    // A mosaic is half as large when developed, and no archive writes EXIF into one.
    let lens = match made {
        None => exif::read(bytes, photo.image.width.max(photo.image.height)),
        Some(_) => Lens::default(),
    };
    Ok(Decoded {
        photo: match made {
            None => photo,
            // As the PNG of it decodes.
            Some(_) => photo.image.into(),
        },
        bands,
        notes,
        lens,
        made,
        attached: None,
    })
}

/// Returns an error in words, with the key that raises a limit.
fn with_key(error: &dyn std::fmt::Display, is_limit: bool) -> String {
    if is_limit {
        format!("{error}: raise `max_decoded_mb` of the extract node")
    } else {
        error.to_string()
    }
}

/// Stores the picture, its thumbnail and its label, and returns their digests.
fn blobs(
    ctx: &Ctx<'_>,
    product: &Product,
    file: &ArchiveFile,
    size_bytes: usize,
    decoded: &Decoded,
) -> Result<BTreeMap<String, Digest>, StageError> {
    let mut blobs = BTreeMap::new();
    let stored = file.digest;
    match &decoded.made {
        Some(made) => {
            blobs.insert("image".to_owned(), ctx.put(made)?);
            blobs.insert("raw".to_owned(), stored);
        }
        None => {
            blobs.insert("image".to_owned(), stored);
        }
    }
    if decoded.made.as_ref().map_or(size_bytes, Vec::len) >= MIN_THUMBNAIL_BYTES {
        let small = thumbnail(&decoded.photo.image).map_err(|error| {
            let what = format!("no thumbnail of `{}` can be made", file.name);
            StageError::new(what).cause(error.to_string())
        })?;
        blobs.insert("thumbnail".to_owned(), ctx.put(&small)?);
    }
    if let Some(label) = &product.label {
        blobs.insert("label".to_owned(), label.digest);
    }
    Ok(blobs)
}

fn facts(
    product: &Product,
    file: &ArchiveFile,
    size_bytes: usize,
    decoded: Decoded,
    shard: u32,
) -> PhotoFacts {
    let (width, height) = (decoded.photo.image.width, decoded.photo.image.height);
    let mut notes = decoded.notes;
    notes.extend(decoded.lens.notes);
    let name = product.name.as_ref();
    let detached = product.label.as_ref().map(|label| &label.label);
    let attached = decoded.attached.as_ref();
    // The attached label belongs to exactly this file. A detached label may be of another rendition.
    let first =
        |get: &dyn Fn(&Label) -> Option<String>| attached.and_then(get).or_else(|| detached.and_then(get));
    let with_camera = [attached, detached]
        .into_iter()
        .flatten()
        .find(|label| label.prior.is_some());
    let prior = with_camera.and_then(|label| label.fit_camera(name, width, height, &mut notes));
    let labels = || [attached, detached].into_iter().flatten();
    let place = labels().find_map(|label| label.place.clone()).filter(|place| {
        let is_known = !place.motion_counter.is_empty() || place.site_from_frame.is_some();
        is_known && prior.is_none()
    });
    let sensor = name
        .and_then(marf_pds::ProductName::sensor)
        .or_else(|| labels().find_map(|label| label.sensor));
    if let Some(label) = with_camera.or(attached).or(detached) {
        notes.extend(label.notes.iter().cloned());
    }
    let sol = [attached, detached]
        .into_iter()
        .flatten()
        .find_map(|label| label.sol);
    let sol = name.and_then(|name| name.sol).or(sol);
    if let Some(other) = sol.filter(|sol| *sol != shard) {
        notes.push(format!("label says sol {other}"));
    }
    PhotoFacts {
        file: file.name.clone(),
        size_bytes: size_bytes as u64,
        width,
        height,
        bands: decoded.bands,
        sol,
        instrument: name
            .map(|name| name.instrument.clone())
            .or_else(|| first(&|label| label.instrument.clone())),
        filter: name
            .and_then(|name| name.filter.clone())
            .or_else(|| first(&|label| label.filter.clone())),
        thumbnail: name.is_some_and(|name| name.thumbnail)
            || [attached, detached]
                .into_iter()
                .flatten()
                .any(|label| label.thumbnail),
        sensor,
        prior,
        place,
        focal_px: decoded.lens.focal_px,
        device: decoded.lens.device,
        notes,
    }
}
