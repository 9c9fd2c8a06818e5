use std::fmt;
use std::str::FromStr;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Which processor is wanted: `auto`, `cpu`, `gpu` or `gpu:NAME`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(try_from = "String", into = "String")]
#[schemars(with = "String")]
pub enum Device {
    /// A GPU if there is one, never a software adapter. Otherwise the CPU.
    #[default]
    Auto,
    /// The CPU.
    Cpu,
    /// A GPU. With a name, the first adapter whose name contains it, whatever its kind.
    Gpu(Option<String>),
}

/// A text that names no device.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("`{0}` is not a device: use `auto`, `cpu`, `gpu` or `gpu:NAME`")]
pub struct DeviceError(String);

impl FromStr for Device {
    type Err = DeviceError;

    fn from_str(text: &str) -> Result<Self, DeviceError> {
        match text.split_once(':') {
            None if text == "auto" => Ok(Self::Auto),
            None if text == "cpu" => Ok(Self::Cpu),
            None if text == "gpu" => Ok(Self::Gpu(None)),
            Some(("gpu", name)) if !name.is_empty() => Ok(Self::Gpu(Some(name.to_owned()))),
            _ => Err(DeviceError(text.to_owned())),
        }
    }
}

impl TryFrom<String> for Device {
    type Error = DeviceError;

    fn try_from(text: String) -> Result<Self, DeviceError> {
        text.parse()
    }
}

impl From<Device> for String {
    fn from(device: Device) -> Self {
        device.to_string()
    }
}

impl Device {
    /// Returns what decides the bits of this device's numbers on another machine: one whose GPU has the
    /// backend id `gpu`, or one without a GPU. `None` for the CPU.
    ///
    /// # Errors
    /// A message if this device is a GPU that the machine does not have.
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
}

/// Returns whether the id of a backend contains a name, ignoring case.
fn holds(id: &str, name: &str) -> bool {
    id.to_lowercase().contains(&name.to_lowercase())
}

impl fmt::Display for Device {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Auto => f.write_str("auto"),
            Self::Cpu => f.write_str("cpu"),
            Self::Gpu(None) => f.write_str("gpu"),
            Self::Gpu(Some(name)) => write!(f, "gpu:{name}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_device_reads_as_it_is_written() {
        for text in ["auto", "cpu", "gpu", "gpu:H200"] {
            let device: Result<Device, _> = text.parse();
            assert_eq!(device.map(|device| device.to_string()), Ok(text.to_owned()));
        }
        for text in ["", "gpu:", "cuda", "cpu:0"] {
            assert!(text.parse::<Device>().is_err(), "{text}");
        }
    }

    #[test]
    fn the_backend_of_another_machine_is_that_of_its_gpu_where_one_is_wanted() {
        let h200 = "NVIDIA H200, driver 1, wgpu 1, kernels ab";
        let id = |device: &str, gpu: Option<&str>| device.parse::<Device>().unwrap().backend_id_on(gpu);
        let is_h200 = Ok(Some(h200.to_owned()));
        for device in ["auto", "gpu", "gpu:h200"] {
            assert_eq!(id(device, Some(h200)), is_h200, "{device}");
        }
        for (device, gpu) in [("cpu", Some(h200)), ("cpu", None), ("auto", None)] {
            assert_eq!(id(device, gpu), Ok(None), "{device}");
        }
        let other = id("gpu:A100", Some(h200)).unwrap_err();
        assert!(other.contains("compute on NVIDIA H200"), "{other}");
        let none = id("gpu", None).unwrap_err();
        assert!(none.contains("jobs have no GPU"), "{none}");
    }
}
