//! `tune = false`: the pipeline without the nodes that choose parameters.

use marf_schema::tune::{BestParams, TuneParams};
use marf_stage::{Document, Params};

use super::error::ConfigError;
use super::syntax::{Entry, SyntaxNode, Value};

/// Key of a whole pipeline.
const KEY: &str = "tune";

/// Takes the nodes of the stage `tune` and the inputs that name them out of a pipeline whose key `tune` is false. Takes the key out too.
///
/// # Errors
/// A value that is neither true nor false.
pub(super) fn apply(root: &mut SyntaxNode) -> Result<(), ConfigError> {
    let Value::Table(entries) = &mut root.value else {
        return Ok(());
    };
    let Some(place) = entries.iter().position(|entry| entry.key == KEY) else {
        return Ok(());
    };
    let key = entries.remove(place).value;
    let Value::Truth(is_tuned) = key.value else {
        return Err(ConfigError::at(key.at, format!("`{KEY}` must be true or false")));
    };
    let nodes = entries.iter_mut().find(|entry| entry.key == "node");
    if let Some(Value::Table(nodes)) = nodes.map(|nodes| &mut nodes.value.value)
        && !is_tuned
    {
        let tunings = nodes.iter().filter(|node| stage(node) == Some(TuneParams::STAGE));
        let tunings: Vec<String> = tunings.map(|node| node.key.clone()).collect();
        nodes.retain(|node| !tunings.contains(&node.key));
        for node in nodes {
            if let Value::Table(keys) = &mut node.value.value {
                keys.retain(|key| !names_one(key, &tunings));
            }
        }
    }
    Ok(())
}

/// Returns the name of the stage of a node.
fn stage(node: &Entry) -> Option<&str> {
    node.value
        .entry("uses")
        .map_or(Some(node.key.as_str()), |uses| uses.value.text())
}

/// Returns whether a key takes the parameters that one of some nodes chooses.
fn names_one(key: &Entry, nodes: &[String]) -> bool {
    let named = key
        .value
        .text()
        .is_some_and(|name| nodes.iter().any(|node| node == name));
    key.key == BestParams::OUTPUT && named
}

#[cfg(test)]
mod tests {
    use super::super::{GlobalOptions, Pipeline, check, check_tree, template};
    use std::path::Path;

    fn checked(text: &str, sets: &[&str]) -> Result<Pipeline, String> {
        let sets: Vec<String> = sets.iter().map(|set| (*set).to_owned()).collect();
        check(text, &sets, &GlobalOptions::default(), Path::new("")).map_err(|error| error.message)
    }

    fn names(pipeline: &Pipeline) -> Vec<&str> {
        pipeline.nodes.iter().map(|node| node.name.as_str()).collect()
    }

    #[test]
    fn a_pipeline_that_is_not_tuned_lacks_only_the_tuning() {
        let text = template("demo").unwrap().text;
        let whole = checked(text, &[]).unwrap();
        assert!(names(&whole).contains(&"tune"), "{:?}", names(&whole));
        for (text, sets) in [
            (format!("tune = false\n{text}"), &[][..]),
            (text.to_owned(), &["tune=false"]),
            // Under another name, and with a key that has no effect then.
            (
                text.replace("[node.tune]", "[node.search]\nuses = \"tune\"")
                    .replace("params = \"tune\"", "params = \"search\""),
                &["tune=false", "search.trials=3"],
            ),
        ] {
            let pipeline = checked(&text, sets).unwrap();
            let mut wanted = names(&whole);
            wanted.retain(|name| *name != "tune");
            assert_eq!(names(&pipeline), wanted);
            let train = pipeline.nodes.iter().find(|node| node.name == "train").unwrap();
            assert!(
                train.edges.iter().all(|edge| edge.key == "input"),
                "{:?}",
                train.edges
            );
            let kept = check_tree(&pipeline.tree, &GlobalOptions::default(), Path::new("")).unwrap();
            // A stored pipeline has its nodes in the order of their names.
            wanted.sort_unstable();
            assert_eq!(names(&kept), wanted, "the stored pipeline");
        }
        assert_eq!(names(&checked(text, &["tune=true"]).unwrap()), names(&whole));
        assert_eq!(
            checked(text, &["tune=0"]).err().unwrap(),
            "`tune` must be true or false"
        );
    }
}
