//! README.md and the pages of the book are true: their commands do what they say, and their links lead somewhere.
//!
//! `docs/SUMMARY.md` has the convention for commands and output.
#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "a test that cannot go on should stop, and says what it did"
)]

mod common;

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use common::{SMALL_DEMO, copy, marf};

/// Why a block of commands is not run here.
const REASONS: [&str; 7] = ["network", "gpu", "cluster", "long", "serves", "program", "yours"];

/// Fewest commands that run and most that do not, so that nobody switches the test off page by page.
const LEAST_RUN: usize = 48;
const MOST_IGNORED: usize = 78;

/// A fenced block of a page.
struct Block {
    line: usize,
    info: String,
    lines: Vec<String>,
}

impl Block {
    /// Its commands, without comments.
    fn commands(&self) -> impl Iterator<Item = &str> {
        let bare = self
            .lines
            .iter()
            .map(|line| line.split(" # ").next().unwrap().trim());
        bare.filter(|line| !line.is_empty() && !line.starts_with('#'))
    }
}

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn read(page: &str) -> String {
    std::fs::read_to_string(root().join(page)).unwrap_or_else(|error| panic!("{page}: {error}"))
}

/// The pages of a folder and of its folders, from the root.
fn pages_in(folder: &str) -> Vec<String> {
    let found = walkdir::WalkDir::new(root().join(folder)).sort_by_file_name();
    let paths = found.into_iter().map(|entry| entry.unwrap().into_path());
    let pages = paths.filter(|path| path.extension().is_some_and(|ext| ext == "md"));
    pages
        .map(|path| {
            path.strip_prefix(root())
                .unwrap()
                .to_str()
                .unwrap()
                .replace('\\', "/")
        })
        .collect()
}

fn blocks(text: &str) -> Vec<Block> {
    let (mut found, mut open): (Vec<Block>, Option<Block>) = (Vec::new(), None);
    for (number, line) in text.lines().enumerate() {
        match (line.strip_prefix("```"), &mut open) {
            (Some(info), None) => {
                open = Some(Block {
                    line: number + 1,
                    info: info.to_owned(),
                    lines: Vec::new(),
                });
            }
            (Some(_), Some(_)) => found.extend(open.take()),
            (None, Some(block)) => block.lines.push(line.to_owned()),
            (None, None) => {}
        }
    }
    found
}

/// The demo's pipeline with small photos and short trainings.
fn small_demo(template: &str) -> String {
    let mut file: toml::Table = template.parse().unwrap();
    let mut set = |setting: &str| {
        let (path, value) = setting.split_once('=').unwrap();
        let path = match path.strip_prefix("archive.") {
            Some(_) => path.to_owned(),
            None => format!("node.{path}"),
        };
        let (tables, key) = path.rsplit_once('.').unwrap();
        let table = tables.split('.').fold(&mut file, |table, name| {
            table.get_mut(name).unwrap().as_table_mut().unwrap()
        });
        table.insert(key.to_owned(), value.parse::<toml::Value>().unwrap());
    };
    SMALL_DEMO.iter().copied().for_each(&mut set);
    // Photos of 320 pixels are a row lower than `shape` asks for.
    set("archive.demo.width=340");
    toml::to_string(&file).unwrap()
}

/// The folder that each kind of page starts in, and what `marf run` printed in that of the demo.
struct Folders {
    demo: PathBuf,
    photos: PathBuf,
    printed: String,
    _dir: tempfile::TempDir,
}

impl Folders {
    fn prepare() -> Self {
        let dir = tempfile::tempdir().unwrap();
        let (demo, photos) = (dir.path().join("demo"), dir.path().join("photos"));
        std::fs::create_dir_all(&demo).unwrap();
        std::fs::create_dir_all(photos.join("photos")).unwrap();
        marf(&demo, &["init"]).exits(0);
        let pipeline = demo.join("pipeline.toml");
        let template = std::fs::read_to_string(&pipeline).unwrap();
        std::fs::write(pipeline, small_demo(&template)).unwrap();
        let ran = marf(&demo, &["run"]).exits(0);
        marf(&demo, &["export", "cameras", "--out", "../exported"]).exits(0);
        for entry in std::fs::read_dir(dir.path().join("exported")).unwrap() {
            let path = entry.unwrap().path();
            // The photos of one sol.
            if path.extension().is_some_and(|ext| ext == "png") && path.to_string_lossy().contains("_0001_") {
                std::fs::rename(&path, photos.join("photos").join(path.file_name().unwrap())).unwrap();
            }
        }
        Self {
            demo,
            photos,
            printed: ran.stdout + &ran.stderr,
            _dir: dir,
        }
    }

    /// A fresh copy of the folder that a page asks for in its first line.
    fn fresh(&self, text: &str) -> tempfile::TempDir {
        let dir = tempfile::tempdir().unwrap();
        match text.lines().next() {
            Some("<!-- commands: demo -->") => copy(&self.demo, dir.path()),
            Some("<!-- commands: photos -->") => copy(&self.photos, dir.path()),
            _ => {}
        }
        dir
    }
}

