//! Processes that are killed.

use std::{
    io::{BufRead, BufReader},
    process::{Command, Stdio},
};

use super::*;

const FOLDER: &str = "MARF_TEST_STORE";

/// The child of the test below: uses a store until it is killed, and says what it has committed.
#[test]
fn a_child_that_is_killed() {
    let Some(root) = std::env::var_os(FOLDER) else {
        return;
    };
    let store = Store::open(root).unwrap();
    for round in 0_u32.. {
        let record = record(&format!("{} {round}", std::process::id()), &store, &[7; 900]);
        store.put(&large(round as u8)).unwrap();
        store.put_record(record.clone());
        store.commit().unwrap();
        println!("committed {}", record.key);
        if round % 5 == 4 {
            store
                .gc(&GcPlan {
                    always: Roots {
                        keys: vec![record.key],
                        blobs: Vec::new(),
                    },
                    grace: std::time::Duration::from_secs(3600),
                    ..GcPlan::default()
                })
                .unwrap();
        }
    }
}

/// Each child is killed at another moment: after a number of lines of its output, which come in bursts.
#[test]
fn a_killed_process_loses_nothing_that_it_committed() {
    let dir = tempfile::tempdir().unwrap();
    let root = dir.path().join(".marf");
    let mut committed = Vec::new();
    for round in 0..super::rounds(12) {
        let mut child = Command::new(std::env::current_exe().unwrap())
            .args([
                "--exact",
                "store::tests::processes::a_child_that_is_killed",
                "--nocapture",
            ])
            .env(FOLDER, &root)
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let lines = BufReader::new(child.stdout.take().unwrap()).lines();
        let keys = lines
            .map_while(Result::ok)
            .filter_map(|line| Some(line.split_once("committed ")?.1.parse::<Digest>().unwrap()));
        for (number, key) in keys.enumerate() {
            committed.push(key);
            if number == round % 17 {
                child.kill().unwrap();
            }
        }
        child.wait().unwrap();
        let store = Store::open(&root).unwrap();
        for key in &committed {
            let record = store.hit(key).unwrap();
            let record = record.unwrap_or_else(|| panic!("round {round}: {key} is lost"));
            assert_eq!(&*store.get(&record.outputs["photos"].digest).unwrap(), &[7; 900]);
        }
    }
    assert!(!committed.is_empty());
    let store = Store::open(&root).unwrap();
    let options = FsckOptions {
        read_data: ReadShare::ALL,
        repair: false,
    };
    assert_eq!(store.fsck(options).unwrap().faults, vec![]);
}
