//! `marf bench faults`: does to a small pipeline what disks, users and power cuts do, and compares every digest with those of
//! an undisturbed run.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use marf_engine::Cancel;
use serde::Serialize;

use super::super::args::{Fault, FaultsArgs};
use super::super::error::{CliError, Diagnostic};
use super::super::files;
use super::child::random;
use super::pictures::{Shade, picture};
use crate::terminal::{eprint_line, print_line};

/// Photos, filters, cameras, a training and two retrainings, in a second.
const PIPELINE: &str = r#"name = "faults"
[archive.photos]
kind = "folder"
path = "photos"
[node.extract]
archive = "photos"
[node.size]
input = "extract"
min_bytes = 100
[node.shape]
input = "size"
min_width = 32
min_height = 24
[node.duplicate]
input = "shape"
[node.grayscale]
input = "duplicate"
[node.histogram]
input = "grayscale"
[node.blur]
input = "histogram"
[node.calibrate]
input = "extract"
cameras = "extract"
method = "import"
[node.train]
input = "calibrate"
steps = 40
scale = 4
[node.bootstrap]
input = "calibrate"
steps = 20
scale = 4
b = 2
frames = 2
width = 32
"#;
/// Photos of the pipeline: a ring of cameras around nothing in particular.
const RING: u32 = 12;
/// Size of a photo, pixels.
const SIZE: (u32, u32) = (160, 120);
/// As the pipeline, but with another threshold early on: a run with it reads most of what a run before has stored.
const CHANGE: [&str; 2] = ["--set", "size.min_bytes=1"];
/// A stopped run must have ended after this time.
const STOP_LIMIT: Duration = Duration::from_secs(2);

/// The result of one kind of fault.
#[derive(Debug, Serialize)]
struct Report {
    fault: &'static str,
    rounds: u32,
    /// Rounds after which a digest differed, a check failed, or a run did not end well.
    bad: u32,
    /// The first of them, in words.
    #[serde(skip_serializing_if = "Option::is_none")]
    first_bad: Option<String>,
    /// What was done, in words.
    detail: String,
    wall_s: f64,
}

/// The outputs of all nodes: name of node and output to digest.
type Outputs = BTreeMap<String, String>;

/// Runs `marf bench faults`: one JSON line a fault.
///
/// # Errors
/// A folder that cannot be written; a fault after which something was wrong.
pub fn faults(args: &FaultsArgs, cancel: &Cancel) -> Result<(), CliError> {
    let lab = Lab::new(&args.dir, args.seed)?;
    eprint_line("the undisturbed runs");
    let expected = lab.undisturbed(cancel)?;
    let chosen: Vec<Fault> = match args.fault.is_empty() {
        true => Fault::ALL.to_vec(),
        false => args.fault.clone(),
    };
    let mut bad = 0;
    for fault in chosen {
        if cancel.is_set() {
            return Err(CliError::Interrupted);
        }
        let began = Instant::now();
        let mut tally = Tally::default();
        let detail = match fault {
            Fault::Kill => lab.kill(args.rounds, &expected, &mut tally, cancel)?,
            Fault::Interrupt => lab.interrupt(args.rounds, &expected, &mut tally, cancel)?,
            Fault::Damage => lab.damage(args.rounds, &expected, &mut tally, cancel)?,
            Fault::Full => lab.full(args.rounds, &expected, &mut tally, cancel)?,
            Fault::Eight => lab.eight(args.rounds, &expected, &mut tally, cancel)?,
            Fault::Collect => lab.collect(args.rounds, &expected, &mut tally, cancel)?,
            Fault::Clock => lab.clock(&expected, &mut tally)?,
        };
        let report = Report {
            fault: fault.name(),
            rounds: tally.rounds,
            bad: tally.bad,
            first_bad: tally.first_bad,
            detail,
            wall_s: began.elapsed().as_secs_f64(),
        };
        bad += report.bad;
        print_line(&serde_json::to_string(&report).map_err(|error| CliError::failed(error.to_string()))?);
    }
    match bad {
        0 => {
            lab.remove();
            Ok(())
        }
        _ => Err(CliError::failed(format!("{bad} rounds ended badly"))),
    }
}

