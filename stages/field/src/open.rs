//! From the name of a device to the backend that computes there: the one place that knows which backends there are.

use std::sync::Arc;

use crate::backend::Backend;
use crate::cpu_backend::Cpu;
use crate::{Device, GpuError};

impl Device {
    /// Returns the backend of this device; a GPU is opened once in a process.
    ///
    /// # Errors
    /// A GPU that is not there, or that gives no device; [`GpuError::NotBuilt`] without the feature `gpu`.
    pub(crate) fn backend(&self) -> Result<Arc<dyn Backend>, GpuError> {
        Ok(match gpu(self)? {
            Some(gpu) => gpu,
            None => Arc::new(Cpu::best()),
        })
    }

    /// Returns what decides the bits of this device's numbers, as keys hold it: adapter, driver and kernels of a GPU;
    /// `None` for the CPU, whose numbers are the same on every machine.
    ///
    /// A device that cannot be opened has its name for an id: whoever runs on it gets the error.
    pub fn backend_id(&self) -> Option<String> {
        match self.backend() {
            Ok(backend) => backend.id().map(str::to_owned),
            Err(_) => Some(self.to_string()),
        }
    }
}

#[cfg(feature = "gpu")]
fn gpu(device: &Device) -> Result<Option<Arc<dyn Backend>>, GpuError> {
    Ok(crate::gpu::Gpu::shared(device)?.map(|gpu| gpu as Arc<dyn Backend>))
}

#[cfg(not(feature = "gpu"))]
fn gpu(device: &Device) -> Result<Option<Arc<dyn Backend>>, GpuError> {
    match device {
        Device::Auto | Device::Cpu => Ok(None),
        Device::Gpu(_) => Err(GpuError::NotBuilt),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_cpu_has_no_id_because_its_numbers_are_the_same_everywhere() {
        assert_eq!(Device::Cpu.backend_id(), None);
    }

    #[cfg(not(feature = "gpu"))]
    #[test]
    fn without_the_feature_a_gpu_is_refused_and_auto_is_the_cpu() {
        assert_eq!(Device::Auto.backend_id(), None);
        let gpu = Device::Gpu(None);
        assert_eq!(gpu.backend().err(), Some(GpuError::NotBuilt));
        assert_eq!(gpu.backend_id().as_deref(), Some("gpu"));
    }
}
