//! Nodes of a run as jobs of a batch system (Slurm, or another by a template).
//!
//! ```text
//! FOLDER/<key>.action    action of a job
//! FOLDER/<key>.sh        script of the job
//! FOLDER/<key>.log       output of the job, attempts one after the other
//! FOLDER/<key>.json      end of the job, written by rename ([`JobResult`])
//! FOLDER/<key>.progress  progress of the job ([`JobProgress`])
//! FOLDER/<key>.backend   the backend of the GPU of a machine of jobs, which is in keys ([`BackendQuestion`])
//! FOLDER/<key>/          scratch folder of the job, with its store and checkpoints, until it has a result
//! ```
//! FOLDER is on a file system that the machine of the run and those of the jobs share. Inputs and results travel through a shared
//! store. Only the file of a job reports how it ended. The batch system is asked which jobs exist, never how one ended: its
//! accounting may be off, and forgets. So only the queue shows that a job is alive, and only the file shows that it is done. A
//! job that is in neither for a while is lost and submitted again.
//!
//! The name of a job is its key. A run that begins looks for jobs of its keys in the queue, and takes them over.

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
