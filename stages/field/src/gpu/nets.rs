//! Layers on the device: products, gradients of weights, Adam.

use marf_shaders::{self as shaders, AdamNet, OuterRun, Pace, ProductRun, SumRun, TransposeRun};

use super::Gpu;
use super::array::{Array, Part};
use super::kernel::{GROUP, Kernel, fold};
use super::record::{Work, dispatch};
use crate::GpuError;
use crate::cpu::adam::{BETA1, BETA2, Bias};
use crate::cpu::composite::{LOGIT_LIMIT, OPAQUE, RAW_LIMIT, RAW_SHIFT, RUNAWAY};
use crate::schedule::EPSILON;

/// Samples of a thread of the products.
const LANES: usize = 4;
/// Samples whose gradients are one part of a sum: a batch of 2^16 then has 512 parts of a layer, each of some tiles,
/// which keeps tens of thousands of threads busy. No less: parts would take more memory than the widest columns.
pub const CHUNK: usize = 128;
/// Weights of a workgroup of the kernel `sum`, whose other axis is as many slices of the parts.
const SUMMED: usize = 16;

/// Returns the head of kernels that look at the limits of the field's numbers.
pub fn limits() -> String {
    let limits = shaders::Limits {
        runaway: RUNAWAY,
        raw: RAW_LIMIT,
        shift: RAW_SHIFT,
        logit: LOGIT_LIMIT,
        opaque: OPAQUE,
    };
    limits.head()
}

/// What all kernels of a batch share.
#[derive(Clone, Copy)]
pub struct Batch<'a> {
    /// The device.
    pub gpu: &'a Gpu,
    /// u32 `[counts::LEN]`.
    pub counts: &'a Array<u32>,
    /// u32 `[faults::LEN]`.
    pub faults: &'a Array<u32>,
    /// Samples a column, a multiple of 256.
    pub capacity: usize,
    /// Rays a column, a multiple of 64.
    pub rays: usize,
}

/// Returns the workgroups of a kernel with a thread for each of so many things.
pub fn one_each(things: usize) -> [usize; 3] {
    fold(things.div_ceil(GROUP))
}

/// Returns the workgroups of a kernel whose threads take 4 samples of a row, or of several.
pub fn four_each(capacity: usize, rows: usize) -> [usize; 3] {
    [capacity.div_ceil(LANES * GROUP), rows, 1]
}

/// Rows of an array of columns, from one on.
#[derive(Clone)]
pub struct Rows<'a> {
    /// f32 `[.][capacity]`.
    pub part: Part<'a>,
    /// The first row that counts.
    pub first: usize,
}

impl<'a> From<&'a Array<f32>> for Rows<'a> {
    fn from(array: &'a Array<f32>) -> Self {
        Self {
            part: array.into(),
            first: 0,
        }
    }
}

/// What is done to a finished sum.
#[derive(Clone)]
pub enum After<'a> {
    /// Stored as it is.
    Nothing,
    /// Negative sums become 0.
    Relu,
    /// Becomes 0 unless the number here, f32 `[outputs][capacity]`, is above 0: the slope of a ReLU.
    Gate(Part<'a>),
}

/// C = after(A B) over all samples in use.
#[derive(Clone)]
pub struct Product<'a> {
    /// Input, `inner` rows.
    pub a: Rows<'a>,
    /// Weights, f32 `[inner][outputs]`.
    pub b: Part<'a>,
    /// Receives `outputs` rows.
    pub c: Rows<'a>,
    /// `[inner, outputs]`; `outputs` is a multiple of 8.
    pub shape: [usize; 2],
    /// What happens to the sums.
    pub after: After<'a>,
}

/// G = sum over all samples in use of A D^T.
#[derive(Clone)]
pub struct Gradient<'a> {
    /// Inputs of the layer, `inner` rows.
    pub a: Rows<'a>,
    /// Slopes of its outputs, `outputs` rows.
    pub d: Rows<'a>,
    /// `[inner, outputs]`, multiples of 4 and 8.
    pub shape: [usize; 2],
    /// Numbers a column of A and D.
    pub capacity: usize,
    /// Memory for [`Gradient::parts`] numbers; layers may share it.
    pub parts: Part<'a>,
    /// Receives f32 `[inner][outputs]`.
    pub gradient: Part<'a>,
    /// What a sum that runs away is.
    pub fault: u32,
}

impl Gradient<'_> {
    /// Returns the numbers that the parts of a gradient take.
    pub fn parts(capacity: usize, [inner, outputs]: [usize; 2]) -> usize {
        capacity.div_ceil(CHUNK) * inner * outputs
    }
}

/// A tensor that Adam moves, in rows of 16 numbers.
#[derive(Clone)]
pub struct Tensor<'a> {
    /// f32 `[rows][16]`.
    pub weights: Part<'a>,
    /// f32 `[rows][16]`; 0 afterwards.
    pub gradient: Part<'a>,
    /// f32 `[rows][16]`.
    pub mean: Part<'a>,
    /// f32 `[rows][16]`.
    pub square: Part<'a>,
    /// u32 `[rows]`.
    pub count: Part<'a>,
    /// Rows.
    pub rows: usize,
    /// Step size in learning rates, and pull to zero.
    pub rates: [f32; 2],
}

/// What all tensors share with Adam.
#[derive(Clone, Copy)]
pub struct Rates<'a> {
    /// The uniform that holds the learning rate.
    pub pace: &'a Array<Pace>,
    /// From [`Nets::bias`].
    pub bias: &'a Array<[f32; 2]>,
}

