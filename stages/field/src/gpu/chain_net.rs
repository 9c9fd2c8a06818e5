//! A network on the device, forward and backward.

use marf_shaders::counts;

use super::array::Array;
use super::nets::{After, Gradient, Nets, Product};
use super::record::Work;
use super::rig::Rig;
use crate::cpu::net::Net;
use crate::cpu::simd::flat;
use marf_shaders::faults;

/// One network on the device.
pub struct OnDevice {
    pub shapes: Vec<[usize; 2]>,
    weights: Vec<Array<f32>>,
    turned: Vec<Array<f32>>,
    pub outputs: Vec<Array<f32>>,
    /// Slopes of the inputs of every layer.
    pub slopes: Vec<Array<f32>>,
    pub gradients: Vec<Array<f32>>,
}

impl OnDevice {
    pub fn new(rig: &Rig, net: &Net) -> Self {
        let layers = || net.layers.iter();
        let zeros = |numbers: usize| rig.gpu.zeros("numbers", numbers).unwrap();
        Self {
            shapes: layers().map(|layer| [layer.inputs, layer.outputs]).collect(),
            weights: layers().map(|layer| rig.filled(flat(&layer.weights))).collect(),
            turned: layers()
                .map(|layer| zeros(layer.inputs * layer.outputs))
                .collect(),
            outputs: layers()
                .map(|layer| zeros(layer.outputs * rig.capacity))
                .collect(),
            slopes: layers().map(|layer| zeros(layer.inputs * rig.capacity)).collect(),
            gradients: layers()
                .map(|layer| zeros(layer.inputs * layer.outputs))
                .collect(),
        }
    }

    pub fn output(&self) -> &Array<f32> {
        self.outputs.last().unwrap()
    }

    pub fn forward(&self, rig: &Rig, nets: &Nets, slot: u32, input: &Array<f32>) -> Vec<Work> {
        let last = self.shapes.len() - 1;
        let layers = self.shapes.iter().enumerate().map(|(layer, shape)| {
            let product = Product {
                a: if layer == 0 {
                    input
                } else {
                    &self.outputs[layer - 1]
                }
                .into(),
                b: (&self.weights[layer]).into(),
                c: (&self.outputs[layer]).into(),
                shape: *shape,
                after: if layer == last {
                    After::Nothing
                } else {
                    After::Relu
                },
            };
            nets.product(rig.batch(), slot, product).unwrap()
        });
        layers.collect()
    }

    /// `outputs` are the activations that belong to the samples of `slope`.
    pub fn backward(
        &self,
        rig: &Rig,
        nets: &Nets,
        (input, outputs): (&Array<f32>, &[Array<f32>]),
        slope: &Array<f32>,
        parts: &Array<f32>,
    ) -> Vec<Work> {
        let mut runs = Vec::new();
        for (layer, [inner, out]) in self.shapes.iter().copied().enumerate().rev() {
            let below = if layer == 0 { input } else { &outputs[layer - 1] };
            let slope = self.slopes.get(layer + 1).unwrap_or(slope);
            let gradient = Gradient {
                a: below.into(),
                d: slope.into(),
                shape: [inner, out],
                capacity: rig.capacity,
                parts: parts.into(),
                gradient: (&self.gradients[layer]).into(),
                fault: faults::NETWORKS,
            };
            runs.push(nets.gradient(rig.batch(), counts::KEPT, gradient).unwrap());
            let (weights, turned) = (&self.weights[layer], &self.turned[layer]);
            runs.push(
                nets.transpose(&rig.gpu, [inner, out], weights.into(), turned.into())
                    .unwrap(),
            );
            let product = Product {
                a: slope.into(),
                b: turned.into(),
                c: (&self.slopes[layer]).into(),
                shape: [out, inner],
                after: if layer == 0 {
                    After::Nothing
                } else {
                    After::Gate(below.into())
                },
            };
            runs.push(nets.product(rig.batch(), counts::KEPT, product).unwrap());
        }
        runs
    }
}
