//! From the name of a device to the backend that computes there: the one place that knows which backends there are.

use std::sync::Arc;

use marf_field::backend::Backend;
use marf_field::{Cpu, Device, FieldError, GpuError};

/// Returns the backend of a device. A GPU is opened once in a process.
///
/// # Errors
/// A GPU that does not exist, or that gives no device. [`GpuError::NotBuilt`] without the feature `gpu`.
pub fn open(device: &Device) -> Result<Arc<dyn Backend>, FieldError> {
    Ok(open_gpu(device)?.unwrap_or_else(|| Arc::new(Cpu::best())))
}

/// Returns what decides the bits of a device's numbers, as keys hold it: adapter, driver and kernels of a
/// GPU. `None` for the CPU, whose numbers are the same on every machine.
///
/// The id of a device that cannot be opened is its name: a stage that computes there gets the error.
pub fn backend_id(device: &Device) -> Option<String> {
    opened_id(device).unwrap_or_else(|_| Some(device.to_string()))
}

/// As [`backend_id`], for a device that must be there.
///
/// # Errors
/// A GPU that is not there, or that gives no device.
pub fn opened_id(device: &Device) -> Result<Option<String>, FieldError> {
    Ok(open(device)?.id().map(str::to_owned))
}

/// Returns the device of this machine that has a backend id: by the name of its adapter, with which the id
/// begins. Any GPU if no adapter has it.
pub fn device_with_id(id: Option<&str>) -> Device {
    let Some(id) = id else { return Device::Cpu };
    let name = id.split(',').next().unwrap_or(id);
    let named = Device::Gpu(Some(name.to_owned()));
    if backend_id(&named).as_deref() == Some(id) {
        named
    } else {
        Device::Gpu(None)
    }
}

/// Returns the GPU of a device. `None` for the CPU.
#[cfg(feature = "gpu")]
fn open_gpu(device: &Device) -> Result<Option<Arc<dyn Backend>>, GpuError> {
    Ok(crate::Gpu::shared(device)?.map(|gpu| gpu as Arc<dyn Backend>))
}

#[cfg(not(feature = "gpu"))]
fn open_gpu(device: &Device) -> Result<Option<Arc<dyn Backend>>, GpuError> {
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
        assert_eq!(backend_id(&Device::Cpu), None);
        assert_eq!(device_with_id(None), Device::Cpu);
    }

    #[test]
    fn an_id_that_no_adapter_has_is_that_of_any_gpu() {
        assert_eq!(device_with_id(Some("no such card, driver")), Device::Gpu(None));
    }

    #[cfg(not(feature = "gpu"))]
    #[test]
    fn without_the_feature_a_gpu_is_refused_and_auto_is_the_cpu() {
        assert_eq!(backend_id(&Device::Auto), None);
        let gpu = Device::Gpu(None);
        assert_eq!(open(&gpu).err(), Some(FieldError::Gpu(GpuError::NotBuilt)));
        assert_eq!(backend_id(&gpu).as_deref(), Some("gpu"));
    }
}
