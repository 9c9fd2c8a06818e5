//! Traces bytes to their origin, from a crate alone.

use std::collections::{BTreeMap, BTreeSet};

use marf_cache::manifest::Row;
use marf_cache::{Action, Digest};
use marf_engine::NodeRun;
use marf_stage::{Origin, PHOTOS};
use serde::Serialize;

use super::lineage::origins;
use super::open::OpenCrate;
use crate::contents::rows;

/// Origin of some bytes.
#[derive(Debug, Serialize)]
pub struct Trace {
    /// Name of the run.
    pub run: String,
    /// Name of the pipeline.
    pub pipeline: String,
    /// The command as typed.
    pub command: String,
    /// The program with its version.
    pub program: String,
    /// Start of the run, in seconds since 1970.
    pub started_unix_s: u64,
    /// Photos that the sources among the steps gave.
    pub photos_read: u64,
    /// Roles of the bytes: results of nodes, or objects of a photo.
    pub is: Vec<Role>,
    /// The nodes it took, sources first.
    pub steps: Vec<Step>,
    /// The photos it took, with the files they came from.
    pub products: Vec<Product>,
}

/// Role of some bytes.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Role {
    /// An output of a node.
    Output {
        /// The node.
        node: String,
        /// Name of the output.
        output: String,
    },
    /// An object of a photo.
    Photo {
        /// Id of the photo.
        id: String,
        /// `image`, `raw`, `label` or `thumbnail`.
        role: String,
    },
}

/// A node on the way.
#[derive(Debug, Serialize)]
pub struct Step {
    /// Its name.
    pub node: String,
    /// Key of its result.
    pub key: Digest,
    /// Everything the result depends on.
    pub action: Action,
    /// Its inputs, each with the node that made it. `None` for inputs from outside.
    pub reads: BTreeMap<String, Option<String>>,
}

/// A photo on the way.
#[derive(Debug, Serialize)]
pub struct Product {
    /// Its id.
    pub id: String,
    /// Its objects by role.
    pub blobs: BTreeMap<String, Digest>,
    /// The files of the archive that they are. Empty if the run did not note them.
    pub files: Vec<Origin>,
}

impl OpenCrate {
    /// Traces the bytes of a digest. `None` if they are neither a result nor a photo of the run.
    ///
    /// # Errors
    /// An action or a list that is not in the crate or is damaged.
    pub fn trace(&self, digest: &Digest) -> Result<Option<Trace>, String> {
        let mut actions = BTreeMap::new();
        for node in &self.run.nodes {
            actions.insert(node.name.as_str(), self.action(node)?);
        }
        let is = self.roles(digest);
        if is.is_empty() {
            return Ok(None);
        }
        let makers: BTreeSet<&str> = is.iter().filter_map(|role| self.maker(role)).collect();
        let wanted = self.upstream(&actions, makers);
        let nodes: Vec<&NodeRun> = self
            .run
            .nodes
            .iter()
            .filter(|node| wanted.contains(node.name.as_str()))
            .collect();
        Ok(Some(Trace {
            run: self.run.id.clone(),
            pipeline: self.run.pipeline.clone(),
            command: self.run.command.clone(),
            program: self.run.program.clone(),
            started_unix_s: self.run.started_unix_s,
            photos_read: nodes
                .iter()
                .filter(|node| is_source(&actions, node))
                .map(|node| self.rows(node).len() as u64)
                .sum(),
            products: self.products(&actions, &nodes, &is)?,
            is,
            steps: nodes
                .iter()
                .filter_map(|node| self.step(&actions, node))
                .collect(),
        }))
    }

    fn roles(&self, digest: &Digest) -> Vec<Role> {
        let mut roles = Vec::new();
        for node in &self.run.nodes {
            let outputs = node.outputs.iter().filter(|(_, output)| output.digest == *digest);
            roles.extend(outputs.map(|(name, _)| Role::Output {
                node: node.name.clone(),
                output: name.clone(),
            }));
        }
        if !roles.is_empty() {
            return roles;
        }
        for row in self.run.nodes.iter().flat_map(|node| self.rows(node)) {
            let blobs = row.blobs.iter().filter(|(_, blob)| *blob == digest);
            for (role, _) in blobs {
                let role = Role::Photo {
                    id: row.id.clone(),
                    role: role.clone(),
                };
                if !roles.contains(&role) {
                    roles.push(role);
                }
            }
        }
        roles
    }

