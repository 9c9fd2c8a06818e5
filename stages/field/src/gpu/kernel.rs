//! Buffers, kernels and the recording of a submit: the least that the kernels need of wgpu.

use std::marker::PhantomData;
use std::panic::{AssertUnwindSafe, catch_unwind};

use bytemuck::Pod;
use marf_shaders::Shader;

use super::{Gpu, GpuError};

/// Threads a workgroup of every kernel that does not say otherwise.
pub const GROUP: usize = 64;
/// Workgroups in x before they go on in y: WebGPU allows 65,535.
const MOST_GROUPS: usize = 1 << 15;

/// An array on the device.
pub struct Array<T> {
    buffer: wgpu::Buffer,
    len: usize,
    of: PhantomData<T>,
}

impl<T> Array<T> {
    /// Returns the number of elements.
    pub fn len(&self) -> usize {
        self.len
    }
}

/// A buffer, or a part of it, as a kernel sees it.
#[derive(Clone)]
pub struct Part<'a>(wgpu::BufferBinding<'a>);

impl<'a, T> From<&'a Array<T>> for Part<'a> {
    fn from(array: &'a Array<T>) -> Self {
        Self(array.buffer.as_entire_buffer_binding())
    }
}

impl<T> Array<T> {
    /// Returns elements `first..first + len`, whose first byte is a multiple of 256.
    pub fn part(&self, first: usize, len: usize) -> Part<'_> {
        let bytes = |count: usize| (count * size_of::<T>()) as u64;
        Part(wgpu::BufferBinding {
            buffer: &self.buffer,
            offset: bytes(first),
            size: std::num::NonZero::new(bytes(len)),
        })
    }
}

/// A compiled kernel.
#[derive(Clone)]
pub struct Kernel {
    name: &'static str,
    pipeline: wgpu::ComputePipeline,
}

/// A kernel with its buffers.
#[derive(Clone)]
pub struct Bound {
    name: &'static str,
    pipeline: wgpu::ComputePipeline,
    group: wgpu::BindGroup,
}

impl Gpu {
    /// Compiles entry point `main` of a kernel; `head` goes before its text: the constants that decide its shape.
    ///
    /// # Errors
    /// [`GpuError::Kernel`] with what the driver said; a lost device.
    pub fn kernel(&self, shader: &Shader, head: &str) -> Result<Kernel, GpuError> {
        self.entry(shader, head, "main")
    }

    /// As [`Gpu::kernel`], with a named entry point.
    ///
    /// # Errors
    /// As [`Gpu::kernel`].
    pub fn entry(&self, shader: &Shader, head: &str, entry: &str) -> Result<Kernel, GpuError> {
        self.check()?;
        let text = shader.source(head);
        let key = (entry.to_owned(), text.clone());
        let compiled = || self.kernels.lock();
        if let Some(kernel) = compiled().get(&key) {
            return Ok(kernel.clone());
        }
        let kernel = self.compile(shader.name, text, entry)?;
        compiled().insert(key, kernel.clone());
        Ok(kernel)
    }

