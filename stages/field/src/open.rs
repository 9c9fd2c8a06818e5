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
        self.opened_id().unwrap_or_else(|_| Some(self.to_string()))
    }

    /// As [`Device::backend_id`], of a device that is there.
    ///
    /// # Errors
    /// A GPU that is not there, or that gives no device.
    pub fn opened_id(&self) -> Result<Option<String>, GpuError> {
        Ok(self.backend()?.id().map(str::to_owned))
    }

    /// Returns what [`Device::backend_id`] is on another machine: one whose GPU has the id `gpu`, or one without a GPU.
    ///
    /// # Errors
    /// A GPU is wanted that the machine does not have, in words.
    pub fn backend_id_on(&self, gpu: Option<&str>) -> Result<Option<String>, String> {
        match (self, gpu) {
            (Self::Cpu, _) => Ok(None),
            (Self::Auto, gpu) => Ok(gpu.map(str::to_owned)),
            (Self::Gpu(None), Some(gpu)) => Ok(Some(gpu.to_owned())),
            (Self::Gpu(Some(name)), Some(gpu)) if holds(gpu, name) => Ok(Some(gpu.to_owned())),
            (Self::Gpu(_), Some(gpu)) => {
                Err(format!("it wants the device `{self}`, and jobs compute on {gpu}"))
            }
            (Self::Gpu(_), None) => Err(format!("it wants the device `{self}`, and jobs have no GPU")),
        }
    }

    /// Returns the device of this machine that has a backend id: by the name of its adapter, with which the id begins; any GPU if no
    /// adapter has it.
    pub fn of_backend(id: Option<&str>) -> Self {
        let Some(id) = id else { return Self::Cpu };
        let name = id.split(',').next().unwrap_or(id);
        let named = Self::Gpu(Some(name.to_owned()));
        match named.backend_id().as_deref() == Some(id) {
            true => named,
            false => Self::Gpu(None),
        }
    }
}

/// Tells whether the id of a backend holds a name, in small letters or capitals.
fn holds(id: &str, name: &str) -> bool {
    id.to_lowercase().contains(&name.to_lowercase())
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
        assert_eq!(Device::of_backend(None), Device::Cpu);
    }

    #[test]
    fn the_backend_of_another_machine_is_that_of_its_gpu_where_one_is_wanted() {
        let h200 = "NVIDIA H200, driver 1, wgpu 1, kernels ab";
        let on = |device: &str, gpu: Option<&str>| device.parse::<Device>().unwrap().backend_id_on(gpu);
        let is_h200 = Ok(Some(h200.to_owned()));
        for device in ["auto", "gpu", "gpu:h200"] {
            assert_eq!(on(device, Some(h200)), is_h200, "{device}");
        }
        for (device, gpu) in [("cpu", Some(h200)), ("cpu", None), ("auto", None)] {
            assert_eq!(on(device, gpu), Ok(None), "{device}");
        }
        assert!(
            on("gpu:A100", Some(h200))
                .unwrap_err()
                .contains("compute on NVIDIA H200")
        );
        assert!(on("gpu", None).unwrap_err().contains("jobs have no GPU"));
        assert_eq!(
            Device::of_backend(Some("no such card, driver")),
            Device::Gpu(None)
        );
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
