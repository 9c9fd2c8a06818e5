//! The bars on the shape of the code.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    reason = "a test that cannot go on should stop"
)]

use std::fmt::Write as _;
use std::path::Path;
use std::sync::LazyLock;

use marf_tidy::{Checkout, Report, Rule};

/// What is limited.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Bar {
    /// Lines of code outside tests, of all packages.
    Code,
    /// Lines of code outside tests, of the package marf.
    CodeOfMarf,
    /// Lines of code outside tests, of each other package.
    CodeOfACrate,
    /// How often a rule does not hold.
    Rule(Rule),
}

/// The most that is allowed now, and the bar. A limit goes down, but where defects cost lines.
struct Limit {
    bar: Bar,
    now: usize,
    goal: usize,
}

const fn limit(bar: Bar, now: usize, goal: usize) -> Limit {
    Limit { bar, now, goal }
}

static LIMITS: [Limit; 12] = [
    limit(Bar::Code, 111_544, 97_000),
    limit(Bar::CodeOfMarf, 3_990, 5_000),
    limit(Bar::CodeOfACrate, 8_000, 8_000),
    limit(Bar::Rule(Rule::LongFunctions), 0, 0),
    limit(Bar::Rule(Rule::LongFiles), 0, 0),
    limit(Bar::Rule(Rule::Arguments), 0, 0),
    limit(Bar::Rule(Rule::TupleParameters), 0, 0),
    limit(Bar::Rule(Rule::BooleanMatches), 0, 0),
    limit(Bar::Rule(Rule::Names), 0, 0),
    limit(Bar::Rule(Rule::States), 0, 0),
    limit(Bar::Rule(Rule::Circles), 0, 0),
    limit(Bar::Rule(Rule::Terminal), 0, 0),
];

static REPORT: LazyLock<Report> = LazyLock::new(|| {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    Report::new(&Checkout::read(&root).unwrap())
});

fn limit_of(bar: Bar) -> &'static Limit {
    LIMITS.iter().find(|limit| limit.bar == bar).unwrap()
}

/// Fails with the number and every place if a rule is broken more often than its limit allows.
fn check(rule: Rule) {
    let total = REPORT.total();
    let Limit { now, goal, .. } = limit_of(Bar::Rule(rule));
    let count = total.count(rule);
    let mut places = String::new();
    for finding in total.findings.iter().filter(|finding| finding.rule == rule) {
        writeln!(places, "{finding}").unwrap();
    }
    assert!(
        count <= *now,
        "{}: {count}, the limit is {now} and the bar {goal}\n{places}",
        rule.name()
    );
}

#[test]
fn all_code_outside_tests_has_at_most_so_many_lines() {
    let Limit { now, goal, .. } = limit_of(Bar::Code);
    let code = REPORT.total().code;
    assert!(
        code <= *now,
        "{code} lines of code, the limit is {now} and the bar {goal}"
    );
}

#[test]
fn the_package_marf_is_small_and_no_other_is_large() {
    for (package, measure) in &REPORT.packages {
        let bar = if package == "marf" {
            Bar::CodeOfMarf
        } else {
            Bar::CodeOfACrate
        };
        let Limit { now, goal, .. } = limit_of(bar);
        let code = measure.code;
        assert!(
            code <= *now,
            "{package}: {code} lines of code, the limit is {now} and the bar {goal}"
        );
    }
}

/// The laboratory reads what it has written itself.
const OTHER_READERS: &str = "labs/";

#[test]
fn files_are_read_by_the_functions_that_refuse_what_has_no_end() {
    let total = REPORT.total();
    let findings = total
        .findings
        .iter()
        .filter(|finding| finding.rule == Rule::Reads);
    let others = findings.filter(|finding| !finding.file.starts_with(OTHER_READERS));
    let others: Vec<String> = others.map(ToString::to_string).collect();
    assert!(others.is_empty(), "{others:#?}");
}

#[test]
fn functions_have_at_most_80_lines() {
    check(Rule::LongFunctions);
}

#[test]
fn files_have_at_most_450_lines() {
    check(Rule::LongFiles);
}

#[test]
fn functions_have_at_most_five_arguments_besides_self() {
    check(Rule::Arguments);
}

#[test]
fn no_parameter_is_a_packed_tuple() {
    check(Rule::TupleParameters);
}

#[test]
fn no_match_has_arms_true_and_false() {
    check(Rule::BooleanMatches);
}

#[test]
fn functions_and_modules_have_names_that_say_what_they_do() {
    check(Rule::Names);
}

#[test]
fn no_type_is_named_after_a_state() {
    check(Rule::States);
}

#[test]
fn no_crate_has_a_circle_of_files() {
    check(Rule::Circles);
}

#[test]
fn only_marf_and_the_laboratory_know_clap_and_the_terminal() {
    check(Rule::Terminal);
}
