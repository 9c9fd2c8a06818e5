//! Nodes as jobs of a batch system: a stub of Slurm that runs, delays and kills jobs.
#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "a test that cannot go on should stop; a skipped test says so"
)]
#![cfg(unix)]

#[path = "../common/mod.rs"]
mod common;
mod exec;
mod pbs;

use std::collections::BTreeMap;
use std::os::unix::fs::PermissionsExt as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::OnceLock;
use std::time::{Duration, Instant};

use common::{Ran, marf};
use serde_json::Value;

const PIPELINE: &str = r#"name = "cluster"
[archive.demo]
kind = "demo"
sols = "1"
width = 160
[node.extract]
archive = "demo"
[node.calibrate]
input = "extract"
method = "labels"
[node.train]
input = "calibrate"
steps = 16
scale = 4
device = "cpu"
field = { log2_table = 10, density_width = 16, color_width = 16, batch_samples = 1024, cone = 0.2, occupancy_resolution = 16 }
[node.bootstrap]
input = "calibrate"
training = "train"
b = 3
device = "cpu"
"#;

/// Runs a script when asked to, and kills the first jobs of each name, as many as the file `kills` says. With a file `lag` a job has the
/// shared store as of its submission, and its additions become visible `lag` seconds after its end, records first.
const SBATCH: &str = r#"#!/bin/bash
cd "$(dirname "$0")" || exit 1
script="${@: -1}"
[ -f refuse ] && { cat refuse >&2; exit 1; }
exec 9> lock; flock 9
id=$(( $(cat next 2> /dev/null || echo 100) + 1 )); echo $id > next
name=$(sed -n 's/^#SBATCH --job-name=//p' "$script"); log=$(sed -n 's/^#SBATCH --output=//p' "$script")
echo "$id $name $(sed -n 's/^#SBATCH --mem=//p' "$script")" >> history
mkdir -p jobs/$id; echo "$name" > jobs/$id/name
shared=""
if [ -f lag ]; then
  shared=$(sed -n 's#^exec .*--store file://\([^ ]*\) .*#\1#p' "$script"); cp -r "$shared" "$shared.node"
  sed "s#--store file://[^ ]*#&.node#" "$script" > "$script.node"; script=$script.node
fi
kill=no; [ "$(grep -c " $name " history)" -le "$(cat kills 2> /dev/null || echo 0)" ] && kill=yes
flock -u 9
setsid bash -c '
  sleep 0.2
  if [ '$kill' = yes ]; then echo "'$id' 9" >> ended
  else
    setsid bash "'"$script"'" >> "'"$log"'" 2>&1 & echo $! > jobs/'$id'/pid
    wait $!; echo "'$id' $?" >> ended
  fi
  rm -r jobs/'$id'
  shared="'"$shared"'"
  [ -n "$shared" ] && { sleep $(cat lag); cp -r "$shared.node/records" "$shared"; sleep 0.3; cp -r "$shared.node/." "$shared"; }
' 9>&- > /dev/null 2>&1 < /dev/null &
echo $id
"#;

const SQUEUE: &str = r#"#!/bin/bash
cd "$(dirname "$0")/jobs" 2> /dev/null || exit 0
for id in *; do [ -f $id/name ] && echo "$id|$(cat $id/name)|RUNNING|None"; done
exit 0
"#;

const SCANCEL: &str = r#"#!/bin/bash
cd "$(dirname "$0")"; echo $1 >> cancelled
kill -TERM -- -$(cat jobs/$1/pid 2> /dev/null) 2> /dev/null
exit 0
"#;

const SCONTROL: &str = r#"#!/bin/bash
echo "JobId=${@: -1} JobState=OUT_OF_MEMORY Reason=OutOfMemory ExitCode=0:125"
"#;

/// Returns a folder with a store in which the photos are drawn and the cameras known, made once.
fn calibrated() -> &'static Path {
    static FOLDER: OnceLock<tempfile::TempDir> = OnceLock::new();
    let made = FOLDER.get_or_init(|| {
        let dir = tempfile::tempdir().unwrap();
        std::fs::write(dir.path().join("pipeline.toml"), PIPELINE).unwrap();
        marf(dir.path(), &["run", "--to", "calibrate"]).exits(0);
        dir
    });
    made.path()
}

