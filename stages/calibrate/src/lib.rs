//! Photos and priors to a calibrated scene: which photo was taken by which camera from where.
//!
//! `sfm` finds cameras from the photos themselves, with labels as priors. `labels` takes the camera models of the archive's labels and
//! resamples each photo once to an ideal pinhole. `import` reads the cameras another program found.
//! `cameras` writes a scene as a folder for other programs.
//!
//! Invariant: a photo is in the scene with a camera for the very bytes its frame names, or it is listed as unplaced with the reason. No
//! photo is dropped silently.

mod calibration;
mod cameras;
mod export;
pub mod import;
mod labels;
mod mask_files;
mod mask_names;
mod masks;
mod orientation;
mod photos;
mod resample;
mod scenes;
mod sfm;
mod stage;
mod ties;
mod up;

pub use cameras::ExportCameras;
pub use export::{
    Observation, TrackPoint, Tracks, write_colmap, write_colmap_text, write_ply, write_transforms,
};
pub use masks::Masks;
pub use scenes::SplitByPlace;
pub use stage::Calibrate;
pub use ties::TieScenes;
