//! Public programs that read our files, if they can be installed. A test that lacks one says so and is skipped.
#![allow(
    dead_code,
    clippy::print_stdout,
    reason = "each test file uses a part; a skipped test says so"
)]

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::{Mutex, PoisonError};

/// Returns the Python of an environment `target/NAME` after these installations (arguments of `pip install`). If it cannot be made,
/// prints the reason and returns `None`. `stamp` identifies the installations: if it has changed, all are made again.
pub fn python(name: &str, stamp: &str, installs: &[Vec<&str>]) -> Option<PathBuf> {
    let folder = target(name);
    let python = folder.join("bin/python");
    let make = || {
        let install = |packages: &Vec<&str>| {
            succeeds(
                &python,
                &[&["-m", "pip", "install", "--quiet"], &packages[..]].concat(),
            )
        };
        succeeds(Path::new("python3"), &["-m", "venv", folder.to_str().unwrap()])
            && installs.iter().all(install)
    };
    once(name, stamp, make).then_some(python)
}

/// Returns the folder of modules of Node with a package. If it cannot be made, prints the reason and returns
/// `None`.
pub fn node_modules(name: &str, package: &str) -> Option<PathBuf> {
    let folder = target(name);
    let make = || {
        std::fs::create_dir_all(&folder).unwrap();
        succeeds(
            Path::new("npm"),
            &[
                "install",
                "--silent",
                "--no-audit",
                "--no-fund",
                "--prefix",
                folder.to_str().unwrap(),
                package,
            ],
        )
    };
    once(name, package, make).then(|| folder.join("node_modules"))
}

/// Runs a program that must succeed and returns its JSON. If the program is missing, prints so and returns `None`.
pub fn json_of(command: &mut Command) -> Option<serde_json::Value> {
    let program = command.get_program().to_string_lossy().into_owned();
    let Ok(output) = command.output() else {
        println!("skipped: needs {program}");
        return None;
    };
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{program}: {errors}");
    Some(serde_json::from_slice(&output.stdout).unwrap())
}

fn target(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("target").join(name)
}

/// Makes an installation unless it is there: tests of one process run at the same time.
fn once(name: &str, stamp: &str, make: impl FnOnce() -> bool) -> bool {
    static ONE: Mutex<()> = Mutex::new(());
    let _one = ONE.lock().unwrap_or_else(PoisonError::into_inner);
    let installed = target(name).join("installed.txt");
    if std::fs::read_to_string(&installed).is_ok_and(|is| is == stamp) {
        return true;
    }
    if !make() {
        println!("skipped: {name} cannot be installed");
        return false;
    }
    std::fs::write(installed, stamp).unwrap();
    true
}

fn succeeds(program: &Path, args: &[&str]) -> bool {
    match Command::new(program).args(args).output() {
        Ok(output) if output.status.success() => true,
        Ok(output) => {
            let text = String::from_utf8_lossy(&output.stderr);
            println!("{}", text.lines().last().unwrap_or_default());
            false
        }
        Err(error) => {
            println!("{}: {error}", program.display());
            false
        }
    }
}