/// A folder with the pipeline, its cameras, a site file and a stub of Slurm.
struct Site {
    dir: tempfile::TempDir,
}

impl Site {
    fn new(pipeline: &str) -> Self {
        let site = Self {
            dir: tempfile::tempdir().unwrap(),
        };
        std::fs::create_dir(site.stub()).unwrap();
        for (name, script) in [
            ("sbatch", SBATCH),
            ("squeue", SQUEUE),
            ("scancel", SCANCEL),
            ("scontrol", SCONTROL),
        ] {
            let path = site.stub().join(name);
            std::fs::write(&path, script).unwrap();
            std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o755)).unwrap();
        }
        let path = |name: &str| site.dir.path().join(name).display().to_string();
        let (store, jobs, stub) = (path("shared"), path("jobs"), site.stub().display().to_string());
        let text = format!(
            "[executor]\nstore = \"file://{store}\"\nfolder = \"{jobs}\"\npoll_s = 0.1\npatience_s = 1.0\ncores = 1\n\
             memory_mb = 700\n\
             [executor.commands]\nsubmit = [\"{stub}/sbatch\", \"--parsable\", \"{{script}}\"]\nlist = [\"{stub}/squeue\"]\n\
             cancel = [\"{stub}/scancel\", \"{{id}}\"]\nexplain = [\"{stub}/scontrol\", \"{{id}}\"]\n"
        );
        std::fs::write(site.dir.path().join("site.toml"), text).unwrap();
        let copied = Command::new("cp")
            .arg("-r")
            .args([&calibrated().join(".marf"), site.path()])
            .status();
        assert!(copied.unwrap().success());
        std::fs::write(site.dir.path().join("pipeline.toml"), pipeline).unwrap();
        site
    }

    fn path(&self) -> &Path {
        self.dir.path()
    }

    fn stub(&self) -> PathBuf {
        self.path().join("stub")
    }

    fn tell(&self, file: &str, text: &str) {
        std::fs::write(self.stub().join(file), text).unwrap();
    }

    /// What the stub has noted, a line a job.
    fn noted(&self, file: &str) -> Vec<String> {
        let text = std::fs::read_to_string(self.stub().join(file)).unwrap_or_default();
        text.lines().map(str::to_owned).collect()
    }

    fn run(&self, more: &[&str]) -> Ran {
        marf(self.path(), &[&["run", "--on", "slurm"], more].concat())
    }
}

/// The digests of all outputs of the last run, by node.
fn outputs(folder: &Path) -> BTreeMap<String, Value> {
    let status = marf(folder, &["status", "--json"]).exits(0).stdout;
    let status: Value = serde_json::from_str(&status).unwrap();
    let nodes = status["nodes"].as_array().unwrap().iter();
    nodes
        .map(|node| (node["name"].as_str().unwrap().to_owned(), node["outputs"].clone()))
        .collect()
}

/// Trainings and members are jobs, the rest runs here. Killed jobs are made again, with twice the memory if there was too little. Every
/// output is that of a run on one machine.
#[test]
fn a_run_on_a_batch_system_that_kills_jobs_gives_the_digests_of_a_local_run() {
    let site = Site::new(PIPELINE);
    site.tell("kills", "1");
    let ran = site.run(&[]).exits(0);
    let jobs = site.noted("history");
    // The training and three members, each twice.
    assert_eq!(jobs.len(), 8, "{jobs:?}");
    let memory = |line: &String| line.rsplit(' ').next().unwrap().to_owned();
    assert_eq!(
        (memory(&jobs[0]), memory(&jobs[1])),
        ("700M".to_owned(), "1400M".to_owned())
    );
    assert!(
        ran.stderr.contains(" ended without a result (")
            && ran.stderr.contains(") and is submitted with 1.4 GB"),
        "{}",
        ran.stderr
    );
    let left: Vec<_> = std::fs::read_dir(site.path().join("jobs")).unwrap().collect();
    assert!(left.is_empty(), "{left:?}");

    let local = tempfile::tempdir().unwrap();
    std::fs::write(local.path().join("pipeline.toml"), PIPELINE).unwrap();
    marf(local.path(), &["run"]).exits(0);
    assert_eq!(outputs(site.path()), outputs(local.path()));

    let again = site.run(&[]).exits(0);
    assert!(again.stdout.contains("0 of 4 nodes ran"), "{}", again.stdout);
    assert_eq!(site.noted("history").len(), 8);
}

