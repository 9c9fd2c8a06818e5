//! Which program runs, to the byte.

use marf_cache::Digest;
use marf_cache::file::{self, Links};
use marf_engine::Build;

/// The program with its version, as records name it.
pub const PROGRAM: &str = concat!("marf ", env!("CARGO_PKG_VERSION"));

/// Returns the identity of the program's file, with the commit that it is built from. None if the system does not report the file, or it
/// cannot be read. The digest of 100 MB takes 20 ms.
pub fn build(commit: Option<&str>) -> Option<Build> {
    let path = std::env::current_exe().ok()?;
    let (blake3, bytes) = Digest::from_reader(file::open(&path, Links::Followed).ok()?).ok()?;
    Some(Build {
        commit: commit.map(str::to_owned),
        blake3,
        bytes,
        os: std::env::consts::OS.to_owned(),
        arch: std::env::consts::ARCH.to_owned(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_program_is_known_by_its_digest() {
        let build = build(None).unwrap();
        let exe = std::fs::read(std::env::current_exe().unwrap()).unwrap();
        assert_eq!(
            (build.blake3, build.bytes),
            (Digest::from_content(&exe), exe.len() as u64)
        );
    }
}
