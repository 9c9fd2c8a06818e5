//! The executor: each action that it takes is a job, from its submission to its result.

use marf_cache::Action;
use marf_engine::{Executor, Machine, Order};
use marf_stage::StageError;

use crate::{cluster::Cluster, job::JobOrder, job_files::JobFiles};

impl Executor for Cluster {
    fn machine_of(&self, stage: &str) -> Option<Machine<'_>> {
        let gpu = self.gpu.as_deref();
        self.site.stages.contains(stage).then_some(Machine { gpu })
    }

    fn takes(&self, action: &Action) -> bool {
        self.site.stages.contains(&action.stage)
    }

    fn slots(&self) -> usize {
        self.site.max_jobs
    }

    fn execute(&self, order: &Order<'_>) -> Result<(), StageError> {
        if !self.fetch(order)? {
            self.share(order)?;
            self.run(&JobOrder::new(order))?;
            self.bring_told(order)?;
            self.note_shared(order)?;
        }
        JobFiles::new(&self.site.folder, &order.key).remove();
        Ok(())
    }
}
