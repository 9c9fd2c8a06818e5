//! Tells the program the commit it is built from, if it is built in a repository with git. Lets the linker of Rust make functions of equal
//! code one.

use std::env;
use std::path::Path;
use std::process::Command;

fn main() {
    for path in ["Cargo.toml", "Cargo.lock", "cache", "shaders", "src", "stages"] {
        println!("cargo:rerun-if-changed={path}");
    }
    if let Some(log) = git(&["rev-parse", "--git-path", "logs/HEAD"]) {
        println!("cargo:rerun-if-changed={log}");
    }
    let changes = git(&["status", "--porcelain", "--untracked-files=no"]);
    if let (Some(commit), Some(changes)) = (git(&["rev-parse", "HEAD"]), changes) {
        let mark = if changes.is_empty() { "" } else { "+changes" };
        println!("cargo:rustc-env=MARF_COMMIT={commit}{mark}");
    }
    if links_by_lld() {
        println!("cargo:rustc-link-arg-bins=-Wl,--icf=all");
    }
}

/// Returns whether the linker is the LLD that Rust brings for this target, and nobody has chosen another.
fn links_by_lld() -> bool {
    let target = env::var("TARGET").unwrap_or_default();
    let flags = env::var("CARGO_ENCODED_RUSTFLAGS").unwrap_or_default();
    let sysroot = env::var_os("RUSTC").and_then(|rustc| {
        let output = Command::new(rustc).args(["--print", "sysroot"]).output().ok()?;
        String::from_utf8(output.stdout).ok()
    });
    let lld = format!("lib/rustlib/{target}/bin/gcc-ld/ld.lld");
    target == "x86_64-unknown-linux-gnu"
        && env::var_os("RUSTC_LINKER").is_none()
        && !flags.contains("link")
        && sysroot.is_some_and(|sysroot| Path::new(sysroot.trim_end()).join(lld).exists())
}

/// Returns what git says, without the line's end; none if it cannot tell.
fn git(args: &[&str]) -> Option<String> {
    let output = Command::new("git").args(args).output().ok()?;
    let text = String::from_utf8(output.stdout).ok()?;
    output.status.success().then(|| text.trim_end().to_owned())
}