/// What a batch system says against a job, a job that is lost too often, and a shared store with a result of it already.
#[test]
fn a_job_that_is_refused_or_lost_is_one_clear_error_and_what_is_done_stays() {
    let site = Site::new(PIPELINE);
    let error = "sbatch: error: Batch job submission failed: Requested node configuration is not available";
    site.tell("refuse", error);
    let refused = site.run(&["--to", "train"]).exits(1);
    assert!(
        refused
            .stderr
            .contains("the batch system takes no job for `train`"),
        "{}",
        refused.stderr
    );
    assert!(
        refused.stderr.contains("Requested node configuration"),
        "{}",
        refused.stderr
    );
    std::fs::remove_file(site.stub().join("refuse")).unwrap();

    site.tell("kills", "99");
    let lost = site.run(&["--to", "train"]).exits(1);
    assert!(
        lost.stderr.contains("3 jobs ended without a result"),
        "{}",
        lost.stderr
    );
    assert!(lost.stderr.contains("JobState=OUT_OF_MEMORY"), "{}", lost.stderr);
    assert!(lost.stderr.contains("memory_mb"), "{}", lost.stderr);
    assert!(
        marf(site.path(), &["status"])
            .exits(0)
            .stdout
            .contains("calibrate")
    );

    site.tell("kills", "0");
    site.run(&["--to", "train"]).exits(0);
    let jobs = site.noted("history").len();
    // Another folder with an empty store: the result is in the shared store, and no job is made.
    std::fs::remove_dir_all(site.path().join(".marf")).unwrap();
    site.run(&["--to", "train"]).exits(0);
    assert_eq!(site.noted("history").len(), jobs);
}

/// A file system of many machines that shows what jobs wrote after their end, and records before what they name.
#[test]
fn results_that_a_shared_folder_shows_late_are_waited_for() {
    let site = Site::new(PIPELINE);
    site.tell("lag", "0.4");
    site.run(&["--to", "train"]).exits(0);
    assert_eq!(site.noted("history").len(), 1);

    let never = Site::new(PIPELINE);
    never.tell("lag", "20");
    let refused = never.run(&["--to", "train"]).exits(1).stderr;
    assert!(
        refused.contains("after 1 s the shared store lacks its result"),
        "{refused}"
    );
    assert!(refused.contains("the same place on all machines"), "{refused}");
}

/// A driver that is killed leaves its jobs. The next one takes them over, and no job is made twice.
#[test]
fn a_run_that_is_killed_leaves_jobs_that_the_next_one_takes_over() {
    let slow = PIPELINE.replace("steps = 16", "steps = 400");
    let site = Site::new(&slow);
    let mut driver = Command::new(env!("CARGO_BIN_EXE_marf"))
        .current_dir(site.path())
        .args(["run", "--on", "slurm", "--to", "train"])
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let began = Instant::now();
    while site.noted("history").is_empty() {
        assert!(began.elapsed() < Duration::from_secs(120), "no job came");
        std::thread::sleep(Duration::from_millis(50));
    }
    driver.kill().unwrap();
    driver.wait().unwrap();
    let ran = site.run(&["--to", "train"]).exits(0);
    assert_eq!(site.noted("history").len(), 1, "{}", ran.stderr);
    assert_eq!(site.noted("cancelled"), [] as [&str; 0]);
}

