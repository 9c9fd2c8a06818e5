//! The nodes that a pipeline has once for each scene: those that read what `scenes` has split, and all that follow from them.

use std::collections::BTreeSet;

use marf_engine::Edge;
use marf_schema::scenes::ScenesParams;
use marf_stage::Params;
use serde_json::Value;

use super::resolve::{Node, Pipeline};

/// What stands between a node and its scene: `train@site1-20`.
const OF: char = '@';

/// The node of a pipeline that splits photos by place, and those that then run once for each scene.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ByScene {
    /// The node that splits.
    pub split: String,
    /// The nodes that run for each scene.
    pub nodes: BTreeSet<String>,
    /// The nodes that run once after these: those that take several nodes and read the outputs of all scenes, and
    /// everything that follows.
    pub after: BTreeSet<String>,
}

/// Returns the name of a node for one scene.
pub fn node_of(node: &str, scene: &str) -> String {
    format!("{node}{OF}{scene}")
}

/// Returns the scene that a node is of, if it is of one.
pub fn scene_of(node: &str) -> Option<&str> {
    node.rsplit_once(OF).map(|(_, scene)| scene)
}

impl ByScene {
    /// Returns the nodes that run for each scene, or `None` if the pipeline is not split by place or has been
    /// split already.
    pub fn from_pipeline(pipeline: &Pipeline) -> Option<Self> {
        let mut nodes = pipeline.nodes.iter();
        let split = nodes
            .find(|node| node.def.name == ScenesParams::STAGE)?
            .name
            .clone();
        let mut found: BTreeSet<String> = BTreeSet::new();
        loop {
            let reads = |node: &&Node, edge: &Edge| {
                let of_split = edge.upstream == split && edge.part.is_none();
                (of_split || found.contains(&edge.upstream)) && !takes_many(node, &edge.key)
            };
            let reads = pipeline
                .nodes
                .iter()
                .filter(|node| node.edges.iter().any(|edge| reads(node, edge)));
            let reads: BTreeSet<String> = reads.map(|node| node.name.clone()).collect();
            if reads == found {
                break;
            }
            found = reads;
        }
        let mut reached = found.clone();
        loop {
            let reads = |node: &&Node| node.edges.iter().any(|edge| reached.contains(&edge.upstream));
            let readers: BTreeSet<String> = pipeline
                .nodes
                .iter()
                .filter(reads)
                .map(|node| node.name.clone())
                .collect();
            if readers.is_subset(&reached) {
                break;
            }
            reached.extend(readers);
        }
        (!found.is_empty()).then(|| Self {
            split,
            after: &reached - &found,
            nodes: found,
        })
    }

    /// Returns the pipeline with its nodes for each of these scenes: `calibrate` becomes `calibrate@NAME`, which reads the part `NAME` of
    /// what was split.
    pub fn expanded(&self, pipeline: &Pipeline, scenes: &[String]) -> Value {
        let mut tree = pipeline.tree.clone();
        let Some(tables) = tree.get_mut("node").and_then(Value::as_object_mut) else {
            return tree;
        };
        for node in pipeline
            .nodes
            .iter()
            .filter(|node| self.nodes.contains(&node.name))
        {
            let Some(template) = tables.remove(&node.name) else {
                continue;
            };
            for scene in scenes {
                let mut table = template.clone();
                table["uses"] = node.def.name.into();
                for edge in &node.edges {
                    let upstream = &edge.upstream;
                    if *upstream == self.split {
                        table[&edge.key] = format!("{upstream}/{scene}").into();
                    } else if self.nodes.contains(upstream) {
                        table[&edge.key] = node_of(upstream, scene).into();
                    }
                }
                tables.insert(node_of(&node.name, scene), table);
            }
        }
        let after = pipeline
            .nodes
            .iter()
            .filter(|node| self.after.contains(&node.name));
        for node in after {
            for key in node.edges.iter().map(|edge| &edge.key) {
                let named = node.edges.iter().filter(|edge| edge.key == *key);
                let named = named.flat_map(|edge| self.named(&edge.upstream, scenes));
                if takes_many(node, key) {
                    tables[&node.name][key] = named.collect();
                }
            }
        }
        tree
    }

    /// Returns the nodes of a name: for a node that runs for each scene, one for each scene.
    pub fn named(&self, name: &str, scenes: &[String]) -> Vec<String> {
        if self.nodes.contains(name) {
            scenes.iter().map(|scene| node_of(name, scene)).collect()
        } else {
            vec![name.to_owned()]
        }
    }
}

