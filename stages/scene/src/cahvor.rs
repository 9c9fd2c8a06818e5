use serde::{Deserialize, Serialize};

/// A CAHV, CAHVOR or CAHVORE camera model; integer pixel coordinates are pixel centres, 0-based.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Cahvor {
    /// Centre of projection, metres.
    pub c: [f64; 3],
    /// Axis: normal of the image plane.
    pub a: [f64; 3],
    /// Horizontal vector, pixels.
    pub h: [f64; 3],
    /// Vertical vector, pixels.
    pub v: [f64; 3],
    /// Optical axis of the lens, for the radial terms.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub o: Option<[f64; 3]>,
    /// Radial terms r0, r1, r2.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub r: Option<[f64; 3]>,
    /// Entrance pupil terms.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub e: Option<Entrance>,
}

/// The E of CAHVORE: how the entrance pupil moves with the angle, and the kind of lens.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Entrance {
    /// e0, e1, e2, metres.
    pub terms: [f64; 3],
    /// Linearity L: 1 perspective, 0 fish-eye, other values general.
    pub linearity: f64,
}
