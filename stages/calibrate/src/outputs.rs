//! Names of the outputs.

/// Output that holds the scene ([`marf_scene::Scene::encode`]).
pub const SCENE: &str = "scene";
/// Output that says the result of each photo ([`crate::Metrics`] as JSON).
pub const METRICS: &str = "metrics";
/// Output that holds the scene as transforms.json ([`crate::write_transforms`]).
pub const TRANSFORMS: &str = "transforms";
/// Outputs below this name are the scene as COLMAP's model ([`crate::write_colmap`]): `sparse/0/cameras.bin`.
pub const SPARSE: &str = "sparse/";
/// Output that holds the sparse points as PLY ([`crate::write_ply`]).
pub const POINTS: &str = "points.ply";
