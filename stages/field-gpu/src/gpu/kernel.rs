//! Kernels: compiled once a text, then bound to their arrays.

use marf_shaders::Shader;

use super::Gpu;
use super::array::Part;
use marf_field::GpuError;

/// Threads a workgroup of every kernel that does not say otherwise.
pub const GROUP: usize = 64;
/// Workgroups in x before they continue in y: WebGPU allows 65,535.
const MOST_GROUPS: usize = 1 << 15;

/// A compiled kernel.
#[derive(Clone)]
pub struct Kernel {
    name: &'static str,
    pipeline: wgpu::ComputePipeline,
}

/// A kernel with its buffers.
#[derive(Clone)]
pub struct Bound {
    pub(super) pipeline: wgpu::ComputePipeline,
    pub(super) group: wgpu::BindGroup,
}

impl Gpu {
    /// Compiles entry point `main` of a kernel. `head` goes before its text: the constants that decide its
    /// shape.
    ///
    /// # Errors
    /// [`GpuError::Kernel`] with the driver's message. A lost device.
    pub fn kernel(&self, shader: &Shader, head: &str) -> Result<Kernel, GpuError> {
        self.entry(shader, head, "main")
    }

    /// Compiles a named entry point of a kernel, as [`Gpu::kernel`] does `main`.
    ///
    /// # Errors
    /// As [`Gpu::kernel`].
    pub fn entry(&self, shader: &Shader, head: &str, entry: &str) -> Result<Kernel, GpuError> {
        self.check()?;
        let text = shader.source(head);
        let key = (entry.to_owned(), text.clone());
        let name = shader.name;
        let compiled = || self.pipelines.lock();
        if let Some(pipeline) = compiled().get(&key).cloned() {
            return Ok(Kernel { name, pipeline });
        }
        let pipeline = self.compile(name, text, entry)?;
        compiled().insert(key, pipeline.clone());
        Ok(Kernel { name, pipeline })
    }

    fn compile(
        &self,
        name: &'static str,
        text: String,
        entry: &str,
    ) -> Result<wgpu::ComputePipeline, GpuError> {
        let scopes = [wgpu::ErrorFilter::Validation, wgpu::ErrorFilter::Internal]
            .map(|filter| self.device.push_error_scope(filter));
        let module = self.device.create_shader_module(wgpu::ShaderModuleDescriptor {
            label: Some(name),
            source: wgpu::ShaderSource::Wgsl(text.into()),
        });
        let pipeline = self
            .device
            .create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
                label: Some(name),
                layout: None,
                module: &module,
                entry_point: Some(entry),
                // Kernels write workgroup memory before they read it.
                compilation_options: wgpu::PipelineCompilationOptions {
                    zero_initialize_workgroup_memory: false,
                    ..Default::default()
                },
                cache: None,
            });
        let mut refused = None;
        for scope in scopes.into_iter().rev() {
            refused = pollster::block_on(scope.pop()).or(refused);
        }
        match refused {
            None => Ok(pipeline),
            Some(error) => Err(GpuError::Kernel {
                kernel: name,
                adapter: self.name().to_owned(),
                message: error.to_string(),
            }),
        }
    }

    /// Gives a kernel its buffers, binding 0 first.
    pub fn bind(&self, kernel: &Kernel, parts: &[Part<'_>]) -> Bound {
        let entries: Vec<_> = parts
            .iter()
            .enumerate()
            .map(|(binding, part)| wgpu::BindGroupEntry {
                binding: binding as u32,
                resource: wgpu::BindingResource::Buffer(part.0.clone()),
            })
            .collect();
        let group = self.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some(kernel.name),
            layout: &kernel.pipeline.get_bind_group_layout(0),
            entries: &entries,
        });
        Bound {
            pipeline: kernel.pipeline.clone(),
            group,
        }
    }
}

/// Spreads workgroups over x and y. A kernel's thread is `id.x + id.y * groups.x * 64`.
pub fn fold(groups: usize) -> [usize; 3] {
    let x = groups.clamp(1, MOST_GROUPS);
    [x, groups.div_ceil(x).max(1), 1]
}

/// Returns the workgroups of a kernel with a thread for each of `things`.
pub fn one_each(things: usize) -> [usize; 3] {
    fold(things.div_ceil(GROUP))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gpu::testing::gpu;

    #[test]
    fn a_kernel_that_does_not_compile_is_refused_by_name() {
        let Some(gpu) = gpu("a_kernel_that_does_not_compile_is_refused_by_name") else {
            return;
        };
        let shader = Shader {
            name: "broken",
            shared: &[],
            text: "fn main() { let x: f32 = 1u; }",
            heads: &[],
        };
        let refused = gpu.kernel(&shader, "").err();
        assert!(
            matches!(&refused, Some(GpuError::Kernel { kernel: "broken", .. })),
            "{refused:?}"
        );
        assert_eq!(gpu.check(), Ok(()));
    }

    #[test]
    fn groups_beyond_the_limit_of_one_axis_go_on_in_the_next() {
        assert_eq!(fold(0), [1, 1, 1]);
        assert_eq!(fold(5), [5, 1, 1]);
        assert_eq!(fold((1 << 15) + 1), [1 << 15, 2, 1]);
    }
}
