//! Indexes of packs that are whole and tell lies.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on should stop")]

mod common;

use std::time::Duration;

use common::{Quiet, World, run_in};
use marf_cache::{Digest, ReadShare};
use marf_remote::{FsckOptions, RemoteError};

/// Bytes before the entries, of an entry, and of the digest behind them.
const MAGIC: usize = 12;
const ENTRY: usize = 44;
const CHECKSUM: usize = 32;

/// Changes the entries of an index and seals it.
fn forged(index: &[u8], forge: impl Fn(usize, &mut [u8])) -> Vec<u8> {
    let mut bytes = index[..index.len() - CHECKSUM].to_vec();
    let entries = bytes[MAGIC..].chunks_exact_mut(ENTRY).enumerate();
    entries.for_each(|(number, entry)| forge(number, entry));
    let checksum = Digest::from_content(&bytes);
    bytes.extend_from_slice(checksum.as_bytes());
    bytes
}

fn add_to_offset(entry: &mut [u8], more: u64) {
    let offset = u64::from_le_bytes(entry[32..40].try_into().unwrap());
    entry[32..40].copy_from_slice(&(offset + more).to_le_bytes());
}

type Forge = fn(usize, &mut [u8]);

#[test]
fn an_index_that_lies_is_damage_and_nothing_of_it_is_stored() {
    let lies: [(&str, Forge); 6] = [
        ("other bytes", |_, entry| add_to_offset(entry, 1)),
        ("half of them beyond the end", |number, entry| {
            add_to_offset(entry, (number as u64 % 2) << 20);
        }),
        ("all far beyond the end", |_, entry| add_to_offset(entry, 1 << 60)),
        ("4 GB a blob", |_, entry| entry[40..].fill(0xff)),
        ("no bytes", |_, entry| entry[40..].fill(0)),
        ("blobs of other digests", |_, entry| entry[..32].rotate_left(1)),
    ];
    for (name, lie) in lies {
        let world = World::new();
        let (here, there) = (world.store("here"), world.store("there"));
        let run = run_in(&here);
        world.remote().push(&here, &run, &Quiet::default()).unwrap();
        let path = world.files("packs", ".idx")[0].clone();
        let index = std::fs::read(&path).unwrap();
        std::fs::write(&path, forged(&index, lie)).unwrap();
        let error = world.remote().pull(&there, &run, &Quiet::default()).unwrap_err();
        assert!(
            matches!(error, RemoteError::Damaged { .. } | RemoteError::Missing { .. }),
            "{name}: {error}"
        );
        for key in &run.keys {
            assert_eq!(there.record(key).unwrap(), None, "{name}");
        }
        let fetched = world
            .remote()
            .fetch(&there, &run.keys, Duration::from_secs(60), &Quiet::default());
        assert_eq!(
            fetched.unwrap().len(),
            1,
            "{name}: the run makes the results itself"
        );

        let repair = FsckOptions {
            read_data: ReadShare::ALL,
            repair: true,
        };
        let found = world.remote().fsck(repair, &Quiet::default()).unwrap();
        assert!(found.is_repaired, "{name}");
        world.remote().push(&here, &run, &Quiet::default()).unwrap();
        world.remote().pull(&there, &run, &Quiet::default()).unwrap();
        assert_eq!(
            there.closure(&run.keys, &run.blobs).unwrap().missing,
            vec![],
            "{name}"
        );
    }
}

#[test]
fn a_record_of_a_terabyte_is_refused_unread() {
    let world = World::new();
    let (here, there) = (world.store("here"), world.store("there"));
    let run = run_in(&here);
    world.remote().push(&here, &run, &Quiet::default()).unwrap();
    for path in world.files("records", "") {
        std::fs::File::options()
            .write(true)
            .open(path)
            .unwrap()
            .set_len(1 << 40)
            .unwrap();
    }
    let error = world.remote().pull(&there, &run, &Quiet::default()).unwrap_err();
    // A mebibyte is more than any record takes.
    assert!(
        error
            .to_string()
            .contains("it has 1099511627776 bytes, above the limit of "),
        "{error}"
    );
}
