/// What keeps a GPU from being used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum GpuError {
    /// A GPU is set, and the feature `gpu` is off.
    #[error("this marf was built without the GPU: rebuild with `--features gpu`, or use `--device cpu`")]
    NotBuilt,
    /// No adapter matches the device.
    #[error("no GPU {wanted}: found {found}. Use `device = \"cpu\"`, or `gpu:NAME` for one of these")]
    NoAdapter {
        /// The requested device.
        wanted: String,
        /// Names of the adapters there are, or `none`.
        found: String,
    },
    /// An adapter that offers less than is needed.
    #[error("`{adapter}` offers {offered} {limit}, {needed} are needed: {hint}")]
    Limit {
        /// The adapter.
        adapter: String,
        /// Name of the limit, as WebGPU calls it.
        limit: &'static str,
        /// What it offers.
        offered: u64,
        /// What is needed.
        needed: u64,
        /// What to set.
        hint: &'static str,
    },
    /// A training that is larger than the memory of the device.
    #[error(
        "`{adapter}` gives {offered} bytes, the training takes {needed}, {share} of them for {part}: lower `{key}`, or use `device = \"cpu\"`"
    )]
    TooLarge {
        /// The adapter.
        adapter: String,
        /// Bytes that it gives.
        offered: u64,
        /// Bytes that are needed.
        needed: u64,
        /// Bytes of the largest share of these.
        share: u64,
        /// What that is for.
        part: &'static str,
        /// The key that decides it.
        key: &'static str,
    },
    /// Memory that was refused.
    #[error(
        "`{adapter}` refused {bytes} bytes for `{what}`: lower `batch_samples`, `log2_table` or `memory`, or use `device = \"cpu\"`"
    )]
    Memory {
        /// The adapter.
        adapter: String,
        /// The buffer.
        what: &'static str,
        /// Its size.
        bytes: u64,
    },
    /// A kernel that this driver does not compile.
    #[error("kernel `{kernel}` does not compile on `{adapter}`: {message}. Use `device = \"cpu\"`")]
    Kernel {
        /// The kernel.
        kernel: &'static str,
        /// The adapter.
        adapter: String,
        /// What the driver said.
        message: String,
    },
    /// A device that was lost, or refused a command.
    #[error(
        "`{adapter}` failed: {message}. Run again to continue from the last checkpoint, or use `device = \"cpu\"`"
    )]
    Lost {
        /// The adapter.
        adapter: String,
        /// What the driver said.
        message: String,
    },
}
