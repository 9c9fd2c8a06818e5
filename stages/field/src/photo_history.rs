//! What a field stores about its photos, so that another training can start from it.

use marf_scene::Pose;
use serde::{Deserialize, Serialize};

/// The photos that a field, and those that it was started from, were trained on.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PhotoHistory {
    /// Metres per unit of the world, if known.
    pub metres_per_unit: Option<f64>,
    /// The photos, sorted by id.
    pub photos: Vec<PhotoRecord>,
}

/// A photo that was trained on.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PhotoRecord {
    /// Its id.
    pub id: String,
    /// Its pose then.
    pub cam_from_world: Pose,
    /// Its exposure, if photos had their own: log gains of three channels and an unused number, then offsets likewise if it had any.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub exposure: Vec<f32>,
}

impl PhotoHistory {
    /// Returns the entry of a photo.
    pub fn photo(&self, id: &str) -> Option<&PhotoRecord> {
        let found = self.photos.binary_search_by(|photo| photo.id.as_str().cmp(id));
        Some(&self.photos[found.ok()?])
    }

    /// Returns it with the photos of `earlier` that it has not.
    #[must_use]
    pub fn and(mut self, earlier: &Self) -> Self {
        let gone = earlier
            .photos
            .iter()
            .filter(|photo| self.photo(&photo.id).is_none());
        let gone: Vec<PhotoRecord> = gone.cloned().collect();
        self.photos.extend(gone);
        self.photos.sort_by(|a, b| a.id.cmp(&b.id));
        self
    }
}
