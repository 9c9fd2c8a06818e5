//! Programs as children, and what programs cost: time, memory, disk.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use marf_run::{Diagnostic, Error};
use serde::Serialize;
use serde_json::Value;

use crate::output::Result;

/// Ticks a second in /proc/self/stat, on every Linux.
const TICKS_PER_S: f64 = 100.0;

/// Time between two looks at the memory of a program.
const BETWEEN_LOOKS: Duration = Duration::from_millis(1);

/// Cost of a program.
#[derive(Debug, Clone, Copy, Default, Serialize)]
pub struct Cost {
    /// Wall time.
    pub wall_s: f64,
    /// Processor time of all its threads, in steps of 0.01 s.
    pub cpu_s: f64,
    /// Largest memory, in MB.
    pub peak_mb: u64,
}

/// Returns the path of the program `marf` that was built with this one.
///
/// # Errors
/// A program that is not there, with how to build it.
pub fn marf() -> Result<PathBuf> {
    let program = std::env::current_exe()?.with_file_name(format!("marf{}", std::env::consts::EXE_SUFFIX));
    if program.is_file() {
        return Ok(program);
    }
    let missing = Diagnostic::new(format!("cannot find the program {}", program.display()));
    let hint =
        "build it with the same profile: `cargo build --release` for `cargo run --release -p marf-labs`";
    Err(Error::Failed(missing.hint(hint)).into())
}

/// Runs a program in a folder and returns its cost, and the lines of JSON it printed.
///
/// # Errors
/// Returns an error if the program cannot be started, or if it fails. Its output is the cause.
pub fn run(program: &Path, dir: &Path, arguments: &[&str]) -> Result<(Cost, Vec<Value>)> {
    let (began, cpu_before_s) = (Instant::now(), children_cpu_s());
    let child = Command::new(program)
        .args(arguments)
        .current_dir(dir)
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()?;
    let pid = child.id();
    let peak = std::thread::spawn(move || peak_kb_until_end(pid));
    let output = child.wait_with_output()?;
    let cost = Cost {
        wall_s: began.elapsed().as_secs_f64(),
        cpu_s: children_cpu_s() - cpu_before_s,
        peak_mb: peak.join().unwrap_or_default() / 1024,
    };
    if !output.status.success() {
        let message = format!("`{} {}` failed", program.display(), arguments.join(" "));
        let cause = Some(String::from_utf8_lossy(&output.stderr).into_owned());
        let message = Diagnostic::new(message);
        return Err(Error::Failed(Diagnostic { cause, ..message }).into());
    }
    let lines = String::from_utf8_lossy(&output.stdout);
    let lines = lines.lines().filter_map(|line| serde_json::from_str(line).ok());
    Ok((cost, lines.collect()))
}

/// Returns the processor time of this program so far, or 0 if the system does not report it.
pub fn cpu_s() -> f64 {
    cpu_s_from(11)
}

/// Returns the processor time of all children that have ended, or 0 if the system does not report it.
fn children_cpu_s() -> f64 {
    cpu_s_from(13)
}

/// Returns the sum of two fields of /proc/self/stat: user and system time.
fn cpu_s_from(field: usize) -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    // Fields are counted after the name of the program in parentheses, which may hold anything.
    let fields = stat.rsplit_once(')').map_or("", |(_, fields)| fields);
    let ticks = fields.split_whitespace().skip(field).take(2);
    ticks.filter_map(|ticks| ticks.parse::<f64>().ok()).sum::<f64>() / TICKS_PER_S
}

/// Returns the largest memory of this program so far, in MB, or 0 if the system does not report it.
pub fn peak_mb() -> u64 {
    peak_kb("self").unwrap_or(0) * 1024 / 1_000_000
}

/// Returns the largest memory of a program up to its last look before it ends, in units of 1,024 bytes.
fn peak_kb_until_end(pid: u32) -> u64 {
    let (pid, mut last_kb) = (pid.to_string(), 0);
    while let Some(kb) = peak_kb(&pid) {
        last_kb = kb;
        std::thread::sleep(BETWEEN_LOOKS);
    }
    last_kb
}

/// Returns the largest memory of a running program so far, in units of 1,024 bytes, or `None` once it has
/// ended.
fn peak_kb(pid: &str) -> Option<u64> {
    let status = std::fs::read_to_string(format!("/proc/{pid}/status")).ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    line.trim().trim_end_matches("kB").trim().parse().ok()
}

/// Returns the bytes of all files below a folder.
pub fn bytes_below(dir: &Path) -> u64 {
    let files = walkdir::WalkDir::new(dir).into_iter().flatten();
    let files = files.filter_map(|file| file.metadata().ok());
    files.filter(|meta| meta.is_file()).map(|meta| meta.len()).sum()
}

/// Returns the absolute path of a folder that does not exist yet.
///
/// # Errors
/// A folder that exists.
pub fn absent(dir: &Path) -> Result<PathBuf> {
    let dir = std::path::absolute(dir)?;
    if dir.exists() {
        let shown = dir.display();
        let message = format!("{shown} exists. Remove it or name another folder with --dir");
        return Err(Error::usage(message).into());
    }
    Ok(dir)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn processor_time_and_memory_grow_with_work() {
        if !Path::new("/proc/self/stat").exists() {
            return;
        }
        let before = cpu_s();
        let mut sum = 0_u64;
        while cpu_s() - before < 0.02 {
            sum = (0..100_000).fold(sum, u64::wrapping_add);
        }
        assert!(peak_mb() > 0);
    }
}
