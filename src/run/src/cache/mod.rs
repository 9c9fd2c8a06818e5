//! What is kept in a store, and shared stores.

mod local;
mod remote;

pub use local::{GcResult, gc, pin, unpin};
pub use remote::{PullResult, PushResult, SharedStore};
