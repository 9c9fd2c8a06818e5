//! Transfers in words.

use marf_progress::format::size;
use marf_remote::Traffic;

/// Returns the requests and bytes between this machine and a shared store.
pub fn traffic_text(traffic: Traffic) -> String {
    format!(
        "{} requests, {} sent, {} received",
        traffic.requests,
        size(traffic.sent_bytes),
        size(traffic.received_bytes)
    )
}
