use std::collections::HashMap;
use std::fmt;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, LazyLock, OnceLock};

use marf_cache::Digest;
use marf_shaders::{SHADERS, constants};
use parking_lot::Mutex;

use super::order::{AT_ONCE, FIRST_ROUND, GROUPS, MOST_WORK};
use marf_field::{Device, GpuError};

/// An opened GPU.
pub struct Gpu {
    pub(super) device: wgpu::Device,
    pub(super) queue: wgpu::Queue,
    pub(super) limits: wgpu::Limits,
    pub(super) features: wgpu::Features,
    name: String,
    id: String,
    kind: wgpu::DeviceType,
    /// What was compiled so far, by entry point and text: fields of one shape share their kernels.
    pub(super) pipelines: Mutex<HashMap<(String, String), wgpu::ComputePipeline>>,
    /// The first error that no call returned.
    failed: Arc<OnceLock<String>>,
    /// Bytes of all arrays that were made, whether they are still there or not.
    taken: AtomicU64,
    /// The buffer of all arrays of a device that only counts them.
    pub(super) stand_in: Option<wgpu::Buffer>,
    /// Bytes that a test says the device has.
    #[cfg(test)]
    pub(super) planted_memory: Option<u64>,
}

impl fmt::Debug for Gpu {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("Gpu").field(&self.id).finish()
    }
}

/// The limit of one binding, as WebGPU calls it.
pub(super) const BINDING: &str = "max_storage_buffer_binding_size";

/// Devices opened so far, by the requested device: a process holds one device an adapter.
static OPENED: LazyLock<Mutex<HashMap<Device, Option<Arc<Gpu>>>>> = LazyLock::new(Mutex::default);

/// Backends that are searched for adapters. OpenGL lacks features of the kernels.
const BACKENDS: wgpu::Backends = wgpu::Backends::VULKAN
    .union(wgpu::Backends::METAL)
    .union(wgpu::Backends::DX12);

/// Share of the memory that the system offers which may be taken, in percent: a driver that is out of it loses the device.
const MEMORY_SHARE: u8 = 95;

/// Version of wgpu, a part of the backend id. A test compares it with Cargo.lock.
const WGPU: &str = "wgpu 30.0.1";

impl Gpu {
    /// Opens the wanted device once in a process: later calls get the same, unless it failed. `None` is the
    /// CPU.
    ///
    /// # Errors
    /// As [`Gpu::open`].
    pub fn shared(wanted: &Device) -> Result<Option<Arc<Self>>, GpuError> {
        let mut opened = OPENED.lock();
        if let Some(gpu) = opened.get(wanted)
            && gpu.as_ref().is_none_or(|gpu| gpu.check().is_ok())
        {
            return Ok(gpu.clone());
        }
        let gpu = Self::open(wanted)?.map(Arc::new);
        opened.insert(wanted.clone(), gpu.clone());
        Ok(gpu)
    }

    /// Opens the wanted device. `None` is the CPU.
    ///
    /// # Errors
    /// The adapter does not exist, or it gives no device.
    pub fn open(wanted: &Device) -> Result<Option<Self>, GpuError> {
        Self::open_within(wanted, None)
    }

