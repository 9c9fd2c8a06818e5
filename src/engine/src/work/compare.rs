//! Comparisons: the context with which the rows of a set are compared, from summaries of its shards. Each summary has its record, so only a
//! new shard is summarised.

use std::{
    collections::BTreeMap,
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
};

use marf_cache::{Digest, Record};
use marf_stage::{Comparison, Map, Outputs, StageError};
use rayon::prelude::*;

use super::{
    measure::{MeasuredShard, measure_shard},
    shards::{PartRequest, shard_parts},
    stage_run::{PartKind, StageRun},
};
use crate::{errors::store_error, items::ShardLeaves, key::Key};

/// Name of the input of a part that is the context it looks at.
const CONTEXT: &str = "context";
/// Name of the output of a part that is the summary of a shard.
const SUMMARY: &str = "summary";

/// The results of all passes so far. Empty before the first.
#[derive(Debug, Default)]
pub(super) struct Context {
    pub(super) bytes: Vec<u8>,
    digest: Option<Digest>,
}

impl Context {
    /// Returns the context of these bytes.
    pub(super) fn new(bytes: Vec<u8>) -> Self {
        Self {
            digest: Some(Digest::from_content(&bytes)),
            bytes,
        }
    }
}

/// The data that the decisions of a map use in addition to their rows.
#[derive(Debug, Default)]
pub(super) struct ComparisonResult {
    pub(super) context: Context,
    /// Keys of the summaries by shard, pass after pass.
    pub(super) keys: Vec<(u32, Digest)>,
    /// Number of summaries that no earlier run had made.
    pub(super) summarised: u64,
    /// Number of rows that no earlier run had measured.
    pub(super) measured: u64,
}

/// Returns the inputs of the part that looks at a shard and a context: its summary, or its decision.
pub(super) fn part_inputs(shard: &ShardLeaves, context: &Context) -> BTreeMap<String, Digest> {
    let context = context.digest.map(|digest| (CONTEXT.to_owned(), digest));
    shard.inputs().into_iter().chain(context).collect()
}

/// Returns the summary that a record holds.
pub(super) fn summary_of(record: &Record) -> Option<Digest> {
    record.outputs.get(SUMMARY).map(|output| output.digest)
}

/// Runs all passes of a comparison.
pub(super) fn compare(
    run: &StageRun<'_>,
    map: &dyn Map,
    comparison: &dyn Comparison,
    shards: &[ShardLeaves],
) -> Result<ComparisonResult, StageError> {
    let mut compared = ComparisonResult::default();
    for (index, name) in comparison.passes().into_iter().enumerate() {
        let pass = Pass {
            run,
            map,
            comparison,
            index,
            before: &compared.context,
            made: AtomicU64::new(0),
            measured: AtomicU64::new(0),
        };
        let kind = PartKind::Summarise(name);
        let key = |shard: &ShardLeaves| run.part_key(kind, shard.shard, part_inputs(shard, pass.before));
        let requests: Vec<PartRequest<'_>> = shards
            .par_iter()
            .map(|shard| PartRequest::new(shard, key(shard)))
            .collect();
        let found = shard_parts(
            run,
            map,
            &requests,
            |key| Ok(run.part_record(key)?.as_ref().and_then(summary_of)),
            |key, shard| pass.summarise(key, &shard),
        )?;
        let mut summaries = requests
            .iter()
            .zip(&found.parts)
            .map(|(request, summary)| pass.read(request, summary));
        let context = Context::new(comparison.context(index, &pass.before.bytes, &mut summaries)?);
        run.ctx.put(&context.bytes)?;
        compared.keys.extend(requests.iter().map(PartRequest::shard_key));
        compared.summarised += pass.made.into_inner();
        compared.measured += found.measured + pass.measured.into_inner();
        compared.context = context;
    }
    Ok(compared)
}

/// One pass over all shards.
struct Pass<'a> {
    run: &'a StageRun<'a>,
    map: &'a dyn Map,
    comparison: &'a dyn Comparison,
    index: usize,
    before: &'a Context,
    /// Number of summaries made.
    made: AtomicU64,
    /// Number of rows measured for summaries that were lost.
    measured: AtomicU64,
}

impl Pass<'_> {
    /// Summarises a shard and stores its summary as a part.
    fn summarise(&self, key: &Key, shard: &MeasuredShard) -> Result<Digest, StageError> {
        let summary = self
            .comparison
            .summarise(self.index, &self.before.bytes, &shard.items())?;
        let summary = self.run.store.put(&summary).map_err(store_error)?;
        let outputs = Outputs::from([(SUMMARY.to_owned(), summary)]);
        self.run.put_outputs(key, outputs, Vec::new(), None)?;
        self.made.fetch_add(1, Ordering::Relaxed);
        Ok(summary)
    }

    /// Reads the summary of a shard. A lost summary is computed again.
    fn read(&self, request: &PartRequest<'_>, summary: &Digest) -> Result<Arc<[u8]>, StageError> {
        self.run.ctx.check()?;
        match self.run.ctx.get(summary) {
            Err(StageError::Blob(error)) if error.lost.is_some() => {
                let (shard, measured) = measure_shard(self.run, self.map, request.shard)?;
                self.measured.fetch_add(measured, Ordering::Relaxed);
                self.run.ctx.get(&self.summarise(&request.key, &shard)?)
            }
            summary => summary,
        }
    }
}
