use serde::{Deserialize, Serialize};

/// Whether one item is kept or rejected, and why.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Verdict {
    /// The item's id, or the name of a file that gave no item.
    pub id: String,
    /// The file it came from.
    pub file: String,
    /// `keep`, or the name of the filter that rejected it, or `decode` if it could not be decoded.
    pub verdict: String,
    /// The measure the verdict rests on, in the filter's own unit.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub score: Option<f64>,
    /// The threshold that the measure was compared with.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub threshold: Option<f64>,
    /// For duplicates, the item that is kept instead.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub twin: Option<String>,
    /// One sentence of explanation. Empty for a plain `keep`.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub reason: String,
}

impl Verdict {
    /// The verdict of an item that is kept.
    pub const KEEP: &'static str = "keep";

    /// Start of the reason of an item that is kept although it is of another kind than the rest.
    const KEPT_AS: &'static str = "kept as ";

    /// Returns the reason to keep an item as one of a kind, with the group it belongs to: `monochrome` and `NAVCAM_LEFT`.
    pub fn kept_as_reason(kind: &str, group: &str) -> String {
        format!("{}{kind}: {group}", Self::KEPT_AS)
    }

    /// Returns kind and group of an item that is kept for such a reason.
    pub fn kept_as(&self) -> Option<(&str, &str)> {
        let reason = self.keeps().then(|| self.reason.strip_prefix(Self::KEPT_AS))??;
        reason.split_once(": ")
    }

    /// Returns whether the item is kept.
    pub fn keeps(&self) -> bool {
        self.verdict == Self::KEEP
    }
}