    fn compile(&self, name: &'static str, text: String, entry: &str) -> Result<Kernel, GpuError> {
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
                compilation_options: wgpu::PipelineCompilationOptions::default(),
                cache: None,
            });
        let mut refused = None;
        for scope in scopes.into_iter().rev() {
            refused = pollster::block_on(scope.pop()).or(refused);
        }
        match refused {
            None => Ok(Kernel { name, pipeline }),
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
            name: kernel.name,
            pipeline: kernel.pipeline.clone(),
            group,
        }
    }

    /// Makes a storage array of zeros.
    ///
    /// # Errors
    /// More than a buffer or the memory holds; a lost device.
    pub fn zeros<T: Pod>(&self, what: &'static str, len: usize) -> Result<Array<T>, GpuError> {
        self.array(what, len, wgpu::BufferUsages::STORAGE)
    }

    /// Makes a storage array of these values.
    ///
    /// # Errors
    /// As [`Gpu::zeros`].
    pub fn filled<T: Pod>(&self, what: &'static str, values: &[T]) -> Result<Array<T>, GpuError> {
        let array = self.zeros(what, values.len())?;
        self.write(&array, 0, values);
        Ok(array)
    }

    /// Makes a uniform.
    ///
    /// # Errors
    /// As [`Gpu::zeros`].
    pub fn uniform<T: Pod>(&self, what: &'static str, value: T) -> Result<Array<T>, GpuError> {
        let array = self.array(what, 1, wgpu::BufferUsages::UNIFORM)?;
        self.write(&array, 0, &[value]);
        Ok(array)
    }

    fn array<T: Pod>(
        &self,
        what: &'static str,
        len: usize,
        usage: wgpu::BufferUsages,
    ) -> Result<Array<T>, GpuError> {
        // An empty buffer cannot be bound.
        let bytes = (len.max(1) * size_of::<T>()).next_multiple_of(4) as u64;
        let offered = self.limits.max_buffer_size;
        if bytes > offered {
            let hint = "lower `batch_samples`, `log2_table` or `memory`";
            return Err(self.limit("max_buffer_size", [offered, bytes], hint));
        }
        // A lost device gives a buffer that is none, and no error.
        self.check()?;
        let scopes = [wgpu::ErrorFilter::OutOfMemory, wgpu::ErrorFilter::Validation]
            .map(|filter| self.device.push_error_scope(filter));
        let buffer = self.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some(what),
            size: bytes,
            usage: usage | wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::COPY_SRC,
            mapped_at_creation: false,
        });
        let mut refused = None;
        for scope in scopes.into_iter().rev() {
            refused = pollster::block_on(scope.pop()).or(refused);
        }
        match refused {
            None => Ok(Array {
                buffer,
                len,
                of: PhantomData,
            }),
            Some(wgpu::Error::OutOfMemory { .. }) => Err(GpuError::Memory {
                adapter: self.name().to_owned(),
                what,
                bytes,
            }),
            Some(error) => Err(self.lost(error.to_string())),
        }
    }

    /// Overwrites elements from `first` on, before whatever is submitted next.
    pub fn write<T: Pod>(&self, array: &Array<T>, first: usize, values: &[T]) {
        let offset = (first * size_of::<T>()) as u64;
        self.queue
            .write_buffer(&array.buffer, offset, bytemuck::cast_slice(values));
    }

    /// Waits for all that was submitted and copies an array back.
    ///
    /// # Errors
    /// A lost device.
    pub fn read<T: Pod>(&self, array: &Array<T>) -> Result<Vec<T>, GpuError> {
        let size = array.buffer.size();
        let staging = self.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("read back"),
            size,
            usage: wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        let mut encoder = self.device.create_command_encoder(&Default::default());
        encoder.copy_buffer_to_buffer(&array.buffer, 0, &staging, 0, size);
        self.queue.submit([encoder.finish()]);
        let (sender, receiver) = std::sync::mpsc::channel();
        staging.map_async(wgpu::MapMode::Read, .., move |mapped| {
            // The receiver waits below; if it is gone nobody wants the answer.
            let _ = sender.send(mapped);
        });
        self.wait()?;
        let failed = |error: &dyn std::fmt::Display| self.lost(error.to_string());
        let mapped = receiver.recv().map_err(|error| failed(&error))?;
        mapped.map_err(|error| failed(&error))?;
        let view = staging.get_mapped_range(..).map_err(|error| failed(&error))?;
        let mut values: Vec<T> = bytemuck::pod_collect_to_vec(&view[..]);
        values.truncate(array.len);
        Ok(values)
    }

    /// Records dispatches and submits them at once, in one pass.
    pub fn submit(&self, record: impl FnOnce(&mut Recorder<'_>)) {
        let mut encoder = self.device.create_command_encoder(&Default::default());
        record(&mut Recorder::Pass(
            encoder.begin_compute_pass(&Default::default()),
        ));
        self.queue.submit([encoder.finish()]);
    }

    /// Records dispatches, submits each in a pass of its own between two timestamps, and waits for the times of all.
    ///
    /// # Errors
    /// [`GpuError::NoTimestamps`], a lost device.
    pub fn submit_timed(&self, record: impl FnOnce(&mut Recorder<'_>)) -> Result<Vec<Timing>, GpuError> {
        if !self.features.contains(wgpu::Features::TIMESTAMP_QUERY) {
            return Err(GpuError::NoTimestamps {
                adapter: self.name().to_owned(),
            });
        }
        let mut recorder = Recorder::List(Work::default());
        record(&mut recorder);
        let Recorder::List(Work(dispatches)) = recorder else {
            return Ok(Vec::new());
        };
        let times = dispatches.chunks(TIMED_AT_ONCE).map(|some| self.timed(some));
        Ok(times.collect::<Result<Vec<_>, _>>()?.concat())
    }

    fn timed(&self, dispatches: &[(Bound, [usize; 3])]) -> Result<Vec<Timing>, GpuError> {
        let count = 2 * dispatches.len() as u32;
        let queries = self.device.create_query_set(&wgpu::QuerySetDescriptor {
            label: Some("timestamps"),
            ty: wgpu::QueryType::Timestamp,
            count,
        });
        let ticks = self.array::<u64>("timestamps", count as usize, wgpu::BufferUsages::QUERY_RESOLVE)?;
        let mut encoder = self.device.create_command_encoder(&Default::default());
        for (begin, (bound, groups)) in (0..).step_by(2).zip(dispatches) {
            let pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
                label: Some(bound.name),
                timestamp_writes: Some(wgpu::ComputePassTimestampWrites {
                    query_set: &queries,
                    beginning_of_pass_write_index: Some(begin),
                    end_of_pass_write_index: Some(begin + 1),
                }),
            });
            Recorder::Pass(pass).groups(bound, *groups);
        }
        encoder.resolve_query_set(&queries, 0..count, &ticks.buffer, 0);
        self.queue.submit([encoder.finish()]);
        let tick_s = f64::from(self.queue.get_timestamp_period()) * 1e-9;
        let ticks = self.read(&ticks)?;
        let pairs = dispatches.iter().zip(ticks.as_chunks::<2>().0);
        let times = pairs.map(|((bound, _), [begin, end])| {
            let seconds = end.saturating_sub(*begin) as f64 * tick_s;
            (bound.name, seconds)
        });
        Ok(times.collect())
    }

    /// Waits until all that was submitted is done.
    ///
    /// # Errors
    /// A lost device.
    pub fn wait(&self) -> Result<(), GpuError> {
        self.guarded(|| self.device.poll(wgpu::PollType::wait_indefinitely()))
    }

    /// Makes an error of a wait that panics: wgpu 30 does where the driver loses the device meanwhile, and nowhere else
    /// that is called here.
    fn guarded(
        &self,
        wait: impl FnOnce() -> Result<wgpu::PollStatus, wgpu::PollError>,
    ) -> Result<(), GpuError> {
        let waited = catch_unwind(AssertUnwindSafe(wait));
        // What the driver said tells more.
        self.check()?;
        match waited {
            Ok(Ok(_)) => Ok(()),
            Ok(Err(error)) => Err(self.lost(error.to_string())),
            Err(panic) => {
                let text = panic.downcast_ref::<String>().map(|text| text.trim_end());
                Err(self.lost(text.unwrap_or("lost while it was waited for").to_owned()))
            }
        }
    }
}