/// Whether a shown line is a printed one. Words with a digit and units of time differ from run to run, and `…` is any text.
fn agree(shown: &[&str], printed: &[&str]) -> bool {
    let has_digit = |word: &str| word.contains(|letter: char| letter.is_ascii_digit());
    let similar = |shown: &str, printed: &str| match shown.strip_suffix('…') {
        Some(start) if !has_digit(start) => printed.starts_with(start),
        _ => {
            let both = |is: &dyn Fn(&str) -> bool| is(shown) && is(printed);
            shown == printed || both(&has_digit) || both(&|word| ["ms", "s", "min"].contains(&word))
        }
    };
    match (shown, printed) {
        ([], _) => printed.is_empty(),
        (["…", rest @ ..], _) => (0..=printed.len()).any(|skipped| agree(rest, &printed[skipped..])),
        ([word, rest @ ..], [first, more @ ..]) => similar(word, first) && agree(rest, more),
        (_, []) => false,
    }
}

/// Checks that the lines of a block were printed in this order.
fn is_printed(at: &str, block: &Block, printed: &str) {
    let mut lines = printed.lines();
    for shown in &block.lines {
        let words: Vec<&str> = shown.split_whitespace().collect();
        let found = words.is_empty()
            || words == ["…"]
            || lines.any(|line| agree(&words, &line.split_whitespace().collect::<Vec<_>>()));
        assert!(
            found,
            "{at}: not printed, or not in this order: {shown}\n{printed}"
        );
    }
}

#[test]
fn commands_of_the_pages_do_what_they_say() {
    let folders = Folders::prepare();
    let (mut run, mut ignored) = (0, BTreeMap::<String, usize>::new());
    let pages = pages_in("docs").into_iter();
    let pages = pages.filter(|page| page.matches('/').count() == 1 && page != "docs/SUMMARY.md");
    for page in ["README.md".to_owned()].into_iter().chain(pages) {
        let text = read(&page);
        let folder = folders.fresh(&text);
        let mut printed = String::new();
        for block in blocks(&text) {
            let at = format!("{page}:{}", block.line);
            if block.info == "sh" {
                printed.clear();
                for command in block.commands() {
                    let words: Vec<&str> = command.split_whitespace().collect();
                    assert_eq!(words[0], "marf", "{at}: {command}: only marf can be run here");
                    let start = std::time::Instant::now();
                    let ran = marf(folder.path(), &words[1..]);
                    assert_eq!(ran.code, 0, "{at}: {command}\n{}{}", ran.stdout, ran.stderr);
                    println!("{at}: {command}: {:.1} s", start.elapsed().as_secs_f64());
                    printed = printed + &ran.stdout + &ran.stderr;
                    run += 1;
                }
            } else if let Some(reason) = block.info.strip_prefix("sh,ignore") {
                let reason = reason.trim_start_matches(',');
                assert!(
                    REASONS.contains(&reason),
                    "{at}: a block that is not run needs one of {REASONS:?}"
                );
                *ignored.entry(reason.to_owned()).or_default() += block.commands().count();
                let is_prepared = block.commands().any(|command| command == "marf run");
                printed = String::from(if is_prepared { &folders.printed } else { "" });
            } else if block.info == "text" {
                is_printed(&at, &block, &printed);
            }
        }
    }
    println!("{run} commands were run. Not run: {ignored:?}");
    let not_run = ignored.values().sum::<usize>();
    assert!(
        run >= LEAST_RUN,
        "only {run} commands are run, expected {LEAST_RUN} or more"
    );
    assert!(
        not_run <= MOST_IGNORED,
        "{not_run} commands are not run, expected {MOST_IGNORED} or fewer"
    );
}

/// The anchors of a page, as GitHub and mdBook name them.
fn anchors(text: &str) -> BTreeSet<String> {
    let mut found = BTreeSet::new();
    for heading in without_code(text)
        .lines()
        .filter_map(|line| line.strip_prefix('#'))
    {
        let title = heading.trim_start_matches('#').trim().to_lowercase();
        let kept = title
            .chars()
            .filter(|letter| letter.is_alphanumeric() || " -_".contains(*letter));
        let anchor: String = kept
            .map(|letter| if letter == ' ' { '-' } else { letter })
            .collect();
        let mut names = (0..).map(|number| match number {
            0 => anchor.clone(),
            _ => format!("{anchor}-{number}"),
        });
        found.insert(names.find(|name| !found.contains(name)).unwrap());
    }
    found
}

/// A page without its fenced blocks.
fn without_code(text: &str) -> String {
    let parts = text.split("\n```").step_by(2);
    parts.collect::<Vec<_>>().join("\n")
}

#[test]
fn links_of_the_pages_lead_to_files_and_headings() {
    let mut pages = ["README.md", "ARCHITECTURE.md", "CONTRIBUTING.md", "CHANGELOG.md"]
        .map(str::to_owned)
        .to_vec();
    pages.extend(pages_in("docs"));
    pages.extend(pages_in("benches"));
    let (mut links, mut broken) = (0, Vec::new());
    for page in &pages {
        let text = without_code(&read(page));
        for link in text.split("](").skip(1).filter_map(|rest| rest.split_once(')')) {
            let (path, anchor) = link.0.split_once('#').unwrap_or((link.0, ""));
            if path.contains("://") {
                continue;
            }
            links += 1;
            let folder = Path::new(page).parent().unwrap();
            let target = if path.is_empty() {
                PathBuf::from(page)
            } else {
                folder.join(path)
            };
            let exists = root().join(&target).exists();
            if !exists || !anchor.is_empty() && !anchors(&read(target.to_str().unwrap())).contains(anchor) {
                broken.push(format!("{page}: {}", link.0));
            }
        }
    }
    assert!(broken.is_empty(), "links that lead nowhere: {broken:#?}");
    assert!(links >= 100, "only {links} links were found");
}
