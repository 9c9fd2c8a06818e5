//! Light along the rays of a batch: opacities, what shows, colours, the loss and its slopes.

use marf_shaders::{self as shaders, CompareRun, Extent, Pace, SpreadRun, Total, counts};

use super::Gpu;
use super::array::{Array, Part};
use super::kernel::Kernel;
use super::nets::{Batch, limits, one_each};
use super::record::{Work, dispatch};
use crate::Config;
use crate::GpuError;
use crate::cpu::march::Steps;
use crate::depth::{FLOOR, REACH};

/// Totals that wait for the host.
pub const RING: usize = 16;

/// Columns of samples of the same rays.
#[derive(Clone, Copy)]
pub struct Columns<'a> {
    /// u32 `[4][rays]`: first sample and number of visited samples, then of kept ones, which are the first of every ray.
    pub spans: &'a Array<u32>,
    /// f32 `[3][capacity]`: distance, length, place.
    pub along: &'a Array<f32>,
    /// f32 `[.][capacity]`, outputs of the density network; row 0 is the raw density.
    pub density: &'a Array<f32>,
    /// f32 `[3][capacity]`: optical depth, opacity, transmittance.
    pub light: &'a Array<f32>,
}

/// What colours are made of.
#[derive(Clone)]
pub struct Colours<'a> {
    /// f32 `[3][capacity]`.
    pub logits: Part<'a>,
    /// f32 `[3][capacity]`.
    pub rgb: Part<'a>,
}

impl<'a> Colours<'a> {
    /// Takes f32 `[6][capacity]` apart: colours, then logits.
    pub fn of(colours: &'a Array<f32>) -> Self {
        let half = colours.len() / 2;
        Self {
            logits: colours.part(half, half),
            rgb: colours.part(0, half),
        }
    }
}

/// What rays are compared with.
#[derive(Clone)]
pub struct Aims<'a> {
    /// `[rays]`: direction, and 1 where there is a ray.
    pub directions: &'a Array<[f32; 4]>,
    /// `[rays]`: pixel, and the bits of the view.
    pub targets: &'a Array<[f32; 4]>,
    /// `[views]` log gains, then as many offsets if photos have them; the fourth number is unused.
    pub gains: &'a Array<[f32; 4]>,
    /// Photos.
    pub views: usize,
    /// f32 `[3][16]`; `None` for black.
    pub background: Option<Part<'a>>,
    /// f32 `[found::LEN][rays]`.
    pub found: &'a Array<f32>,
    /// Receives the parts of the background's gradient, where there is one: of `Layers::behind`.
    pub parts: Part<'a>,
}

/// The kernels of light.
pub struct Light {
    opacity: Kernel,
    kept: Kernel,
    totals: Kernel,
}

impl Light {
    /// Compiles them, but `compare` and `spread`: these bind ten storage buffers, and are compiled when they are bound, so that
    /// a device of eight renders.
    ///
    /// # Errors
    /// [`GpuError::Kernel`].
    pub fn new(gpu: &Gpu) -> Result<Self, GpuError> {
        let head = limits();
        Ok(Self {
            opacity: gpu.kernel(&shaders::OPACITY, &head)?,
            kept: gpu.kernel(&shaders::KEPT, "")?,
            totals: gpu.kernel(&shaders::TOTALS, "")?,
        })
    }

    /// Binds opacities and transmittances of visited samples; `slot` is the place in `counts` of the rays in use.
    ///
    /// `before`: f32 `[rays]`, optical depth in front of the first sample (more numbers may follow).
    /// `shown`: u32 `[2][rays]`, receives the samples that show and the bits of the optical depth of all.
    ///
    /// # Errors
    /// The memory of a uniform.
    pub fn opacity(
        &self,
        batch: Batch<'_>,
        slot: u32,
        columns: Columns<'_>,
        before: &Array<f32>,
        shown: &Array<u32>,
    ) -> Result<Work, GpuError> {
        let extent = extent(batch, slot)?;
        let parts = [
            (&extent).into(),
            batch.counts.into(),
            columns.spans.into(),
            columns.density.into(),
            columns.along.into(),
            before.into(),
            columns.light.into(),
            shown.into(),
            batch.faults.into(),
        ];
        Ok(dispatch(batch.gpu, &self.opacity, &parts, one_each(batch.rays)))
    }

