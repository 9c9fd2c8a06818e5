//! Helpers of the unit tests.
#![allow(clippy::print_stdout, reason = "a test that is skipped says so")]

use std::path::{Path, PathBuf};

/// Returns a folder of the real data. `None`, with a line of output, if it is absent.
pub fn real(name: &str) -> Option<PathBuf> {
    let root = std::env::var_os("MARF_SHARED_DATA").map_or_else(
        || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data"),
        PathBuf::from,
    );
    let path = root.join(name);
    if !path.is_dir() {
        println!("skipped: {name} needs ../shared/data");
        return None;
    }
    Some(path)
}
