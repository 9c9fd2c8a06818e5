//! The requests behind the verbs of marf and their results, without a command line or a terminal.
//!
//! Every request gets a [`Context`]: its pipeline, its store, and the receiver of its progress.

pub mod archive;
pub mod audit;
mod batch_system;
pub mod cache;
pub mod calibrate;
pub mod choice;
pub mod compare;
mod context;
mod copies;
pub mod depth;
pub mod depth_score;
mod derived;
pub mod diff;
mod documents;
mod error;
pub mod exec;
pub mod execute;
pub mod export;
mod export_table;
mod file_state;
pub mod files;
pub mod filter;
pub mod fit;
pub mod folder;
pub mod key;
mod live_report;
mod manual_lists;
mod outputs;
pub mod photos;
pub mod plan;
pub mod program;
pub mod render;
pub mod replay;
pub mod report;
mod report_memos;
pub mod report_view;
pub mod results;
pub mod run;
pub mod scenes;
pub mod session;
mod shared;
pub mod status;
pub mod trade;
mod trust;
mod verdicts;
pub mod view;

pub use context::{Context, Feedback, RunFeedback, Signing, open_store};
pub use error::{Answer, Diagnostic, Error};
