//! One page of each kind that a feed has, and the records of one sol.

use std::collections::BTreeMap;

use marf_stage::{Sols, StageError};
use serde_json::Value;

use super::question::{MAX_PAGE_BYTES, Newest};
use super::records::{id_of, sol_of};
use super::{Feed, RUN_SOLS, Records, runs, wanted};
use crate::check::{Absence, Checkup, Question, Reading};
use crate::remote::catalog::ListedSol;
use crate::remote::crawl::urls;

/// A page of records, by sol.
type BySol = BTreeMap<u32, Records>;

impl Feed {
    /// Asks for the latest sol, and for the first page of the newest sols of a choice.
    pub(super) fn one_page_of_each(
        &self,
        sols: &Sols,
        checkup: &mut Checkup<'_>,
    ) -> Result<Option<ListedSol>, StageError> {
        let question = self.question("latest sol", &self.latest_path())?;
        let newest = checkup.ask(question, |bytes| {
            let sol = Newest::from_answer(&json(bytes)?).sol;
            let sol = sol.ok_or("the answer has no `latest_sol`")?;
            Ok(Reading::new(sol, format!("sol {sol}")))
        })?;
        let Some(newest) = newest else {
            return Ok(None);
        };
        let last_run = runs(&wanted(sols, Some(newest))?).pop();
        let (first, last) = last_run.unwrap_or((newest.saturating_sub(RUN_SOLS - 1), newest));
        let what = format!("records of sols {first} to {last}");
        let question = self.question(&what, &self.page_path(first, last, 0))?;
        let found = checkup.ask(question, |bytes| self.reading(&json(bytes)?, first, last))?;
        let listed = found.into_iter().flatten().rev().map(|(sol, records)| ListedSol {
            sol,
            files: self.sol_files(&records),
        });
        Ok(listed.into_iter().find(|listed| !listed.files.files.is_empty()))
    }

    fn reading(&self, json: &Value, first: u32, last: u32) -> Result<Reading<BySol>, String> {
        let (records, total) = self
            .read_page(json, first, last)
            .map_err(|error| error.to_string())?;
        let mut found = BySol::new();
        for record in &records {
            if let (Some(sol), Some(id)) = (sol_of(record), id_of(record)) {
                found.entry(sol).or_default().insert(id, (*record).clone());
            }
        }
        let mut differs = Vec::new();
        if found.is_empty() && !records.is_empty() {
            differs.push(format!(
                "none of its {} records has `imageid` and `sol`",
                records.len()
            ));
        }
        let files: Vec<_> = found.values().map(|records| self.sol_files(records)).collect();
        let left_out = files.iter().flat_map(|files| &files.left_out).next();
        if let Some((id, reason)) = left_out.filter(|_| files.iter().all(|files| files.files.is_empty())) {
            differs.push(format!(
                "none of its {} records is taken, as `{id}`: {reason}",
                records.len()
            ));
        }
        let total = total.map_or_else(|| "an unknown number".to_owned(), |total| total.to_string());
        Ok(Reading {
            found: format!("{} of {total} records", records.len()),
            value: found,
            differs,
        })
    }

    fn question(&self, what: &str, path: &str) -> Result<Question, StageError> {
        Ok(Question {
            what: what.to_owned(),
            urls: urls(&self.bases, path)?,
            cap_bytes: MAX_PAGE_BYTES,
            absence: Absence::Differs,
        })
    }
}

fn json(bytes: &[u8]) -> Result<Value, String> {
    serde_json::from_slice(bytes).map_err(|error| format!("the answer is not JSON: {error}"))
}