    /// Returns the node that made or brought in what has this role.
    fn maker<'a>(&'a self, role: &'a Role) -> Option<&'a str> {
        match role {
            Role::Output { node, .. } => Some(node),
            Role::Photo { id, .. } => {
                let mut nodes = self.run.nodes.iter();
                let node = nodes.find(|node| self.rows(node).iter().any(|row| row.id == *id));
                node.map(|node| node.name.as_str())
            }
        }
    }

    fn made_by(&self, digest: &Digest) -> Option<&str> {
        let mut nodes = self.run.nodes.iter();
        let node = nodes.find(|node| node.outputs.values().any(|output| output.digest == *digest));
        node.map(|node| node.name.as_str())
    }

    /// Returns nodes, their children, and all that these read from, up to the sources.
    fn upstream<'a>(
        &'a self,
        actions: &'a BTreeMap<&str, Action>,
        of: BTreeSet<&'a str>,
    ) -> BTreeSet<&'a str> {
        let mut wanted = of;
        loop {
            let before = wanted.len();
            for node in &self.run.nodes {
                if node
                    .parent
                    .as_deref()
                    .is_some_and(|parent| wanted.contains(parent))
                {
                    wanted.insert(&node.name);
                }
                if wanted.contains(node.name.as_str()) {
                    let inputs = actions.get(node.name.as_str()).into_iter();
                    let inputs = inputs.flat_map(|action| action.inputs.values());
                    wanted.extend(inputs.filter_map(|digest| self.made_by(digest)));
                }
            }
            if wanted.len() == before {
                return wanted;
            }
        }
    }

    fn step(&self, actions: &BTreeMap<&str, Action>, node: &NodeRun) -> Option<Step> {
        let action = actions.get(node.name.as_str())?;
        let inputs = action.inputs.iter();
        let reads = inputs.map(|(name, digest)| (name.clone(), self.made_by(digest).map(str::to_owned)));
        Some(Step {
            node: node.name.clone(),
            key: node.key?,
            reads: reads.collect(),
            action: action.clone(),
        })
    }

    /// Returns the traced photos, or those that nodes on the way read without passing them on.
    fn products(
        &self,
        actions: &BTreeMap<&str, Action>,
        nodes: &[&NodeRun],
        is: &[Role],
    ) -> Result<Vec<Product>, String> {
        let mut files = BTreeMap::new();
        for node in nodes {
            let action = actions.get(node.name.as_str());
            if let Some(action) = action.filter(|_| is_source(actions, node)) {
                files.extend(origins(self, node, action)?);
            }
        }
        let taken = self.taken(actions, nodes, is)?;
        let product = |row: Row| Product {
            files: row
                .blobs
                .values()
                .filter_map(|blob| files.get(blob).cloned())
                .collect(),
            id: row.id,
            blobs: row.blobs,
        };
        Ok(taken.into_values().map(product).collect())
    }

    fn taken(
        &self,
        actions: &BTreeMap<&str, Action>,
        nodes: &[&NodeRun],
        is: &[Role],
    ) -> Result<BTreeMap<String, Row>, String> {
        let mut taken = BTreeMap::new();
        let mut take = |row: Row| drop(taken.insert(row.id.clone(), row));
        for role in is {
            match role {
                Role::Photo { id, .. } => {
                    let rows = nodes.iter().flat_map(|node| self.rows(node));
                    rows.filter(|row| row.id == *id).take(1).for_each(&mut take);
                }
                Role::Output { node, output } if output == PHOTOS => {
                    let node = nodes.iter().find(|known| known.name == *node);
                    node.into_iter()
                        .flat_map(|node| self.rows(node))
                        .for_each(&mut take);
                }
                Role::Output { .. } => {}
            }
        }
        if is.iter().any(|role| matches!(role, Role::Photo { .. })) {
            return Ok(taken);
        }
        for node in nodes.iter().filter(|node| !node.outputs.contains_key(PHOTOS)) {
            let action = actions.get(node.name.as_str());
            if let Some(root) = action.and_then(|action| action.inputs.get(PHOTOS)) {
                let read = rows(root, &|digest| self.object(digest), "a set of photos");
                read.map_err(|error| error.to_string())?
                    .into_iter()
                    .for_each(&mut take);
            }
        }
        Ok(taken)
    }
}

/// Returns true if a node reads an archive.
fn is_source(actions: &BTreeMap<&str, Action>, node: &NodeRun) -> bool {
    let action = actions.get(node.name.as_str());
    action.is_some_and(|action| action.inputs.contains_key(marf_engine::LISTING))
}