/// The kernels of layers.
pub struct Nets {
    plain: Kernel,
    rectified: Kernel,
    gated: Kernel,
    transpose: Kernel,
    outer: Kernel,
    sum: Kernel,
    adam: Kernel,
}

impl Nets {
    /// Compiles them.
    ///
    /// # Errors
    /// [`GpuError::Kernel`].
    pub fn new(gpu: &Gpu) -> Result<Self, GpuError> {
        Ok(Self {
            plain: gpu.kernel(&shaders::PRODUCT, "")?,
            rectified: gpu.entry(&shaders::PRODUCT, "", "rectified")?,
            gated: gpu.entry(&shaders::PRODUCT, "", "gated")?,
            transpose: gpu.kernel(&shaders::TRANSPOSE, "")?,
            outer: gpu.kernel(&shaders::OUTER, "")?,
            sum: gpu.kernel(&shaders::SUM, &limits())?,
            adam: gpu.kernel(&shaders::ADAM_NET, "")?,
        })
    }

    /// Binds a product; `slot` is the place in `counts` of the samples in use.
    ///
    /// # Errors
    /// The memory of a uniform.
    pub fn product(&self, batch: Batch<'_>, slot: u32, layer: Product<'_>) -> Result<Work, GpuError> {
        let [inner, outputs] = layer.shape;
        let run = ProductRun {
            inner: inner as u32,
            outputs: outputs as u32,
            capacity: batch.capacity as u32,
            slot,
            first_a: layer.a.first as u32,
            first_c: layer.c.first as u32,
            ..ProductRun::default()
        };
        let run = batch.gpu.uniform("product", run)?;
        let mut parts = vec![
            (&run).into(),
            batch.counts.into(),
            layer.a.part,
            layer.b,
            layer.c.part,
        ];
        let kernel = match layer.after {
            After::Nothing => &self.plain,
            After::Relu => &self.rectified,
            After::Gate(gate) => {
                parts.push(gate);
                &self.gated
            }
        };
        let groups = four_each(batch.capacity, outputs / 8);
        Ok(dispatch(batch.gpu, kernel, &parts, groups))
    }

    /// Binds the copy of weights `[inputs, outputs]` to `turned`, `[outputs, inputs]`.
    ///
    /// # Errors
    /// The memory of a uniform.
    pub fn transpose(
        &self,
        gpu: &Gpu,
        [inputs, outputs]: [usize; 2],
        weights: Part<'_>,
        turned: Part<'_>,
    ) -> Result<Work, GpuError> {
        let run = TransposeRun {
            inputs: inputs as u32,
            outputs: outputs as u32,
        };
        let run = gpu.uniform("transpose", run)?;
        let groups = one_each(inputs * outputs);
        Ok(dispatch(
            gpu,
            &self.transpose,
            &[(&run).into(), weights, turned],
            groups,
        ))
    }

    /// Binds the gradient of a layer's weights: parts, then their sum.
    ///
    /// # Errors
    /// The memory of a uniform.
    pub fn gradient(&self, batch: Batch<'_>, slot: u32, layer: Gradient<'_>) -> Result<Work, GpuError> {
        let [inner, outputs] = layer.shape;
        let outer = OuterRun {
            inner: inner as u32,
            outputs: outputs as u32,
            capacity: layer.capacity as u32,
            slot,
            chunk: CHUNK as u32,
            first_a: layer.a.first as u32,
            first_d: layer.d.first as u32,
            pad: 0,
        };
        let sum = SumRun {
            weights: (inner * outputs) as u32,
            slot,
            chunk: CHUNK as u32,
            fault: layer.fault,
        };
        let outer = batch.gpu.uniform("outer", outer)?;
        let sum = batch.gpu.uniform("sum", sum)?;
        let counts = Part::from(batch.counts);
        let parts = layer.parts;
        let threads = layer.capacity.div_ceil(CHUNK) * (inner / 4) * (outputs / 8);
        let first = [
            (&outer).into(),
            counts.clone(),
            layer.a.part,
            layer.d.part,
            parts.clone(),
        ];
        let then = [(&sum).into(), counts, parts, layer.gradient, batch.faults.into()];
        let outer = dispatch(batch.gpu, &self.outer, &first, one_each(threads));
        let groups = fold((inner * outputs).div_ceil(SUMMED));
        let sum = dispatch(batch.gpu, &self.sum, &then, groups);
        Ok(outer.then(sum))
    }

    /// Binds a step of Adam, which does nothing once there is a fault.
    ///
    /// # Errors
    /// The memory of a uniform.
    pub fn adam(&self, batch: Batch<'_>, rates: Rates<'_>, tensor: Tensor<'_>) -> Result<Work, GpuError> {
        let run = AdamNet {
            rows: tensor.rows as u32,
            last: rates.bias.len().saturating_sub(1) as u32,
            factor: tensor.rates[0],
            decay: tensor.rates[1],
            epsilon: EPSILON,
            beta1: BETA1,
            beta2: BETA2,
            pad: 0,
        };
        let run = batch.gpu.uniform("adam of nets", run)?;
        let parts = [
            (&run).into(),
            rates.pace.into(),
            batch.faults.into(),
            rates.bias.into(),
            tensor.weights,
            tensor.gradient,
            tensor.mean,
            tensor.square,
            tensor.count,
        ];
        Ok(dispatch(batch.gpu, &self.adam, &parts, one_each(tensor.rows)))
    }

    /// Uploads the table of Adam's corrections.
    ///
    /// # Errors
    /// The memory.
    pub fn bias(gpu: &Gpu, bias: &Bias) -> Result<Array<[f32; 2]>, GpuError> {
        gpu.filled("bias", bias.corrections())
    }
}
