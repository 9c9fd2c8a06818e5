//! Nodes of a run as jobs of a batch system (Slurm, or another by a template).
//!
//! ```text
//! FOLDER/<key>.action    what a job computes
//! FOLDER/<key>.sh        its script
//! FOLDER/<key>.log       what the job printed, attempts one after the other
//! FOLDER/<key>.json      how it ended, written by rename ([`JobResult`])
//! FOLDER/<key>.progress  how far it is ([`JobProgress`])
//! FOLDER/<key>.backend   what a machine of jobs has told of its GPU, whose backend is in keys ([`BackendQuestion`])
//! FOLDER/<key>/          its scratch store with checkpoints, until it has a result
//! ```
//! FOLDER is on a file system that the machine of the run and those of the jobs share. Inputs and results travel through a shared
//! store; of a job its file alone tells how it ended. The batch system is asked which jobs are there, never how one ended: its
//! accounting may be off, and forgets. So nothing but the queue is believed to say that a job is alive, and nothing but the file
//! that it is done; a job that is in neither for a while is lost and submitted again.
//!
//! The name of a job is its key. A run that begins looks for jobs of its keys in the queue, and takes them over.

mod array_plan;
mod arrays;
mod backend;
mod cluster;
mod commands;
mod errors;
mod executor;
mod job;
mod job_files;
mod job_result;
mod queue;
mod script;
mod site;
mod words;

pub use backend::BackendQuestion;
pub use cluster::Cluster;
pub use job_result::{Fault, JobProgress, JobResult};
pub use site::{Site, SiteError};
