//! Runs the laboratory as its users do.
#![allow(dead_code, unused_imports, reason = "each test file uses a part")]

#[path = "../../../tests/common/photos.rs"]
mod photos;
#[path = "../../../tests/common/ran.rs"]
mod ran;

use std::path::Path;

pub use photos::photos;
pub use ran::Ran;

/// Runs `marf-labs ARGS` in a folder.
pub fn labs(folder: &Path, args: &[&str]) -> Ran {
    Ran::new(env!("CARGO_BIN_EXE_marf-labs"), folder, args)
}
