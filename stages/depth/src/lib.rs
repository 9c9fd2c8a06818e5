//! Dense depths of photos from pairs of them: the stage `depth`, and its core, the disparities of a rectified pair.
//!
//! A disparity d says that what is at column x of the left picture is at column x - d of the right one, in the same row.
//! With the focal length f in pixels and the baseline b in metres, the distance along the axis is f b / d.
//!
//! 1. Census codes and Hamming distances (`cost`).
//! 2. Semi-global matching along eight directions (`paths`), first on small pictures, then near the coarser result
//!    (`levels`).
//! 3. Both pictures have to agree, no other candidate may be as good (`winner`), and islands go (`clean`).
//! 4. Slanted planes are fitted to the two pictures (`refine`).
//!
//! The stage chooses pairs (`pairs`), rectifies them (`rectify`), keeps their disparities from run to run (`kept`), and merges in
//! each photo what its pairs say (`merge`). From the merged depths it makes a cloud (`cloud`) and a map from above (`ground`).
//! One photo at a time is in memory with its pairs. What other programs measured is compared with the depths in `score`.
//!
//! Invariant: the same pair gives the same bytes on every machine, instruction set and number of threads. Costs are
//! integers. Each float belongs to one pixel, and its sums have a fixed order.

mod clean;
mod cloud;
mod cloud_distance;
mod cost;
mod disparities;
mod faults;
mod ground;
mod kept;
mod kernel;
mod levels;
mod margins;
mod matching;
mod merge;
mod overlap;
mod pairs;
mod paths;
mod photos;
#[cfg(test)]
mod plane_photos;
#[cfg(test)]
mod plane_tests;
mod raster;
mod rectify;
mod refine;
mod rows;
pub mod score;
mod search;
mod sky;
mod spline;
mod stage;
#[cfg(test)]
mod stage_tests;
mod surfels;
mod targets;
#[cfg(test)]
mod tests;
mod tuning;
mod winner;
mod write;

pub use cloud_distance::{CloudDistance, PointCloud, Ray};
pub use disparities::{Class, Disparities, Swapped, match_pair};
pub use raster::{Picture, Raster};
pub use rectify::{Eye, LEAST_ANGLE_DEG, PosedCamera, Rectified, RectifyError};
pub use search::{MAX_DISPARITIES, Search};
pub use stage::MakeDepth;
pub use targets::{DistanceSample, TargetDetail, distances};
