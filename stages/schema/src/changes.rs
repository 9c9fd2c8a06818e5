//! `changes`: one place photographed at two times, trained apart and compared.

use marf_field::{Device, Quality};
use marf_stage::{ParamError, Sols};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::check::{check_length, check_scale, check_steps, check_within};

/// Most retrainings of each time.
const MAX_MEMBERS: u32 = 20;
/// Largest picture of the field. A larger number is taken for a mistake.
const MAX_SIDE_PX: u32 = 4096;

/// Parameters of `changes`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct ChangesParams {
    /// Sols of the earlier photos: `"1..=2"`, `"3,5"`. Photos of other sols are left out.
    pub before: Sols,
    /// Sols of the later photos.
    pub after: Sols,
    /// Trainings of each time, at least 2: how far they differ is the noise that a change must exceed.
    pub b: u32,
    /// Seed of the first training. Each further one adds 1.
    pub seed: u64,
    /// Steps, size of the photos and size of the field, as for `train`.
    pub quality: Quality,
    /// Optimiser steps, instead of those of `quality`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub steps: Option<u64>,
    /// Whole factor by which photos are shrunk. Default: as for `train`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub scale: Option<u32>,
    /// Width of a cell of the map, metres. Default: the coarser of the cells that `surface` uses for both
    /// times.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub cell: Option<f64>,
    /// Longest side of the pictures that are rendered to find the ground, pixels.
    pub side_px: u32,
    /// Difference of a cell that counts as a change, in standard deviations.
    pub sigmas: f64,
    /// Fewest cells that a patch needs to be reported.
    pub least_cells: u32,
    /// Device that trains and renders: `auto` (a GPU if there is one, never a software adapter), `cpu`,
    /// `gpu`, or `gpu:NAME` for the adapter whose name contains NAME. Only the device that is used is part
    /// of the key.
    pub device: Device,
}

impl Default for ChangesParams {
    fn default() -> Self {
        Self {
            before: Sols::Ranges(Vec::new()),
            after: Sols::Ranges(Vec::new()),
            b: 3,
            seed: 0,
            quality: Quality::Draft,
            steps: None,
            scale: None,
            cell: None,
            side_px: 480,
            sigmas: 3.0,
            least_cells: 20,
            device: Device::default(),
        }
    }
}

impl ChangesParams {
    /// Checks what a type cannot.
    ///
    /// # Errors
    /// Names the key that is out of range.
    pub fn check(&self) -> Result<(), ParamError> {
        let refuse = |key: &str, message: String| Err(ParamError::new(key, message));
        for (key, sols) in [("before", &self.before), ("after", &self.after)] {
            match sols {
                Sols::Ranges(ranges) if ranges.is_empty() => {
                    return refuse(
                        key,
                        "no sols are named: write `3`, `1..=5` or `1,4,7..=9`".to_owned(),
                    );
                }
                Sols::Ranges(_) => {}
                Sols::All | Sols::Latest => {
                    return refuse(key, format!("`{sols}` changes with every new sol: list the sols"));
                }
            }
        }
        if let Some(sol) = self.before.shared_with(&self.after) {
            return refuse("after", format!("sol {sol} is in `before` too"));
        }
        check_within("b", self.b, 2..=MAX_MEMBERS)?;
        check_steps(self.steps)?;
        check_scale(self.scale)?;
        check_length("cell", self.cell)?;
        check_within("side_px", self.side_px, 16..=MAX_SIDE_PX)?;
        if !(self.sigmas >= 1.0 && self.sigmas.is_finite()) {
            return refuse(
                "sigmas",
                format!("{} is below 1 or not finite: noise alone reaches 1", self.sigmas),
            );
        }
        match self.least_cells {
            0 => refuse("least_cells", "a patch has at least 1 cell".to_owned()),
            _ => Ok(()),
        }
    }
}

/// Change of a patch of ground between the two times.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Change {
    /// The ground is higher.
    Higher,
    /// The ground is lower.
    Lower,
    /// The same shape in another colour: the ratio of the channels differs.
    Colour,
    /// Brighter or darker alone, or by so much that it may be a shadow: light or ground, which photos of one
    /// light each cannot separate.
    Undecided,
}

impl Change {
    /// Returns its name in reports.
    pub const fn word(self) -> &'static str {
        match self {
            Self::Higher => "higher",
            Self::Lower => "lower",
            Self::Colour => "another colour",
            Self::Undecided => "undecided",
        }
    }
}

