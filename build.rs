//! Tells the program the commit it is built from, if it is built in a repository with git.

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
}

/// Returns what git says, without the line's end; none if it cannot tell.
fn git(args: &[&str]) -> Option<String> {
    let output = Command::new("git").args(args).output().ok()?;
    let text = String::from_utf8(output.stdout).ok()?;
    output.status.success().then(|| text.trim_end().to_owned())
}
