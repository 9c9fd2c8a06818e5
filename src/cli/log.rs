use std::time::{Duration, SystemTime};

use marf_engine::{Cancel, NodeState};

use super::args::Global;
use super::error::CliError;
use super::output::print_json;
use super::session::{existing_store, warn};
use crate::progress::duration;
use crate::terminal::print_line;

/// `marf log`: the runs so far, the newest first.
pub fn log(global: &Global, last: usize, cancel: &Cancel) -> Result<(), CliError> {
    let runs = marf_engine::runs(&existing_store(global, cancel)?, warn)?;
    let shown: Vec<_> = runs.iter().rev().take(last).collect();
    if global.json {
        return print_json(&shown);
    }
    for run in shown {
        let count = |state: NodeState| run.nodes.iter().filter(|node| node.state == state).count();
        print_line(&format!(
            "{:>4}  {}  {:<9} {:>3} ran, {:>3} reused, {} failed  {:>12}  {}",
            run.number,
            utc(run.started_unix_s),
            format!("{:?}", run.outcome).to_lowercase(),
            count(NodeState::Finished),
            count(NodeState::Reused),
            count(NodeState::Failed),
            duration(run.seconds),
            run.command,
        ));
    }
    Ok(())
}

/// Last second of the year 9999, the last one that RFC 3339 can write.
const LAST_UNIX_S: u64 = 253_402_300_799;

/// Returns a time as `2026-11-21T07:01:02Z`.
pub fn utc(unix_s: u64) -> String {
    let since_1970 = Duration::from_secs(unix_s.min(LAST_UNIX_S));
    humantime::format_rfc3339_seconds(SystemTime::UNIX_EPOCH + since_1970).to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dates_at_the_edges_of_years_and_leap_days() {
        for (unix_s, text) in [
            (0, "1970-01-01T00:00:00Z"),
            (951_782_400, "2000-02-29T00:00:00Z"),
            (1_709_251_199, "2024-02-29T23:59:59Z"),
            (1_795_244_462, "2026-11-21T07:01:02Z"),
            (LAST_UNIX_S, "9999-12-31T23:59:59Z"),
            (u64::MAX, "9999-12-31T23:59:59Z"),
        ] {
            assert_eq!(utc(unix_s), text);
        }
    }
}
