//! COLMAP as a program: its steps, its log, and its end.

use std::fs::File;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::Duration;

use marf_cache::file::{FileKind, Links, read};
use marf_stage::{Ctx, StageError};

/// Pause between two polls of a running step.
const PAUSE: Duration = Duration::from_millis(50);
/// Last lines of a failed step that are shown.
const LAST_LINES: usize = 6;
/// Steps of a run, for its progress.
const STEPS: u64 = 3;

/// An installed COLMAP and the folder it works in.
pub(super) struct Program {
    path: PathBuf,
    folder: PathBuf,
    /// As it calls itself (`COLMAP 3.8`).
    pub(super) version: String,
}

/// A running step that is killed when dropped.
struct StepProcess(Child);

impl Drop for StepProcess {
    fn drop(&mut self) {
        // It may have ended by itself: then there is nothing to kill.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

impl Program {
    /// Finds the program and its version.
    pub(super) fn find(ctx: &Ctx<'_>, path: &str, folder: &Path) -> Result<Self, StageError> {
        let mut program = Self {
            path: PathBuf::from(path),
            folder: folder.to_path_buf(),
            version: String::new(),
        };
        let (_, output) = program.run(ctx, &["help"])?;
        let line = output
            .lines()
            .find(|line| line.trim_start().starts_with("COLMAP "));
        let line = line.ok_or_else(|| {
            StageError::new(format!("`{path}` does not call itself COLMAP")).hint(missing_hint())
        })?;
        program.version = line.split(" -- ").next().unwrap_or(line).trim().to_owned();
        Ok(program)
    }

    /// Runs `feature_extractor`.
    pub(super) fn extract_features(&self, ctx: &Ctx<'_>) -> Result<(), StageError> {
        let (database, images, masks) = (
            self.place("database.db"),
            self.place("images"),
            self.place("masks"),
        );
        let mut words = vec!["--database_path", &database, "--image_path", &images];
        words.extend([
            "--ImageReader.camera_model",
            "OPENCV",
            "--ImageReader.single_camera_per_folder",
            "1",
        ]);
        if Path::new(&masks).is_dir() {
            words.extend(["--ImageReader.mask_path", &masks]);
        }
        self.step(ctx, 0, "feature_extractor", &words)
    }

    /// Runs a matcher.
    pub(super) fn find_matches(&self, ctx: &Ctx<'_>, matcher: &str) -> Result<(), StageError> {
        self.step(ctx, 1, matcher, &["--database_path", &self.place("database.db")])
    }

    /// Runs `mapper`.
    pub(super) fn map(&self, ctx: &Ctx<'_>) -> Result<(), StageError> {
        let models = self.place("models");
        std::fs::create_dir_all(&models).map_err(|error| cannot_write("a model", &error))?;
        let (database, images) = (self.place("database.db"), self.place("images"));
        let words = [
            "--database_path",
            &database,
            "--image_path",
            &images,
            "--output_path",
            &models,
        ];
        self.step(ctx, 2, "mapper", &words)
    }

    /// Returns the path of a file in the folder.
    fn place(&self, name: &str) -> String {
        self.folder.join(name).to_string_lossy().into_owned()
    }

    /// Runs a step to its end. A failing one is an error with its last lines.
    fn step(&self, ctx: &Ctx<'_>, done: u64, name: &str, words: &[&str]) -> Result<(), StageError> {
        ctx.progress.at(done, STEPS, name);
        let threads = ctx.threads.to_string();
        // The names of options differ between versions. The step's help lists the ones it has.
        let (_, help) = self.run(ctx, &[name, "--help"])?;
        let common = [
            (["SiftExtraction.use_gpu", "FeatureExtraction.use_gpu"], "0"),
            (["SiftMatching.use_gpu", "FeatureMatching.use_gpu"], "0"),
            (
                ["SiftExtraction.num_threads", "FeatureExtraction.num_threads"],
                &threads,
            ),
            (
                ["SiftMatching.num_threads", "FeatureMatching.num_threads"],
                &threads,
            ),
            (["Mapper.num_threads", "Mapper.num_threads"], &threads),
        ];
        let mut all: Vec<String> = [name]
            .iter()
            .chain(words)
            .map(|word| (*word).to_owned())
            .collect();
        for (names, value) in common {
            let name = known(&help, names).map(|name| [format!("--{name}"), value.to_owned()]);
            all.extend(name.into_iter().flatten());
        }
        let all: Vec<&str> = all.iter().map(String::as_str).collect();
        let (status, output) = self.run(ctx, &all)?;
        if status.success() {
            ctx.progress.at(done + 1, STEPS, name);
            return Ok(());
        }
        let lines: Vec<&str> = output.lines().filter(|line| !line.trim().is_empty()).collect();
        let last = lines[lines.len().saturating_sub(LAST_LINES)..].join("\n");
        Err(StageError::new(format!("`colmap {name}` failed: {status}")).cause(last))
    }

    /// Runs the program to its end, or kills it when the run is cancelled. Returns exit status and output.
    fn run(&self, ctx: &Ctx<'_>, words: &[&str]) -> Result<(ExitStatus, String), StageError> {
        let log = self.folder.join("log");
        let failed = |error: std::io::Error| cannot_write("a log", &error);
        let out = File::create(&log).map_err(failed)?;
        let both = out.try_clone().map_err(failed)?;
        let command = Command::new(&self.path)
            .args(words)
            .stdin(Stdio::null())
            .stdout(out)
            .stderr(both)
            .spawn();
        let mut running = StepProcess(command.map_err(|error| self.cannot_start(&error))?);
        let status = loop {
            ctx.check()?;
            match running.0.try_wait() {
                Ok(Some(status)) => break status,
                Ok(None) => std::thread::sleep(PAUSE),
                Err(error) => return Err(self.cannot_start(&error)),
            }
        };
        // Ctrl-C reaches the child too: its failure is then expected.
        ctx.check()?;
        let output = read(&log, FileKind::State, Links::Followed).map_err(failed)?;
        Ok((status, String::from_utf8_lossy(&output).into_owned()))
    }

    /// Returns the error of a program that cannot be started.
    fn cannot_start(&self, error: &std::io::Error) -> StageError {
        let path = self.path.display();
        let what = match error.kind() {
            std::io::ErrorKind::NotFound => format!("the program `{path}` is not there"),
            _ => format!("the program `{path}` cannot be run: {error}"),
        };
        StageError::new(what).hint(missing_hint())
    }
}

/// Returns the error of a file that cannot be written.
pub(super) fn cannot_write(what: &str, error: &std::io::Error) -> StageError {
    StageError::new(format!("{what} for colmap cannot be written: {error}"))
        .hint("free space in the folder for temporary files (TMPDIR)")
}

/// Returns the name under which this version has an option.
fn known(help: &str, names: [&'static str; 2]) -> Option<&'static str> {
    names
        .into_iter()
        .find(|name| help.contains(&format!("--{name} ")))
}

/// Returns how to get COLMAP.
fn missing_hint() -> &'static str {
    "install COLMAP (https://colmap.github.io), name it with `colmap = \"/path/to/colmap\"`, or use `method = \"sfm\"`"
}
