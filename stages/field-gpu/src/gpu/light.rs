//! Light along the rays of a batch: opacities, what shows, colours, the loss and its slopes.

use marf_shaders::{self as shaders, APART, CompareRun, Extent, Pace, SpreadRun, Target, Total, counts};

use super::Gpu;
use super::array::{Array, Part};
use super::batch::Batch;
use super::kernel::{Kernel, one_each};
use super::march::{lanes_each, lanes_head};
use super::nets::limits;
use super::record::{Work, dispatch, dispatch_rays};
use marf_field::GpuError;
use marf_field::depth::{FLOOR, REACH};
use marf_field::training::Training;

/// Totals that wait for the host.
pub const RING: usize = 16;

/// Columns of samples of the same rays.
#[derive(Clone, Copy)]
pub struct Columns<'a> {
    /// u32 `[4][rays]`: first sample and number of visited samples, then of kept ones.
    pub spans: &'a Array<u32>,
    /// f32 `[3][capacity]`: distance, length, place. For kept samples, the first of every ray once `opacity`
    /// has chosen them.
    pub along: &'a Array<f32>,
    /// f32 `[.][capacity]`, outputs of the density network. Row 0 is the raw density.
    pub density: &'a Array<f32>,
    /// f32 `[3][capacity]`: optical depth, opacity, transmittance. Those of kept samples are the first of
    /// every ray.
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
    pub fn new(colours: &'a Array<f32>) -> Self {
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
    /// `[rays]`: pixel, view, and what is behind.
    pub targets: &'a Array<Target>,
    /// `[views]` log gains, then as many offsets if photos have them. The fourth number is unused.
    pub gains: &'a Array<[f32; 4]>,
    /// Photos.
    pub views: usize,
    /// f32 `[3][16]`. `None` for black.
    pub background: Option<Part<'a>>,
    /// f32 `[found::LEN][rays]`.
    pub found: &'a Array<f32>,
    /// Receives the parts of the background's gradient, where there is one: of `Layers::behind`.
    pub parts: Part<'a>,
}

/// What the slopes of samples follow from, and where they go.
#[derive(Clone, Copy)]
pub struct SlopeArrays<'a> {
    /// f32 `[found::LEN][rays]`: of `compare`.
    pub found: &'a Array<f32>,
    /// `[rays]`, place and weight of a pull.
    pub pulls: &'a Array<[f32; 2]>,
    /// Receives the slopes of kept samples, f32 `[4][capacity]`: in the logits, then in the raw density.
    pub d_outputs: &'a Array<f32>,
}

/// Returns the workgroups of kernels that walk along `rays` rays.
fn apart_each(rays: usize) -> [usize; 3] {
    one_each(APART * rays)
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
            kept: gpu.kernel(&shaders::KEPT, &lanes_head())?,
            totals: gpu.kernel(&shaders::TOTALS, "")?,
        })
    }

    /// Binds opacities and transmittances of visited samples and the choice of the kept ones, set by the
    /// uniform `chosen`: see [`BatchSize::extent`](super::batch::BatchSize::extent).
    ///
    /// `before`: f32 `[rays]`, optical depth in front of the first sample (more numbers may follow). `shown`: u32
    /// [`BatchSize::shown_words`](super::batch::BatchSize::shown_words), receives the number of kept samples of
    /// every ray, the bits of its optical depth, then the indices of the kept samples.
    pub fn opacity(
        &self,
        batch: Batch<'_>,
        chosen: &Array<Extent>,
        columns: Columns<'_>,
        before: &Array<f32>,
        shown: &Array<u32>,
    ) -> Work {
        let parts = [
            chosen.into(),
            batch.counts.into(),
            columns.spans.into(),
            columns.density.into(),
            columns.along.into(),
            before.into(),
            columns.light.into(),
            shown.into(),
            batch.faults.into(),
        ];
        dispatch_rays(batch, &self.opacity, &parts, apart_each)
    }

    /// Binds the list of kept samples, u32 `[capacity]`, from the spans of `Columns` and what `opacity` chose.
    ///
    /// # Errors
    /// The memory of a uniform.
    pub fn kept(
        &self,
        batch: Batch<'_>,
        spans: &Array<u32>,
        shown: &Array<u32>,
        origin: &Array<u32>,
    ) -> Result<Work, GpuError> {
        let extent = batch.gpu.uniform("extent", batch.size().extent(0))?;
        let parts = [
            (&extent).into(),
            batch.counts.into(),
            spans.into(),
            shown.into(),
            origin.into(),
        ];
        Ok(dispatch_rays(batch, &self.kept, &parts, lanes_each))
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
            // A stand-in for a missing array is not read.
            aims.background.unwrap_or(rgb),
            aims.found.into(),
            batch.faults.into(),
            aims.parts,
        ];
        let kernel = batch.gpu.kernel(&shaders::COMPARE, &limits())?;
        Ok(dispatch_rays(batch, &kernel, &parts, one_each))
    }

    /// Binds the slopes of kept samples.
    ///
    /// # Errors
    /// [`GpuError::Kernel`].
    pub fn spread(
        &self,
        batch: Batch<'_>,
        run: &Array<SpreadRun>,
        columns: Columns<'_>,
        colours: Colours<'_>,
        slopes: SlopeArrays<'_>,
    ) -> Result<Work, GpuError> {
        let parts = [
            run.into(),
            batch.counts.into(),
            columns.spans.into(),
            colours.rgb,
            columns.along.into(),
            colours.logits,
            slopes.found.into(),
            slopes.pulls.into(),
            columns.light.into(),
            slopes.d_outputs.into(),
        ];
        let kernel = batch.gpu.kernel(&shaders::SPREAD, &limits())?;
        Ok(dispatch_rays(batch, &kernel, &parts, apart_each))
    }

    /// Binds the totals of a step for the host. `loss` is f32 `[rays]`, row `found::LOSS` of the output of
    /// `compare`.
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
        let extent = batch.gpu.uniform("extent", batch.size().extent(0))?;
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

/// Returns the uniform of `spread` for the losses in a step.
pub fn weights_of_losses(batch: Batch<'_>, training: &Training, step: u64) -> SpreadRun {
    SpreadRun {
        slot: counts::RAYS,
        capacity: batch.capacity as u32,
        rays: batch.rays as u32,
        distortion: training.distortion_at(step),
        cell: 1.0 / training.march.count as f32,
        emptiness: training.config.emptiness as f32,
        reach: REACH,
        floor: FLOOR,
    }
}
