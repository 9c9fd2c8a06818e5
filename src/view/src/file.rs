//! What is served.

use std::sync::Arc;

/// Bytes with their type.
#[derive(Debug, Clone)]
pub struct File {
    /// Their type.
    pub media: &'static str,
    /// The bytes.
    pub bytes: Arc<[u8]>,
}
