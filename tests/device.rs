//! `--device`: what runs where, what the key and the record hold, and what a device that is not there gets.
#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "a test that cannot go on should stop; a skipped test says so"
)]

mod common;

use std::path::Path;

use common::{marf, photos};

/// The software adapter that is tested with: `$MARF_TEST_GPU`, which must then be there, or Mesa's.
fn adapter(folder: &Path) -> Option<String> {
    let asked = std::env::var("MARF_TEST_GPU").ok();
    let name = format!("gpu:{}", asked.as_deref().unwrap_or("llvmpipe"));
    std::fs::write(folder.join("pipeline.toml"), PIPELINE).unwrap();
    let ran = marf(folder, &["run", "--device", &name, "--store", "probe"]);
    if ran.code == 0 {
        return Some(name);
    }
    assert!(asked.is_none(), "{name}: {}", ran.stderr);
    println!("skipped: needs a software adapter (mesa-vulkan-drivers)");
    None
}

const PIPELINE: &str = r#"
name = "device"
[archive.photos]
kind = "folder"
path = "photos"
[node.extract]
archive = "photos"
[node.calibrate]
input = "extract"
cameras = "extract"
method = "import"
[node.train]
input = "calibrate"
steps = 20
[node.train.field]
log2_table = 10
density_width = 16
color_width = 16
batch_samples = 1024
cone = 0.2
occupancy_resolution = 16
"#;

fn field<'a>(event: &'a serde_json::Value, key: &str) -> &'a str {
    event[key].as_str().unwrap_or_default()
}

#[test]
fn the_adapter_stands_in_the_log_and_in_the_key_and_two_stores_get_the_same_bytes() {
    let dir = photos();
    let Some(device) = adapter(dir.path()) else {
        return;
    };
    let on = |device: &str, store: &str| {
        let words = ["run", "--device", device, "--store", store, "--json"];
        marf(dir.path(), &words).exits(0)
    };
    let weights = |ran: &common::Ran| {
        let events = ran.events();
        let done = events
            .iter()
            .find(|event| event["event"] == "finished" && event["node"] == "train");
        done.map(|event| event["outputs"]["weights"]["digest"].clone())
    };
    let cpu = on("cpu", "one");
    let gpu = on(&device, "one");
    let started = gpu.events();
    let started = started.iter().find(|event| event["event"] == "will_run").unwrap();
    assert_eq!(field(started, "node"), "train", "only the training runs anew");
    assert!(field(started, "device").contains("wgpu"), "{started}");
    assert!(
        field(started, "reason").contains("backend: absent ->"),
        "{started}"
    );
    assert_ne!(weights(&cpu), weights(&gpu));
    let again = on(&device, "two");
    assert_eq!(weights(&again), weights(&gpu), "two stores");
    let back = on("cpu", "one");
    assert_eq!(weights(&back), None, "the CPU's result is still there");

    let ran = marf(dir.path(), &["run", "--device", &device, "--store", "one"]).exits(0);
    let first = ran.stderr.lines().find(|line| line.starts_with("device"));
    assert!(first.is_some_and(|line| line.contains("wgpu")), "{}", ran.stderr);
}

#[test]
fn a_device_that_is_not_there_is_one_error_with_a_way_out() {
    let dir = photos();
    std::fs::write(dir.path().join("pipeline.toml"), PIPELINE).unwrap();
    let ran = marf(dir.path(), &["run", "--device", "gpu:no such card"]).exits(1);
    let errors = ran.stderr.lines().filter(|line| line.starts_with("error: "));
    let errors: Vec<&str> = errors.filter(|line| line.contains("train")).collect();
    assert_eq!(errors.len(), 1, "{}", ran.stderr);
    assert!(
        errors[0].contains("no such card") && errors[0].contains("cpu"),
        "{errors:?}"
    );
    let ran = marf(dir.path(), &["run", "--device", "cuda"]).exits(2);
    assert!(
        ran.stderr.contains("use `auto`, `cpu`, `gpu` or `gpu:NAME`"),
        "{}",
        ran.stderr
    );
    let ran = marf(dir.path(), &["run", "--set", "train.device=cuda"]).exits(2);
    assert!(
        ran.stderr.contains("use `auto`, `cpu`, `gpu` or `gpu:NAME`"),
        "{}",
        ran.stderr
    );
}

#[test]
fn a_nodes_own_device_wins_over_the_command_line() {
    let dir = photos();
    let own = PIPELINE.replace("steps = 20", "steps = 2\ndevice = \"cpu\"");
    std::fs::write(dir.path().join("pipeline.toml"), own).unwrap();
    let ran = marf(dir.path(), &["run", "--device", "gpu:no such card", "--json"]).exits(0);
    let events = ran.events();
    let train = events
        .iter()
        .find(|event| event["event"] == "will_run" && event["node"] == "train");
    assert_eq!(field(train.unwrap(), "device"), "cpu");
}

#[test]
fn libraries_print_nothing_where_there_is_no_window_system() {
    let dir = tempfile::tempdir().unwrap();
    marf(dir.path(), &["init"]).exits(0);
    let planned = std::process::Command::new(env!("CARGO_BIN_EXE_marf"))
        .current_dir(dir.path())
        .arg("plan")
        .env_remove("XDG_RUNTIME_DIR")
        .output()
        .unwrap();
    let stderr = String::from_utf8_lossy(&planned.stderr);
    assert!(
        planned.status.success() && !stderr.contains("XDG_RUNTIME_DIR"),
        "{stderr}"
    );
}
