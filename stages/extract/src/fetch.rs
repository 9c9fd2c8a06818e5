//! From the files of a shard to rows and verdicts.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering};

use marf_cache::manifest::Row;
use marf_pds::exif::{self, Lens};
use marf_pds::{Label, ProductName, raw};
use marf_scene::{Photo, PhotoFacts};
use marf_stage::{Ctx, Fetched, StageError, Verdict};
use rayon::prelude::*;

use crate::archive::{ArchiveFile, Kind};
use crate::products::{Product, Sorted, left, sort};

/// Decodes the files of one shard and stores them: a row for each photo, a verdict for each file.
///
/// # Errors
/// The store, the wish to stop, or a file that changed; a bad file is a verdict.
pub(crate) fn fetch(ctx: &Ctx<'_>, files: &[ArchiveFile], shard: u32) -> Result<Fetched, StageError> {
    let Sorted { products, left_out } = sort(ctx, files)?;
    let (done, total) = (AtomicU64::new(0), products.len() as u64);
    let outcomes: Result<Vec<_>, StageError> = products
        .par_iter()
        .map(|product| {
            ctx.check()?;
            let outcome = one_product(ctx, product, shard)?;
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
    for (row, verdicts) in outcomes? {
        fetched.rows.extend(row);
        fetched.verdicts.extend(verdicts);
    }
    fetched.verdicts.sort_by(|a, b| a.file.cmp(&b.file));
    Ok(fetched)
}

/// Takes the first file of a product that can be decoded; the others get a verdict each.
fn one_product(
    ctx: &Ctx<'_>,
    product: &Product,
    shard: u32,
) -> Result<(Option<Row>, Vec<Verdict>), StageError> {
    let mut verdicts = Vec::new();
    let mut row: Option<Row> = None;
    for file in &product.files {
        if let Some(row) = &row {
            let reason = format!(
                "another file of product {}, of which a better one is taken",
                row.id
            );
            verdicts.push(left(&file.name, "skipped", reason));
            continue;
        }
        let bytes = file.keep(ctx)?;
        match decode(product, file, &bytes) {
            Ok(decoded) => {
                verdicts.push(Verdict {
                    id: product.id.clone(),
                    ..left(&file.name, Verdict::KEEP, String::new())
                });
                row = Some(make_row(ctx, product, file, &bytes, decoded, shard)?);
            }
            Err(reason) => verdicts.push(left(&file.name, "decode", reason)),
        }
    }
    Ok((row, verdicts))
}

/// A decoded photo, and what its own file says of it.
struct Decoded {
    size: (u32, u32),
    bands: u8,
    notes: Vec<String>,
    lens: Lens,
    /// The picture that later stages decode, if it is not the file itself.
    made: Option<Vec<u8>>,
    /// The label at the head of the file.
    attached: Option<Label>,
}

fn decode(product: &Product, file: &ArchiveFile, bytes: &[u8]) -> Result<Decoded, String> {
    let (name, beside) = (
        product.name.as_ref(),
        product.label.as_ref().map(|label| &label.label),
    );
    if file.kind == Kind::Raw {
        let developed = raw::develop(name, bytes, beside)?;
        return Ok(Decoded {
            size: (developed.image.width, developed.image.height),
            bands: developed.bands,
            notes: developed.notes,
            lens: Lens::default(),
            made: Some(raw::png(&developed.image)?),
            attached: developed.attached,
        });
    }
    let photo = Photo::decode(bytes).map_err(|error| error.to_string())?;
    let mosaic = name.is_some_and(ProductName::is_mosaic);
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
    // A mosaic is half as large when developed, and no archive writes EXIF into one.
    let lens = match made {
        None => exif::read(bytes, photo.image.width.max(photo.image.height)),
        Some(_) => Lens::default(),
    };
    Ok(Decoded {
        size: (photo.image.width, photo.image.height),
        bands: photo.bands,
        notes: photo.notes,
        lens,
        made,
        attached: None,
    })
}

fn make_row(
    ctx: &Ctx<'_>,
    product: &Product,
    file: &ArchiveFile,
    bytes: &[u8],
    decoded: Decoded,
    shard: u32,
) -> Result<Row, StageError> {
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
    if let Some(label) = &product.label {
        blobs.insert("label".to_owned(), label.digest);
    }
    Ok(Row {
        id: product.id.clone(),
        blobs,
        facts: facts(product, file, bytes.len(), decoded, shard).to_json(),
    })
}

fn facts(
    product: &Product,
    file: &ArchiveFile,
    size_bytes: usize,
    decoded: Decoded,
    shard: u32,
) -> PhotoFacts {
    let mut notes = decoded.notes;
    notes.extend(decoded.lens.notes);
    let name = product.name.as_ref();
    let detached = product.label.as_ref().map(|label| &label.label);
    let attached = decoded.attached.as_ref();
    // The label in the file is of this very file; a label beside it may be of another rendition.
    let first =
        |get: &dyn Fn(&Label) -> Option<String>| attached.and_then(get).or_else(|| detached.and_then(get));
    let with_camera = [attached, detached]
        .into_iter()
        .flatten()
        .find(|label| label.prior.is_some());
    let prior = with_camera.and_then(|label| label.fit_camera(name, decoded.size, &mut notes));
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
        width: decoded.size.0,
        height: decoded.size.1,
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
        prior,
        focal_px: decoded.lens.focal_px,
        device: decoded.lens.device,
        notes,
    }
}
