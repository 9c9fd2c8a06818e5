use std::collections::BTreeMap;

use marf_engine::{Cancel, NodeRun};
use marf_view::lines_of_running;
use serde::Deserialize;

use super::args::Global;
use super::error::CliError;
use super::output::print_json;
use super::run::state_word;
use super::scenes::parent_of;
use super::session::{existing_store, is_aside_name, last_of, warn};
use marf_config::scenes::scene_of;
use marf_progress::{Standing, duration, event_folder};
use crate::terminal::print_line;

/// `marf status`: the nodes of the run that goes on and began last, and how far others are; or the nodes of the last run. Exports aside.
pub fn status(global: &Global, cancel: &Cancel) -> Result<(), CliError> {
    let store = existing_store(global, cancel)?;
    if !global.json
        && let Some(text) = running_text(&lines_of_running(&event_folder(&store)))
    {
        text.lines().for_each(print_line);
        return Ok(());
    }
    let runs = marf_engine::runs(&store, warn)?;
    let Some(run) = last_of(&runs) else {
        return Err(CliError::failed(format!("no run in {}", store.dir().display())));
    };
    if global.json {
        return print_json(run);
    }
    let outcome = format!("{:?}", run.outcome).to_lowercase();
    print_line(&format!(
        "run {} of `{}`: {outcome} in {}",
        run.number,
        run.pipeline,
        duration(run.seconds)
    ));
    let mut nodes: Vec<&NodeRun> = run.nodes.iter().collect();
    // What all scenes share comes first, then scene by scene.
    nodes.sort_by_key(|node| scene_of(parent_of(&node.name)));
    for node in nodes {
        let key = node.key.map(|key| key.short()).unwrap_or_default();
        let line = format!(
            "{:<22} {:<8} {key:<13} {}",
            node.name,
            state_word(node.state),
            node.reason
        );
        print_line(line.trim_end());
    }
    Ok(())
}

/// Returns the page of what the programs that run have told: the nodes of the first, a line each of the others; none if none of them runs a
/// pipeline.
fn running_text(programs: &[Vec<String>]) -> Option<String> {
    let all = programs.iter().filter_map(|lines| Running::read(lines));
    let mut all = all.filter(|running| !is_aside_name(&running.pipeline));
    let mut text = all.next()?.text();
    for other in all {
        text += &format!("\nbeside it {}", other.heading().join(": "));
    }
    Some(text)
}

/// A line that a running program has left, as far as it is shown.
#[derive(Deserialize)]
#[serde(tag = "event", rename_all = "snake_case")]
enum Line {
    Began {
        pipeline: String,
        command: String,
        nodes: Vec<String>,
        upstream: BTreeMap<String, Vec<String>>,
    },
    Standing(Standing),
    WillRun {
        node: String,
    },
    Reused {
        node: String,
    },
    Progress {
        node: String,
        done: u64,
        total: u64,
        note: String,
    },
    Finished {
        node: String,
        seconds: f64,
    },
    Failed {
        node: String,
        message: String,
    },
    Skipped {
        node: String,
        reason: String,
    },
    Warning {},
}

/// A program that runs, as its lines tell.
#[derive(Default)]
struct Running {
    pipeline: String,
    head: String,
    /// The nodes with their children below them, in the order in which they are shown.
    order: Vec<String>,
    nodes: BTreeMap<String, NodeLine>,
    upstream: BTreeMap<String, Vec<String>>,
    standing: Option<Standing>,
}

/// How a node stands.
#[derive(Default)]
struct NodeLine {
    /// None: it waits.
    word: Option<&'static str>,
    note: String,
}

impl Running {
    /// Reads the lines of a program; none if the first of them is not the beginning of a run.
    fn read(lines: &[String]) -> Option<Self> {
        let mut running = Self::default();
        // A line of a newer version is passed over.
        let known = lines.iter().filter_map(|line| serde_json::from_str(line).ok());
        known.for_each(|line| running.take(line));
        (!running.head.is_empty()).then_some(running)
    }

    fn take(&mut self, line: Line) {
        match line {
            Line::Began {
                pipeline,
                command,
                nodes,
                upstream,
            } => {
                self.head = format!("`{pipeline}` runs: {command}");
                self.pipeline = pipeline;
                self.order = nodes;
                self.upstream = upstream;
            }
            Line::Standing(standing) => self.standing = Some(standing),
            Line::WillRun { node } => self.set(node, "running", String::new()),
            Line::Reused { node } => self.set(node, "reused", String::new()),
            Line::Progress {
                node,
                done,
                total,
                note,
            } => {
                let at = if total > 0 {
                    format!("{done}/{total}  {note}")
                } else {
                    note
                };
                self.set(node, "running", at);
            }
            Line::Finished { node, seconds } => self.set(node, "ran", duration(seconds)),
            Line::Failed { node, message } => self.set(node, "failed", message),
            Line::Skipped { node, reason } => self.set(node, "skipped", reason),
            Line::Warning {} => {}
        }
    }

