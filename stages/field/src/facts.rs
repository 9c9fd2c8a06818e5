use serde::{Deserialize, Serialize};

use crate::Sizes;

/// One level of the hash grid.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LevelFacts {
    /// Cells a side over the whole contracted box.
    pub resolution: u32,
    /// Entries stored.
    pub entries: u32,
    /// Every corner has its own entry. Otherwise corners share entries by hash.
    pub dense: bool,
}

/// What decided the size of a field: every number with the number that decided it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Facts {
    /// Centre of the box, world units.
    pub origin: [f64; 3],
    /// Half side of the inner box, world units. Beyond it space is contracted.
    pub half_side: f64,
    /// Why this box.
    pub box_reason: String,
    /// Distance of the first sample from the camera, world units.
    pub near: f64,
    /// Distance of the last sample, world units.
    pub far: f64,
    /// Steps from near to far, if every cell were occupied.
    pub steps_per_ray: u32,
    /// Times that the steps along rays have been halved.
    pub halvings: u32,
    /// Levels, coarse to fine.
    pub levels: Vec<LevelFacts>,
    /// What decided near, far, levels and table.
    pub sizes: Sizes,
    /// Trained numbers (tables, networks, background, gains).
    pub parameters: u64,
    /// Share of the occupancy grid that some camera sees.
    pub seen_share: f64,
    /// Share of it that is occupied now.
    pub occupied_share: f64,
    /// Optimiser steps behind the weights.
    pub steps: u64,
    /// Photos trained on that are transparent somewhere: their rays train over a random colour each.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub transparent_photos: u64,
}

// Fields of opaque photos keep their bytes.
fn is_zero(count: &u64) -> bool {
    *count == 0
}
