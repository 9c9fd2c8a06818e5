//! Names of outputs that are not JSON documents. One that ends with `/` is a prefix: any number of outputs lie below.

/// The photos of each scene, of `scenes`: `photos/<name>`, each the root of a set.
pub const PHOTOS_OF: &str = "photos/";
/// A scene ([`marf_scene::Scene::encode`]), of `calibrate` and passed on by `train`.
pub const SCENE: &str = "scene";
/// The scene of `calibrate` as `transforms.json` of nerfstudio.
pub const TRANSFORMS: &str = "transforms";
/// The scene of `calibrate` as COLMAP's model: `sparse/0/cameras.bin`.
pub const SPARSE: &str = "sparse/";
/// The images of that model, with what each observes.
pub const SPARSE_IMAGES: &str = "sparse/0/images.bin";
/// The points of that model.
pub const SPARSE_POINTS: &str = "sparse/0/points3D.bin";
/// The folder of `cameras`: `cameras/transforms.json`, `cameras/sparse/0/images.txt`, `cameras/<photo>`.
pub const CAMERAS: &str = "cameras/";
/// Proposed masks of `masks`, black where a picture does not move: `masks/<camera>.png`.
pub const MASKS: &str = "masks/";
/// A photo with the proposed mask in red, of `masks`: `overlay/<camera>.png`.
pub const OVERLAY: &str = "overlay/";
/// Points as PLY: the sparse ones of `calibrate`, and clouds of `depth` and `surface`.
pub const POINTS: &str = "points.ply";
/// A trained field (safetensors), of `train`.
pub const WEIGHTS: &str = "weights";
/// The state of a training that was stopped on its way, of `partial`: `train` and `partial` go on from it.
pub const STATE: &str = "state";
/// Renders at the views of photos, of `train` and `evaluate`: `heldout/<name>.png`.
pub const HELDOUT: &str = "heldout/";
/// The photos of those views at the size they were compared at: `photo/<name>.png`.
pub const PHOTO: &str = "photo/";
/// A film (MP4), of `video`.
pub const VIDEO: &str = "video";
/// Pictures along the path of `render`: `frames/0001.png`.
pub const FRAMES: &str = "frames/";
/// Depths as pictures of 16 bits with their scale in the text, of `render` (`depth/0001.png`), `surface` and `depth` (`depth/<name>.png`).
pub const DEPTH: &str = "depth/";
/// Depths along the path of `render` in colours: `depth-preview/0001.png`.
pub const DEPTH_PREVIEW: &str = "depth-preview/";
/// Inverse depths along the axis, of `depth`, as [`DEPTH`]: `inverse-depth/<name>.png`.
pub const INVERSE_DEPTH: &str = "inverse-depth/";
/// Their standard deviations: `sigma/<name>.png`.
pub const SIGMA: &str = "sigma/";
/// Unit normals of the surface towards the camera, of `depth`: `normal/<name>.png`.
pub const NORMAL: &str = "normal/";
/// What is known of each pixel, of `depth`: `class/<name>.png`.
pub const DEPTH_CLASS: &str = "class/";
/// How far retrainings differ along the path of `render`, as [`DEPTH`]: `uncertainty/0001.png`.
pub const UNCERTAINTY: &str = "uncertainty/";
/// The same in colours: `uncertainty-preview/0001.png`.
pub const UNCERTAINTY_PREVIEW: &str = "uncertainty-preview/";
/// Maps of `bootstrap`: `maps/<viewpoint>-std.png`.
pub const MAPS: &str = "maps/";
/// The surface of a field as PLY, of `surface`.
pub const MESH_PLY: &str = "mesh.ply";
/// The surface of a field as GLB, of `surface`.
pub const MESH_GLB: &str = "mesh.glb";
/// Files of `surface` for splats, if requested.
pub const SPLAT_FILES: &str = "splats/";
/// The surface of a field as Gaussian splats (PLY), of `surface`.
pub const SPLATS: &str = "splats/splats.ply";
/// Pictures splats | field at the views of held-out photos, of `surface`: `splats/views/<name>.png`.
pub const SPLAT_VIEWS: &str = "splats/views/";
/// Maps of `surface` and `depth`: `map/height.png`, with `map/height.pgw`.
pub const SURFACE_MAPS: &str = "map/";
/// Maps of `changes`: `changes/map.png`, with `changes/map.pgw`.
pub const CHANGE_MAPS: &str = "changes/";
