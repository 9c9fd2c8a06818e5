use marf_engine::NodeState;

use super::args::Global;
use super::error::CliError;
use super::output::print_json;
use super::session::existing_store;
use crate::progress::duration;
use crate::terminal::print_line;

/// `marf log`: the runs so far, the newest first.
pub fn log(global: &Global, last: usize) -> Result<(), CliError> {
    let runs = marf_engine::runs(&existing_store(global)?)?;
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

/// Returns a time as `2026-11-21T07:01:02Z` (civil-from-days, proleptic Gregorian calendar).
pub fn utc(unix_s: u64) -> String {
    let (days, second) = (unix_s / 86_400, unix_s % 86_400);
    let shifted = days + 719_468; // days since 0000-03-01
    let (era, day_of_era) = (shifted / 146_097, shifted % 146_097);
    let year_of_era = (day_of_era - day_of_era / 1_460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let month_from_march = (5 * day_of_year + 2) / 153;
    let day = day_of_year - (153 * month_from_march + 2) / 5 + 1;
    let month = if month_from_march < 10 {
        month_from_march + 3
    } else {
        month_from_march - 9
    };
    let year = era * 400 + year_of_era + u64::from(month <= 2);
    format!(
        "{year:04}-{month:02}-{day:02}T{:02}:{:02}:{:02}Z",
        second / 3600,
        second / 60 % 60,
        second % 60
    )
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
        ] {
            assert_eq!(utc(unix_s), text);
        }
    }
}
