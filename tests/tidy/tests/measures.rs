//! What the measures count, on small checkouts.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    reason = "a test that cannot go on should stop"
)]

use std::collections::BTreeMap;

use marf_tidy::{Checkout, Measure, Report, Rule};

const MANIFEST: &str = "[package]\nname = \"it\"\n";

/// Returns the measure of a package with these files.
fn measure(files: &[(&str, &str)]) -> Measure {
    let mut texts: BTreeMap<String, String> = files
        .iter()
        .map(|(path, text)| ((*path).to_owned(), (*text).to_owned()))
        .collect();
    texts.insert("Cargo.toml".to_owned(), MANIFEST.to_owned());
    Report::new(&Checkout::from_texts(&texts).unwrap()).total()
}

fn found(measure: &Measure, rule: Rule) -> Vec<String> {
    let findings = measure.findings.iter().filter(|finding| finding.rule == rule);
    findings.map(ToString::to_string).collect()
}

#[test]
fn a_line_of_code_holds_a_token_and_tests_are_apart() {
    let text = r##"//! About.

/// A function.
fn one() -> &'static str { // with a remark
    /* and
       a longer one */
    "two

    lines"
}

/// Its tests.
#[cfg(test)]
mod tests {
    #[test]
    fn two() {}
}

#[cfg(all(test, feature = "gpu"))]
const THREE: [usize; 1] = { [3] };
"##;
    let measure = measure(&[("src/lib.rs", text)]);
    assert_eq!(
        (measure.code, measure.comments, measure.blank, measure.tests),
        (5, 4, 3, 8)
    );
    assert_eq!(measure.lengths, [7]);
}

#[test]
fn files_that_only_tests_reach_are_tests() {
    let measure = measure(&[
        (
            "src/lib.rs",
            "mod a;\n#[cfg(test)]\nmod b;\n#[cfg(test)]\nmod tests {\n    mod c;\n}\n",
        ),
        ("src/a/mod.rs", "fn a() {}\n"),
        ("src/b.rs", "mod d;\nmod inner { mod e; }\n"),
        ("src/b/d.rs", "fn d() {}\n"),
        ("src/b/inner/e.rs", "fn e() {}\n"),
        ("src/tests/c.rs", "fn c() {}\n"),
        ("src/nowhere.rs", "fn nowhere() {}\n"),
        ("build.rs", "fn main() {}\n"),
        ("examples/f.rs", "fn main() {}\n"),
        ("benches/g.rs", "fn main() {}\n"),
    ]);
    assert_eq!(measure.lengths.len(), 4, "a, nowhere, build.rs and examples/f.rs");
    assert_eq!((measure.code, measure.tests), (5, 12));
}

#[test]
fn signatures_are_counted_with_file_line_and_number() {
    let text = "
trait T {
    fn many(&self, a: u8, b: u8, c: u8, d: u8, e: u8);
    fn more(&self, a: u8, b: u8, c: u8, d: u8, e: u8, f: u8);
}
fn pair((a, b): (u8, u8), both: &(u8, u8), unit: ()) {}
fn of() { let f = |(a, b): (u8, u8)| a; let g = |(a, b)| a; }
mod on {}
struct Begun;
#[cfg(test)]
fn again((a, b): (u8, u8)) {}
";
    let measure = measure(&[("src/lib.rs", text)]);
    assert_eq!(found(&measure, Rule::Arguments), ["src/lib.rs:4: fn more (6)"]);
    assert_eq!(
        found(&measure, Rule::TupleParameters),
        ["src/lib.rs:6: fn pair (2)"]
    );
    assert_eq!(measure.count(Rule::TupleTypes), 2);
    assert_eq!(
        found(&measure, Rule::Names),
        ["src/lib.rs:7: fn of (1)", "src/lib.rs:8: mod on (1)"]
    );
    assert_eq!(found(&measure, Rule::States), ["src/lib.rs:9: type Begun (1)"]);
}

#[test]
fn long_functions_and_files_are_counted_by_their_lines() {
    let lines = |count: usize| "    one();\n".repeat(count);
    let text = format!("fn most() {{\n{}}}\nfn long() {{\n{}}}\n", lines(78), lines(79));
    let measure = measure(&[("src/lib.rs", &text), ("tests/long.rs", &"\n".repeat(451))]);
    assert_eq!(
        found(&measure, Rule::LongFunctions),
        ["src/lib.rs:81: fn long (81)"]
    );
    assert_eq!(found(&measure, Rule::LongFiles), ["tests/long.rs:1: file (451)"]);
    assert_eq!(measure.length_of_share(0.5), 80);
    assert_eq!(measure.length_of_share(0.95), 81);
}

#[test]
fn matches_on_booleans_are_counted_also_in_macros() {
    let text = "
fn a(a: bool, b: Option<bool>) {
    match a { true => {} false => {} }
    match b { Some(true) => {} _ => {} }
    match (a, b) { (true, _) => {} _ => {} }
    html! { @match a { false => one(), _ if a => two() } }
    if a { true } else { false };
    Begin { a: true, b: false };
}
";
    let measure = measure(&[("src/lib.rs", text)]);
    assert_eq!(
        found(&measure, Rule::BooleanMatches),
        [
            "src/lib.rs:3: match with arms `true` or `false` (2)",
            "src/lib.rs:6: match with arms `true` or `false` (1)"
        ]
    );
}

