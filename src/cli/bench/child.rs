//! A run of this program as a child, with what it cost.

use std::io::{BufRead as _, BufReader, Read as _};
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use serde::Serialize;
use serde_json::Value;

use marf_run::{Diagnostic, Error};

/// Ticks a second in /proc/self/stat, on every Linux.
const TICKS_PER_S: f64 = 100.0;

/// Time between two looks at the memory of a program.
const BETWEEN_LOOKS: Duration = Duration::from_millis(1);

/// What a program cost.
#[derive(Debug, Clone, Copy, Default, Serialize)]
pub struct Cost {
    /// Wall time.
    pub wall_s: f64,
    /// Processor time of all its threads, in steps of 0.01 s.
    pub cpu_s: f64,
    /// Largest memory, in MB.
    pub peak_mb: u64,
}

/// Runs this program in a folder and returns what it cost, and the lines of JSON it printed.
///
/// # Errors
/// A program that cannot be started, or that fails; its words are the cause.
pub fn run(dir: &Path, arguments: &[&str]) -> Result<(Cost, Vec<Value>), Error> {
    let failed = |cause: String| {
        let message = format!("`marf {}` in {} failed", arguments.join(" "), dir.display());
        Error::Failed(Diagnostic {
            message,
            cause: Some(cause),
            hint: None,
        })
    };
    let io = |error: std::io::Error| failed(error.to_string());
    let program = std::env::current_exe().map_err(io)?;
    let (began, cpu_before) = (Instant::now(), children_cpu_s());
    let mut child = Command::new(program)
        .args(arguments)
        .current_dir(dir)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .map_err(io)?;
    let (stdout, stderr) = (child.stdout.take(), child.stderr.take());
    let words = std::thread::spawn(move || {
        let mut text = String::new();
        let read = stderr.map(|mut stderr| stderr.read_to_string(&mut text));
        read.transpose().map(|_| text)
    });
    let pid = child.id();
    let peak = std::thread::spawn(move || peak_until_end(pid));
    let mut lines = Vec::new();
    for line in stdout
        .into_iter()
        .flat_map(|stdout| BufReader::new(stdout).lines())
    {
        lines.extend(serde_json::from_str(&line.map_err(io)?).ok());
    }
    // Before the child is waited for, so that its number is still its own.
    let peak_mb = peak.join().unwrap_or_default();
    let status = child.wait().map_err(io)?;
    let cost = Cost {
        wall_s: began.elapsed().as_secs_f64(),
        cpu_s: children_cpu_s() - cpu_before,
        peak_mb,
    };
    match (status.success(), words.join()) {
        (true, _) => Ok((cost, lines)),
        (false, Ok(Ok(words))) => Err(failed(words)),
        (false, _) => Err(failed(status.to_string())),
    }
}

/// Returns the processor time of all children that have ended; 0 where the system does not tell.
fn children_cpu_s() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    // The name of the program, in parentheses, may hold anything; cutime and cstime are fields 16 and 17.
    let fields = stat.rsplit_once(')').map_or("", |(_, fields)| fields);
    let ticks: f64 = fields
        .split_whitespace()
        .skip(13)
        .take(2)
        .filter_map(|field| field.parse::<f64>().ok())
        .sum();
    ticks / TICKS_PER_S
}

/// Returns the largest memory of a program up to its last look before it ends, in MB; 0 where the system does not tell.
fn peak_until_end(pid: u32) -> u64 {
    let mut last_kb = 0;
    while let Some(kb) = peak_kb(pid) {
        last_kb = kb;
        std::thread::sleep(BETWEEN_LOOKS);
    }
    last_kb / 1024
}

/// Returns the largest memory of a running program so far; nothing once it ended (a program that is not yet waited for
/// has no memory).
fn peak_kb(pid: u32) -> Option<u64> {
    let status = std::fs::read_to_string(format!("/proc/{pid}/status")).ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    line.trim().trim_end_matches("kB").trim().parse().ok()
}

/// Returns the bytes of all files below a folder.
pub fn bytes_below(dir: &Path) -> u64 {
    let files = walkdir::WalkDir::new(dir).into_iter().filter_map(Result::ok);
    let sizes = files
        .filter_map(|file| file.metadata().ok())
        .filter(|meta| meta.is_file());
    sizes.map(|meta| meta.len()).sum()
}

/// Returns a random number of a pair (SplitMix64, Steele et al. 2014).
pub fn random(a: u64, b: u64) -> u64 {
    let mut z = a
        .wrapping_mul(0x9e37_79b9_7f4a_7c15)
        .wrapping_add(b.wrapping_mul(0xd1b5_4a32_d192_ed03));
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}
