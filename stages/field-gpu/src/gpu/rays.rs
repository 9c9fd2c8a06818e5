//! Rays of a training step and of a picture, drawn and set out on the device.

use marf_scene::{Camera, Pose};
use marf_shaders::{Observed, PixelRange, RAYS, Step, Target, VIEW_RAYS, ViewCamera};

use super::Gpu;
use super::array::{Array, halves};
use super::kernel::{Bound, Kernel};
use marf_field::GpuError;
use marf_field::View;
use marf_field::cpu::march::Steps;
use marf_field::depth::{Observation, SHARE};
use marf_field::draw::DRAWS;
use marf_field::frame::Frame;
use marf_field::pixels::HIDDEN;
use marf_field::rng::Purpose;

/// Rays on the device.
pub struct RayArrays {
    /// Slots.
    pub slots: usize,
    /// Origin, half sides, and place within every step, in [0, 1).
    pub origins: Array<[f32; 4]>,
    /// Unit vector, and 1. All zero where there is no ray.
    pub directions: Array<[f32; 4]>,
    /// What they are compared with.
    pub targets: Array<Target>,
    /// Place and weight of a pull. Weight 0: none.
    pub pulls: Array<[f32; 2]>,
}

impl RayArrays {
    /// Allocates the arrays of rays.
    ///
    /// # Errors
    /// More than the device holds.
    pub fn new(gpu: &Gpu, slots: usize) -> Result<Self, GpuError> {
        Ok(Self {
            slots,
            origins: gpu.zeros("origins", slots)?,
            directions: gpu.zeros("directions", slots)?,
            targets: gpu.zeros("targets", slots)?,
            pulls: gpu.zeros("pulls", slots)?,
        })
    }
}

/// How far the rays of a picture have come.
pub struct Progress {
    /// Step to continue from, `[rays]`.
    pub next_step: Array<u32>,
    /// 1 where a ray has ended, `[rays]`.
    pub done: Array<u32>,
}

impl Progress {
    /// Returns rays at their first step.
    ///
    /// # Errors
    /// More than the device holds.
    pub fn new(gpu: &Gpu, slots: usize) -> Result<Self, GpuError> {
        Ok(Self {
            next_step: gpu.zeros("next_step", slots)?,
            done: gpu.zeros("done", slots)?,
        })
    }
}

/// All photos of a training on the device.
pub struct Photos {
    /// Cameras and poses, `[views]`.
    cameras: Array<ViewCamera>,
    /// Kept pixels, r | g << 8 | b << 16 | place in its run << 24.
    pub pixels: Array<u32>,
    /// Opacities of the kept pixels of photos with transparency, 4 a word.
    alphas: Array<u32>,
}

impl Photos {
    /// Copies photos to the device, 4 bytes a kept pixel and 1 more of a photo with transparency.
    ///
    /// # Errors
    /// More pixels than one binding holds: thin them, by `memory`.
    pub fn new(gpu: &Gpu, views: &[View], world_from_cams: &[Pose], frame: &Frame) -> Result<Self, GpuError> {
        let kept: usize = views.iter().map(|view| view.image.count()).sum();
        let hint = "set `memory`, so that fewer pixels of every photo are kept";
        gpu.check_binding((kept * size_of::<u32>()) as u64, hint)?;
        let pixels = gpu.zeros("pixels", kept)?;
        let (mut cameras, mut alphas, mut first) = (Vec::new(), Vec::new(), 0);
        for (view, world_from_cam) in views.iter().zip(world_from_cams) {
            // A binding holds fewer than 2^32 bytes, so the number of a pixel fits 32 bits.
            cameras.push(ViewCamera {
                first: first as u32,
                run: view.image.run(),
                alpha: if view.image.is_transparent() {
                    alphas.len() as u32 + 1
                } else {
                    0
                },
                ..camera(&view.camera, world_from_cam, frame)
            });
            alphas.extend_from_slice(view.image.alpha());
            let words: Vec<u32> = view.image.words().map(|word| word as u32).collect();
            gpu.write(&pixels, first, &words);
            first += words.len();
        }
        alphas.resize(alphas.len().next_multiple_of(4), 0);
        let alphas = alphas
            .as_chunks()
            .0
            .iter()
            .map(|bytes| u32::from_le_bytes(*bytes));
        Ok(Self {
            cameras: gpu.filled("cameras", &cameras)?,
            alphas: gpu.filled("alphas", &alphas.collect::<Vec<_>>())?,
            pixels,
        })
    }