#[test]
fn files_that_use_each_other_are_a_circle() {
    let measure = measure(&[
        ("src/lib.rs", "mod a;\nmod b;\nmod c;\nmod d;\n"),
        ("src/a.rs", "use crate::b::B;\npub struct A(B);\n"),
        (
            "src/b.rs",
            "pub struct B;\nfn b() { html! { (super::c::c()) } }\n",
        ),
        (
            "src/c.rs",
            "pub fn c() { use super::a::{self, x::Y}; let _: a::A; }\n",
        ),
        ("src/d.rs", "use super::{a::A, b, c::*};\nfn d() { c(); }\n"),
    ]);
    assert_eq!(measure.circles.len(), 1);
    let files: Vec<&str> = measure.circles[0].files.iter().map(String::as_str).collect();
    assert_eq!(files, ["src/a.rs", "src/b.rs", "src/c.rs"]);
    assert_eq!(
        found(&measure, Rule::Circles),
        [
            "src/a.rs:1: uses `crate::b::B` of src/b.rs (3)",
            "src/b.rs:2: uses `super::c::c` of src/c.rs (3)",
            "src/c.rs:1: uses `a::A` of src/a.rs (3)"
        ]
    );
}

#[test]
fn a_parent_that_only_re_exports_is_in_no_circle() {
    let parent = "mod a;\nmod b;\nmod macros;\npub use a::A;\npub(crate) use self::b::*;\n";
    let a = "use super::B;\nuse crate::made;\npub struct A(B);\n";
    let apart = measure(&[
        ("src/lib.rs", "pub mod parent;\npub use parent::A;\n"),
        ("src/parent/mod.rs", parent),
        ("src/parent/a.rs", a),
        ("src/parent/b.rs", "pub struct B;\n"),
        (
            "src/parent/macros.rs",
            "#[macro_export]\nmacro_rules! made { () => { $crate::parent::B }; }\n",
        ),
        ("src/main.rs", "fn main() { it::parent::A; }\n"),
    ]);
    assert_eq!(found(&apart, Rule::Circles), [""; 0]);

    let parent = format!("{parent}fn uses(a: a::A) {{}}\npub struct Own;\n");
    let circle = measure(&[
        ("src/lib.rs", "pub mod parent;\n"),
        ("src/parent/mod.rs", &parent),
        (
            "src/parent/a.rs",
            "use crate::parent::{B, Own};\npub struct A(B, Own);\n",
        ),
        ("src/parent/b.rs", "pub struct B;\n"),
        ("src/parent/macros.rs", ""),
    ]);
    assert_eq!(circle.count(Rule::Circles), 2);
    assert_eq!(
        found(&circle, Rule::Circles),
        [
            "src/parent/a.rs:1: uses `crate::parent::Own` of src/parent/mod.rs (2)",
            "src/parent/mod.rs:6: uses `a::A` of src/parent/a.rs (2)"
        ]
    );
}

#[test]
fn output_to_the_terminal_is_found_in_every_form() {
    let text = "
use clap::Parser;
use std::io::{self, IsTerminal as _, Read};
fn a() { println!(); let _ = io::stdout(); indicatif::ProgressBar::new(1); writeln!(child.stdout) }
#[test]
fn b() { println!(); }
";
    let measure = measure(&[("src/lib.rs", text), ("build.rs", "fn main() { println!(); }\n")]);
    let mut places = found(&measure, Rule::Terminal);
    places.sort();
    assert_eq!(
        places,
        [
            "src/lib.rs:2: clap::Parser (1)",
            "src/lib.rs:3: std::io::IsTerminal (1)",
            "src/lib.rs:4: indicatif::ProgressBar::new (1)",
            "src/lib.rs:4: io::stdout (1)",
            "src/lib.rs:4: println! (1)",
        ]
    );
}

#[test]
fn files_belong_to_the_deepest_package() {
    let texts = [
        ("Cargo.toml", MANIFEST),
        ("src/lib.rs", "mod a;\n"),
        ("src/a.rs", "fn a() {}\n"),
        ("src/deep/Cargo.toml", "[package]\nname = \"deep\"\n"),
        ("src/deep/src/lib.rs", "fn deep() {}\nfn deeper() {}\n"),
    ];
    let texts = texts
        .map(|(path, text)| (path.to_owned(), text.to_owned()))
        .into();
    let report = Report::new(&Checkout::from_texts(&texts).unwrap());
    assert_eq!(report.packages["it"].code, 2);
    assert_eq!(report.packages["deep"].code, 2);
}

#[test]
fn a_file_that_is_not_rust_is_an_error_with_its_line() {
    let texts = BTreeMap::from([("src/lib.rs".to_owned(), "\nfn (\n".to_owned())]);
    let error = Checkout::from_texts(&texts).map(|_| ()).unwrap_err();
    assert!(error.file.starts_with("src/lib.rs:"), "{error}");
}

#[test]
fn reads_of_whatever_it_is_are_found_in_each_form() {
    let text = "use std::fs::{self, File, read};\n\
        fn a() { fs::read(p); std::fs::read_to_string(p); File::open(p); f.read_to_end(&mut b); f.read_to_string(&mut s); }\n\
        fn b() { file::read(p); read_to_end(p); fs::read_dir(p); fs::read_link(p); }\n\
        #[cfg(test)]\nmod tests { fn c() { fs::read(p); f.read_to_end(&mut b); } }\n";
    let found_in = |path: &str| found(&measure(&[(path, text)]), Rule::Reads).len();
    assert_eq!(found_in("src/lib.rs"), 6);
    assert_eq!(found_in("tests/a.rs"), 0);
}
