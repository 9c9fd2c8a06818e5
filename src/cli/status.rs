use marf_engine::{Cancel, NodeRun};

use super::args::Global;
use super::error::CliError;
use super::output::print_json;
use super::run::state_word;
use super::scenes::parent_of;
use super::session::{existing_store, last_of, warn};
use crate::config::scenes::scene_of;
use crate::progress::duration;
use crate::terminal::print_line;

/// `marf status`: the nodes of the last run, exports aside.
pub fn status(global: &Global, cancel: &Cancel) -> Result<(), CliError> {
    let store = existing_store(global, cancel)?;
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
