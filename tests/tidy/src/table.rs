//! The table of all packages.

use crate::measure::{Measure, Report};
use crate::rule::Rule;

const HEADINGS: [&str; 20] = [
    "package", "code", "comment", "blank", "tests", "fns", "median", "p95", "max", ">80", ">450", ">5 args",
    "tuples", "types", "bool", "names", "states", "circles", "terminal", "reads",
];

/// Returns one line for each package and one for all together, as Markdown.
///
/// Lines of code, comments and blank lines outside tests, lines of tests, functions with the median, 95th percentile
/// and maximum of their lines, then the count of each rule. `circles` is the number of files in circles.
#[must_use]
pub fn table(report: &Report) -> String {
    let mut lines = vec![
        line(HEADINGS.map(str::to_owned).as_ref()),
        line(&rule_below_headings()),
    ];
    let mut packages: Vec<(&String, &Measure)> = report.packages.iter().collect();
    packages.sort_by_key(|(name, measure)| (std::cmp::Reverse(measure.code), *name));
    lines.extend(
        packages
            .into_iter()
            .map(|(name, measure)| line(&cells(name, measure))),
    );
    lines.push(line(&cells("all", &report.total())));
    lines.concat()
}

fn rule_below_headings() -> Vec<String> {
    let right = std::iter::repeat_n("--:".to_owned(), HEADINGS.len() - 1);
    std::iter::once("---".to_owned()).chain(right).collect()
}

fn cells(name: &str, measure: &Measure) -> Vec<String> {
    let numbers = [
        measure.code,
        measure.comments,
        measure.blank,
        measure.tests,
        measure.lengths.len(),
        measure.length_of_share(0.5),
        measure.length_of_share(0.95),
        measure.length_of_share(1.0),
    ];
    let counts = Rule::ALL.map(|rule| measure.count(rule));
    let numbers = numbers.into_iter().chain(counts).map(|number| number.to_string());
    std::iter::once(name.to_owned()).chain(numbers).collect()
}

fn line(cells: &[String]) -> String {
    let (first, rest) = cells
        .split_first()
        .map_or(("", cells), |(first, rest)| (first.as_str(), rest));
    let rest: String = rest.iter().map(|cell| format!(" {cell:>8} |")).collect();
    format!("| {first:<18} |{rest}\n")
}