    /// Binds the list of kept samples, u32 `[capacity]`, from the spans of `Columns`.
    ///
    /// # Errors
    /// The memory of a uniform.
    pub fn kept(
        &self,
        batch: Batch<'_>,
        slot: u32,
        spans: &Array<u32>,
        origin: &Array<u32>,
    ) -> Result<Work, GpuError> {
        let extent = extent(batch, slot)?;
        let parts = [(&extent).into(), batch.counts.into(), spans.into(), origin.into()];
        Ok(dispatch(batch.gpu, &self.kept, &parts, one_each(batch.rays)))
    }

    /// Binds the loss of every ray, its slopes in colour and exposure, and the parts of the background's gradient.
    ///
    /// # Errors
    /// The memory of a uniform, [`GpuError::Kernel`].
    pub fn compare(
        &self,
        batch: Batch<'_>,
        columns: Columns<'_>,
        rgb: Part<'_>,
        aims: Aims<'_>,
    ) -> Result<Work, GpuError> {
        let run = CompareRun {
            slot: counts::RAYS,
            capacity: batch.capacity as u32,
            rays: batch.rays as u32,
            views: aims.views as u32,
            offsets: u32::from(aims.gains.len() >= 2 * aims.views),
            behind: u32::from(aims.background.is_some()),
            ..CompareRun::default()
        };
        let run = batch.gpu.uniform("compare", run)?;
        let parts = [
            (&run).into(),
            batch.counts.into(),
            columns.spans.into(),
            columns.light.into(),
            rgb.clone(),
            aims.directions.into(),
            aims.targets.into(),
            aims.gains.into(),
            // What is bound in place of none is not read.
            aims.background.unwrap_or(rgb),
            aims.found.into(),
            batch.faults.into(),
            aims.parts,
        ];
        let kernel = batch.gpu.kernel(&shaders::COMPARE, &limits())?;
        Ok(dispatch(batch.gpu, &kernel, &parts, one_each(batch.rays)))
    }

    /// Binds the slopes of kept samples: in raw density to row 0 of `columns.light`, in logits to rows 0 to 2 of
    /// `d_logits`, f32 `[3][capacity]`. `pulls`: `[rays]`, place and weight.
    ///
    /// # Errors
    /// [`GpuError::Kernel`].
    pub fn spread(
        &self,
        batch: Batch<'_>,
        run: &Array<SpreadRun>,
        (columns, colours): (Columns<'_>, Colours<'_>),
        [found, d_logits]: [&Array<f32>; 2],
        pulls: &Array<[f32; 2]>,
    ) -> Result<Work, GpuError> {
        let parts = [
            run.into(),
            batch.counts.into(),
            columns.spans.into(),
            colours.rgb,
            columns.along.into(),
            columns.density.into(),
            colours.logits,
            found.into(),
            pulls.into(),
            columns.light.into(),
            d_logits.into(),
        ];
        let kernel = batch.gpu.kernel(&shaders::SPREAD, &limits())?;
        Ok(dispatch(batch.gpu, &kernel, &parts, one_each(batch.rays)))
    }

    /// Binds the totals of a step for the host; `loss` is f32 `[rays]`, row `found::LOSS` of what `compare` found.
    ///
    /// # Errors
    /// The memory of a uniform.
    pub fn totals(
        &self,
        batch: Batch<'_>,
        pace: &Array<Pace>,
        loss: Part<'_>,
        ring: &Array<Total>,
    ) -> Result<Work, GpuError> {
        let extent = extent(batch, counts::RAYS)?;
        let parts = [
            (&extent).into(),
            pace.into(),
            batch.counts.into(),
            batch.faults.into(),
            loss,
            ring.into(),
        ];
        Ok(dispatch(batch.gpu, &self.totals, &parts, [1, 1, 1]))
    }
}

fn extent(batch: Batch<'_>, slot: u32) -> Result<Array<Extent>, GpuError> {
    let extent = Extent {
        slot,
        capacity: batch.capacity as u32,
        rays: batch.rays as u32,
        pad: 0,
    };
    batch.gpu.uniform("extent", extent)
}

/// Returns what `spread` needs to know of the losses; to be written anew when the steps along rays change.
pub fn weights_of_losses(batch: Batch<'_>, config: &Config, steps: &Steps) -> SpreadRun {
    SpreadRun {
        slot: counts::RAYS,
        capacity: batch.capacity as u32,
        rays: batch.rays as u32,
        distortion: config.distortion as f32,
        cell: 1.0 / steps.count as f32,
        emptiness: config.emptiness as f32,
        reach: REACH,
        floor: FLOOR,
    }
}
