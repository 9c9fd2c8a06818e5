//! The backend of the machines of jobs. Keys hold it, so it must be known before any key is computed. A small job reports it, once for a
//! partition.

use std::{fs, io};

use marf_cache::{Digest, canonical_json};
use marf_engine::Needs;
use marf_stage::{Cancel, Progress, StageError, Threads};
use serde::{Deserialize, Serialize};

use crate::{
    cluster::Cluster,
    errors::failed,
    job::JobOrder,
    job_files::JobFiles,
    job_result::{JobResult, write_whole},
    site::CPU,
};

/// A job's question instead of an action: which backend a device is on the machine of the job.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BackendQuestion {
    /// The device: `gpu`, or `gpu:NAME`.
    pub backend_of: String,
    /// The program that asks: another version may have other kernels.
    pub program: String,
    /// Options of the jobs: another partition has another answer.
    pub options: Vec<String>,
}

impl BackendQuestion {
    /// Reads the question of a file, or returns `None` if it holds something else.
    pub fn decode(bytes: &[u8]) -> Option<Self> {
        serde_json::from_slice(bytes).ok()
    }

    fn encode(&self) -> Vec<u8> {
        // Texts always serialise.
        canonical_json(&serde_json::to_value(self).unwrap_or_default())
    }
}

impl Cluster {
    /// Learns the backend of the machines of jobs, from the stored answer or by a job that asks there. Does nothing if jobs are on the
    /// CPU.
    ///
    /// # Errors
    /// As those of jobs. Also an error if the machine has no such GPU, or [`StageError::Cancelled`] if the user wants to stop.
    pub fn ask_backend(
        &mut self,
        program: &str,
        progress: &dyn Progress,
        cancel: &Cancel,
    ) -> Result<(), StageError> {
        if self.site.device == CPU {
            return Ok(());
        }
        let site = &self.site;
        let question = BackendQuestion {
            backend_of: site.device.clone(),
            program: program.to_owned(),
            options: site.options.iter().chain(&site.gpu_options).cloned().collect(),
        };
        let action = question.encode();
        let order = JobOrder {
            node: "the backend of jobs",
            key: Digest::from_content(&action),
            action,
            needs: Needs {
                cores: Threads::One,
                gpu: true,
                memory_mb: None,
                seconds: None,
            },
            progress,
            cancel,
        };
        let files = JobFiles::new(&self.site.folder, &order.key);
        self.asked = Some(files.backend.clone());
        let answer = match JobResult::read(&files.backend, &order.key) {
            Some(kept) => kept,
            None => {
                let told = self.run(&order)?;
                let kept = write_whole(&files.backend, &told);
                kept.map_err(|error| failed(order.node, "the answer cannot be kept", &error))?;
                files.remove();
                told
            }
        };
        self.gpu = answer.backend;
        match self.gpu {
            Some(_) => Ok(()),
            None => Err(StageError::new(format!(
                "`{}` has told no backend",
                answer.program
            ))),
        }
    }

    /// Forgets the backend of the machines of jobs, so that the next run asks again: a job has met another one.
    pub(crate) fn forget_backend(&self) {
        let removed: io::Result<()> = self.asked.iter().try_for_each(fs::remove_file);
        // Without a file there is nothing to forget.
        let _ = removed;
    }
}
