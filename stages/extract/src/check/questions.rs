//! One question at a time, and what its answer came to.

use marf_stage::{Cancel, StageError};

use crate::archive::check::{Check, CheckState};
use crate::net::{Answer, Client, Download, NetError, Url};

/// A question to a server.
pub(crate) struct Question {
    /// What is asked for, in words.
    pub what: String,
    /// Its address on each mirror.
    pub urls: Vec<Url>,
    /// Largest answer that is taken, bytes.
    pub cap_bytes: u64,
    /// What it means that the server does not have it.
    pub absence: Absence,
}

/// What it means that a server does not have something.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Absence {
    /// The archive differs from what is expected.
    Differs,
    /// Nothing: the archive may be without it.
    Usual,
}

/// What a reader made of an answer.
pub(crate) struct Reading<T> {
    /// What was read.
    pub value: T,
    /// It in words.
    pub found: String,
    /// What is not as expected, one entry each. Empty if all is.
    pub differs: Vec<String>,
}

impl<T> Reading<T> {
    /// Returns a reading in which all is as expected.
    pub fn new(value: T, found: impl Into<String>) -> Self {
        Self {
            value,
            found: found.into(),
            differs: Vec::new(),
        }
    }
}

/// The checks of one archive so far, and the client that asks.
pub(crate) struct Checkup<'a> {
    cancel: &'a Cancel,
    client: &'a Client,
    checks: Vec<Check>,
    /// The server did not answer: it is asked no more.
    is_silent: bool,
}

impl<'a> Checkup<'a> {
    /// Returns an archive that was asked nothing yet.
    pub fn new(client: &'a Client, cancel: &'a Cancel) -> Self {
        Self {
            cancel,
            client,
            checks: Vec::new(),
            is_silent: false,
        }
    }

    /// Whether nothing has been found yet.
    pub fn is_empty(&self) -> bool {
        self.checks.is_empty()
    }

    /// Returns what was found.
    pub fn into_checks(self) -> Vec<Check> {
        self.checks
    }

    /// Asks a question, reads the answer, and adds the check. `None` if there is no answer that can be read.
    ///
    /// # Errors
    /// The wish to stop.
    pub fn ask<T>(
        &mut self,
        question: Question,
        read: impl FnOnce(&[u8]) -> Result<Reading<T>, String>,
    ) -> Result<Option<T>, StageError> {
        let Question {
            what,
            urls,
            cap_bytes,
            absence,
        } = question;
        if self.is_silent {
            self.skip(&what, "not asked for, as the server did not answer before");
            return Ok(None);
        }
        let first = urls.first().map(Url::to_string).unwrap_or_default();
        let (url, reading) = match self.download(urls, cap_bytes)? {
            Some(Ok(Answer::Whole { bytes, url, .. })) => (url, read(&bytes)),
            Some(Ok(Answer::Absent { .. })) if absence == Absence::Usual => return Ok(None),
            Some(Ok(Answer::Absent { status, url })) => (url, Err(answered(status))),
            // Nothing was known before, so that no server may say that it is unchanged.
            Some(Ok(Answer::Unchanged)) => (first, Err(answered(304))),
            Some(Err(error)) => {
                self.is_silent = error.retryable;
                let state = if error.retryable {
                    CheckState::NotChecked
                } else {
                    CheckState::Differs
                };
                self.add(what, Some(first), state, error.to_string());
                return Ok(None);
            }
            None => return Ok(None),
        };
        Ok(self.take(what, Some(url), reading))
    }

    /// Adds the check of something that needs no question: it came with another answer.
    pub fn take<T>(
        &mut self,
        what: String,
        url: Option<String>,
        reading: Result<Reading<T>, String>,
    ) -> Option<T> {
        match reading {
            Ok(Reading {
                value,
                found,
                differs,
            }) => {
                if differs.is_empty() {
                    self.add(what, url, CheckState::AsExpected, found);
                } else {
                    self.add(what, url, CheckState::Differs, differs.join(", "));
                }
                Some(value)
            }
            Err(reason) => {
                self.add(what, url, CheckState::Differs, reason);
                None
            }
        }
    }

    /// Adds something that could not be asked for.
    pub fn skip(&mut self, what: &str, reason: impl Into<String>) {
        self.add(what.to_owned(), None, CheckState::NotChecked, reason.into());
    }

    fn add(&mut self, what: String, url: Option<String>, state: CheckState, found: String) {
        self.checks.push(Check {
            what,
            url,
            state,
            found,
        });
    }

    fn download(
        &self,
        urls: Vec<Url>,
        cap_bytes: u64,
    ) -> Result<Option<Result<Answer, NetError>>, StageError> {
        let want = Download {
            urls,
            cap_bytes,
            known: None,
            part: None,
        };
        let mut got = None;
        self.client.get_all(self.cancel, &[want], &mut |_, answer| {
            got = Some(answer);
            Ok(())
        })?;
        Ok(got)
    }
}

fn answered(status: u16) -> String {
    format!("the server answers status {status}")
}
