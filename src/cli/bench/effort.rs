//! Time, work and memory of a process.

use std::fs;
use std::time::Instant;

/// Ticks a second in /proc/self/stat, on every Linux.
const TICKS_PER_S: f64 = 100.0;

/// Time and work so far.
#[derive(Default)]
pub struct Effort {
    pub wall_s: f64,
    pub cpu_s: f64,
    pub rays: u64,
    pub samples: u64,
}

impl Effort {
    /// Does a work and adds its time.
    pub fn timed<T>(&mut self, work: impl FnOnce() -> T) -> T {
        let (wall, cpu_s) = (Instant::now(), cpu_s());
        let done = work();
        self.wall_s += wall.elapsed().as_secs_f64();
        self.cpu_s += self::cpu_s() - cpu_s;
        done
    }
}

/// Processor seconds of this process so far; 0 without /proc.
fn cpu_s() -> f64 {
    let stat = fs::read_to_string("/proc/self/stat").unwrap_or_default();
    // The name in brackets may hold spaces: user and system time are the 12th and 13th word after it.
    let words = stat.rsplit(')').next().unwrap_or_default().split_whitespace();
    let ticks = words
        .skip(11)
        .take(2)
        .filter_map(|ticks| ticks.parse::<f64>().ok());
    ticks.sum::<f64>() / TICKS_PER_S
}

/// Largest resident size so far, MB; 0 without /proc.
pub fn peak_mb() -> u64 {
    let status = fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    let kilobytes = line.and_then(|line| line.trim().strip_suffix(" kB")?.parse::<u64>().ok());
    kilobytes.unwrap_or(0) * 1024 / 1_000_000
}

#[cfg(test)]
mod tests {
    use std::path::Path;

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
