//! Signed distances to the surface on a sparse grid, averaged over the views.

use std::collections::{HashMap, HashSet};

use marf_stage::Cancel;
use nalgebra::Vector3;
use rayon::prelude::*;

use crate::SurfaceError;
use crate::error::go_on;
use crate::view::SurfaceView;

/// Samples along a side of a block.
pub const SIDE: usize = 8;
/// Samples of a block.
pub const SAMPLES: usize = SIDE * SIDE * SIDE;

/// Blocks from the origin of the world at most: places of samples are whole numbers of 32 bits.
const FARTHEST: f64 = 1e8;

/// A sample's place on the grid.
pub type Place = [i32; 3];

/// Layout of a volume.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Layout {
    /// Distance between samples, world units, above 0.
    pub cell: f64,
    /// Samples farther from a surface than this are not averaged, world units. At least one cell.
    pub band: f64,
    /// Most blocks that are taken.
    pub most_blocks: usize,
}

/// Signed distances on a grid that stores only blocks near surfaces.
#[derive(Debug, Clone)]
pub struct Volume {
    cell: f64,
    /// Places of the blocks in units of blocks, sorted.
    places: Vec<Place>,
    index: HashMap<Place, u32>,
    /// `[blocks][512]`, x fastest: signed distance in cells, positive before the surface, NaN if unknown.
    blocks: Vec<[f32; SAMPLES]>,
}

impl Volume {
    /// Averages the signed distances that the views show.
    ///
    /// D(x) = Σ wᵢ dᵢ / Σ wᵢ (Curless and Levoy, A Volumetric Method for Building Complex Models from Range
    /// Images, SIGGRAPH 1996, eq. 3). dᵢ is the distance from x to the plane that view i shows at the pixel
    /// of x. wᵢ = cos² θ / r² with the angle θ between normal and ray and the distance r to the camera, as a
    /// pixel covers r / cos θ of the surface. A view says nothing about points more than a band behind its
    /// surface. More than a band before it counts as one band.
    ///
    /// Blocks run in parallel, each over the views in their order: the values do not depend on the number of threads.
    ///
    /// # Errors
    /// [`SurfaceError::TooFine`] if the surfaces touch more blocks than the layout allows.
    /// [`SurfaceError::Layout`] for a cell or a band that is not a length. The wish to stop.
    pub fn fuse(
        views: &[SurfaceView],
        layout: Layout,
        reach: f64,
        cancel: &Cancel,
    ) -> Result<Self, SurfaceError> {
        layout.check()?;
        let places = touched(views, layout, reach, cancel)?;
        let blocks = places.par_iter().map(|place| {
            go_on(cancel)?;
            Ok(block(views, layout, place))
        });
        let blocks = blocks.collect::<Result<_, SurfaceError>>()?;
        Ok(Self::from_blocks(layout.cell, places, blocks))
    }

    /// Returns the volume of blocks of samples at these places, which are sorted.
    pub(crate) fn from_blocks(cell: f64, places: Vec<Place>, blocks: Vec<[f32; SAMPLES]>) -> Self {
        let numbered = places.iter().enumerate();
        Self {
            cell,
            index: numbered.map(|(index, place)| (*place, index as u32)).collect(),
            places,
            blocks,
        }
    }

    /// Returns the distance between samples, world units.
    pub fn cell(&self) -> f64 {
        self.cell
    }

    /// Returns the places of the blocks, sorted.
    pub fn places(&self) -> &[Place] {
        &self.places
    }

    /// Returns the samples of a block and of the first layer of its neighbours, `[9][9][9]`, x fastest.
    pub fn with_border(&self, place: &Place) -> Vec<f32> {
        const WIDE: usize = SIDE + 1;
        let mut samples = vec![f32::NAN; WIDE * WIDE * WIDE];
        for neighbour in 0..8 {
            let step = [neighbour & 1, neighbour >> 1 & 1, neighbour >> 2];
            let at = [0, 1, 2].map(|axis| place[axis] + step[axis]);
            let Some(block) = self.index.get(&at).map(|index| &self.blocks[*index as usize]) else {
                continue;
            };
            let along = |axis: usize| if step[axis] == 1 { SIDE..WIDE } else { 0..SIDE };
            for z in along(2) {
                for y in along(1) {
                    for x in along(0) {
                        let from = (z % SIDE * SIDE + y % SIDE) * SIDE + x % SIDE;
                        samples[(z * WIDE + y) * WIDE + x] = block[from];
                    }
                }
            }
        }
        samples
    }
}