/// Counts rounds and bad ones.
#[derive(Default)]
struct Tally {
    rounds: u32,
    bad: u32,
    first_bad: Option<String>,
}

impl Tally {
    fn add(&mut self, outcome: Result<(), String>) {
        self.rounds += 1;
        if let Err(what) = outcome {
            self.bad += 1;
            eprint_line(&format!("bad: {what}"));
            self.first_bad.get_or_insert(what);
        }
    }
}

/// What undisturbed runs gave.
struct Expected {
    outputs: Outputs,
    /// With the change.
    changed: Outputs,
    wall: Duration,
}

/// A folder in which stores are made and broken.
struct Lab {
    dir: PathBuf,
    program: PathBuf,
    seed: u64,
}

impl Lab {
    fn new(dir: &Path, seed: u64) -> Result<Self, CliError> {
        let dir = std::path::absolute(dir).unwrap_or_else(|_| dir.to_owned());
        if dir.exists() {
            return Err(CliError::usage(format!(
                "{} is there already; remove it or name another folder with --dir",
                dir.display()
            )));
        }
        files::write(&dir.join("pipeline.toml"), PIPELINE.as_bytes())?;
        files::write(&dir.join("photos/transforms.json"), ring().to_string().as_bytes())?;
        for at in 0..RING {
            let path = dir.join("photos").join(photo_name(at));
            files::write(&path, &picture(u64::from(at), SIZE, Shade::Full)?)?;
        }
        let program = std::env::current_exe().map_err(|error| CliError::failed(error.to_string()))?;
        Ok(Self { dir, program, seed })
    }

    fn remove(&self) {
        let _ = std::fs::remove_dir_all(&self.dir);
    }

    fn random(&self, what: u64, round: u64) -> u64 {
        random(self.seed, what << 32 | round)
    }

    fn store(&self, name: &str) -> PathBuf {
        self.dir.join(name)
    }

