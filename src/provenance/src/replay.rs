//! Needs of a replay, and the comparison of its results with the run.

use std::collections::BTreeMap;

use marf_cache::{Digest, Record, Store};
use marf_engine::{LISTING, NodeRun};
use marf_model::{
    Run, RunError, RunNode,
    product::{SourcePart, set},
    unless_lost,
};
use marf_stage::{COMPANIONS, Origin, RecordedArchive, Shard};
use serde::Serialize;

use crate::difference::{Difference, difference};

/// Returns the archive that a source met, to be read again instead of the real one.
///
/// # Errors
/// Something of it that is lost, or was not noted.
pub fn recorded(store: &Store, source: &RunNode) -> Result<RecordedArchive, RunError> {
    let listing = source.run.inputs.get(LISTING).map(|input| input.digest);
    let listed = listing
        .map(|listing| set(store, &listing))
        .transpose()?
        .unwrap_or_default();
    let lists: BTreeMap<u32, Digest> = source
        .parts(store)?
        .iter()
        .map(|part| Ok((part.shard, list_of(store, part)?)))
        .collect::<Result<_, RunError>>()?;
    let mut shards = Vec::new();
    for leaf in listed.leaves {
        let shard = Shard {
            shard: leaf.shard,
            fingerprint: leaf.leaf,
        };
        let list = lists.get(&leaf.shard).ok_or_else(|| not_noted(leaf.shard))?;
        shards.push((shard, *list));
    }
    let companions = match source.run.inputs.get(COMPANIONS) {
        None => BTreeMap::new(),
        Some(input) => {
            serde_json::from_slice(&store.get(&input.digest)?).map_err(|error| RunError::Malformed {
                what: "the list of companions".to_owned(),
                message: error.to_string(),
            })?
        }
    };
    Ok(RecordedArchive { shards, companions })
}

fn list_of(store: &Store, part: &SourcePart) -> Result<Digest, RunError> {
    let record = store.record(&part.key)?.ok_or_else(|| RunError::NoRecord {
        what: format!("sol {}", part.shard),
        key: part.key,
    })?;
    record.origins.ok_or_else(|| not_noted(part.shard))
}

fn not_noted(sol: u32) -> RunError {
    RunError::Malformed {
        what: format!("the list of files of sol {sol}"),
        message: "the program that read it did not note its files".to_owned(),
    }
}

/// Copies what a source met into another store: the lists of files, the files that were read, the companions.
///
/// # Errors
/// A file that is lost, a store that cannot be read or written.
pub fn copy_archive(archive: &RecordedArchive, from: &Store, to: &Store) -> Result<(), RunError> {
    for (shard, list) in &archive.shards {
        let bytes = from.get(list)?;
        let origins = Origin::decode(&bytes).map_err(|error| RunError::Malformed {
            what: format!("the list of files of sol {}", shard.shard),
            message: error.to_string(),
        })?;
        to.put(&bytes)?;
        for origin in origins.iter().filter(|origin| origin.bytes.is_some()) {
            to.put(&from.get(&origin.blake3)?)?;
        }
    }
    for companion in archive.companions.values() {
        to.put(&from.get(companion)?)?;
    }
    Ok(to.commit()?)
}

/// Copies the record of a key and its action, and not what it gave: the other store then knows of it and must make it.
///
/// # Errors
/// A record or action that is lost, a store that cannot be read or written.
pub fn copy_record(key: &Digest, from: &Store, to: &Store) -> Result<Record, RunError> {
    let record = from.record(key)?.ok_or_else(|| RunError::NoRecord {
        what: "a result".to_owned(),
        key: *key,
    })?;
    to.put(&from.get(key)?)?;
    to.put_record(record.clone());
    to.commit()?;
    Ok(record)
}

/// Result of the replay of a node.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Replayed {
    /// Its name.
    pub node: String,
    /// Outputs whose digests are equal.
    pub equal: u64,
    /// Outputs that are not.
    pub differs: Vec<DifferingOutput>,
    /// Why it cannot be made here, or failed. Absent for a node that was made again.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub not_made: Option<String>,
}

/// An output that came out otherwise.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct DifferingOutput {
    /// Its name.
    pub output: String,
    /// Output of the run. `None` if it had no such output.
    pub was: Option<Digest>,
    /// Output of the replay. `None` if it gave no such output.
    pub is: Option<Digest>,
    /// Where and how much, where both can be read.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub difference: Option<Difference>,
}

impl Replayed {
    /// Returns true if the node was made again, to the same digests.
    pub fn is_equal(&self) -> bool {
        self.not_made.is_none() && self.differs.is_empty()
    }
}

/// Compares nodes of a run with those of its replay. `not_made` holds, by name, the nodes that the replay
/// left out.
///
/// # Errors
/// A store that cannot be read.
pub fn compare(
    run: &Run<'_>,
    nodes: &[&RunNode],
    replay: &Run<'_>,
    not_made: &BTreeMap<String, String>,
) -> Result<Vec<Replayed>, RunError> {
    let mut compared = Vec::new();
    for node in nodes.iter().filter(|node| node.run.state.is_good()) {
        let name = &node.run.name;
        let mut replayed = Replayed {
            node: name.clone(),
            equal: 0,
            differs: Vec::new(),
            not_made: not_made.get(name).cloned(),
        };
        match replay.record.node(name).filter(|made| made.state.is_good()) {
            _ if replayed.not_made.is_some() => {}
            None => replayed.not_made = Some(reason(replay, name)),
            Some(made) => compare_outputs(run.store(), &node.run, replay.store(), made, &mut replayed)?,
        }
        compared.push(replayed);
    }
    Ok(compared)
}

fn reason(replay: &Run<'_>, node: &str) -> String {
    let made = replay.record.node(node);
    made.map_or_else(
        || "the replay has no such node".to_owned(),
        |made| made.reason.clone(),
    )
}

fn compare_outputs(
    was_in: &Store,
    was: &NodeRun,
    is_in: &Store,
    is: &NodeRun,
    replayed: &mut Replayed,
) -> Result<(), RunError> {
    let names: std::collections::BTreeSet<&String> = was.outputs.keys().chain(is.outputs.keys()).collect();
    for name in names {
        let digest = |node: &NodeRun| node.outputs.get(name).map(|output| output.digest);
        let (was, is) = (digest(was), digest(is));
        if was == is {
            replayed.equal += 1;
            continue;
        }
        let read = |store: &Store, digest: Option<Digest>| match digest {
            None => Ok(None),
            Some(digest) => unless_lost(store.get(&digest).map_err(RunError::from)),
        };
        let both = read(was_in, was)?.zip(read(is_in, is)?);
        replayed.differs.push(DifferingOutput {
            output: name.clone(),
            was,
            is,
            difference: both.and_then(|(was, is)| difference(&was, &is)),
        });
    }
    Ok(())
}