/// The driver has no GPU that it would take by itself, and the jobs have one: a small job reports its backend, which is in the key of
/// the training, and the answer is kept. A job that meets another backend is refused, and the answer is forgotten.
#[test]
fn the_backend_of_a_training_is_that_of_the_machine_that_trains() {
    let site = Site::new(
        &PIPELINE
            .replace("device = \"cpu\"\n", "")
            .replace("steps = 16", "steps = 4"),
    );
    let jobs = site.path().join("jobs");
    let kept = || -> Vec<PathBuf> {
        let files = std::fs::read_dir(&jobs).unwrap().map(|file| file.unwrap().path());
        files
            .filter(|path| path.extension().is_some_and(|end| end == "backend"))
            .collect()
    };
    let text = std::fs::read_to_string(site.path().join("site.toml")).unwrap();
    let adapter = std::env::var("MARF_TEST_GPU").unwrap_or("llvmpipe".to_owned());
    let on_gpu = |name: &str| {
        let lines = format!("[executor]\ndevice = \"gpu:{name}\"\ngpu_options = []");
        std::fs::write(site.path().join("site.toml"), text.replace("[executor]", &lines)).unwrap();
    };
    on_gpu("no such card");
    let absent = site.run(&["--to", "train"]).exits(1);
    assert!(
        absent.stderr.contains("no GPU whose name holds `no such card`"),
        "{}",
        absent.stderr
    );
    assert_eq!(kept(), [] as [PathBuf; 0]);
    if absent.stderr.contains("found none") {
        println!("skipped: needs an adapter");
        return;
    }
    on_gpu(&adapter);
    let before = site.noted("history").len();
    site.run(&["--to", "train"]).exits(0);
    assert_eq!(
        site.noted("history").len(),
        before + 2,
        "the question and the training"
    );
    let [answer] = kept().try_into().unwrap();
    let told: Value = serde_json::from_slice(&std::fs::read(&answer).unwrap()).unwrap();
    let backend = told["backend"].as_str().unwrap();
    assert!(backend.contains(&adapter), "{backend}");
    let own = marf_cache::Store::open(site.path().join(".marf")).unwrap();
    let made = marf(site.path(), &["status", "--json"]).exits(0).stdout;
    let made: Value = serde_json::from_str(&made).unwrap();
    let train = made["nodes"]
        .as_array()
        .unwrap()
        .iter()
        .find(|node| node["name"] == "train")
        .unwrap();
    let key: marf_cache::Digest = train["key"].as_str().unwrap().parse().unwrap();
    let action = marf_cache::Action::decode(&own.get(&key).unwrap()).unwrap();
    assert_eq!(action.backend.as_deref(), Some(backend));

    let other = std::fs::read_to_string(&answer)
        .unwrap()
        .replace(backend, "another card, driver 1");
    std::fs::write(&answer, other).unwrap();
    let refused = site.run(&["--to", "train"]).exits(1);
    assert!(
        refused
            .stderr
            .contains("stage `train` on another card, driver 1, and here is"),
        "{}",
        refused.stderr
    );
    assert_eq!(kept(), [] as [PathBuf; 0]);
}

#[test]
fn a_site_file_that_is_not_there_or_is_none_is_a_usage_error() {
    let site = Site::new(PIPELINE);
    std::fs::write(
        site.path().join("bad.toml"),
        "[executor]\nstore = \"file:///s\"\nfolder = \"f\"\n",
    )
    .unwrap();
    for (file, expected) in [
        ("absent.toml", "absent.toml: "),
        ("bad.toml", "executor.folder: "),
    ] {
        let ran = site.run(&["--site", file]).exits(2);
        assert!(ran.stderr.contains(expected), "{}", ran.stderr);
    }
}

#[test]
fn a_machine_without_the_batch_system_says_so_before_anything_runs() {
    let site = Site::new(PIPELINE);
    std::fs::remove_file(site.stub().join("squeue")).unwrap();
    let ran = site.run(&[]).exits(1);
    assert!(
        ran.stderr
            .contains("the batch system does not answer: there is no program"),
        "{}",
        ran.stderr
    );
    assert!(!ran.stderr.contains("extract"), "{}", ran.stderr);
}