    /// Opens the wanted device with these limits and no features. Without limits, with all that it has.
    ///
    /// # Errors
    /// As [`Gpu::open`].
    pub(super) fn open_within(
        wanted: &Device,
        limits: Option<wgpu::Limits>,
    ) -> Result<Option<Self>, GpuError> {
        if *wanted == Device::Cpu {
            return Ok(None);
        }
        let mut descriptor = wgpu::InstanceDescriptor::new_without_display_handle();
        descriptor.backends = BACKENDS;
        descriptor.memory_budget_thresholds.for_resource_creation = Some(MEMORY_SHARE);
        let instance = wgpu::Instance::new(descriptor);
        let mut adapters = pollster::block_on(instance.enumerate_adapters(BACKENDS));
        // A card of its own before one that shares the memory. Names decide among equals.
        adapters.sort_by_key(|adapter| {
            let info = adapter.get_info();
            (rank(info.device_type), info.name)
        });
        let fits = |adapter: &&wgpu::Adapter| {
            let info = adapter.get_info();
            match wanted {
                Device::Gpu(Some(name)) => info.name.to_lowercase().contains(&name.to_lowercase()),
                _ => rank(info.device_type) < SOFTWARE,
            }
        };
        match adapters.iter().find(fits) {
            Some(adapter) => Self::request(adapter, limits).map(Some),
            None if *wanted == Device::Auto => Ok(None),
            None => Err(GpuError::NoAdapter {
                wanted: match wanted {
                    Device::Gpu(Some(name)) => format!("whose name holds `{name}`"),
                    _ => "but software adapters".to_owned(),
                },
                found: names(&adapters),
            }),
        }
    }

    fn request(adapter: &wgpu::Adapter, limits: Option<wgpu::Limits>) -> Result<Self, GpuError> {
        let info = adapter.get_info();
        let wanted = wgpu::Features::SHADER_INT64 | wgpu::Features::SHADER_INT64_ATOMIC_ALL_OPS;
        let (features, limits) = match limits {
            None => (adapter.features() & wanted, adapter.limits()),
            Some(limits) => (wgpu::Features::empty(), limits),
        };
        let request = adapter.request_device(&wgpu::DeviceDescriptor {
            label: Some("marf"),
            required_features: features,
            required_limits: limits.clone(),
            ..Default::default()
        });
        let (device, queue) = pollster::block_on(request).map_err(|error| GpuError::Lost {
            adapter: info.name.clone(),
            message: error.to_string(),
        })?;
        let failed = Arc::new(OnceLock::new());
        let (lost, refused) = (failed.clone(), failed.clone());
        device.set_device_lost_callback(move |reason, message| {
            // The first error is the cause of the others.
            let _ = lost.set(format!("device lost ({reason:?}): {message}"));
        });
        device.on_uncaptured_error(Arc::new(move |error: wgpu::Error| {
            let _ = refused.set(error.to_string());
        }));
        Ok(Self {
            device,
            queue,
            limits,
            features,
            id: format!(
                "{}, {} {}, {WGPU}, kernels {}",
                info.name,
                info.driver,
                info.driver_info,
                kernels()
            ),
            name: info.name,
            kind: info.device_type,
            pipelines: Mutex::default(),
            failed,
            taken: AtomicU64::new(0),
            stand_in: None,
            #[cfg(test)]
            planted_memory: None,
        })
    }

    /// Returns this device as one that counts the arrays that are made of it, and neither makes nor writes them.
    ///
    /// # Errors
    /// A lost device.
    pub(super) fn counting(&self) -> Result<Self, GpuError> {
        Ok(Self {
            stand_in: Some(self.buffer("stand-in", 256, wgpu::BufferUsages::STORAGE)?),
            device: self.device.clone(),
            queue: self.queue.clone(),
            limits: self.limits.clone(),
            features: self.features,
            id: self.id.clone(),
            name: self.name.clone(),
            kind: self.kind,
            pipelines: Mutex::default(),
            failed: self.failed.clone(),
            taken: AtomicU64::new(0),
            #[cfg(test)]
            planted_memory: None,
        })
    }

    /// Notes that an array was made.
    pub(super) fn take(&self, bytes: u64) {
        self.taken.fetch_add(bytes, Ordering::Relaxed);
    }

    /// Returns the bytes of all arrays that were made so far.
    pub(super) fn taken(&self) -> u64 {
        self.taken.load(Ordering::Relaxed)
    }

    /// Returns the adapter's name.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Returns adapter, driver, version of wgpu and digest of the kernels: two runs with one id give the same bytes.
    pub fn id(&self) -> &str {
        &self.id
    }

