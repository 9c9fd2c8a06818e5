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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_sent_and_received_is_not_exchanged() {
        let traffic = Traffic {
            requests: 3,
            sent_bytes: 2000,
            received_bytes: 5,
        };
        let expected = format!("3 requests, {} sent, {} received", size(2000), size(5));
        assert_eq!(traffic_text(traffic), expected);
    }
}
