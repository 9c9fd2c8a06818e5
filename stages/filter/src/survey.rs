//! The table of filters, and the survey of a photo: the measures of the filters that lack theirs, from one decode.

use marf_cache::{Digest, manifest::Row};
use marf_scene::Photo;
use marf_stage::{Ctx, Measure, StageDef, StageError, Table, define};

use crate::blur::Blur;
use crate::bytes::from_bytes;
use crate::decoded::DecodedPhoto;
use crate::descriptor::ViewDescriptor;
use crate::duplicate::Duplicate;
use crate::filter::Filter;
use crate::grayscale::Grayscale;
use crate::histogram::Histogram;
#[cfg(test)]
use crate::section::Guarded;
use crate::section::{MEASURED, REFUSED, Section, Surveyed};
use crate::shape::Shape;
use crate::size::Size;
use crate::stage::FilterStage;

macro_rules! filters {
    ($($stage:ty),* $(,)?) => {
        /// The filters in the order in which `marf filter` runs them.
        pub static STAGES: &[StageDef] = &[$(define::<$stage>()),*];
        /// What each of them adds to a survey.
        static SECTIONS: &[Option<Section>] = &[$(<$stage as Surveyed>::SECTION),*];
        /// Name, version and guard of each of them.
        #[cfg(test)]
        pub(crate) const GUARDS: &[Guarded] = &[$(Guarded::new::<$stage>()),*];
    };
}

filters! {
    FilterStage<Size>,
    FilterStage<Shape>,
    Duplicate,
    FilterStage<Grayscale>,
    FilterStage<Histogram>,
    FilterStage<Blur>,
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
    let decoded = DecodedPhoto::new(photo);
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

impl<F: Filter> Measure for FilterStage<F> {
    fn table(&self) -> Option<Table> {
        Self::SECTION.map(|section| section.table)
    }

    /// Returns the tables of all filters that measure pixels: one decode fills all.
    fn together(&self) -> Vec<Table> {
        self.table().map_or_else(Vec::new, |_| tables())
    }

    fn measure(&self, ctx: &Ctx<'_>, row: &Row, wanted: &[Table]) -> Result<Vec<Vec<u8>>, StageError> {
        measure_row(ctx, row, wanted)
    }
}

impl Measure for Duplicate {
    fn table(&self) -> Option<Table> {
        Some(Self::TABLE)
    }

    fn together(&self) -> Vec<Table> {
        tables()
    }

    fn measure(&self, ctx: &Ctx<'_>, row: &Row, wanted: &[Table]) -> Result<Vec<Vec<u8>>, StageError> {
        measure_row(ctx, row, wanted)
    }

    /// Returns the gradient planes that a [`ViewDescriptor`] names.
    fn blobs(&self, measure: &[u8]) -> Vec<Digest> {
        let measured = measure.strip_prefix(&[MEASURED]);
        measured
            .and_then(from_bytes::<ViewDescriptor>)
            .map(|descriptor| descriptor.planes)
            .into_iter()
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use marf_stage::harness::Harness;

    use super::*;
    use crate::common::{ground, png};
    use crate::section::measured;

    fn row() -> Row {
        Row {
            id: "a".to_owned(),
            blobs: Default::default(),
            facts: serde_json::Value::Null,
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
