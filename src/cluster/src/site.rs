//! The site file: where and how jobs run. It is in no key.

use std::{
    collections::BTreeSet,
    path::{Path, PathBuf},
};

use marf_cache::file::{self, FileKind, Links};
use serde::Deserialize;

use crate::{commands::Commands, script};

/// The device of jobs without a GPU.
pub(crate) const CPU: &str = "cpu";

/// A batch system and how it is used.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Site {
    /// Address of the shared store (`file:///FOLDER`, `s3://BUCKET/PREFIX`), as the machines of the jobs see it.
    pub store: String,
    /// Files with the public keys of trusted writers. If empty, everybody is trusted. Jobs sign with the key
    /// of their user, if there is one.
    pub trust: Vec<PathBuf>,
    /// Folder of scripts, results and logs, which the machines of the jobs see under the same path.
    pub folder: PathBuf,
    /// Stages whose nodes are jobs, if these work on a whole set. All others are computed on the machine of the run.
    pub stages: BTreeSet<String>,
    /// Most jobs at once, including those that wait in the queue.
    pub max_jobs: usize,
    /// The program on the machines of the jobs [default: this one].
    pub marf: Option<PathBuf>,
    /// Cores of a job whose stage can use more than one.
    pub cores: usize,
    /// Memory of a job whose node never ran, MB. One that ran gets half as much again as it took.
    pub memory_mb: u64,
    /// Longest time of a job, minutes. A job that is stopped goes on from its checkpoint.
    pub minutes: u64,
    /// Further options of every job, a line of the script each (`--partition=long`).
    pub options: Vec<String>,
    /// On what jobs train: `cpu`, `gpu`, or `gpu:NAME`. A node with `device = "cpu"` trains on the CPU everywhere.
    pub device: String,
    /// Further options of jobs on a GPU.
    pub gpu_options: Vec<String>,
    /// Seconds between two looks at the queue and at the files of jobs.
    pub poll_s: f64,
    /// Seconds for which a job may be in neither the queue nor its folder before it counts as lost: a shared file system lags.
    pub patience_s: f64,
    /// File with another script of jobs, for other batch systems, with the placeholders of `script.rs`. A line with `{options}` is repeated for
    /// each further option.
    pub template: Option<PathBuf>,
    /// Commands of the batch system.
    pub commands: Commands,
}

impl Default for Site {
    fn default() -> Self {
        Self {
            store: String::new(),
            trust: Vec::new(),
            folder: PathBuf::new(),
            stages: ["train", "partial"].map(str::to_owned).into(),
            max_jobs: 100,
            marf: None,
            cores: 4,
            memory_mb: 4_000,
            minutes: 240,
            options: Vec::new(),
            device: CPU.to_owned(),
            gpu_options: vec!["--gres=gpu:1".to_owned()],
            poll_s: 5.0,
            patience_s: 60.0,
            template: None,
            commands: Commands::default(),
        }
    }
}

/// A site file that cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum SiteError {
    /// It, or a file that it names, cannot be read, or holds what no site can have.
    #[error("{path}: {message}", path = path.display())]
    Invalid {
        /// The file.
        path: PathBuf,
        /// Where and what.
        message: String,
    },
    /// The batch system does not list its jobs.
    #[error("the batch system does not answer: {said}")]
    Silent {
        /// What it says.
        said: String,
    },
}

impl SiteError {
    /// Returns the error of a file.
    pub(crate) fn invalid(path: &Path, message: impl ToString) -> Self {
        Self::Invalid {
            path: path.to_owned(),
            message: message.to_string(),
        }
    }
}

/// Longest wait: a year.
const MOST_SECONDS: f64 = 31_536_000.0;

/// The table `[executor]` of a site file.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    executor: Site,
}

impl Site {
    /// Reads a site file.
    ///
    /// # Errors
    /// Returns an error if the file is absent or not a site file, or has an invalid value.
    pub fn read(path: &Path) -> Result<Self, SiteError> {
        Self::from_text(&read_text(path)?, path)
    }

    /// Reads the text of a site file. Errors name the path.
    ///
    /// # Errors
    /// As [`Site::read`].
    pub fn from_text(text: &str, path: &Path) -> Result<Self, SiteError> {
        let settings: Result<File, _> = toml::from_str(text);
        let site = settings
            .map_err(|error| SiteError::invalid(path, error.to_string().trim_end()))?
            .executor;
        site.check()
            .map_err(|(key, message)| SiteError::invalid(path, format!("executor.{key}: {message}")))?;
        Ok(site)
    }

