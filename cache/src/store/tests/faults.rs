//! Every call to the file system fails once, and the machine crashes at every call.

use std::{io::ErrorKind, time::Duration};

use super::{
    super::files::Files,
    layer::{Faulty, Mishap},
    *,
};

/// Runs the session on files with a mishap. Returns the steps whose commits returned.
fn run_with(root: &Path, faulty: &Arc<Faulty>) -> Vec<u8> {
    let mut done = Vec::new();
    let files = Files::with_operations(Arc::clone(faulty) as Arc<dyn files::Operations>);
    if let Ok(store) = Store::open_on(root.join(".marf"), files, Notices::default()) {
        store.objects.index.set_patience(Duration::ZERO);
        let _ = session::run(&store, &mut done);
    }
    done
}

fn calls_of_a_session() -> usize {
    let dir = tempfile::tempdir().unwrap();
    let faulty = Faulty::new(usize::MAX, Mishap::Crash, &dir.path().join("removed"));
    assert_eq!(run_with(dir.path(), &faulty).len(), usize::from(session::STEPS));
    faulty.calls()
}

/// Every n, or every few of them. `MARF_FAULT_ROUNDS` raises the number.
fn chosen(calls: usize) -> impl Iterator<Item = usize> {
    let rounds = super::rounds(120);
    (0..calls).step_by(calls.div_ceil(rounds).max(1))
}

#[test]
fn whichever_call_fails_no_result_is_lost_or_false_and_the_session_can_be_repeated() {
    let calls = calls_of_a_session();
    for at in chosen(calls) {
        let kind = [ErrorKind::StorageFull, ErrorKind::Other][at % 2];
        let context = format!("call {at} of {calls} fails with {kind}");
        let dir = tempfile::tempdir().unwrap();
        let faulty = Faulty::new(at, Mishap::Fail(kind), &dir.path().join("removed"));
        let done = run_with(dir.path(), &faulty);
        let store = again_unsynced(&dir);
        session::check(&store, &done, &context);
        session::repeat(&store, &context);
    }
}

#[test]
fn wherever_it_crashes_unsynced_writes_take_no_committed_result_along() {
    let calls = calls_of_a_session();
    for at in chosen(calls) {
        let context = format!("crash at call {at} of {calls}");
        let dir = tempfile::tempdir().unwrap();
        let faulty = Faulty::new(at, Mishap::Crash, &dir.path().join("removed"));
        let done = run_with(dir.path(), &faulty);
        faulty.lose_unsynced();
        let index = dir.path().join(".marf/index.sqlite");
        // The index is as it was, lost, or half.
        match (at % 3, fs::read(&index)) {
            (1, Ok(_)) => fs::remove_file(&index).unwrap(),
            (2, Ok(bytes)) => fs::write(&index, &bytes[..bytes.len() / 2]).unwrap(),
            _ => {}
        }
        let store = again_unsynced(&dir);
        session::check(&store, &done, &context);
        session::repeat(&store, &context);
    }
}
