//! A multilayer perceptron without biases, with ReLU between the layers.

use super::gemm::{After, Outer, Product};
use super::simd::{Block, InstructionSet, LANES, Run, flat, flat_mut};
use marf_numeric::Rng;

/// One layer. Both widths are multiples of 16.
#[derive(Clone, Debug, PartialEq)]
pub struct Layer {
    /// Width of the input.
    pub inputs: usize,
    /// Width of the output.
    pub outputs: usize,
    /// `[inputs, outputs]`.
    pub weights: Vec<Block>,
    /// `[outputs, inputs]`, for the gradient of the input. Follows `weights`.
    transposed: Vec<Block>,
}

impl Layer {
    fn new(inputs: usize, outputs: usize) -> Self {
        let blocks = inputs * outputs / LANES;
        Self {
            inputs,
            outputs,
            weights: vec![Block::default(); blocks],
            transposed: vec![Block::default(); blocks],
        }
    }

    /// Copies the weights into their transposed form. Call it after they changed.
    pub fn refresh(&mut self) {
        let transposed = flat_mut(&mut self.transposed);
        for (input, row) in flat(&self.weights).chunks_exact(self.outputs).enumerate() {
            for (output, weight) in row.iter().enumerate() {
                transposed[output * self.inputs + input] = *weight;
            }
        }
    }
}

/// Gradients on their way back through the layers, row by row.
#[derive(Default)]
pub struct Slopes {
    /// Those of the outputs of one layer.
    pub rows: Vec<Block>,
    /// Memory for those of the layer below.
    spare: Vec<Block>,
}

/// Layers in order.
#[derive(Clone, Debug, PartialEq)]
pub struct Net {
    /// The layers.
    pub layers: Vec<Layer>,
    /// Outputs that a loss may depend on, the first ones: the gradients of the others are zero.
    used: usize,
    /// Blocks of the input whose gradients are wanted, the first ones.
    wanted: usize,
}

impl Net {
    /// Returns a network of zero weights. `widths` are those of input, hidden layers and output.
    pub fn new(widths: &[usize]) -> Self {
        let layers = widths.windows(2).map(|pair| Layer::new(pair[0], pair[1]));
        Self {
            layers: layers.collect(),
            used: widths.last().copied().unwrap_or_default(),
            wanted: widths.first().map_or(0, |inputs| inputs / LANES),
        }
    }

    /// Returns the network with gradients of only the first `used` outputs, carried back to only the first `wanted` blocks of
    /// the input.
    pub fn carrying(self, used: usize, wanted: usize) -> Self {
        Self { used, wanted, ..self }
    }

    /// Draws weights uniform in +-sqrt(6 / (inputs + outputs)) (Glorot and Bengio 2010).
    pub fn randomise(&mut self, rng: &mut Rng) {
        for layer in &mut self.layers {
            let limit = (6.0 / (layer.inputs + layer.outputs) as f32).sqrt();
            for weight in flat_mut(&mut layer.weights) {
                *weight = limit * 2.0_f32.mul_add(rng.unit_f32(), -1.0);
            }
            layer.refresh();
        }
    }

    /// Gives `gradients` one buffer a layer and leaves their contents unchanged.
    pub fn shape_gradients(&self, gradients: &mut Vec<Vec<Block>>) {
        gradients.resize_with(self.layers.len(), Vec::new);
        for (layer, gradient) in self.layers.iter().zip(gradients) {
            gradient.resize(layer.weights.len(), Block::default());
        }
    }

    /// Runs rows through all layers. `activations[l]` receives the output of layer l.
    pub fn forward(&self, level: InstructionSet, input: &[Block], activations: &mut Vec<Vec<Block>>) {
        activations.resize_with(self.layers.len(), Vec::new);
        let rows = self
            .layers
            .first()
            .map_or(0, |layer| input.len() * LANES / layer.inputs);
        for (index, layer) in self.layers.iter().enumerate() {
            let (before, here) = activations.split_at_mut(index);
            here[0].resize(rows * layer.outputs / LANES, Block::default());
            let last = index + 1 == self.layers.len();
            level.run(Product {
                a: before.last().map_or(input, Vec::as_slice),
                b: &layer.weights,
                c: &mut here[0],
                inner: layer.inputs,
                steps: layer.inputs,
                across: layer.outputs / LANES,
                columns: layer.outputs / LANES,
                after: if last { After::Nothing } else { After::Relu },
            });
        }
    }

    /// Carries gradients back.
    ///
    /// `slopes` hold the gradient of the output, zero where it is not used, and receive that of the input, as many blocks a row as
    /// are wanted. `gradients` are overwritten.
    pub fn backward(
        &self,
        level: InstructionSet,
        input: &[Block],
        activations: &[Vec<Block>],
        slopes: &mut Slopes,
        gradients: &mut [Vec<Block>],
    ) {
        let Slopes { rows: slope, spare } = slopes;
        for (index, layer) in self.layers.iter().enumerate().rev() {
            let below = if index == 0 {
                input
            } else {
                &activations[index - 1]
            };
            level.run(Outer {
                a: below,
                d: slope,
                g: &mut gradients[index],
                inner: layer.inputs,
                columns: layer.outputs / LANES,
            });
            let across = layer.inputs / LANES;
            let columns = if index > 0 { across } else { self.wanted };
            spare.resize(below.len() / across * columns, Block::default());
            let last = index + 1 == self.layers.len();
            level.run(Product {
                a: slope,
                b: &layer.transposed,
                c: spare,
                inner: layer.outputs,
                steps: if last { self.used } else { layer.outputs },
                across,
                columns,
                after: if index > 0 {
                    After::Gate(below)
                } else {
                    After::Nothing
                },
            });
            std::mem::swap(slope, spare);
        }
    }
}
