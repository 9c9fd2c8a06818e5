//! Arrays on the device: making, writing and reading them.

use std::marker::PhantomData;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::mpsc::Receiver;

use bytemuck::Pod;
use parking_lot::Mutex;

use super::Gpu;
use marf_field::GpuError;

/// An array on the device: a buffer, or a part of one.
pub struct Array<T> {
    pub(super) buffer: wgpu::Buffer,
    /// Its first byte in the buffer, a multiple of 256.
    offset: u64,
    len: usize,
    of: PhantomData<T>,
}

impl<T> Array<T> {
    /// Returns the number of elements.
    pub fn len(&self) -> usize {
        self.len
    }

    /// Returns the bytes it takes.
    pub fn bytes(&self) -> u64 {
        bytes::<T>(self.len)
    }
}

/// A copy of an array on its way to the host.
pub struct Reading<T> {
    staging: wgpu::Buffer,
    submission: wgpu::SubmissionIndex,
    /// Behind a lock, so that a session that holds it may be shared.
    mapped: Mutex<Receiver<Result<(), wgpu::BufferAsyncError>>>,
    len: usize,
    of: PhantomData<T>,
}

/// Returns the bytes of `len` elements. An empty buffer cannot be bound.
fn bytes<T>(len: usize) -> u64 {
    (len.max(1) * size_of::<T>()).next_multiple_of(4) as u64
}

/// A buffer, or a part of it, as a kernel sees it.
#[derive(Clone)]
pub struct Part<'a>(pub(super) wgpu::BufferBinding<'a>);

impl<'a, T> From<&'a Array<T>> for Part<'a> {
    fn from(array: &'a Array<T>) -> Self {
        Self(wgpu::BufferBinding {
            buffer: &array.buffer,
            offset: array.offset,
            size: std::num::NonZero::new(array.bytes()),
        })
    }
}

impl<T> Array<T> {
    /// Returns elements `first..first + len`, whose first byte is a multiple of 256.
    pub fn part(&self, first: usize, len: usize) -> Part<'_> {
        let bytes = |count: usize| (count * size_of::<T>()) as u64;
        Part(wgpu::BufferBinding {
            buffer: &self.buffer,
            offset: self.offset + bytes(first),
            size: std::num::NonZero::new(bytes(len)),
        })
    }

    /// Returns elements `first..first + len` as an array of the same memory. The first byte is a multiple of
    /// 256.
    pub fn share(&self, first: usize, len: usize) -> Self {
        Self {
            buffer: self.buffer.clone(),
            offset: self.offset + (first * size_of::<T>()) as u64,
            len,
            of: PhantomData,
        }
    }
}

impl Gpu {
    /// Makes a storage array of zeros.
    ///
    /// # Errors
    /// More than a buffer or the memory holds. A lost device.
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

    /// Makes an array for one use.
    pub(super) fn array<T: Pod>(
        &self,
        what: &'static str,
        len: usize,
        usage: wgpu::BufferUsages,
    ) -> Result<Array<T>, GpuError> {
        let bytes = bytes::<T>(len);
        let offered = self.limits.max_buffer_size;
        if bytes > offered {
            let hint = "lower `batch_samples`, `log2_table` or `memory`";
            return Err(self.limit("max_buffer_size", offered, bytes, hint));
        }
        self.take(bytes);
        let buffer = match &self.stand_in {
            Some(stand_in) => stand_in.clone(),
            None => self.buffer(what, bytes, usage)?,
        };
        Ok(Array {
            buffer,
            offset: 0,
            len,
            of: PhantomData,
        })
    }

    /// Makes a buffer.
    ///
    /// # Errors
    /// Memory that was refused. A lost device.
    pub(super) fn buffer(
        &self,
        what: &'static str,
        bytes: u64,
        usage: wgpu::BufferUsages,
    ) -> Result<wgpu::Buffer, GpuError> {
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
            None => Ok(buffer),
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
        if self.stand_in.is_some() {
            return;
        }
        let offset = array.offset + (first * size_of::<T>()) as u64;
        self.queue
            .write_buffer(&array.buffer, offset, bytemuck::cast_slice(values));
    }

    /// Waits for all that was submitted and copies an array back.
    ///
    /// # Errors
    /// A lost device.
    pub fn read<T: Pod>(&self, array: &Array<T>) -> Result<Vec<T>, GpuError> {
        self.received(self.copy_back(array))
    }

