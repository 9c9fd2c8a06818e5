//! Run roots: numbered files that are written last.

use std::{fs, path::PathBuf};

use super::{Published, Store, StoreError, files};

impl Store {
    /// Seals everything put so far, then stores a run under the next free number.
    ///
    /// # Errors
    /// A store that cannot be written.
    pub fn put_run(&self, bytes: &[u8]) -> Result<u64, StoreError> {
        self.commit()?;
        let session = self.session()?;
        let file = session.path(&session.next_name());
        files::write_new(&file, &[bytes])?;
        files::sync(std::slice::from_ref(&file))?;
        let mut number = self.run_numbers()?.last().copied().unwrap_or(0) + 1;
        // Two processes may want one number: the second takes the next.
        while self.name_run(&file, number)? == Published::Present {
            number += 1;
        }
        let _ = fs::remove_file(&file);
        files::sync(&[self.dir.join("runs")])?;
        Ok(number)
    }

    fn name_run(&self, file: &std::path::Path, number: u64) -> Result<Published, StoreError> {
        let to = self.run_path(number);
        match fs::hard_link(file, &to) {
            Ok(()) => Ok(Published::New),
            Err(_) if to.exists() => Ok(Published::Present),
            Err(_) => files::publish(file, &to),
        }
    }

    fn run_path(&self, number: u64) -> PathBuf {
        self.dir.join("runs").join(format!("{number:06}.json"))
    }

    /// Returns the numbers of all runs, oldest first.
    ///
    /// # Errors
    /// A folder that cannot be read.
    pub fn run_numbers(&self) -> Result<Vec<u64>, StoreError> {
        let names = files::names(&self.dir.join("runs"))?;
        let numbers = names
            .iter()
            .filter_map(|name| name.strip_suffix(".json")?.parse().ok());
        let mut numbers: Vec<u64> = numbers.collect();
        numbers.sort_unstable();
        Ok(numbers)
    }

    /// Reads a run.
    ///
    /// # Errors
    /// A number without a run, or a file that cannot be read.
    pub fn run(&self, number: u64) -> Result<Vec<u8>, StoreError> {
        let path = self.run_path(number);
        fs::read(&path).map_err(StoreError::io("read", path))
    }
}
