//! The survey of a photo: the measures of the filters that lack theirs, from one decode.

use marf_cache::manifest::Row;
use marf_scene::Photo;
use marf_stage::{Ctx, StageError, Table};

use crate::SECTIONS;
use crate::decoded::DecodedPhoto;

/// First byte of the measure of a photo that cannot be decoded; the reason follows.
const REFUSED: u8 = 0;
/// First byte of the measure of a decoded photo; what the filter measured follows.
const MEASURED: u8 = 1;

/// The part of a survey that belongs to one filter.
pub(crate) struct Section {
    /// Where the measures are kept: the name of the filter and the version of its measure.
    pub(crate) table: Table,
    /// Measures a photo; only the filter itself reads the bytes.
    pub(crate) measure: fn(&Ctx<'_>, &DecodedPhoto<'_>) -> Result<Vec<u8>, StageError>,
}

/// A stage of the table of filters.
pub(crate) trait Surveyed {
    /// What it adds to a survey; `None` for a filter that needs the facts alone.
    const SECTION: Option<Section>;
    /// Digests of its answers on fixed photos.
    #[cfg(test)]
    const GUARD: crate::guard::Guard;
}

/// Returns the tables of all filters that measure pixels.
pub fn tables() -> Vec<Table> {
    SECTIONS.iter().flatten().map(|section| section.table).collect()
}

/// Measures a decoded photo for each of the wanted tables, in their order: what [`marf_stage::Measure::measure`] of a filter
/// returns for a row whose blob `image` decodes to this photo. Computes nothing that is not wanted.
///
/// # Errors
/// A table of no filter, or a store that cannot be written.
pub fn measure_photo(ctx: &Ctx<'_>, photo: &Photo, wanted: &[Table]) -> Result<Vec<Vec<u8>>, StageError> {
    if photo.image.pixels.is_empty() {
        return Ok(refused("the image has no pixels", wanted));
    }
    let decoded = DecodedPhoto::of(photo);
    let measure = |table: &Table| {
        let mut bytes = vec![MEASURED];
        bytes.extend((section_of(table)?.measure)(ctx, &decoded)?);
        Ok(bytes)
    };
    wanted.iter().map(measure).collect()
}

/// Decodes the photo of a row once and measures it for each of the wanted tables.
///
/// # Errors
/// A row without image, a blob that cannot be read or written, or a table of no filter.
pub(crate) fn measure_row(ctx: &Ctx<'_>, row: &Row, wanted: &[Table]) -> Result<Vec<Vec<u8>>, StageError> {
    if wanted.is_empty() {
        return Ok(Vec::new());
    }
    let digest = row.blobs.get("image");
    let digest = digest.ok_or_else(|| StageError::new(format!("photo `{}` has no blob `image`", row.id)))?;
    match Photo::decode_validated(&ctx.get(digest)?) {
        Ok(photo) => measure_photo(ctx, &photo, wanted),
        Err(error) => Ok(refused(&error.to_string(), wanted)),
    }
}

/// Returns the section that fills a table.
fn section_of(table: &Table) -> Result<&'static Section, StageError> {
    let mut sections = SECTIONS.iter().flatten();
    sections.find(|section| section.table == *table).ok_or_else(|| {
        StageError::new(format!(
            "no filter fills version {} of table `{}`",
            table.version, table.name
        ))
    })
}

/// Returns the measures of a photo that cannot be decoded.
fn refused(reason: &str, wanted: &[Table]) -> Vec<Vec<u8>> {
    vec![[&[REFUSED], reason.as_bytes()].concat(); wanted.len()]
}

/// Returns what a filter measured of a photo, or why the photo could not be decoded.
///
/// # Errors
/// Bytes that are no measure.
pub(crate) fn measured<'a>(measure: &'a [u8], row: &Row) -> Result<Result<&'a [u8], String>, StageError> {
    match measure.split_first() {
        Some((&REFUSED, reason)) => Ok(Err(String::from_utf8_lossy(reason).into_owned())),
        Some((&MEASURED, part)) => Ok(Ok(part)),
        _ => Err(unreadable(row, "its first byte is neither 0 nor 1")),
    }
}

/// Returns the error of a kept measure that is not what was written.
pub(crate) fn unreadable(row: &Row, cause: impl std::fmt::Display) -> StageError {
    damaged(format!("measure of `{}` cannot be read", row.id)).cause(cause.to_string())
}

/// Returns the error of something kept that cannot be read, with what to do about it.
pub(crate) fn damaged(message: String) -> StageError {
    StageError::new(message).hint("the store may be damaged: measure again in an empty one, `--store DIR`")
}

#[cfg(test)]
mod tests {
    use marf_stage::harness::Harness;

    use super::*;
    use crate::common::{ground, png};

    fn row() -> Row {
        Row {
            id: "a".to_owned(),
            blobs: Default::default(),
            facts: serde_json::Value::Null,
        }
    }

    #[test]
    fn a_measure_or_the_reason_comes_back_and_damage_is_an_error() {
        assert_eq!(measured(b"\x01sharp", &row()).unwrap(), Ok(&b"sharp"[..]));
        assert_eq!(measured(b"\x01", &row()).unwrap(), Ok(&b""[..]));
        assert_eq!(measured(b"\0cut", &row()).unwrap(), Err("cut".to_owned()));
        for damaged in [&b""[..], b"{}", b"\x07"] {
            let error = measured(damaged, &row()).unwrap_err().to_string();
            assert!(error.contains("`a`"), "{error}");
        }
    }

    /// A survey in one go is what each table gets alone, in the order asked for.
    #[test]
    fn tables_are_filled_together_or_one_by_one() {
        let harness = Harness::default();
        let photo = Photo::decode(&png(&ground(3))).unwrap();
        let mut wanted = tables();
        wanted.reverse();
        let together = measure_photo(&harness.ctx(), &photo, &wanted).unwrap();
        for (table, measure) in wanted.iter().zip(together) {
            let alone = measure_photo(&harness.ctx(), &photo, &[*table]).unwrap();
            assert_eq!(alone, [measure], "{}", table.name);
        }
        assert!(measure_photo(&harness.ctx(), &photo, &[]).unwrap().is_empty());
    }

    /// A corrected measure asks for its table alone: nothing is read of a row that lacks none, and an older version of a
    /// table is filled by nobody.
    #[test]
    fn a_table_of_another_version_is_refused_by_name() {
        let harness = Harness::default();
        let mut old = tables()[0];
        old.version += 1;
        let photo = Photo::decode(&png(&ground(3))).unwrap();
        let error = measure_photo(&harness.ctx(), &photo, &[old])
            .unwrap_err()
            .to_string();
        assert!(error.contains(old.name), "{error}");
        assert!(measure_row(&harness.ctx(), &row(), &[]).unwrap().is_empty());
    }

    #[test]
    fn a_picture_without_pixels_has_the_reason_as_its_measure() {
        let harness = Harness::default();
        let photo = Photo::from(marf_scene::Image::from_fn(0, 4, |_, _| [0; 3]));
        for measure in measure_photo(&harness.ctx(), &photo, &tables()).unwrap() {
            let reason = measured(&measure, &row()).unwrap().unwrap_err();
            assert_eq!(reason, "the image has no pixels");
        }
    }
}