    /// Submits a copy of an array as it is behind all that was submitted so far, for [`Gpu::received`].
    pub fn copy_back<T: Pod>(&self, array: &Array<T>) -> Reading<T> {
        let size = array.bytes();
        let staging = self.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("read back"),
            size,
            usage: wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        let mut encoder = self.device.create_command_encoder(&Default::default());
        encoder.copy_buffer_to_buffer(&array.buffer, array.offset, &staging, 0, size);
        let submission = self.queue.submit([encoder.finish()]);
        let (sender, receiver) = std::sync::mpsc::channel();
        staging.map_async(wgpu::MapMode::Read, .., move |mapped| {
            // Without a receiver nobody wants the answer.
            let _ = sender.send(mapped);
        });
        Reading {
            staging,
            submission,
            mapped: Mutex::new(receiver),
            len: array.len,
            of: PhantomData,
        }
    }

    /// Waits for a copy, and for nothing that was submitted behind it.
    ///
    /// # Errors
    /// A lost device.
    pub fn received<T: Pod>(&self, reading: Reading<T>) -> Result<Vec<T>, GpuError> {
        self.poll(wgpu::PollType::Wait {
            submission_index: Some(reading.submission),
            timeout: None,
        })?;
        let failed = |error: &dyn std::fmt::Display| self.lost(error.to_string());
        let mapped = reading.mapped.into_inner().recv();
        let mapped = mapped.map_err(|error| failed(&error))?;
        mapped.map_err(|error| failed(&error))?;
        let view = reading.staging.get_mapped_range(..);
        let view = view.map_err(|error| failed(&error))?;
        let mut values: Vec<T> = bytemuck::pod_collect_to_vec(&view[..]);
        values.truncate(reading.len);
        Ok(values)
    }

    /// Waits until all that was submitted is done.
    ///
    /// # Errors
    /// A lost device.
    pub fn wait(&self) -> Result<(), GpuError> {
        self.poll(wgpu::PollType::wait_indefinitely())
    }

    /// Looks at the device, or waits for what was submitted.
    ///
    /// # Errors
    /// A lost device.
    pub(super) fn poll(&self, until: wgpu::PollType) -> Result<(), GpuError> {
        self.guarded(|| self.device.poll(until))
    }

    /// Makes an error of a wait that panics: wgpu 30 does where the driver loses the device meanwhile, and nowhere else
    /// that is called here.
    fn guarded(
        &self,
        wait: impl FnOnce() -> Result<wgpu::PollStatus, wgpu::PollError>,
    ) -> Result<(), GpuError> {
        let waited = catch_unwind(AssertUnwindSafe(wait));
        // What the driver said is more precise.
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

/// Returns the low and the high half of a word, which is how kernels see 64 bits.
pub fn halves(word: u64) -> [u32; 2] {
    [word as u32, (word >> 32) as u32]
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

    /// The copy is of the moment in which it was asked for, whatever is written until it is received.
    #[test]
    fn a_copy_that_is_received_late_is_what_the_array_was() {
        let Some(gpu) = gpu("a_copy_that_is_received_late_is_what_the_array_was") else {
            return;
        };
        let array = gpu.filled::<u32>("numbers", &[1, 2]).unwrap();
        let first = gpu.copy_back(&array);
        gpu.write(&array, 0, &[3]);
        let second = gpu.copy_back(&array);
        gpu.write(&array, 0, &[5]);
        assert_eq!(gpu.received(second), Ok(vec![3, 2]));
        assert_eq!(gpu.received(first), Ok(vec![1, 2]));
        assert_eq!(gpu.read(&array), Ok(vec![5, 2]));
    }

    #[test]
    fn what_is_shared_is_the_same_memory() {
        let Some(gpu) = gpu("what_is_shared_is_the_same_memory") else {
            return;
        };
        let numbers: Vec<u32> = (0..192).collect();
        let array = gpu.filled("numbers", &numbers).unwrap();
        let shared = array.share(64, 64);
        gpu.write(&shared, 1, &[7, 8]);
        let expected = [vec![64, 7, 8], (67..128).collect()].concat();
        assert_eq!(gpu.read(&shared), Ok(expected));
        assert_eq!(gpu.read(&array.share(64, 3)), Ok(vec![64, 7, 8]));
        assert_eq!(gpu.read(&array).unwrap()[63..67], [63, 64, 7, 8]);
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
}
