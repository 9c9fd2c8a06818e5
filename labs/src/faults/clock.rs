//! Files of the store with times of 1970, of 2099 and of any time between, as a clock that was set back leaves them.

use std::fs::File;
use std::time::{Duration, SystemTime};

use super::case::{Case, Variant, files_of};
use super::injector::{Fault, Injector, Outcome};
use super::lab::Lab;

/// The first second of 2099.
const FAR_S: u64 = 4_070_908_800;

/// Changes the times of files in copies of the undisturbed store.
pub struct Clock<'a> {
    pub lab: &'a Lab,
    pub case: Case,
}

impl Injector for Clock<'_> {
    fn prepare(&mut self, _round: u32) -> Outcome {
        self.lab.reset_to_undisturbed(&self.case)
    }

    fn inject(&mut self, round: u32) -> Outcome {
        let seconds = match round {
            0 => 0,
            1 => FAR_S,
            _ => self.lab.random(Fault::Clock, round) % FAR_S,
        };
        let time = SystemTime::UNIX_EPOCH + Duration::from_secs(seconds);
        let store = self.case.store();
        for file in files_of(&store) {
            File::open(store.join(file))?.set_modified(time)?;
        }
        Ok(())
    }

    fn judge(&mut self, _round: u32) -> Outcome {
        self.lab.ends_equal(&self.case, Variant::Plain)?;
        self.case.ran_nothing()
    }

    fn detail(&self) -> String {
        "files of 1970, of 2099 and of random times between. Nothing runs again".to_owned()
    }
}
