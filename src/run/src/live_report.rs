//! The report of a run that goes on: `report.html` is written again as results arrive, and once more when the run is stopped.

use std::collections::BTreeSet;
use std::path::Path;
use std::time::{Duration, Instant};

use marf_config::scenes::scene_of;
use marf_engine::{Event, Listener, RunRecord, StateListener, document};
use parking_lot::Mutex;

use crate::error::Error;
use crate::session::Session;
use crate::{files, report, scenes};

/// Shortest time between two writes.
const EVERY: Duration = Duration::from_secs(2);
/// The report may take this part of the time of a run: one in 20.
const PARTS: u32 = 20;
/// Time of the first write, which nobody has measured yet: a run of less than 20 s has a report only at its end.
const FIRST: Duration = Duration::from_secs(1);

/// Writes the report of a run while it goes on.
pub struct LiveReport<'a> {
    session: &'a Session,
    out: &'a Path,
    state: Mutex<State>,
}

/// What is due, and what was spent on it.
struct State {
    began: Instant,
    /// Pages that show an older state: of a scene, or of everything that scenes share. `None` after a fault.
    due: Option<BTreeSet<Option<String>>>,
    is_written: bool,
    last_end: Instant,
    last_took: Duration,
    spent: Duration,
}

impl<'a> LiveReport<'a> {
    /// Returns the report of a run that begins now, in the folder `out`.
    pub fn new(session: &'a Session, out: &'a Path) -> Self {
        let now = Instant::now();
        let state = State {
            began: now,
            due: Some(BTreeSet::new()),
            is_written: false,
            last_end: now,
            last_took: FIRST,
            spent: Duration::ZERO,
        };
        Self {
            session,
            out,
            state: Mutex::new(state),
        }
    }

    /// Writes the report of a run that was stopped, if it made anything. A fault is a warning, as the user waits for the end.
    pub fn write_stopped(&self, record: &RunRecord) {
        let state = self.state.lock();
        let has_news = state.due.as_ref().is_none_or(|due| !due.is_empty());
        if !state.is_written && !has_news {
            return;
        }
        let changed = state.due.clone().unwrap_or_default();
        if let Err(error) = self.write(record, &changed) {
            self.session.context.warn(error.message().to_owned());
        }
    }

    /// Writes the page of everything that scenes share, and those of some scenes.
    fn write(&self, record: &RunRecord, changed: &BTreeSet<Option<String>>) -> Result<(), Error> {
        for scene in changed.iter().flatten() {
            let page = report::page_of(self.session, record, Some(scene.as_str()))?;
            files::write(&self.out.join(scenes::page_name(scene)), page.as_bytes())?;
        }
        let page = report::page_of(self.session, record, None)?;
        files::write(&self.out.join(document::REPORT), page.as_bytes())
    }
}

impl Listener for LiveReport<'_> {
    fn on_event(&self, event: &Event) {
        let (Event::Finished { node, .. } | Event::Failed { node, .. }) = event else {
            return;
        };
        // What is below another node is on no page by itself.
        if !node.contains('/')
            && let Some(due) = &mut self.state.lock().due
        {
            due.insert(scene_of(node).map(str::to_owned));
        }
    }
}

impl StateListener for LiveReport<'_> {
    fn on_state(&self, record: &dyn Fn() -> Option<RunRecord>) {
        let mut state = self.state.lock();
        if !state.may_write(Instant::now()) || self.session.check().is_err() {
            return;
        }
        let began = Instant::now();
        let Some(record) = record().filter(RunRecord::goes_on) else {
            return;
        };
        let changed = state.due.take().unwrap_or_default();
        match self.write(&record, &changed) {
            Ok(()) => {
                state.due = Some(BTreeSet::new());
                state.is_written = true;
            }
            Err(Error::Interrupted) => state.due = Some(changed),
            // The end of the run meets the same fault, and fails.
            Err(error) => self.session.context.warn(error.message().to_owned()),
        }
        let end = Instant::now();
        state.last_end = end;
        state.last_took = end - began;
        state.spent += end - began;
    }
}

impl State {
    /// Returns whether a page is due, and a write as long as the last one is within the share of the time so far.
    fn may_write(&self, now: Instant) -> bool {
        let is_due = self.due.as_ref().is_some_and(|due| !due.is_empty());
        let share = (now - self.began) / PARTS;
        is_due && now - self.last_end >= EVERY && self.spent + self.last_took <= share
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_report_waits_two_seconds_and_takes_a_twentieth_of_the_time() {
        let began = Instant::now();
        let at = |seconds: f64| began + Duration::from_secs_f64(seconds);
        let mut state = State {
            began,
            due: Some(BTreeSet::from([None])),
            is_written: false,
            last_end: began,
            last_took: FIRST,
            spent: Duration::ZERO,
        };
        assert!(
            !state.may_write(at(19.9)) && state.may_write(at(20.1)),
            "1 s of 20"
        );
        state.last_end = at(20.6);
        state.last_took = Duration::from_millis(50);
        state.spent = Duration::from_millis(50);
        assert!(
            !state.may_write(at(22.5)) && state.may_write(at(22.7)),
            "2 s apart"
        );
        state.spent = Duration::from_millis(1_500);
        assert!(
            !state.may_write(at(30.9)) && state.may_write(at(31.1)),
            "1.55 s of 31"
        );
        state.due = Some(BTreeSet::new());
        assert!(!state.may_write(at(99.0)), "nothing is new");
        state.due = None;
        assert!(!state.may_write(at(99.0)), "it could not be written");
    }
}