    /// Returns whether the adapter is software on the CPU.
    pub fn is_software(&self) -> bool {
        rank(self.kind) >= SOFTWARE
    }

    /// Returns whether the device is a card with memory of its own.
    pub(super) fn is_card(&self) -> bool {
        self.kind == wgpu::DeviceType::DiscreteGpu
    }

    /// Checks that the device was not lost and has refused nothing.
    ///
    /// # Errors
    /// [`GpuError::Lost`] with the first complaint of the driver.
    pub fn check(&self) -> Result<(), GpuError> {
        match self.failed.get() {
            None => Ok(()),
            Some(message) => Err(self.lost(message.clone())),
        }
    }

    /// Returns the bytes that one binding holds: kernels count them in 32 bits.
    pub(super) fn binding(&self) -> u64 {
        self.limits
            .max_storage_buffer_binding_size
            .min(u64::from(u32::MAX))
    }

    /// Checks that one binding can hold the needed bytes. `hint` is the advice if it cannot.
    ///
    /// # Errors
    /// [`GpuError::Limit`].
    pub(super) fn check_binding(&self, needed: u64, hint: &'static str) -> Result<(), GpuError> {
        let offered = self.binding();
        if needed <= offered {
            return Ok(());
        }
        Err(self.limit(BINDING, offered, needed, hint))
    }

    pub(super) fn limit(
        &self,
        limit: &'static str,
        offered: u64,
        needed: u64,
        hint: &'static str,
    ) -> GpuError {
        GpuError::Limit {
            adapter: self.name.clone(),
            limit,
            offered,
            needed,
            hint,
        }
    }

    pub(super) fn lost(&self, message: String) -> GpuError {
        GpuError::Lost {
            adapter: self.name.clone(),
            message,
        }
    }
}

/// Returns a short digest of all kernels and of the numbers that decide the order of their sums. A change
/// gives another id, so that no version has to be raised.
fn kernels() -> String {
    let texts = SHADERS
        .iter()
        .flat_map(|shader| shader.shared.iter().chain([&shader.text]));
    let order = format!("{GROUPS} {MOST_WORK} {AT_ONCE:?} {FIRST_ROUND}\n");
    let all = order + &constants() + &texts.copied().collect::<String>();
    Digest::from_content(all.as_bytes()).short().to_string()
}

/// Ranks from here on are not taken unless named.
const SOFTWARE: u32 = 3;

fn rank(kind: wgpu::DeviceType) -> u32 {
    match kind {
        wgpu::DeviceType::DiscreteGpu => 0,
        wgpu::DeviceType::IntegratedGpu => 1,
        wgpu::DeviceType::VirtualGpu => 2,
        wgpu::DeviceType::Cpu => SOFTWARE,
        wgpu::DeviceType::Other => SOFTWARE + 1,
    }
}

fn names(adapters: &[wgpu::Adapter]) -> String {
    let names: Vec<String> = adapters
        .iter()
        .map(|adapter| format!("`{}`", adapter.get_info().name))
        .collect();
    match names.as_slice() {
        [] => "none".to_owned(),
        names => names.join(", "),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_version_in_the_id_is_the_one_that_is_built() {
        let lock = include_str!("../../../../Cargo.lock");
        let version = WGPU.trim_start_matches("wgpu ");
        let entry = format!("name = \"wgpu\"\nversion = \"{version}\"\n");
        assert!(lock.contains(&entry), "{WGPU} is not what Cargo.lock has");
    }

    #[test]
    fn an_adapter_that_is_not_there_is_refused_with_those_that_are() {
        let wanted = Device::Gpu(Some("no such card".to_owned()));
        let refused = Gpu::open(&wanted).map(|gpu| gpu.is_some());
        assert!(
            matches!(&refused, Err(GpuError::NoAdapter { wanted, .. }) if wanted.contains("no such card")),
            "{refused:?}"
        );
        assert!(matches!(Gpu::open(&Device::Cpu), Ok(None)));
    }
}
