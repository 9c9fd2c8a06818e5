//! Surfaces of trained fields: meshes, clouds of points, Gaussian splats, height maps and orthophotos, in the formats of other programs.
//!
//! The distances at which the rays of a field end, at the views of its photos, are averaged into signed
//! distances on a grid. The surface is where these change their sign. Everything but the stage is pure: no
//! file, no clock. Invariants: the bytes are the same for any number of threads. Parts that no photo saw are
//! holes. Metres and up are used only if the scene knows them.

mod changes;
mod cloud;
mod cubes;
mod error;
mod extract;
mod frame;
mod geotiff;
pub mod glb;
mod look;
mod map;
mod members;
mod mesh;
pub mod ply;
pub mod splats;
mod stage;
mod triangle;
mod view;
mod volume;
mod write;

pub use changes::FindChanges;
pub use cloud::cloud;
pub use cubes::{Triangles, march};
pub use error::SurfaceError;
pub use extract::{Surface, SurfaceLimits, extract};
pub use frame::{ExportFrame, MapAxes};
pub use map::{MapCell, MapGrid, SurfaceMap};
pub use mesh::{Mesh, Retrained, SurfaceSample, Vertex, Witnesses};
pub use stage::MakeSurface;
pub use triangle::{CoveredPixel, covered_pixels};
pub use view::{Patch, PlaneRules, SurfaceView};
pub use volume::{Layout, Volume};