    fn check(&self) -> Result<(), (&'static str, String)> {
        let positive = |key: &'static str, is_positive: bool| {
            if is_positive {
                Ok(())
            } else {
                Err((key, "a number above 0 is needed".to_owned()))
            }
        };
        if self.store.is_empty() {
            return Err(("store", "the address of the shared store is missing".to_owned()));
        }
        if self.folder.as_os_str().is_empty() {
            return Err(("folder", "a folder that all machines see is missing".to_owned()));
        }
        positive("max_jobs", self.max_jobs > 0)?;
        positive("cores", self.cores > 0)?;
        positive("memory_mb", self.memory_mb > 0)?;
        positive("minutes", self.minutes > 0)?;
        for (key, seconds) in [("poll_s", self.poll_s), ("patience_s", self.patience_s)] {
            if !(seconds > 0.0 && seconds <= MOST_SECONDS) {
                let message = format!("a number of seconds above 0 and up to {MOST_SECONDS} is needed");
                return Err((key, message));
            }
        }
        self.check_texts()?;
        if !self.folder.is_absolute() {
            let message = format!(
                "`{}`: machines of jobs need the whole path",
                self.folder.display()
            );
            return Err(("folder", message));
        }
        if self.device != CPU && self.device != "gpu" && !self.device.starts_with("gpu:") {
            let message = format!("`{}`: cpu, gpu or gpu:NAME", self.device);
            return Err(("device", message));
        }
        if self.stages.is_empty() {
            return Err(("stages", "no stage: nothing would be a job".to_owned()));
        }
        self.commands.check()
    }

    /// Refuses texts that would be something else in a script than one value: with a line feed they would be a line of it.
    fn check_texts(&self) -> Result<(), (&'static str, String)> {
        let paths = [("folder", Some(&self.folder)), ("marf", self.marf.as_ref())];
        let paths = paths
            .into_iter()
            .filter_map(|(key, path)| Some((key, path?.to_string_lossy())));
        let lists = [("options", &self.options), ("gpu_options", &self.gpu_options)];
        let lists = lists.into_iter();
        let options = lists.flat_map(|(key, list)| list.iter().map(move |text| (key, text.into())));
        let mut texts = paths
            .chain([("store", self.store.as_str().into())])
            .chain(options);
        if let Some((key, text)) = texts.find(|(_, text)| text.contains(char::is_control)) {
            return Err((key, format!("{text:?}: a control character")));
        }
        Ok(())
    }

    /// Returns the script of jobs, with its placeholders.
    ///
    /// # Errors
    /// A template that cannot be read, or lacks what every job needs.
    pub(crate) fn script(&self) -> Result<String, SiteError> {
        let Some(path) = &self.template else {
            return Ok(script::SLURM.to_owned());
        };
        let template = read_text(path)?;
        let of_gpu = self.gpu_options.iter().filter(|_| self.device != CPU);
        let options: Vec<String> = self.options.iter().chain(of_gpu).cloned().collect();
        script::check(&template, &options).map_err(|message| SiteError::invalid(path, message))?;
        Ok(template)
    }
}

/// Reads a file of settings.
fn read_text(path: &Path) -> Result<String, SiteError> {
    file::read_text(path, FileKind::Settings, Links::Followed)
        .map_err(|error| SiteError::invalid(path, error))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Site, String> {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("site.toml");
        std::fs::write(&path, text).unwrap();
        let prefix = format!("{}: ", path.display());
        Site::read(&path).map_err(|error| error.to_string().replace(&prefix, ""))
    }

    const LEAST: &str = "[executor]\nstore = \"file:///s\"\nfolder = \"/f\"\n";

    #[test]
    fn a_site_needs_a_store_and_a_folder_and_has_defaults_for_the_rest() {
        let site = read(LEAST).unwrap();
        assert_eq!((site.max_jobs, site.cores, site.memory_mb), (100, 4, 4_000));
        assert_eq!(site.stages.len(), 2, "both trainings");
        assert_eq!(site.commands, Commands::default());
        assert!(
            read("[executor]\nstore = \"file:///s\"\n")
                .unwrap_err()
                .contains("executor.folder: a folder that all machines see is missing")
        );
    }

    #[test]
    fn values_that_no_site_can_have_are_refused_by_key() {
        for (line, expected) in [
            ("max_jobs = 0", "executor.max_jobs: a number above 0 is needed"),
            (
                "poll_s = 0.0",
                "executor.poll_s: a number of seconds above 0 and up to 31536000 is needed",
            ),
            (
                "poll_s = 31536001.0",
                "executor.poll_s: a number of seconds above 0",
            ),
            (
                "patience_s = nan",
                "executor.patience_s: a number of seconds above 0 and up to 31536000 is needed",
            ),
            ("device = \"tpu\"", "executor.device: `tpu`: cpu, gpu or gpu:NAME"),
            ("stages = []", "executor.stages: no stage: nothing would be a job"),
            ("commands.submit = []", "executor.commands.submit: no program"),
            ("pace = 3", "unknown field `pace`"),
            (
                "options = [\"-q long\", \"x\\ntouch y\"]",
                "executor.options: \"x\\ntouch y\": a control character",
            ),
            (
                "gpu_options = [\"\\u001b\"]",
                "executor.gpu_options: \"\\u{1b}\": a control character",
            ),
            (
                "marf = \"/a\\nb\"",
                "executor.marf: \"/a\\nb\": a control character",
            ),
        ] {
            let error = read(&format!("{LEAST}{line}\n")).unwrap_err();
            assert!(error.contains(expected), "{line}: {error}");
        }
        let relative = read("[executor]\nstore = \"file:///s\"\nfolder = \"jobs\"\n").unwrap_err();
        assert!(relative.contains("whole path"), "{relative}");
        for (text, key) in [
            ("store = \"file:///s\"\nfolder = \"/x\\ntouch y\\n#\"\n", "folder"),
            ("store = \"file:///s\\n\"\nfolder = \"/x\"\n", "store"),
        ] {
            let error = read(&format!("[executor]\n{text}")).unwrap_err();
            assert!(error.contains(&format!("executor.{key}: ")), "{error}");
            assert!(error.contains("a control character"), "{error}");
        }
    }
}