    /// Returns the command of a run on a store.
    fn run_command(&self, store: &Path, more: &[&str]) -> Command {
        let mut command = Command::new(&self.program);
        command
            .current_dir(&self.dir)
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::null());
        let name = store.file_name().unwrap_or_default().to_string_lossy();
        command
            .args(["run", "--device", "cpu", "--out"])
            .arg(format!("{name}-out"));
        command.arg("--store").arg(store).args(more);
        command
    }

    fn start(&self, store: &Path, more: &[&str]) -> Result<Child, CliError> {
        self.run_command(store, more)
            .spawn()
            .map_err(|error| CliError::failed(error.to_string()))
    }

    /// Runs to the end; the inner error says how it ended otherwise.
    fn finish(&self, store: &Path, more: &[&str]) -> Result<Result<(), String>, CliError> {
        let mut command = self.run_command(store, more);
        let output = command.stderr(Stdio::piped()).output();
        let output = output.map_err(|error| CliError::failed(error.to_string()))?;
        Ok(match output.status.success() {
            true => Ok(()),
            false => Err(format!("{}: {}", output.status, last_lines(&output.stderr))),
        })
    }

    /// Runs to the end and compares every digest.
    fn finish_equal(
        &self,
        store: &Path,
        more: &[&str],
        expected: &Outputs,
    ) -> Result<Result<(), String>, CliError> {
        Ok(match self.finish(store, more)? {
            Err(error) => Err(error),
            Ok(()) => self
                .outputs(store)
                .and_then(|outputs| differences(expected, &outputs)),
        })
    }

    /// Verifies all of a store.
    fn check(&self, store: &Path) -> Result<Result<(), String>, CliError> {
        let output = Command::new(&self.program)
            .current_dir(&self.dir)
            .args(["cache", "fsck", "--read-data", "--store"])
            .arg(store)
            .output()
            .map_err(|error| CliError::failed(error.to_string()))?;
        Ok(match output.status.success() {
            true => Ok(()),
            false => Err(format!("fsck: {}", last_lines(&output.stderr))),
        })
    }

    /// Returns the digests of the last run of a store.
    fn outputs(&self, store: &Path) -> Result<Outputs, String> {
        let output = Command::new(&self.program)
            .current_dir(&self.dir)
            .args(["status", "--json", "--store"])
            .arg(store)
            .output()
            .map_err(|error| error.to_string())?;
        let run: serde_json::Value =
            serde_json::from_slice(&output.stdout).map_err(|error| format!("status: {error}"))?;
        let mut outputs = Outputs::new();
        for node in run["nodes"].as_array().into_iter().flatten() {
            for (name, output) in node["outputs"].as_object().into_iter().flatten() {
                let node = node["name"].as_str().unwrap_or_default();
                let digest = output["digest"].as_str().unwrap_or_default();
                outputs.insert(format!("{node}:{name}"), digest.to_owned());
            }
        }
        Ok(outputs)
    }

    fn undisturbed(&self, cancel: &Cancel) -> Result<Expected, CliError> {
        let store = self.store("undisturbed");
        let began = Instant::now();
        let failed = |error: String| CliError::failed(format!("the undisturbed run: {error}"));
        self.finish(&store, &[])?.map_err(failed)?;
        let wall = began.elapsed();
        let outputs = self.outputs(&store).map_err(failed)?;
        if cancel.is_set() {
            return Err(CliError::Interrupted);
        }
        let other = self.store("undisturbed-changed");
        self.finish(&other, &CHANGE)?.map_err(failed)?;
        Ok(Expected {
            changed: self.outputs(&other).map_err(failed)?,
            outputs,
            wall,
        })
    }

    /// Kills runs at random moments until one comes to its end, again and again.
    fn kill(
        &self,
        rounds: u32,
        expected: &Expected,
        tally: &mut Tally,
        cancel: &Cancel,
    ) -> Result<String, CliError> {
        let mut stores = 0;
        while tally.rounds < rounds && !cancel.is_set() {
            stores += 1;
            let store = self.store(&format!("kill-{stores}"));
            let mut has_ended = false;
            while !has_ended && tally.rounds < rounds {
                let span = expected.wall.as_micros() as u64 / 3;
                let after = Duration::from_micros(self.random(1, u64::from(tally.rounds)) % span.max(1));
                let mut run = self.start(&store, &[])?;
                has_ended = ended_within(&mut run, after)?;
                if !has_ended {
                    let _ = run.kill();
                    let _ = run.wait();
                    tally.add(self.check(&store)?);
                }
            }
            let outcome = self.finish_equal(&store, &[], &expected.outputs)?;
            tally.add(outcome);
            tally.rounds -= 1; // the last run of a store is no kill
            let _ = std::fs::remove_dir_all(&store);
        }
        Ok(format!(
            "SIGKILL at random moments, {stores} stores, each verified after each kill and run to the end"
        ))
    }

    /// Asks runs to stop at random moments.
    fn interrupt(
        &self,
        rounds: u32,
        expected: &Expected,
        tally: &mut Tally,
        cancel: &Cancel,
    ) -> Result<String, CliError> {
        let store = self.store("interrupt");
        let mut longest = Duration::ZERO;
        while tally.rounds < rounds && !cancel.is_set() {
            let span = expected.wall.as_micros() as u64;
            let after = Duration::from_micros(self.random(2, u64::from(tally.rounds)) % span.max(1));
            let mut run = self.start(&store, &[])?;
            if ended_within(&mut run, after)? {
                let _ = std::fs::remove_dir_all(&store);
            }
            let asked = Instant::now();
            interrupt(&run);
            let status = run.wait().map_err(|error| CliError::failed(error.to_string()))?;
            let took = asked.elapsed();
            longest = longest.max(took);
            // Exit code 0 is that of a run that had just ended.
            tally.add(match (took <= STOP_LIMIT, status.code()) {
                (true, Some(0 | 130)) => Ok(()),
                (_, code) => Err(format!("after {after:?}: {took:?}, exit code {code:?}")),
            });
        }
        let outcome = self.finish_equal(&store, &[], &expected.outputs)?;
        tally.add(outcome);
        Ok(format!(
            "SIGINT at random moments; the longest stop took {:.2} s",
            longest.as_secs_f64()
        ))
    }

    /// Flips a bit of a file of the store, cuts it or empties it, then runs what reads most of it.
    fn damage(
        &self,
        rounds: u32,
        expected: &Expected,
        tally: &mut Tally,
        cancel: &Cancel,
    ) -> Result<String, CliError> {
        let whole = self.store("undisturbed");
        let all = files_of(&whole);
        let mut kinds = BTreeMap::<String, u32>::new();
        while tally.rounds < rounds && !cancel.is_set() && !all.is_empty() {
            let round = u64::from(tally.rounds);
            // Every file once before any twice.
            let file = &all[(self.seed + round) as usize % all.len()];
            let store = self.store("damage");
            let _ = std::fs::remove_dir_all(&store);
            copy(&whole, &store)?;
            let what = damage(&store.join(file), self.random(3, round))?;
            *kinds.entry(what.to_owned()).or_default() += 1;
            let outcome = self.finish_equal(&store, &CHANGE, &expected.changed)?;
            tally.add(outcome.map_err(|error| format!("{what} {}: {error}", file.display())));
        }
        let kinds: Vec<String> = kinds
            .iter()
            .map(|(what, count)| format!("{count} {what}"))
            .collect();
        Ok(format!("{}, {} files in the store", kinds.join(", "), all.len()))
    }

    /// Lets no file grow beyond a limit, which is what a full disk does to a write, then lifts it.
    fn full(
        &self,
        rounds: u32,
        expected: &Expected,
        tally: &mut Tally,
        cancel: &Cancel,
    ) -> Result<String, CliError> {
        let store = self.store("full");
        while tally.rounds < rounds && !cancel.is_set() {
            let _ = std::fs::remove_dir_all(&store);
            let blocks = 1 + self.random(4, u64::from(tally.rounds)) % 400;
            let run = self.run_command(&store, &[]);
            let mut limited = Command::new("sh");
            // The signal of the limit is ignored, so that the write fails as on a full disk.
            limited.args([
                "-c",
                "trap '' XFSZ; ulimit -f \"$1\"; shift; exec \"$@\"",
                "sh",
                &blocks.to_string(),
            ]);
            limited
                .arg(run.get_program())
                .args(run.get_args())
                .current_dir(&self.dir);
            let output = limited.stdin(Stdio::null()).output();
            let output = output.map_err(|error| CliError::failed(error.to_string()))?;
            let words = String::from_utf8_lossy(&output.stderr);
            let ended = match output.status.code() {
                Some(0) => Ok(()),
                Some(1) if words.contains("error:") => Ok(()),
                code => Err(format!(
                    "files of {blocks} blocks: exit code {code:?}: {}",
                    last_lines(&output.stderr)
                )),
            };
            let outcome = match ended {
                Ok(()) => self.finish_equal(&store, &[], &expected.outputs)?,
                bad => bad,
            };
            tally.add(outcome);
        }
        Ok("files limited to 1 to 400 blocks of 512 bytes, then without a limit".to_owned())
    }

    /// Eight runs at once on one new store.
    fn eight(
        &self,
        rounds: u32,
        expected: &Expected,
        tally: &mut Tally,
        cancel: &Cancel,
    ) -> Result<String, CliError> {
        let store = self.store("eight");
        for _ in 0..rounds.div_ceil(8) {
            if cancel.is_set() {
                break;
            }
            let _ = std::fs::remove_dir_all(&store);
            let runs: Result<Vec<Child>, CliError> =
                (0..8).map(|_| self.start(&store, &["--threads", "1"])).collect();
            for run in runs? {
                let outcome = wait(run)?;
                tally.add(outcome);
            }
            let outcome = self.finish_equal(&store, &[], &expected.outputs)?;
            tally.add(outcome.and(self.check(&store)?));
        }
        Ok("eight programs on one new store, then one more".to_owned())
    }

    /// Collects garbage, with no grace and nothing to keep, beside runs that come and go.
    fn collect(
        &self,
        rounds: u32,
        expected: &Expected,
        tally: &mut Tally,
        cancel: &Cancel,
    ) -> Result<String, CliError> {
        let store = self.store("collect");
        let mut collections = 0;
        while tally.rounds < rounds && !cancel.is_set() {
            let runs: Result<Vec<Child>, CliError> = (0..8)
                .map(|at| match at % 2 {
                    0 => self.start(&store, &["--threads", "1"]),
                    _ => self.start(&store, &["--threads", "1", CHANGE[0], CHANGE[1]]),
                })
                .collect();
            let mut runs = runs?;
            while !runs.is_empty() {
                collections += 1;
                let outcome = self.garbage(&store)?;
                tally.add(outcome);
                let mut left = Vec::new();
                for mut run in runs {
                    match run
                        .try_wait()
                        .map_err(|error| CliError::failed(error.to_string()))?
                    {
                        None => left.push(run),
                        Some(status) if status.success() => {}
                        Some(status) => tally.add(Err(format!("a run beside a collection: {status}"))),
                    }
                }
                runs = left;
            }
            let outcome = self.finish_equal(&store, &[], &expected.outputs)?;
            tally.add(outcome.and(self.check(&store)?));
        }
        Ok(format!(
            "eight runs of two pipelines, {collections} collections beside them"
        ))
    }

    fn garbage(&self, store: &Path) -> Result<Result<(), String>, CliError> {
        if !store.is_dir() {
            return Ok(Ok(()));
        }
        let output = Command::new(&self.program)
            .current_dir(&self.dir)
            .args(["cache", "gc", "--keep-last", "1", "--grace", "0s", "--store"])
            .arg(store)
            .output()
            .map_err(|error| CliError::failed(error.to_string()))?;
        Ok(match output.status.code() {
            Some(0 | 11) => Ok(()),
            code => Err(format!("gc: exit code {code:?}: {}", last_lines(&output.stderr))),
        })
    }

    /// Gives all files of the store times of 1970 and of 2099.
    fn clock(&self, expected: &Expected, tally: &mut Tally) -> Result<String, CliError> {
        let store = self.store("clock");
        copy(&self.store("undisturbed"), &store)?;
        for seconds in [0, 4_070_908_800] {
            let time = std::time::SystemTime::UNIX_EPOCH + Duration::from_secs(seconds);
            for file in files_of(&store) {
                let file = std::fs::File::open(store.join(file));
                let _ = file.and_then(|file| file.set_modified(time));
            }
            let outcome = self.finish_equal(&store, &[], &expected.outputs)?;
            tally.add(outcome.and_then(|()| self.ran_nothing(&store)));
        }
        Ok("files of 1970 and of 2099".to_owned())
    }

    fn ran_nothing(&self, store: &Path) -> Result<(), String> {
        let output = Command::new(&self.program)
            .current_dir(&self.dir)
            .args(["status", "--json", "--store"])
            .arg(store)
            .output()
            .map_err(|error| error.to_string())?;
        let run: serde_json::Value =
            serde_json::from_slice(&output.stdout).map_err(|error| error.to_string())?;
        let nodes = run["nodes"].as_array().into_iter().flatten();
        match nodes.filter(|node| node["state"] != "reused").count() {
            0 => Ok(()),
            ran => Err(format!("{ran} nodes ran again")),
        }
    }
}

