//! A scripted use of a store that passes through all its parts, and a check of the resulting store.

use std::time::Duration;

use super::*;

/// Steps of the session. From eight commits on packs are merged.
pub(super) const STEPS: u8 = 10;

/// The objects that a step stores: its record, the output, and the memo with its blob.
pub(super) struct Step {
    pub(super) action: Action,
    pub(super) output: Vec<u8>,
    pub(super) large: Option<Vec<u8>>,
    pub(super) memo: Digest,
    pub(super) memo_blob: Vec<u8>,
}

pub(super) fn step(number: u8) -> Step {
    let name = format!("step {number}");
    Step {
        action: action("blur", &name, &[]),
        output: [number].repeat(300 + usize::from(number)),
        large: (number % 4 == 1).then(|| [number, 1].repeat(40_000)),
        memo: Digest::from_content(name.as_bytes()),
        memo_blob: format!("memo of {name}").into_bytes(),
    }
}

impl Step {
    pub(super) fn record(&self) -> Record {
        let mut record = record_of(
            &self.action,
            Digest::from_content(&self.output),
            self.output.len() as u64,
        );
        if let Some(large) = &self.large {
            let output = Output {
                digest: Digest::from_content(large),
                bytes: large.len() as u64,
            };
            record.outputs.insert("large".to_owned(), output);
        }
        record
    }

    fn run(&self, store: &Store) -> Result<(), StoreError> {
        store.put(&self.action.encode())?;
        store.put(&self.output)?;
        self.large.as_ref().map(|large| store.put(large)).transpose()?;
        store.put_record(self.record());
        let memo = store.put(&self.memo_blob)?;
        store.put_memo(self.memo, memo, self.action.key());
        // Writes that a full disk refused stay pending, and the next commit writes them.
        store.commit().or_else(|_| store.commit())
    }
}

/// Runs the session. Adds the number of each step to `done` when its commit has returned.
pub(super) fn run(store: &Store, done: &mut Vec<u8>) -> Result<(), StoreError> {
    let mut keys = Vec::new();
    for number in 0..STEPS {
        let step = step(number);
        keys.push(step.action.key());
        if store.hit(&step.action.key())?.is_none() {
            step.run(store)?;
        }
        done.push(number);
        if number % 3 == 2 {
            store.put_run(format!("{{\"step\":{number}}}").as_bytes())?;
        }
    }
    store.put(b"nobody needs this")?;
    store.commit()?;
    let plan = GcPlan {
        always: Roots {
            keys,
            blobs: Vec::new(),
        },
        grace: Duration::ZERO,
        ..GcPlan::default()
    };
    store.gc(&plan)?;
    Ok(())
}

/// Checks that every existing object is correct, and that the finished steps are in the store.
pub(super) fn check(store: &Store, done: &[u8], context: &str) {
    for number in 0..STEPS {
        let step = step(number);
        match store.hit(&step.action.key()).unwrap() {
            Some(record) => assert_eq!(record, step.record(), "{context}: step {number}"),
            None => assert!(!done.contains(&number), "{context}: step {number} is lost"),
        }
        if let Some(record) = store.hit(&step.action.key()).unwrap() {
            for output in record.outputs.values() {
                let bytes = store.get(&output.digest).unwrap();
                assert_eq!(Digest::from_content(&bytes), output.digest, "{context}");
            }
        }
        if let Some(blob) = store.memo(&step.memo).unwrap() {
            assert_eq!(
                &*store.get(&blob).unwrap(),
                step.memo_blob.as_slice(),
                "{context}"
            );
        }
    }
    for number in store.run_numbers().unwrap() {
        if let Ok(root) = store.run(number) {
            let text = String::from_utf8(root).unwrap();
            assert!(
                text.starts_with("{\"step\":") && text.ends_with('}'),
                "{context}: {text}"
            );
        }
    }
}

/// Runs the session again and checks that everything is there.
pub(super) fn repeat(store: &Store, context: &str) {
    let mut done = Vec::new();
    if let Err(error) = run(store, &mut done) {
        panic!("{context}: {error}");
    }
    assert_eq!(done.len(), usize::from(STEPS));
    check(store, &done, context);
}
