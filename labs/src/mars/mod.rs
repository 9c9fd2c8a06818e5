//! The built-in Mars: photos of it for tests and benchmarks, and its truth next to the results of runs.

mod depth;
mod descent;
mod hardware;
mod heights;
mod maps;
mod pairs;
mod pictures;
mod plain;
mod stereo;
mod surface;
mod truth;

use std::path::PathBuf;

use clap::Subcommand;

use crate::output::Result;

/// Programs about the built-in Mars.
#[derive(Debug, Clone, Subcommand)]
pub enum MarsProgram {
    /// Write photos of a descent and their cameras, for `train`
    Descent {
        /// Folder to write into
        dir: PathBuf,
        #[arg(default_value_t = 64)]
        photos: u32,
        /// Width and height of a photo
        #[arg(default_value_t = 320)]
        side_px: u32,
    },
    /// Write photos of a flat plain and their cameras, for `train`: gentle waves of colour, from which the correct field is known
    Plain {
        /// Folder to write into
        dir: PathBuf,
        /// Length of the shortest waves in the photos
        wave_px: u32,
        #[arg(default_value_t = 40)]
        photos: u32,
        /// Width and height of a photo
        #[arg(default_value_t = 320)]
        side_px: u32,
    },
    /// Write photos clean to DIR/clean, and with a part of the rover in the picture and masks of it to DIR/hardware: a pipeline like
    /// `pipelines/folder.toml` reads both. Without DIR/hardware/masks the rover is learnt as a part of Mars
    Hardware {
        /// Folder to write into
        dir: PathBuf,
        #[arg(default_value_t = 2)]
        sols: u32,
    },
    /// Compare the depths of a bootstrap and their 90 % intervals with the truth: a JSON line a photo and one of the means
    TrueDepth {
        /// scene.json of the calibration
        scene: PathBuf,
        /// Folder of the maps of the bootstrap
        maps: PathBuf,
    },
    /// Pick pairs of points in the photos of a training as a user of `marf view` would, with their true distance: a JSON line a pair.
    /// `benches/distances.py` asks a running `marf view` for the distance of each
    TruePairs {
        /// scene.json of the training
        scene: PathBuf,
        /// Number of pairs
        pairs: usize,
        /// Largest distance of a point from the photo, metres
        #[arg(default_value_t = f64::INFINITY)]
        reach_m: f64,
    },
    /// Compare the held-out pictures of a training with what the true scene shows through the same cameras: a JSON line a photo and one
    /// of the means
    TruePictures {
        /// Folder of the training
        dir: PathBuf,
    },
    /// Compare a mesh or a cloud with the true terrain: a JSON line for each range of distances
    TrueSurface {
        /// scene.json of the training
        scene: PathBuf,
        /// The mesh or cloud
        ply: PathBuf,
    },
    /// Compare the depths of `depth` with the true ones, on ground within 20 m that a photo and a partner show, and its heights with those of
    /// all ground within 10 m of a photo that shows it: one JSON line
    TrueStereo {
        /// scene.json of the calibration, of photos as the archive has them
        scene: PathBuf,
        /// Folder of the outputs of `depth`
        dir: PathBuf,
    },
}

/// Runs a program.
///
/// # Errors
/// Those of the program.
pub fn run(program: MarsProgram) -> Result {
    match program {
        MarsProgram::Descent { dir, photos, side_px } => descent::descent(&dir, photos, side_px),
        MarsProgram::Plain {
            dir,
            wave_px,
            photos,
            side_px,
        } => plain::plain(&dir, wave_px, photos, side_px),
        MarsProgram::Hardware { dir, sols } => hardware::hardware(&dir, sols),
        MarsProgram::TrueDepth { scene, maps } => depth::depth(&scene, &maps),
        MarsProgram::TruePairs {
            scene,
            pairs,
            reach_m,
        } => pairs::pairs(&scene, pairs, reach_m),
        MarsProgram::TruePictures { dir } => pictures::pictures(&dir),
        MarsProgram::TrueSurface { scene, ply } => surface::surface(&scene, &ply),
        MarsProgram::TrueStereo { scene, dir } => stereo::stereo(&scene, &dir),
    }
}
