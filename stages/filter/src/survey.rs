//! The survey of a photo: the measures of all filters, from one decode.

use marf_cache::{ContentHash, Visitor, manifest::Row};
use marf_scene::Photo;
use marf_stage::{Ctx, StageError};

use crate::decoded::DecodedPhoto;

/// Name and version of the table that keeps the surveys, for all filters together.
pub(crate) const TABLE: (&str, u32) = ("filters", 1);

/// The part of a survey that belongs to one filter.
pub(crate) struct Section {
    /// Name of the filter.
    pub(crate) name: &'static str,
    /// Version of the measure.
    pub(crate) version: u32,
    /// Measures a photo; only the filter itself reads the bytes.
    pub(crate) measure: fn(&DecodedPhoto) -> Result<Vec<u8>, serde_json::Error>,
}

/// A stage of the table of filters.
pub(crate) trait Surveyed {
    /// What it adds to a survey; `None` for a filter that needs the facts alone.
    const SECTION: Option<Section>;
    /// Digests of its answers on fixed photos.
    #[cfg(test)]
    const GUARD: crate::guard::Guard;
}

/// What a survey depends on beside the photo: the name and the measure's version of every section.
pub(crate) struct SectionVersions(pub(crate) &'static [Option<Section>]);

impl ContentHash for SectionVersions {
    fn walk(&self, visitor: &mut dyn Visitor) {
        let sections = || self.0.iter().flatten();
        visitor.open("survey", sections().count());
        for section in sections() {
            visitor.field(section.name);
            visitor.unsigned(u64::from(section.version));
        }
        visitor.close();
    }
}

/// Decodes the photo of a row once and asks every filter for its measure.
///
/// Returns a byte 1 and, for each section, its name and bytes (each behind its length, u32 LE); or a byte 0 and why
/// the photo cannot be decoded.
///
/// # Errors
/// A row without image, or a blob that cannot be read.
pub(crate) fn survey(sections: &[Option<Section>], ctx: &Ctx<'_>, row: &Row) -> Result<Vec<u8>, StageError> {
    let digest = row.blobs.get("image");
    let digest = digest.ok_or_else(|| StageError::new(format!("photo `{}` has no blob `image`", row.id)))?;
    let refused = |reason: String| Ok([&[0][..], reason.as_bytes()].concat());
    let photo = match Photo::decode_validated(&ctx.get(digest)?) {
        Ok(photo) if photo.image.pixels.is_empty() => return refused("the image has no pixels".to_owned()),
        Ok(photo) => photo,
        Err(error) => return refused(error.to_string()),
    };
    let decoded = DecodedPhoto::of(photo);
    let mut bytes = vec![1];
    for section in sections.iter().flatten() {
        let measure = (section.measure)(&decoded).map_err(|error| {
            let what = format!("measure `{}` of `{}` cannot be written", section.name, row.id);
            StageError::new(what).cause(error.to_string())
        })?;
        put(&mut bytes, section.name.as_bytes());
        put(&mut bytes, &measure);
    }
    Ok(bytes)
}

/// Appends a part behind its length.
fn put(bytes: &mut Vec<u8>, part: &[u8]) {
    bytes.extend((part.len() as u32).to_le_bytes());
    bytes.extend(part);
}

/// Returns the part of a survey that belongs to a filter, or why the photo could not be decoded.
///
/// # Errors
/// Bytes that are no survey, or one without this filter.
pub(crate) fn part<'a>(
    survey: &'a [u8],
    name: &str,
    row: &Row,
) -> Result<Result<&'a [u8], String>, StageError> {
    let found = match survey.split_first() {
        Some((0, reason)) => return Ok(Err(String::from_utf8_lossy(reason).into_owned())),
        Some((1, mut rest)) => std::iter::from_fn(|| Some((take(&mut rest)?, take(&mut rest)?)))
            .find(|(of, _)| *of == name.as_bytes())
            .map(|(_, part)| part),
        _ => None,
    };
    found
        .map(Ok)
        .ok_or_else(|| unreadable(row, "it has no such part"))
}

/// Removes a part, and its length before it, from the front of `bytes`; `None` if they are too short.
fn take<'a>(bytes: &mut &'a [u8]) -> Option<&'a [u8]> {
    let (length, rest) = bytes.split_first_chunk::<4>()?;
    let (part, rest) = rest.split_at_checked(u32::from_le_bytes(*length) as usize)?;
    *bytes = rest;
    Some(part)
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
    use marf_cache::{Digest, digest_of};
    use marf_stage::{ParamError, define};

    use super::*;
    use crate::guard::Guard;
    use crate::{ByHand, Decision, Filter, FilterStage, MeasuredPhoto};

    fn row() -> Row {
        Row {
            id: "a".to_owned(),
            blobs: Default::default(),
            facts: serde_json::Value::Null,
        }
    }

    /// A filter without a rule, with a version of its measure and one of its decision.
    struct Versioned<const MEASURE: u32, const DECISION: u32>;

    impl<const MEASURE: u32, const DECISION: u32> Filter for Versioned<MEASURE, DECISION> {
        const NAME: &'static str = "versioned";
        const ABOUT: &'static str = "keeps every photo";
        const MEASURE_VERSION: u32 = MEASURE;
        const DECISION_VERSION: u32 = DECISION;
        const GUARD: Guard = Guard::NONE;
        type Params = ByHand;
        type Measure = u32;
        const MEASURE: Option<fn(&DecodedPhoto) -> u32> = Some(|_| 0);

        fn check(_: &ByHand) -> Result<(), ParamError> {
            Ok(())
        }

        fn by_hand(params: &ByHand) -> &ByHand {
            params
        }

        fn decide(_: &ByHand, photos: &[MeasuredPhoto<u32>]) -> Vec<Decision> {
            vec![Decision::pass(""); photos.len()]
        }
    }

    /// Returns the version in the key of a node of the filter, and the digest in the key of its kept measures.
    fn keys<F: Filter>() -> (u32, Digest) {
        let sections = vec![<FilterStage<F> as Surveyed>::SECTION].leak();
        (
            define::<FilterStage<F>>().version,
            digest_of(&SectionVersions(sections)),
        )
    }

    #[test]
    fn a_new_decision_keeps_the_measures_and_a_new_measure_renews_both() {
        let (node, measures) = keys::<Versioned<1, 1>>();
        let (decided_anew, kept) = keys::<Versioned<1, 2>>();
        assert!(decided_anew != node && kept == measures);
        let (measured_anew, renewed) = keys::<Versioned<2, 1>>();
        assert!(measured_anew != node && renewed != measures);
    }

    #[test]
    fn each_filter_finds_its_own_part_and_a_damaged_survey_is_an_error() {
        let mut bytes = vec![1];
        for (name, measure) in [("blur", &b"sharp"[..]), ("histogram", b"")] {
            put(&mut bytes, name.as_bytes());
            put(&mut bytes, measure);
        }
        assert_eq!(part(&bytes, "blur", &row()).unwrap(), Ok(&b"sharp"[..]));
        assert_eq!(part(&bytes, "histogram", &row()).unwrap(), Ok(&b""[..]));
        assert_eq!(part(b"\0cut", "blur", &row()).unwrap(), Err("cut".to_owned()));
        for (damaged, name) in [
            (&bytes[..], "shape"),
            (&bytes[..7], "blur"),
            (b"", "blur"),
            (b"{}", "blur"),
        ] {
            let error = part(damaged, name, &row()).unwrap_err().to_string();
            assert!(error.contains("`a`"), "{error}");
        }
    }
}
