use clap::Args;
use marf_config::scenes::scene_of;
use marf_engine::{NodeRun, RunRecord};
use marf_progress::format::duration;
use marf_run::results::state_word;
use marf_run::scenes::parent_of;
use marf_run::status::{self, RunningProgram};
use marf_run::{Context, Error};

use super::options::RecordArgs;
use super::output::print_json;
use crate::terminal::{print_line, print_lines};

/// Arguments of `status`.
#[derive(Debug, Clone, Args)]
pub struct StatusArgs {
    #[command(flatten)]
    record: RecordArgs,
}

/// `marf status`: the running programs of the pipeline with the nodes of the one that was started first, or the nodes of the newest run.
pub fn status(args: StatusArgs, context: Context) -> Result<(), Error> {
    let context = &args.record.store.context(context);
    let store = context.existing_store()?;
    if args.record.json {
        return print_json(&status::newest_run(context, &store)?);
    }
    if let Some(lines) = running_text(&status::running(context, &store)?) {
        print_lines(lines);
        return Ok(());
    }
    print_run(&status::newest_run(context, &store)?);
    Ok(())
}

fn print_run(run: &RunRecord) {
    let outcome = format!("{:?}", run.outcome).to_lowercase();
    print_line(&format!(
        "run {} of `{}`: {outcome} in {}",
        run.number,
        run.pipeline,
        duration(run.seconds)
    ));
    let mut nodes: Vec<&NodeRun> = run.nodes.iter().collect();
    // Nodes that all scenes share come first, then scene by scene.
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
}

/// Returns the text on running programs: the nodes of the first, a line for each of the others. None if no program runs.
fn running_text(programs: &[RunningProgram]) -> Option<Vec<String>> {
    let (first, others) = programs.split_first()?;
    let mut lines = page(first);
    lines.extend(
        others
            .iter()
            .map(|other| format!("next to it {}", heading(other).join(": "))),
    );
    Some(lines)
}

/// Returns the running command and, once it is known, how far it is.
fn heading(program: &RunningProgram) -> Vec<String> {
    let standing = program.standing.as_ref();
    let far = standing.map(|standing| format!("{}, after {}", standing.text(), duration(standing.seconds)));
    let head = format!("`{}` runs: {}", program.start.pipeline, program.start.command);
    [head].into_iter().chain(far).collect()
}

/// Returns the page of a program: one line a node, children only while they run.
fn page(program: &RunningProgram) -> Vec<String> {
    let mut lines = heading(program);
    for name in &program.start.nodes {
        let node = program.nodes.get(name);
        if name.contains('/') && node.is_none_or(|node| node.word != "running") {
            continue;
        }
        let (word, note) = match node {
            Some(node) => (node.word, node.note.clone()),
            None => ("waiting", awaited(program, name)),
        };
        lines.push(format!("{name:<22} {word:<8} {note}").trim_end().to_owned());
    }
    lines
}

/// Says which nodes a node waits for: those that are not over.
fn awaited(program: &RunningProgram, name: &str) -> String {
    let is_open = |name: &&String| {
        let node = program.nodes.get(*name);
        node.is_none_or(|node| node.word == "running")
    };
    let upstream = program.start.upstream.get(name).into_iter().flatten();
    let open: Vec<&str> = upstream.filter(is_open).map(String::as_str).collect();
    if open.is_empty() {
        return String::new();
    }
    format!("for {}", open.join(", "))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pages(programs: &[&[&str]]) -> Option<String> {
        let owned = |lines: &&[&str]| lines.iter().map(|line| (*line).to_owned()).collect();
        let programs = marf_run::status::programs(&programs.iter().map(owned).collect::<Vec<_>>());
        running_text(&programs).map(|lines| lines.join("\n"))
    }

    fn page(lines: &[&str]) -> Option<String> {
        pages(&[lines])
    }

    const BEGAN: &str = r#"{"event":"began","run":"0a","pipeline":"demo","source":{"kind":"pipeline","file":"pipeline.toml"},"command":"marf run","nodes":["a","b","c"],
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
        let expected = "`demo` runs: marf run\n1 of 3 nodes, about 30 s left and 1 with no known time, after 70 s\n\
            a                      ran      2.5 s\n\
            b                      running  3/9\n\
            b/part-00              running  1/9  psnr 20\n\
            c                      waiting  for b";
        assert_eq!(page.as_deref(), Some(expected));
    }

    #[test]
    fn programs_beside_it_are_a_line_each_and_exports_none() {
        let began = |pipeline: &str, source: &str| {
            format!(
                r#"{{"event":"began","run":"0b","pipeline":"{pipeline}","source":{source},"command":"marf run --to a","nodes":["a"],"upstream":{{}}}}"#
            )
        };
        let of_file = |pipeline: &str| began(pipeline, r#"{"kind":"pipeline","file":"pipeline.toml"}"#);
        let export = began("demo", r#"{"kind":"derived","from":null,"purpose":"export"}"#);
        let [other, new] = ["other", "new"].map(of_file);
        let standing =
            r#"{"event":"standing","seconds":70.0,"over":1,"nodes":3,"left_s":30.0,"unknown":0,"text":""}"#;
        let page = pages(&[&[&export], &[&new], &[&other, standing], &[&new]]);
        let expected = "`new` runs: marf run --to a\na                      waiting\n\
            next to it `other` runs: marf run --to a: 1 of 3 nodes, about 30 s left, after 70 s\n\
            next to it `new` runs: marf run --to a";
        assert_eq!(page.as_deref(), Some(expected));
        assert_eq!(pages(&[&[&export]]), None);
    }

    #[test]
    fn lines_without_a_beginning_are_no_run() {
        assert_eq!(page(&[]), None);
        assert_eq!(page(&["{}", "no JSON"]), None);
    }
}
