//! Prints the table of a checkout, or the places where one rule does not hold.

use std::io::Write as _;
use std::path::PathBuf;
use std::process::ExitCode;

use marf_tidy::{Checkout, Report, Rule, table};

const USAGE: &str = "usage: marf-tidy [--root DIR] [--list RULE]";

fn main() -> ExitCode {
    match output(std::env::args().skip(1)) {
        Ok(text) => {
            // Whoever reads the output may stop early.
            let _ = std::io::stdout().write_all(text.as_bytes());
            ExitCode::SUCCESS
        }
        Err(reason) => {
            let _ = writeln!(std::io::stderr(), "error: {reason}");
            ExitCode::FAILURE
        }
    }
}

fn output(mut arguments: impl Iterator<Item = String>) -> Result<String, String> {
    let mut root = PathBuf::from(".");
    let mut list = None;
    while let Some(option) = arguments.next() {
        let value = arguments.next().ok_or(USAGE)?;
        match option.as_str() {
            "--root" => root = value.into(),
            "--list" => list = Some(Rule::from_name(&value).ok_or_else(|| unknown_rule(&value))?),
            _ => return Err(USAGE.to_owned()),
        }
    }
    let checkout = Checkout::read(&root).map_err(|error| error.to_string())?;
    let report = Report::new(&checkout);
    let Some(rule) = list else {
        return Ok(table(&report));
    };
    let findings = report.total().findings;
    let listed = findings.iter().filter(|finding| finding.rule == rule);
    Ok(listed.map(|finding| format!("{finding}\n")).collect())
}

fn unknown_rule(name: &str) -> String {
    let names = Rule::ALL.map(Rule::name).join(", ");
    format!("no rule `{name}`; the rules are {names}")
}
