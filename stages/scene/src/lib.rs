//! Types that stages share: photos, cameras, poses and scenes. Also image metrics, camera paths and drawn pictures.
//!
//! No files and no network: every function works on bytes and values in memory. Invariant: cameras and poses are f64 and finite. Pixel (0,
//! 0) is the top-left corner, the first pixel's centre is (0.5, 0.5).

mod cahvor;
mod camera;
mod coverage;
mod facts;
mod image;
pub mod metrics;
mod names;
mod nearest;
pub mod path;
mod photo;
pub mod picture;
mod places;
pub mod ply;
mod pose;
mod reach;
mod scene;
mod thumbnail;
mod tones;

pub use cahvor::{Cahvor, CahvorError, EntrancePupil, Intrinsics, Pinhole, Ray};
pub use camera::Camera;
pub use coverage::{Coverage, Observer, SkySeen, SurfaceSeen, seen_at, typical_distance};
pub use facts::{CameraPrior, PhotoFacts, RoverPlace, Sensor};
pub use image::{ColorSpace, Image, Linear, Srgb};
pub use names::picture_names;
pub use nearest::{DepthView, Nearest, TrainedPhotos};
pub use photo::{DecodeError, MAX_DECODED_BYTES, Photo, TooLarge, encode_png};
pub use places::{PosedPhoto, folds, hold_out_more_places, hold_out_places, places_of};
pub use pose::Pose;
pub use scene::{Frame, Point, Scene, SceneError, SiteFrame, Unplaced};
pub use thumbnail::{encode_jpeg, shrunk, thumbnail};
pub use tones::{Falloff, PhotoTone, ToneDifference, Tones};
