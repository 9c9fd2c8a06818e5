use std::collections::HashMap;
use std::sync::OnceLock;

use indicatif::{MultiProgress, ProgressBar, ProgressStyle};
use marf_engine::{Event, Listener};
use marf_progress::{RunProgress, sentence};
use marf_report::visible;
use marf_run::RunFeedback;
use parking_lot::Mutex;

use crate::terminal::eprint_line;

/// A bar for each running node, finished nodes as lines above them.
#[derive(Default)]
pub struct Bars {
    all: MultiProgress,
    running: Mutex<HashMap<String, ProgressBar>>,
    /// The whole run, below all nodes.
    whole: OnceLock<ProgressBar>,
}

impl Bars {
    fn bar(&self, node: &str, total: u64) -> ProgressBar {
        let mut running = self.running.lock();
        let make = || {
            let bar = match self.whole.get() {
                Some(whole) => self.all.insert_before(whole, ProgressBar::new(total)),
                None => self.all.add(ProgressBar::new(total)),
            };
            let bar = bar.with_prefix(visible(node).into_owned());
            let template = "{prefix:<22} {bar:28} {pos:>6}/{len:<6} {elapsed:>4} so far, {eta} left  {msg}";
            bar.set_style(
                ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar()),
            );
            bar
        };
        running.entry(node.to_owned()).or_insert_with(make).clone()
    }

    fn end(&self, node: &str) {
        let mut running = self.running.lock();
        if let Some(bar) = running.remove(node) {
            bar.finish_and_clear();
            self.all.remove(&bar);
        }
    }
}

impl RunFeedback for Bars {
    fn on_devices(&self, devices: &str) {
        eprint_line(&format!("device  {devices}"));
    }

    fn on_run_progress(&self, standing: &RunProgress) {
        let whole = self.whole.get_or_init(|| {
            let bar = self
                .all
                .add(ProgressBar::new(standing.nodes as u64))
                .with_prefix("run");
            let style = ProgressStyle::with_template("{prefix:<22} {bar:28} {elapsed:>4} so far, {msg}");
            bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()));
            bar
        });
        whole.set_position(standing.over as u64);
        whole.set_message(visible(&standing.text()).into_owned());
        if standing.over == standing.nodes {
            whole.finish_and_clear();
        }
    }
}

impl Listener for Bars {
    fn on_event(&self, event: &Event) {
        match event {
            Event::Progress {
                node,
                done,
                total,
                note,
            } => {
                let bar = self.bar(node, *total);
                if bar.length() != Some(*total) {
                    bar.set_length(*total); // the node has begun another piece of work
                    bar.reset_eta();
                }
                bar.set_position(*done);
                bar.set_message(visible(note).into_owned());
            }
            Event::Finished { node, .. } | Event::Failed { node, .. } | Event::Reused { node, .. } => {
                self.end(node);
            }
            _ => {}
        }
        if let Some(line) = sentence(event) {
            let _ = self.all.println(visible(&line)); // a closed terminal is no error
        }
    }
}
