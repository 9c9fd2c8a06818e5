//! The pipeline of most tests, and helpers that declare nodes.

use marf_engine::{Edge, Graph, NodeDecl};
use marf_stage::{StageDef, define};

use super::{
    crowd::Crowd,
    rounds::Knockout,
    stages::{Append, Archive, AtMost, Broken, Distinct, Draw, Many, Sum},
};

/// The stages of the tests.
pub const TABLE: &[StageDef] = &[
    define::<Append>(),
    define::<Archive>(),
    define::<AtMost>(),
    define::<Crowd>(),
    define::<Distinct>(),
    define::<Sum>(),
    define::<Draw>(),
    define::<Knockout>(),
    define::<Many>(),
    define::<Broken>(),
];

/// Returns a stage by name.
fn def(name: &str) -> StageDef {
    *TABLE.iter().find(|def| def.name == name).unwrap()
}

/// Declares a node, with edges as `key=upstream`.
pub fn node(name: &str, stage: &str, fixture: u64, params: serde_json::Value, edges: &[&str]) -> NodeDecl {
    let def = def(stage);
    let mut params = params;
    params["fixture"] = fixture.into();
    let edges = edges.iter().map(|edge| {
        let (key, upstream) = edge.split_once('=').unwrap();
        Edge::new(key, upstream)
    });
    NodeDecl {
        name: name.to_owned(),
        stage: def,
        bound: (def.bind)(params).unwrap(),
        edges: edges.collect(),
    }
}

/// The tests' pipeline: archive, at_most, distinct, sum, many.
#[derive(Clone)]
pub struct TestPipeline {
    pub fixture: u64,
    pub most: u64,
    pub by: u64,
    pub times: u64,
    pub b: u64,
    /// The member that fails.
    pub unlucky: u64,
    pub version: u32,
}

impl TestPipeline {
    pub fn new(fixture: u64) -> Self {
        Self {
            fixture,
            most: 12,
            by: 2,
            times: 1,
            b: 3,
            unlucky: 99,
            version: 1,
        }
    }

    pub fn nodes(&self) -> Vec<NodeDecl> {
        let json = |key: &str, value: u64| serde_json::json!({ key: value });
        let mut nodes = vec![
            node("archive", "archive", self.fixture, serde_json::json!({}), &[]),
            node(
                "at_most",
                "at_most",
                self.fixture,
                json("most", self.most),
                &["input=archive"],
            ),
            node(
                "distinct",
                "distinct",
                self.fixture,
                json("by", self.by),
                &["input=at_most"],
            ),
            node(
                "sum",
                "sum",
                self.fixture,
                json("times", self.times),
                &["input=distinct"],
            ),
            node(
                "many",
                "many",
                self.fixture,
                serde_json::json!({ "b": self.b, "unlucky": self.unlucky }),
                &["input=sum"],
            ),
        ];
        nodes[1].stage.version = self.version;
        nodes
    }

    pub fn graph(&self) -> Graph {
        Graph::new(self.nodes(), TABLE).unwrap()
    }
}
