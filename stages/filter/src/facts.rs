//! What filters read of the facts of a photo.

use marf_cache::manifest::Row;
use marf_scene::Sensor;
use marf_stage::StageError;
use serde::{Deserialize, de::IgnoredAny};

/// What filters read of the facts of a photo ([`marf_scene::PhotoFacts`]), borrowed from its row: no text is copied for a
/// decision.
#[derive(Debug, Clone, Copy, Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Facts<'a> {
    /// Name of the file in its archive.
    pub file: &'a str,
    /// Bytes of the image as stored in the archive.
    pub size_bytes: u64,
    /// Width, pixels.
    pub width: u32,
    /// Height, pixels.
    pub height: u32,
    /// Bands stored in the file, 1 or 3.
    pub bands: u8,
    /// Sol.
    pub sol: Option<u32>,
    /// Instrument and eye as the archive names them.
    pub instrument: Option<&'a str>,
    /// Colour filter as the archive names it.
    pub filter: Option<&'a str>,
    /// Whether its camera sees colour, where product name or label say so.
    pub sensor: Option<Sensor>,
    /// Whether the archive calls it a thumbnail.
    pub thumbnail: bool,
    /// Camera model and pose, which [`marf_scene::PhotoFacts`] holds.
    #[serde(rename = "prior")]
    _prior: IgnoredAny,
    #[serde(rename = "place")]
    _place: IgnoredAny,
    #[serde(rename = "focal_px")]
    _focal_px: IgnoredAny,
    #[serde(rename = "device")]
    _device: IgnoredAny,
    #[serde(rename = "notes")]
    _notes: IgnoredAny,
}

impl<'a> Facts<'a> {
    /// Reads the facts of a row.
    ///
    /// # Errors
    /// Facts that are not those of a photo, with the photo's id.
    pub(crate) fn from_row(row: &'a Row) -> Result<Self, StageError> {
        Self::deserialize(&row.facts).map_err(|error| unreadable_facts(row, &error))
    }
}

/// Returns the error of facts that are not those of a photo.
pub(crate) fn unreadable_facts(row: &Row, cause: &serde_json::Error) -> StageError {
    StageError::new(format!("facts of photo `{}` cannot be read", row.id)).cause(cause.to_string())
}

#[cfg(test)]
mod tests {
    use marf_scene::PhotoFacts;
    use serde_json::json;

    use super::*;

    fn row(facts: serde_json::Value) -> Row {
        Row {
            id: "a".to_owned(),
            blobs: Default::default(),
            facts,
        }
    }

    #[test]
    fn facts_are_those_of_the_row_and_what_is_no_fact_is_refused() {
        let whole = PhotoFacts {
            file: "dir/a.jpg".to_owned(),
            size_bytes: 7,
            width: 40,
            height: 30,
            bands: 3,
            sol: Some(9),
            instrument: Some("ZL".to_owned()),
            filter: Some("0".to_owned()),
            sensor: Some(Sensor::Monochrome),
            thumbnail: true,
            focal_px: Some(3.0),
            device: Some("phone".to_owned()),
            notes: vec!["turned".to_owned()],
            prior: None,
            place: None,
        };
        let row_of_whole = row(whole.to_json());
        let facts = Facts::from_row(&row_of_whole).unwrap();
        assert_eq!(
            (facts.file, facts.size_bytes, facts.sol),
            ("dir/a.jpg", 7, Some(9))
        );
        assert_eq!((facts.width, facts.height, facts.bands), (40, 30, 3));
        assert_eq!(
            (facts.instrument, facts.filter, facts.thumbnail),
            (Some("ZL"), Some("0"), true)
        );
        assert_eq!(facts.sensor, Some(Sensor::Monochrome));
        for odd in [json!({"widht": 3}), json!({"width": -3}), json!(7)] {
            let error = Facts::from_row(&row(odd)).unwrap_err().to_string();
            assert_eq!(error, "facts of photo `a` cannot be read");
        }
    }
}
