//! A node's own last output as an input of its next run.

use marf_cache::{Digest, Store, StoreError};
use marf_stage::{EARLIER, Inputs, Stage, StageDef, StageError};

use crate::{
    errors::store_error,
    executor::Executor,
    key::{Key, StageTable, action_at, node_key},
    record::RunRecord,
};

/// A node that needs a key.
pub(crate) struct KeyRequest<'a> {
    pub(crate) table: &'a StageTable,
    pub(crate) executor: Option<&'a dyn Executor>,
    pub(crate) name: &'a str,
    pub(crate) def: &'a StageDef,
    pub(crate) stage: &'a dyn Stage,
}

impl KeyRequest<'_> {
    /// Returns the key of the node, and its inputs with its own earlier output among them.
    pub(crate) fn key(
        &self,
        store: &Store,
        last: Option<&RunRecord>,
        inputs: Inputs,
    ) -> Result<(Key, Inputs), StageError> {
        let inputs = self.with_earlier(store, last, inputs)?;
        let key = self.node_key(&inputs)?;
        Ok((key, inputs))
    }

    fn node_key(&self, inputs: &Inputs) -> Result<Key, StageError> {
        node_key(self.table, self.executor, self.def, self.stage, inputs)
    }

    /// Adds the output of the node's last finished run as the input [`EARLIER`], if the stage asks for it and the store
    /// has it.
    ///
    /// If nothing else changed, the input is that of the last run: a node never runs because of its own output alone.
    fn with_earlier(
        &self,
        store: &Store,
        last: Option<&RunRecord>,
        inputs: Inputs,
    ) -> Result<Inputs, StageError> {
        let Some(wanted) = self.stage.earlier() else {
            return Ok(inputs);
        };
        let Some((record, earlier)) = self.last_result(store, last).map_err(store_error)? else {
            return Ok(inputs);
        };
        let with = |earlier: Option<Digest>| {
            let mut inputs = inputs.clone();
            let earlier = earlier.filter(|digest| store.contains(digest));
            inputs
                .0
                .extend(earlier.map(|digest| (EARLIER.to_owned(), digest)));
            inputs
        };
        let unchanged = with(earlier);
        if self.node_key(&unchanged)?.digest == record.key {
            return Ok(unchanged);
        }
        Ok(with(record.outputs.get(wanted).map(|output| output.digest)))
    }

    /// Returns the record of the node's last result, and the earlier output that it had as input.
    fn last_result(
        &self,
        store: &Store,
        last: Option<&RunRecord>,
    ) -> Result<Option<(marf_cache::Record, Option<Digest>)>, StoreError> {
        let key = last.and_then(|run| run.latest.get(self.name));
        let record = key.map(|key| store.record(key)).transpose()?.flatten();
        let Some(record) = record.filter(|record| record.stage == self.def.name) else {
            return Ok(None);
        };
        let earlier = action_at(store, &record.key)?.and_then(|action| action.inputs.get(EARLIER).copied());
        Ok(Some((record, earlier)))
    }
}