    fn set(&mut self, node: String, word: &'static str, note: String) {
        if !self.nodes.contains_key(&node) && !self.order.contains(&node) {
            let parent = parent_of(&node).to_owned();
            let place = self.order.iter().rposition(|name| parent_of(name) == parent);
            self.order
                .insert(place.map_or(self.order.len(), |place| place + 1), node.clone());
        }
        self.nodes.insert(
            node,
            NodeLine {
                word: Some(word),
                note,
            },
        );
    }

    /// Returns what runs and, once it is known, how far it is.
    fn heading(&self) -> Vec<String> {
        let standing = self.standing.as_ref();
        let far =
            standing.map(|standing| format!("{}, after {}", standing.text(), duration(standing.seconds)));
        [self.head.clone()].into_iter().chain(far).collect()
    }

    /// Returns the page: one line a node, children only while they run.
    fn text(&self) -> String {
        let mut lines = self.heading();
        for name in &self.order {
            let waits = NodeLine::default();
            let node = self.nodes.get(name).unwrap_or(&waits);
            if name.contains('/') && node.word != Some("running") {
                continue;
            }
            let (word, note) = match node.word {
                Some(word) => (word, node.note.clone()),
                None => ("waiting", self.awaited(name)),
            };
            lines.push(format!("{name:<22} {word:<8} {note}").trim_end().to_owned());
        }
        lines.join("\n")
    }

    /// Says which nodes a node waits for: those that are not over.
    fn awaited(&self, name: &str) -> String {
        let is_open = |name: &&String| {
            let word = self.nodes.get(*name).and_then(|node| node.word);
            word.is_none_or(|word| word == "running")
        };
        let open: Vec<&str> = self
            .upstream
            .get(name)
            .into_iter()
            .flatten()
            .filter(is_open)
            .map(String::as_str)
            .collect();
        match open.is_empty() {
            true => String::new(),
            false => format!("for {}", open.join(", ")),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pages(programs: &[&[&str]]) -> Option<String> {
        let owned = |lines: &&[&str]| lines.iter().map(|line| (*line).to_owned()).collect();
        running_text(&programs.iter().map(owned).collect::<Vec<_>>())
    }

    fn page(lines: &[&str]) -> Option<String> {
        pages(&[lines])
    }

    const BEGAN: &str = r#"{"event":"began","run":"0a","pipeline":"demo","command":"marf run","nodes":["a","b","c"],
        "upstream":{"b":["a"],"c":["a","b"]}}"#;

    #[test]
    fn a_node_is_a_line_with_its_state_and_what_it_waits_for() {
        let page = page(&[
            BEGAN,
            r#"{"time":"t","run":"0a","event":"finished","node":"a","seconds":2.5,"outputs":{},"counts":{}}"#,
            r#"{"time":"t","run":"0a","event":"will_run","node":"b","reason":"never ran","device":"cpu"}"#,
            r#"{"time":"t","run":"0a","event":"progress","node":"b/part-00","done":1,"total":9,"note":"psnr 20"}"#,
            r#"{"time":"t","run":"0a","event":"progress","node":"b","done":3,"total":9,"note":""}"#,
            r#"{"event":"standing","seconds":70.0,"over":1,"nodes":3,"left_s":30.0,"unknown":1,"text":""}"#,
            r#"{"event":"of a newer version"}"#,
        ]);
        let expected = "`demo` runs: marf run\n1 of 3 nodes, about 30.0 s left and 1 with no known time, after 1 min 10 s\n\
            a                      ran      2.5 s\n\
            b                      running  3/9\n\
            b/part-00              running  1/9  psnr 20\n\
            c                      waiting  for b";
        assert_eq!(page.as_deref(), Some(expected));
    }

    #[test]
    fn programs_beside_it_are_a_line_each_and_exports_none() {
        let began = |pipeline: &str| {
            format!(
                r#"{{"event":"began","run":"0b","pipeline":"{pipeline}","command":"marf run --to a","nodes":["a"],"upstream":{{}}}}"#
            )
        };
        let [export, other, new] = ["demo (export)", "other", "new"].map(began);
        let standing =
            r#"{"event":"standing","seconds":70.0,"over":1,"nodes":3,"left_s":30.0,"unknown":0,"text":""}"#;
        let page = pages(&[&[&export], &[&new], &[&other, standing], &[&new]]);
        let expected = "`new` runs: marf run --to a\na                      waiting\n\
            beside it `other` runs: marf run --to a: 1 of 3 nodes, about 30.0 s left, after 1 min 10 s\n\
            beside it `new` runs: marf run --to a";
        assert_eq!(page.as_deref(), Some(expected));
        assert_eq!(pages(&[&[&export]]), None);
    }

    #[test]
    fn lines_without_a_beginning_are_no_run() {
        assert_eq!(page(&[]), None);
        assert_eq!(page(&["{}", "no JSON"]), None);
    }
}