/// Name of a kernel, and the seconds of one dispatch.
pub type Timing = (&'static str, f64);

/// Dispatches between two timestamps each that one set of queries holds.
const TIMED_AT_ONCE: usize = wgpu::QUERY_SET_MAX_QUERIES as usize / 2;

/// Takes dispatches in order; each sees what those before it wrote.
#[expect(clippy::large_enum_variant, reason = "one a submit, on the stack")]
pub enum Recorder<'a> {
    /// All go to one pass.
    Pass(wgpu::ComputePass<'a>),
    /// They are noted down.
    List(Work),
}

impl Recorder<'_> {
    /// Runs a kernel of [`GROUP`] threads a workgroup with at least `threads` threads.
    pub fn threads(&mut self, bound: &Bound, threads: usize) {
        self.groups(bound, fold(threads.div_ceil(GROUP)));
    }

    /// Runs a kernel with so many workgroups in x, y and z.
    pub fn groups(&mut self, bound: &Bound, [x, y, z]: [usize; 3]) {
        match self {
            Self::Pass(pass) => {
                pass.set_pipeline(&bound.pipeline);
                pass.set_bind_group(0, &bound.group, &[]);
                pass.dispatch_workgroups(x as u32, y as u32, z as u32);
            }
            Self::List(work) => work.add(bound.clone(), [x, y, z]),
        }
    }
}