fn photo_name(at: u32) -> String {
    format!("images/{at:02}.jpg")
}

/// Returns the cameras of the photos, in nerfstudio's form: on a circle, looking at its middle.
fn ring() -> serde_json::Value {
    let frame = |at: u32| {
        let angle = f64::from(at) / f64::from(RING) * std::f64::consts::TAU;
        let (sin, cos) = angle.sin_cos();
        // Columns: right, up, back, position.
        serde_json::json!({
            "file_path": photo_name(at),
            "transform_matrix": [
                [-sin, 0.0, cos, 3.0 * cos], [cos, 0.0, sin, 3.0 * sin], [0.0, 1.0, 0.0, 0.5], [0.0, 0.0, 0.0, 1.0],
            ],
        })
    };
    let (width, height) = SIZE;
    serde_json::json!({
        "camera_model": "OPENCV", "w": width, "h": height, "fl_x": 150.0, "fl_y": 150.0,
        "cx": f64::from(width) / 2.0, "cy": f64::from(height) / 2.0,
        "frames": (0..RING).map(frame).collect::<Vec<_>>(),
    })
}

/// Compares outputs; names the first that differs or is not there. A child whose record was lost is not told of when its
/// parent is reused, since nobody needs it.
fn differences(expected: &Outputs, found: &Outputs) -> Result<(), String> {
    for (name, digest) in expected {
        match found.get(name) {
            Some(other) if other != digest => return Err(format!("output {name} differs")),
            None if !name.contains('/') => return Err(format!("output {name} is not there")),
            _ => {}
        }
    }
    match found.keys().find(|name| !expected.contains_key(*name)) {
        Some(name) => Err(format!("output {name} is new")),
        None => Ok(()),
    }
}

