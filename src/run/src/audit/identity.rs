//! Which object a file is a copy of, by its content alone.

use std::collections::BTreeMap;

use marf_cache::{Digest, Store};
use marf_engine::RunRecord;
use marf_model::{product::set, unless_lost};
use marf_provenance::{
    find::{Maker, Place, find},
    nearest::{LEAST_SHARE, Outline},
    stamp::Stamp,
};
use marf_stage::VERDICTS;
use serde::Serialize;

use crate::error::Error;

/// The identity of a file.
#[derive(Debug, Serialize)]
#[serde(untagged)]
pub enum Identity {
    /// A copy of an object that runs of this store made, each of its makers named.
    Whole {
        /// Digest of the object.
        object: Digest,
        /// Who made it.
        makers: Vec<Maker>,
    },
    /// A copy of an object that was changed afterwards.
    Altered {
        /// Digest of the file's bytes, without the mark if there is one.
        content: Digest,
        /// The object it was, or resembles most.
        closest: Digest,
        /// Who made that object.
        makers: Vec<Maker>,
        /// Share of the bytes that both have, in [0, 1]. Absent if the object is not in the store.
        share: Option<f64>,
        /// What shows it.
        because: &'static str,
    },
    /// A whole copy, by its mark, of an object that this store does not have: of another store, or collected.
    Elsewhere {
        /// Digest of the object.
        object: Digest,
        /// Root of the run that it was exported from.
        run: Digest,
    },
    /// Nothing that runs of this store made.
    NotOurs {
        /// Digest of the file's bytes.
        content: Digest,
    },
}

impl Identity {
    /// Returns the makers of the file, or of the file before it was altered.
    pub fn makers(&self) -> &[Maker] {
        match self {
            Self::Whole { makers, .. } | Self::Altered { makers, .. } => makers,
            Self::Elsewhere { .. } | Self::NotOurs { .. } => &[],
        }
    }

    /// Returns whether runs read the file and none made it: a photo or label of an archive.
    pub fn is_input(&self) -> bool {
        let is_input = |maker: &Maker| matches!(maker.place, Place::Product { .. } | Place::File { .. });
        matches!(self, Self::Whole { makers, .. } if makers.iter().all(is_input))
    }
}

/// Returns the identity of a file. `runs` are oldest first.
///
/// # Errors
/// A store that cannot be read.
pub fn identify(store: &Store, runs: &[RunRecord], file: &[u8]) -> Result<Identity, Error> {
    let Some((bytes, stamp)) = Stamp::take_from(file) else {
        return unmarked(store, runs, file);
    };
    let content = Digest::from_content(&bytes);
    if content == stamp.object {
        let makers = find(store, runs, &content)?;
        if makers.is_empty() {
            return Ok(Identity::Elsewhere {
                object: content,
                run: stamp.run,
            });
        }
        return Ok(Identity::Whole {
            object: content,
            makers,
        });
    }
    let of_content = find(store, runs, &content)?;
    let (closest, makers, because) = if of_content.is_empty() {
        let makers = find(store, runs, &stamp.object)?;
        let because = "its bytes are not those that its mark names";
        (stamp.object, makers, because)
    } else {
        let because = "its mark is that of another file";
        (content, of_content, because)
    };
    let object = unless_lost(store.get(&closest).map_err(Into::into))?;
    Ok(Identity::Altered {
        content,
        closest,
        makers,
        share: object.map(|object| Outline::new(&bytes).share_with(&object)),
        because,
    })
}

/// Returns the identity of a file without a mark.
fn unmarked(store: &Store, runs: &[RunRecord], file: &[u8]) -> Result<Identity, Error> {
    let content = Digest::from_content(file);
    let makers = find(store, runs, &content)?;
    if !makers.is_empty() {
        return Ok(Identity::Whole {
            object: content,
            makers,
        });
    }
    if let Some(bytes) = Stamp::take_altered_from(file) {
        let closest = Digest::from_content(&bytes);
        let makers = find(store, runs, &closest)?;
        if !makers.is_empty() {
            return Ok(Identity::Altered {
                content,
                closest,
                makers,
                share: Some(1.0),
                because: "its mark was changed, and nothing else",
            });
        }
    }
    let outline = Outline::new(file);
    let mut best: Option<(f64, Digest)> = None;
    for (digest, bytes) in exported(store, runs)? {
        if !outline.may_resemble(bytes) {
            continue;
        }
        let Some(object) = unless_lost(store.get(&digest).map_err(Into::into))? else {
            continue;
        };
        let share = outline.share_with(&object);
        if share >= LEAST_SHARE && best.is_none_or(|(most, _)| share > most) {
            best = Some((share, digest));
        }
    }
    Ok(match best {
        None => Identity::NotOurs { content },
        Some((share, closest)) => Identity::Altered {
            content,
            closest,
            makers: find(store, runs, &closest)?,
            share: Some(share),
            because: "it resembles a result of this store, but has other bytes",
        },
    })
}

/// Returns all objects that runs write to files, with their lengths: documents, outputs, verdicts by sol.
fn exported(store: &Store, runs: &[RunRecord]) -> Result<BTreeMap<Digest, u64>, Error> {
    let mut objects = BTreeMap::new();
    for run in runs {
        let outputs = run.nodes.iter().flat_map(|node| node.outputs.values());
        objects.extend(
            outputs
                .chain(run.documents.values())
                .map(|output| (output.digest, output.bytes)),
        );
    }
    // Verdicts of many sols change little from run to run, so those of the last run are compared.
    let last = runs.iter().rev().find(|run| !run.source.is_derived());
    for verdicts in last
        .iter()
        .flat_map(|run| &run.nodes)
        .filter_map(|node| node.outputs.get(VERDICTS))
    {
        let leaves = unless_lost(set(store, &verdicts.digest))?.map(|set| set.leaves);
        for leaf in leaves.into_iter().flatten() {
            objects.extend(store.size_of(&leaf.leaf).map(|bytes| (leaf.leaf, bytes)));
        }
    }
    Ok(objects)
}
