//! Sizes and transfers in words.

use marf_remote::Traffic;

/// Returns a size in megabytes.
pub fn megabytes(bytes: u64) -> String {
    format!("{:.1} MB", bytes as f64 / 1e6)
}

/// Returns the requests and bytes between this machine and a shared store.
pub fn traffic_text(traffic: Traffic) -> String {
    format!(
        "{} requests, {} sent, {} received",
        traffic.requests,
        megabytes(traffic.sent_bytes),
        megabytes(traffic.received_bytes)
    )
}