/// One of the two times.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Time {
    /// Sols of its photos.
    pub sols: Vec<u32>,
    /// Photos with a camera.
    pub photos: usize,
    /// Mean PSNR of its first field on its photos held out, dB.
    pub psnr: f64,
    /// Ground that it shows, square metres.
    pub area_m2: f64,
}

/// How one quantity differs where nothing has changed.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Noise {
    /// Half width of the interval that holds 90 % of the unchanged cells, median over the map.
    pub interval: f64,
    /// Factor from how far the trainings differ to that of the unchanged ground: what they share and the two times do not.
    pub factor: f64,
}

/// Difference of the two times as a whole, which was removed.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Registration {
    /// Later height less earlier one at the middle of the map, metres.
    pub offset_m: f64,
    /// Its slope to the right and to the top of the map, metres a metre.
    pub tilt: [f64; 2],
    /// Later light over earlier one, red, green and blue: exposure and the colour of the light.
    pub gain: [f64; 3],
}

/// Ground that changed in one way.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Patch {
    /// The change.
    pub change: Change,
    /// Its area on the map, square metres.
    pub area_m2: f64,
    /// The part of it that differs by as much as was asked for, and the area with one cell more all around.
    pub area_interval_m2: [f64; 2],
    /// Its middle: to the right and to the top of the origin, metres.
    pub middle_m: [f64; 2],
    /// Mean change of height with the half width of a cell's 90 % interval, metres.
    pub height_m: [f64; 2],
    /// Change of height, summed, cubic metres.
    pub volume_m3: f64,
    /// Later light over earlier one, beyond that of the whole map.
    pub brightness: f64,
}

/// Output `changes` of `changes`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ChangesReport {
    /// The earlier time.
    pub before: Time,
    /// The later time.
    pub after: Time,
    /// Width of a cell, metres.
    pub cell_m: f64,
    /// Columns and rows of all maps.
    pub size: [u32; 2],
    /// Middle of the first cell: to the right and to the top of the origin, metres.
    pub first_m: [f64; 2],
    /// The axes to the right, to the top and up, in the world.
    pub axes: [[f64; 3]; 3],
    /// Whose origin coordinates count from: `site 3`, or the world of the scene.
    pub origin: String,
    /// Ground that both times show, square metres.
    pub compared_m2: f64,
    /// Of it what changed, [`Change::Undecided`] left out, square metres.
    pub changed_m2: f64,
    /// Part of it that is [`Change::Undecided`], square metres.
    pub undecided_m2: f64,
    /// Difference of the two times as a whole.
    pub registration: Registration,
    /// Noise of the height, metres.
    pub height: Noise,
    /// Noise of the brightness, natural logarithm.
    pub brightness: Noise,
    /// Noise of the colour (red and blue over green), natural logarithm.
    pub colour: Noise,
    /// The patches, the largest first.
    pub patches: Vec<Patch>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_cannot_be_is_named_by_its_key() {
        let two = ChangesParams {
            before: Sols::Ranges(vec![(1, 2)]),
            after: Sols::Ranges(vec![(8, 9)]),
            ..ChangesParams::default()
        };
        assert_eq!(two.check(), Ok(()));
        let refused = |change: &dyn Fn(&mut ChangesParams)| {
            let mut params = two.clone();
            change(&mut params);
            params.check().unwrap_err().path
        };
        assert_eq!(
            refused(&|params| params.before = ChangesParams::default().before),
            "before"
        );
        assert_eq!(refused(&|params| params.after = Sols::Latest), "after");
        assert_eq!(
            refused(&|params| params.after = Sols::Ranges(vec![(2, 2)])),
            "after"
        );
        assert_eq!(refused(&|params| params.b = 1), "b");
        assert_eq!(refused(&|params| params.steps = Some(0)), "steps");
        assert_eq!(refused(&|params| params.scale = Some(0)), "scale");
        assert_eq!(refused(&|params| params.cell = Some(f64::NAN)), "cell");
        assert_eq!(refused(&|params| params.side_px = 3), "side_px");
        assert_eq!(refused(&|params| params.sigmas = 0.5), "sigmas");
        assert_eq!(refused(&|params| params.sigmas = f64::INFINITY), "sigmas");
        assert_eq!(refused(&|params| params.least_cells = 0), "least_cells");
    }
}
