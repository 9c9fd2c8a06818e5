//! Measures every package of a checkout.

use std::collections::{BTreeMap, BTreeSet};

use crate::checkout::{Checkout, is_in_test_folder};
use crate::graph::{Graph, circles};
use crate::modules::{Declarations, Modules, Use, reached};
use crate::packages::Package;
use crate::paths::{Import, Mention};
use crate::rule::{Finding, Rule};
use crate::scan::{ModuleText, Scan, scan};
use crate::signatures::signatures;
use crate::source::{Line, Source};

/// Most lines of a file.
const FILE_LINES: usize = 450;
/// Crates that only the package marf may use.
const TERMINAL_CRATES: [&str; 4] = ["clap", "clap_complete", "clap_mangen", "indicatif"];
/// Names of `std::io` that reach the terminal.
const TERMINAL_NAMES: [&str; 5] = ["Stderr", "Stdout", "IsTerminal", "stderr", "stdout"];

/// Where files are opened: for everybody, and for the objects of the store.
const READERS: [&str; 2] = ["cache/src/file.rs", "cache/src/store/"];
/// Functions of the standard library that open a file whatever it is.
const READ_PATHS: [[&str; 2]; 3] = [["fs", "read"], ["fs", "read_to_string"], ["File", "open"]];

/// Files of a package that all use each other, directly or through others.
#[derive(Debug, Clone)]
pub struct Circle {
    /// Paths of the files.
    pub files: BTreeSet<String>,
}

/// What was counted in a package, or in several together.
#[derive(Debug, Clone, Default)]
pub struct Measure {
    /// Lines with code outside tests: a line that holds a token which is not of a comment.
    pub code: usize,
    /// Lines outside tests that hold comments only.
    pub comments: usize,
    /// Empty lines outside tests.
    pub blank: usize,
    /// All lines of tests, benchmarks and fuzzers.
    pub tests: usize,
    /// Lines of every function, ascending.
    pub lengths: Vec<usize>,
    /// Circles of files, the largest first.
    pub circles: Vec<Circle>,
    /// Where rules do not hold.
    pub findings: Vec<Finding>,
}

/// The measures of a checkout.
#[derive(Debug, Clone, Default)]
pub struct Report {
    /// By the name of the package.
    pub packages: BTreeMap<String, Measure>,
}

impl Report {
    /// Measures a checkout.
    #[must_use]
    pub fn new(checkout: &Checkout) -> Self {
        let scans: BTreeMap<String, Scan> = checkout
            .sources
            .iter()
            .map(|(path, source)| (path.clone(), scan(source)))
            .collect();
        let mut packages = BTreeMap::new();
        for package in &checkout.packages {
            let measure = measure_package(checkout, &scans, package);
            packages.insert(package.name.clone(), measure);
        }
        Self { packages }
    }

    /// Returns all packages together.
    #[must_use]
    pub fn total(&self) -> Measure {
        let mut total = Measure::default();
        for measure in self.packages.values() {
            total.add(measure.clone());
        }
        total.lengths.sort_unstable();
        total
            .circles
            .sort_by_key(|circle| std::cmp::Reverse(circle.files.len()));
        total
            .findings
            .sort_by(|a, b| (&a.file, a.line).cmp(&(&b.file, b.line)));
        total
    }
}

impl Measure {
    /// Returns how often a rule does not hold. For circles, the number of files in them.
    #[must_use]
    pub fn count(&self, rule: Rule) -> usize {
        if rule == Rule::Circles {
            return self.circles.iter().map(|circle| circle.files.len()).sum();
        }
        self.findings
            .iter()
            .filter(|finding| finding.rule == rule)
            .count()
    }

    /// Returns the length that a share of the functions does not exceed, 0 without functions.
    ///
    /// - `share`: in (0, 1].
    #[must_use]
    pub fn length_of_share(&self, share: f64) -> usize {
        let rank = (share * self.lengths.len() as f64).ceil() as usize;
        self.lengths.get(rank.max(1) - 1).copied().unwrap_or(0)
    }

    fn add(&mut self, other: Self) {
        self.code += other.code;
        self.comments += other.comments;
        self.blank += other.blank;
        self.tests += other.tests;
        self.lengths.extend(other.lengths);
        self.circles.extend(other.circles);
        self.findings.extend(other.findings);
    }
}