/// Dispatches in order.
#[derive(Default)]
pub struct Work(Vec<(Bound, [usize; 3])>);

impl Work {
    /// Adds a kernel and its workgroups in x, y and z.
    pub fn add(&mut self, bound: Bound, groups: [usize; 3]) {
        self.0.push((bound, groups));
    }

    /// Adds what another work does, behind.
    pub fn then(mut self, other: Self) -> Self {
        self.0.extend(other.0);
        self
    }

    /// Records all dispatches.
    pub fn record(&self, recorder: &mut Recorder<'_>) {
        for (bound, groups) in &self.0 {
            recorder.groups(bound, *groups);
        }
    }
}

/// Gives a kernel its buffers and workgroups.
pub fn dispatch(gpu: &Gpu, kernel: &Kernel, parts: &[Part<'_>], groups: [usize; 3]) -> Work {
    Work(vec![(gpu.bind(kernel, parts), groups)])
}

/// Returns the low and the high half of a word, which is how kernels see 64 bits.
pub fn halves(word: u64) -> [u32; 2] {
    [word as u32, (word >> 32) as u32]
}

/// Spreads workgroups over x and y; a kernel's thread is `id.x + id.y * groups.x * 64`.
pub fn fold(groups: usize) -> [usize; 3] {
    let x = groups.clamp(1, MOST_GROUPS);
    [x, groups.div_ceil(x).max(1), 1]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gpu::testing::gpu;

    #[test]
    fn what_is_written_is_read_back_and_the_rest_is_zero() {
        let Some(gpu) = gpu("what_is_written_is_read_back_and_the_rest_is_zero") else {
            return;
        };
        let array = gpu.zeros::<u32>("numbers", 5).unwrap();
        gpu.write(&array, 1, &[7, 8]);
        assert_eq!(gpu.read(&array), Ok(vec![0, 7, 8, 0, 0]));
    }

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
    fn more_than_the_device_has_is_refused_with_the_number() {
        let Some(gpu) = gpu("more_than_the_device_has_is_refused_with_the_number") else {
            return;
        };
        let refused = gpu.zeros::<u64>("table", 1 << 50).err();
        assert!(
            matches!(refused, Some(GpuError::Limit { needed, .. }) if needed == 1 << 53),
            "{refused:?}"
        );
    }

    #[test]
    fn a_wait_that_panics_is_a_lost_device() {
        let Some(gpu) = gpu("a_wait_that_panics_is_a_lost_device") else {
            return;
        };
        let refused = gpu.guarded(|| panic!("Error in Device::poll: {} is lost\n", gpu.name()));
        let told = gpu.lost(format!("Error in Device::poll: {} is lost", gpu.name()));
        assert_eq!(refused, Err(told));
        assert_eq!(gpu.wait(), Ok(()));
    }

    #[test]
    fn groups_beyond_the_limit_of_one_axis_go_on_in_the_next() {
        assert_eq!(fold(0), [1, 1, 1]);
        assert_eq!(fold(5), [5, 1, 1]);
        assert_eq!(fold((1 << 15) + 1), [1 << 15, 2, 1]);
    }
}