/// Waits for a run until a time has gone; tells whether it has ended.
fn ended_within(run: &mut Child, after: Duration) -> Result<bool, CliError> {
    let began = Instant::now();
    loop {
        if run
            .try_wait()
            .map_err(|error| CliError::failed(error.to_string()))?
            .is_some()
        {
            return Ok(true);
        }
        if began.elapsed() >= after {
            return Ok(false);
        }
        std::thread::sleep(Duration::from_millis(1));
    }
}

fn wait(mut run: Child) -> Result<Result<(), String>, CliError> {
    let status = run.wait().map_err(|error| CliError::failed(error.to_string()))?;
    Ok(match status.code() {
        Some(0) => Ok(()),
        code => Err(format!("one of eight runs: exit code {code:?}")),
    })
}

/// Sends Ctrl-C.
fn interrupt(run: &Child) {
    let _ = Command::new("sh")
        .args(["-c", &format!("kill -INT {}", run.id())])
        .stderr(Stdio::null())
        .status();
}

fn last_lines(stderr: &[u8]) -> String {
    let text = String::from_utf8_lossy(stderr);
    let lines: Vec<&str> = text.lines().collect();
    lines[lines.len().saturating_sub(4)..].join(" | ")
}

/// Returns the files below a folder, sorted, by relative path.
fn files_of(dir: &Path) -> Vec<PathBuf> {
    let entries = walkdir::WalkDir::new(dir)
        .sort_by_file_name()
        .into_iter()
        .filter_map(Result::ok);
    let files = entries.filter(|entry| entry.file_type().is_file());
    files
        .filter_map(|file| Some(file.path().strip_prefix(dir).ok()?.to_owned()))
        .collect()
}