impl Layout {
    fn check(&self) -> Result<(), SurfaceError> {
        let is_length = |value: f64| value.is_finite() && value > 0.0;
        if is_length(self.cell) && is_length(self.band) && self.band >= self.cell {
            return Ok(());
        }
        Err(SurfaceError::Layout {
            cell: self.cell,
            band: self.band,
        })
    }
}

/// Returns the position of a sample, world units.
pub fn position(cell: f64, place: Place) -> Vector3<f64> {
    Vector3::from(place.map(f64::from)) * cell
}

pub(crate) fn sample_place(block: &Place, index: usize) -> Place {
    let step = [index % SIDE, index / SIDE % SIDE, index / SIDE / SIDE];
    [0, 1, 2].map(|axis| block[axis] * SIDE as i32 + step[axis] as i32)
}

/// Returns the blocks within a cell more than the band of any surface that is nearer than `reach` to its
/// camera, sorted. Half of a pixel's footprint around it is included, so there is no gap between pixels that
/// are far apart on the surface.
fn touched(
    views: &[SurfaceView],
    layout: Layout,
    reach: f64,
    cancel: &Cancel,
) -> Result<Vec<Place>, SurfaceError> {
    let side = layout.cell * SIDE as f64;
    let mut all: HashSet<Place> = HashSet::new();
    for view in views {
        go_on(cancel)?;
        let mut last = None;
        for (point, patch, _) in view.points() {
            if point.amax() / side > FARTHEST {
                return Err(SurfaceError::Layout {
                    cell: layout.cell,
                    band: layout.band,
                });
            }
            let distance = f64::from(patch.distance);
            let around =
                layout.cell + layout.band + 0.5 * distance * view.pixel_angle() / f64::from(patch.cosine);
            let block = |value: f64| (value / side).floor() as i32;
            let range = (point.map(|x| block(x - around)), point.map(|x| block(x + around)));
            // Neighbouring pixels mostly touch the same blocks.
            if distance > reach || last.replace(range) == Some(range) {
                continue;
            }
            let (low, high) = range;
            for x in low.x..=high.x {
                for y in low.y..=high.y {
                    all.extend((low.z..=high.z).map(|z| [x, y, z]));
                }
            }
            if all.len() > layout.most_blocks {
                return Err(SurfaceError::TooFine {
                    cell: layout.cell,
                    blocks: all.len(),
                    most: layout.most_blocks,
                });
            }
        }
    }
    let mut all: Vec<Place> = all.into_iter().collect();
    all.par_sort_unstable();
    Ok(all)
}

fn block(views: &[SurfaceView], layout: Layout, place: &Place) -> [f32; SAMPLES] {
    let radius = layout.cell * SIDE as f64 * 0.87;
    let middle = position(layout.cell, sample_place(place, 0)) + Vector3::repeat(layout.cell * 3.5);
    let mut sums = [(0.0, 0.0); SAMPLES];
    for view in views.iter().filter(|view| view.may_show(&middle, radius)) {
        for (index, (sum, weights)) in sums.iter_mut().enumerate() {
            let point = position(layout.cell, sample_place(place, index));
            let Some((signed, patch, _)) = view.at(&point) else {
                continue;
            };
            if signed < -layout.band {
                continue;
            }
            let share = f64::from(patch.cosine) / f64::from(patch.distance);
            let weight = share * share;
            *sum += weight * signed.min(layout.band);
            *weights += weight;
        }
    }
    let mut samples = [f32::NAN; SAMPLES];
    for (sample, (sum, weights)) in samples.iter_mut().zip(sums) {
        if weights > 0.0 {
            *sample = (sum / weights / layout.cell) as f32;
        }
    }
    samples
}