/// Returns whether a key of a node may name several nodes.
fn takes_many(node: &Node, key: &str) -> bool {
    node.def.ports.iter().any(|port| port.key == key && port.many)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{GlobalOptions, check, check_tree};
    use std::path::Path;

    const MISSION: &str = r#"
[archive.demo]
kind = "demo"
[node.extract]
archive = "demo"
[node.scenes]
input = "extract"
[node.calibrate]
input = "scenes"
cameras = "extract"
[node.train]
input = "calibrate"
steps = 50
[node.bootstrap]
input = "calibrate"
training = "train"
"#;

    fn pipeline(text: &str) -> Pipeline {
        let options = GlobalOptions::default();
        check(text, &[], &options, Path::new("")).unwrap_or_else(|error| panic!("{error:?}"))
    }

    #[test]
    fn what_follows_from_the_scenes_runs_for_each_and_nothing_else() {
        let pipeline = pipeline(MISSION);
        let by_scene = ByScene::from_pipeline(&pipeline).unwrap();
        assert_eq!(by_scene.split, "scenes");
        assert_eq!(
            Vec::from_iter(&by_scene.nodes),
            ["bootstrap", "calibrate", "train"]
        );
        let scenes = ["a".to_owned(), "b".to_owned()];
        let tree = by_scene.expanded(&pipeline, &scenes);
        let expanded = check_tree(&tree, &GlobalOptions::default(), Path::new("")).unwrap();
        let mut names: Vec<&str> = expanded.nodes.iter().map(|node| node.name.as_str()).collect();
        names.sort_unstable();
        assert_eq!(
            names,
            [
                "bootstrap@a",
                "bootstrap@b",
                "calibrate@a",
                "calibrate@b",
                "extract",
                "scenes",
                "train@a",
                "train@b"
            ]
        );
        assert_eq!(tree["node"]["calibrate@b"]["input"], "scenes/b");
        assert_eq!(tree["node"]["calibrate@b"]["cameras"], "extract");
        assert_eq!(tree["node"]["bootstrap@a"]["training"], "train@a");
        assert_eq!(tree["node"]["train@a"]["steps"], 50);
        // What has its scenes is not split again.
        assert_eq!(ByScene::from_pipeline(&expanded), None);
        assert_eq!(by_scene.named("train", &scenes), ["train@a", "train@b"]);
        assert_eq!(by_scene.named("extract", &scenes), ["extract"]);
        assert_eq!((scene_of("train@a"), scene_of("train")), (Some("a"), None));
    }

    #[test]
    fn what_takes_several_nodes_runs_once_and_reads_all_scenes() {
        let pipeline = pipeline(&format!("{MISSION}[node.ties]\ninput = \"calibrate\"\n"));
        let by_scene = ByScene::from_pipeline(&pipeline).unwrap();
        assert_eq!(Vec::from_iter(&by_scene.after), ["ties"]);
        assert!(!by_scene.nodes.contains("ties"));
        let tree = by_scene.expanded(&pipeline, &["a".to_owned(), "b".to_owned()]);
        assert_eq!(
            tree["node"]["ties"]["input"],
            serde_json::json!(["calibrate@a", "calibrate@b"])
        );
        let expanded = check_tree(&tree, &GlobalOptions::default(), Path::new("")).unwrap();
        let ties = expanded.nodes.iter().find(|node| node.name == "ties").unwrap();
        let upstream: Vec<&str> = ties.edges.iter().map(|edge| edge.upstream.as_str()).collect();
        assert_eq!(upstream, ["calibrate@a", "calibrate@b"]);
    }

    #[test]
    fn a_list_of_nodes_stands_only_where_several_are_taken_and_names_each_once() {
        let refused = |line: &str| {
            let text = format!("{MISSION}[node.ties]\n{line}\n");
            let error = check(&text, &[], &GlobalOptions::default(), Path::new(""));
            error.map(|_| ()).unwrap_err().message
        };
        for (line, expected) in [
            ("input = []", "`input` names no node"),
            ("input = [3]", "`input` is a list of names of nodes"),
            ("input = [\"calibrat\"]", "names no node"),
            ("input = [\"calibrate\", \"calibrate\"]", "twice"),
            ("input = [\"extract\"]", "needs `scene`"),
        ] {
            assert!(refused(line).contains(expected), "{line}: {}", refused(line));
        }
        let one = MISSION.replace("input = \"extract\"", "input = [\"extract\"]");
        let error = check(&one, &[], &GlobalOptions::default(), Path::new(""))
            .map(|_| ())
            .unwrap_err();
        assert!(error.message.contains("must be a string"), "{}", error.message);
    }

    #[test]
    fn a_pipeline_without_places_has_no_node_by_scene() {
        let whole = MISSION.replace("[node.scenes]\ninput = \"extract\"\n", "");
        let whole = whole.replace("input = \"scenes\"", "input = \"extract\"");
        assert_eq!(ByScene::from_pipeline(&pipeline(&whole)), None);
        let one = MISSION.replace("input = \"scenes\"", "input = \"scenes/site1-20\"");
        assert_eq!(
            ByScene::from_pipeline(&pipeline(&one)),
            None,
            "one scene by its name is not a template"
        );
    }

    #[test]
    fn a_part_of_what_has_no_parts_and_a_name_with_a_slash_are_refused() {
        let refused = |text: &str| {
            let error = check(text, &[], &GlobalOptions::default(), Path::new(""));
            error.map(|_| ()).unwrap_err().message
        };
        let part = MISSION.replace("input = \"scenes\"", "input = \"extract/a\"");
        assert!(refused(&part).contains("photos/"), "{}", refused(&part));
        let second = format!("{MISSION}[node.other]\nuses = \"scenes\"\ninput = \"extract\"\n");
        assert!(
            refused(&second).contains("both split photos"),
            "{}",
            refused(&second)
        );
        let slash = MISSION.replace("[node.train]", "[node.\"a/b\"]\nuses = \"train\"");
        assert_eq!(refused(&slash), "`a/b` is not a name of a node");
    }
}