fn copy(from: &Path, to: &Path) -> Result<(), CliError> {
    let failed = |path: &Path| {
        let message = format!("cannot copy {}", path.display());
        move |error: std::io::Error| {
            CliError::Failed(Diagnostic {
                message,
                cause: Some(error.to_string()),
                hint: None,
            })
        }
    };
    for folder in ["cas", "packs", "runs", "tmp"] {
        std::fs::create_dir_all(to.join(folder)).map_err(failed(to))?;
    }
    for file in files_of(from) {
        let target = to.join(&file);
        if let Some(folder) = target.parent() {
            std::fs::create_dir_all(folder).map_err(failed(folder))?;
        }
        std::fs::copy(from.join(&file), &target).map_err(failed(&target))?;
    }
    Ok(())
}

/// Damages a file in one of three ways; returns which.
fn damage(path: &Path, random: u64) -> Result<&'static str, CliError> {
    let failed = |error: std::io::Error| CliError::failed(format!("{}: {error}", path.display()));
    let mut bytes = std::fs::read(path).map_err(failed)?;
    let at = random / 8;
    let what = match (random % 4, bytes.len() as u64) {
        (_, 0) => "an empty file left as it is",
        (0, len) => {
            bytes.truncate((at % len) as usize);
            "cut"
        }
        (1, _) => {
            bytes.clear();
            "emptied"
        }
        (_, len) => {
            bytes[(at % len) as usize] ^= 1 << (random % 8);
            "one bit flipped"
        }
    };
    std::fs::remove_file(path).map_err(failed)?;
    std::fs::write(path, bytes).map_err(failed)?;
    Ok(what)
}