    /// Returns the uniform of a step. Observations, rays, weight of a pull and step size are still 0.
    pub fn step(&self, seed: u64, number: u64) -> Step {
        Step {
            seed: halves(seed),
            number: halves(number),
            pixels: self.pixels.len() as u32,
            share: SHARE as u32,
            views: self.cameras.len() as u32,
            ..bytemuck::Zeroable::zeroed()
        }
    }
}

/// Returns a camera as kernels see it, in the frame of the box. It keeps every pixel, from the first.
pub fn camera(camera: &Camera, world_from_cam: &Pose, frame: &Frame) -> ViewCamera {
    let centre = frame.inward(&world_from_cam.translation);
    let row = |axis: usize| {
        let turn = [0, 1, 2].map(|column| world_from_cam.rotation[(axis, column)] as f32);
        [turn[0], turn[1], turn[2], centre[axis] as f32]
    };
    ViewCamera {
        lens: [camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px].map(|number| number as f32),
        distortion: [camera.k1, camera.k2, camera.p1, camera.p2].map(|number| number as f32),
        row_x: row(0),
        row_y: row(1),
        row_z: row(2),
        first: 0,
        run: 1,
        width: camera.width,
        height: camera.height,
        alpha: 0,
        pad: [0; 3],
    }
}

/// Returns observations as kernels see them. They must be made again whenever the steps are.
pub fn observed(observations: &[Observation], steps: &Steps) -> Vec<Observed> {
    let one = |observation: &Observation| {
        let at = observation.place_and_share(steps);
        Observed {
            pixel: observation.pixel as u32,
            place: at.map_or(0.0, |at| at.place),
            share: at.map_or(0.0, |at| at.share),
        }
    };
    observations.iter().map(one).collect()
}

fn newton_head() -> String {
    format!("const NEWTON_STEPS: u32 = {}u;\n", Camera::NEWTON_STEPS)
}

/// Draws the rays of a training step.
pub struct DrawRays(Kernel);

impl DrawRays {
    /// Compiles the kernel.
    ///
    /// # Errors
    /// A driver that does not.
    pub fn new(gpu: &Gpu) -> Result<Self, GpuError> {
        let head = format!(
            "{}const PURPOSE: u32 = {}u;\nconst HIDDEN: u32 = {HIDDEN}u;\nconst DRAWS: u32 = {DRAWS}u;\n",
            newton_head(),
            Purpose::Rays as u32
        );
        Ok(Self(gpu.kernel(&RAYS, &head)?))
    }

    /// Binds it, one thread a ray.
    pub fn bind(
        &self,
        gpu: &Gpu,
        step: &Array<Step>,
        photos: &Photos,
        observations: &Array<Observed>,
        rays: &RayArrays,
    ) -> Bound {
        let parts = [
            step.into(),
            (&photos.cameras).into(),
            (&photos.pixels).into(),
            observations.into(),
            (&rays.origins).into(),
            (&rays.directions).into(),
            (&rays.targets).into(),
            (&rays.pulls).into(),
            (&photos.alphas).into(),
        ];
        gpu.bind(&self.0, &parts)
    }
}

/// Sets out the rays of a picture.
pub struct ViewRays(Kernel);

impl ViewRays {
    /// Compiles the kernel.
    ///
    /// # Errors
    /// A driver that does not.
    pub fn new(gpu: &Gpu) -> Result<Self, GpuError> {
        Ok(Self(gpu.kernel(&VIEW_RAYS, &newton_head())?))
    }

    /// Binds it, one thread a pixel. Only `origins` and `directions` of the rays are written.
    pub fn bind(&self, gpu: &Gpu, asked: &Array<PixelRange>, rays: &RayArrays, progress: &Progress) -> Bound {
        let parts = [
            asked.into(),
            (&rays.origins).into(),
            (&rays.directions).into(),
            (&progress.next_step).into(),
            (&progress.done).into(),
        ];
        gpu.bind(&self.0, &parts)
    }
}
