//! Rays of a picture: what they gather round by round, and their pixels.

use marf_shaders::{self as shaders, FinishRun, PaintRun, counts};

use super::array::{Array, Part};
use super::batch::Batch;
use super::kernel::{Kernel, one_each};
use super::light::Columns;
use super::nets::limits;
use super::record::{Work, dispatch, dispatch_rays};
use marf_field::GpuError;

/// Rows of a ray's state: optical depth, colour, distance, remaining transmittance.
pub const STATE: usize = 6;
/// Optical depth that ends a ray: e^-9.3 is below [`marf_field::cpu::composite::OPAQUE`].
pub const DEEP: f32 = 9.3;
/// Rows of a picture: colour, opacity, depth.
pub const PICTURE: usize = 5;

/// The kernels of pictures.
pub struct Picture {
    begin: Kernel,
    paint: Kernel,
    finish: Kernel,
    /// Of the box, world units.
    half_side: f32,
}

impl Picture {
    /// Compiles them for a box of this half side, world units.
    ///
    /// # Errors
    /// [`GpuError::Kernel`].
    pub fn new(gpu: &super::Gpu, half_side: f32) -> Result<Self, GpuError> {
        let head = limits();
        Ok(Self {
            begin: gpu.entry(&shaders::PAINT, &head, "begin")?,
            paint: gpu.kernel(&shaders::PAINT, &head)?,
            finish: gpu.kernel(&shaders::FINISH, &head)?,
            half_side,
        })
    }

    /// Binds the start of all rays and the compositing of a round, to be recorded one after the other.
    ///
    /// `state`: f32 `[STATE][rays]`, whose first row is the optical depth in front of the next round.
    /// `columns.spans` lists the kept samples of the rays. `shown` is u32 `[2][rays]` of `Light::opacity`.
    ///
    /// # Errors
    /// The memory of a uniform.
    pub fn paint(
        &self,
        batch: Batch<'_>,
        columns: Columns<'_>,
        rgb: Part<'_>,
        shown: &Array<u32>,
        state: &Array<f32>,
    ) -> Result<[Work; 2], GpuError> {
        let run = PaintRun {
            slot: counts::RAYS,
            capacity: batch.capacity as u32,
            rays: batch.rays as u32,
            deep: DEEP,
        };
        let run = batch.gpu.uniform("paint", run)?;
        let parts = [
            (&run).into(),
            state.into(),
            batch.counts.into(),
            columns.spans.into(),
            columns.light.into(),
            rgb,
            columns.along.into(),
            shown.into(),
        ];
        Ok([
            dispatch(batch.gpu, &self.begin, &parts[..2], one_each(batch.rays)),
            dispatch_rays(batch, &self.paint, &parts, one_each),
        ])
    }

    /// Binds the pixels, f32 `[PICTURE][rays]`, of rays that have ended.
    ///
    /// `background`: f32 `[3][16]`, `None` for black.
    ///
    /// # Errors
    /// The memory of a uniform.
    pub fn finish(
        &self,
        batch: Batch<'_>,
        directions: &Array<[f32; 4]>,
        background: Option<Part<'_>>,
        state: &Array<f32>,
        picture: &Array<f32>,
    ) -> Result<Work, GpuError> {
        let run = FinishRun {
            slot: counts::RAYS,
            rays: batch.rays as u32,
            behind: u32::from(background.is_some()),
            half_side: self.half_side,
        };
        let run = batch.gpu.uniform("finish", run)?;
        let parts = [
            (&run).into(),
            batch.counts.into(),
            state.into(),
            directions.into(),
            // A stand-in for a missing array is not read.
            background.unwrap_or(state.into()),
            picture.into(),
        ];
        Ok(dispatch(batch.gpu, &self.finish, &parts, one_each(batch.rays)))
    }
}