fn measure_package(checkout: &Checkout, scans: &BTreeMap<String, Scan>, package: &Package) -> Measure {
    let code = reached(checkout, scans, package, Declarations::Code);
    let all = reached(checkout, scans, package, Declarations::All);
    let mut measure = Measure::default();
    for source in checkout.sources.values() {
        if !is_of(checkout, package, &source.path) {
            continue;
        }
        if source.lines.len() > FILE_LINES {
            measure.findings.push(Finding {
                rule: Rule::LongFiles,
                file: source.path.clone(),
                line: 1,
                number: source.lines.len(),
                text: "file".to_owned(),
            });
        }
        let is_reached_by_tests = all.contains(&source.path) && !code.contains(&source.path);
        if is_in_test_folder(&source.path) || is_reached_by_tests {
            measure.tests += source.lines.len();
        } else {
            measure_file(package, source, &scans[&source.path], &mut measure);
        }
    }
    measure_circles(&Modules::new(checkout, scans, package).uses(), &mut measure);
    measure.lengths.sort_unstable();
    measure
        .findings
        .sort_by(|a, b| (&a.file, a.line).cmp(&(&b.file, b.line)));
    measure
}

/// Returns whether a file is of a package and of no package in a folder below.
fn is_of(checkout: &Checkout, package: &Package, path: &str) -> bool {
    let is_in = |package: &&Package| {
        package.folder.is_empty()
            || path
                .strip_prefix(&package.folder)
                .is_some_and(|rest| rest.starts_with('/'))
    };
    // Deeper packages come first.
    let owner = checkout.packages.iter().find(is_in);
    owner.is_some_and(|owner| owner.folder == package.folder)
}

fn measure_file(package: &Package, source: &Source, scan: &Scan, measure: &mut Measure) {
    for line in &source.lines {
        match line {
            Line::Blank => measure.blank += 1,
            Line::Comment => measure.comments += 1,
            Line::Code => measure.code += 1,
            Line::Test => measure.tests += 1,
        }
    }
    let signatures = signatures(source);
    measure.lengths.extend(signatures.lengths);
    measure.findings.extend(signatures.findings);
    let may_print = package.name == "marf"
        || package.folder.split('/').any(|name| name == "labs")
        || source.path.rsplit('/').next() == Some("build.rs");
    let may_read = READERS.iter().any(|reader| source.path.starts_with(reader));
    let holds = |rule: Rule| match rule {
        Rule::Terminal => may_print,
        Rule::Reads => may_read,
        _ => false,
    };
    let paths = scan.modules.values().flat_map(paths);
    let named = paths.filter_map(|(path, line)| {
        Some(Finding {
            rule: rule_of(path)?,
            file: source.path.clone(),
            line,
            number: 1,
            text: path.join("::"),
        })
    });
    let findings = scan.findings.iter().cloned().chain(named);
    measure
        .findings
        .extend(findings.filter(|finding| !holds(finding.rule)));
}

/// Returns the rule that a path may break.
fn rule_of(path: &[String]) -> Option<Rule> {
    let is_read = |pair: &[String]| READ_PATHS.iter().any(|read| pair == read);
    if is_terminal(path) {
        Some(Rule::Terminal)
    } else {
        path.windows(2).any(is_read).then_some(Rule::Reads)
    }
}

/// Returns the paths that a module mentions or imports, with their lines.
fn paths(module: &ModuleText) -> impl Iterator<Item = (&[String], usize)> {
    let mentions = module
        .mentions
        .iter()
        .map(|Mention { path, line }| (path.as_slice(), *line));
    let imports = module
        .imports
        .iter()
        .map(|Import { path, line, .. }| (path.as_slice(), *line));
    mentions.chain(imports)
}

fn is_terminal(path: &[String]) -> bool {
    let is_crate = path
        .first()
        .is_some_and(|name| TERMINAL_CRATES.contains(&name.as_str()));
    is_crate
        || path
            .windows(2)
            .any(|pair| pair[0] == "io" && TERMINAL_NAMES.contains(&pair[1].as_str()))
}

fn measure_circles(uses: &[Use], measure: &mut Measure) {
    let mut graph = Graph::new();
    for found in uses {
        graph
            .entry(found.from.clone())
            .or_default()
            .insert(found.to.clone());
    }
    let mut seen = BTreeSet::new();
    for files in circles(&graph) {
        for found in uses
            .iter()
            .filter(|found| files.contains(&found.from) && files.contains(&found.to))
        {
            if seen.insert((&found.from, &found.to)) {
                measure.findings.push(Finding {
                    rule: Rule::Circles,
                    file: found.from.clone(),
                    line: found.line,
                    number: files.len(),
                    text: format!("uses `{}` of {}", found.path, found.to),
                });
            }
        }
        measure.circles.push(Circle { files });
    }
}
