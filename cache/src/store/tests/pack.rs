//! The form of packs.

use super::{
    super::{
        files::Files,
        pack::{Entry, Kind, PackJoiner, Window, Writer, contents, open, seal},
    },
    *,
};

fn write(path: &Path, count: u8) -> Vec<Entry> {
    let files = Files::of_disk();
    let mut writer = Writer::new(&files, path);
    for value in 0..count {
        let blob = vec![value; usize::from(value) * 7];
        writer
            .add(Kind::Blob, &Digest::from_content(&blob), &blob)
            .unwrap();
        let key = Digest::from_content(&[value]);
        let record = seal(Kind::Record, &key, u32::from(value), b"{}");
        writer.add(Kind::Record, &key, &record).unwrap();
    }
    writer.finish().unwrap()
}

fn entries(path: &Path) -> Vec<Entry> {
    contents(&Files::of_disk(), path).unwrap().unwrap().entries
}

#[test]
fn a_pack_without_its_table_lists_the_same() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.pack");
    let written = write(&path, 40);
    assert_eq!(entries(&path), written);
    let bytes = fs::read(&path).unwrap();
    replace(&path, &bytes[..bytes.len() - 1]);
    assert_eq!(entries(&path), written);
}

/// Wherever the bit is, every entry that is listed and verified is one that was written.
#[test]
fn a_flipped_bit_anywhere_makes_no_entry_false() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.pack");
    let written = write(&path, 4);
    let good = fs::read(&path).unwrap();
    for bit in 0..good.len() * 8 {
        let mut bad = good.clone();
        bad[bit / 8] ^= 1 << (bit % 8);
        replace(&path, &bad);
        let files = Files::of_disk();
        let mut window = Window::new(&files, &path);
        for entry in entries(&path) {
            let payload = window.payload(&entry).unwrap();
            if open(entry.kind, &entry.id, payload).is_some() {
                assert!(written.contains(&entry), "bit {bit}: {entry:?}");
            }
        }
    }
}

#[test]
fn a_truncated_pack_keeps_its_whole_entries() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.pack");
    let written = write(&path, 9);
    let bytes = fs::read(&path).unwrap();
    for cut in 0..bytes.len() {
        replace(&path, &bytes[..cut]);
        let listed = entries(&path);
        assert!(listed.iter().all(|entry| written.contains(entry)), "cut {cut}");
    }
}

#[test]
fn joined_packs_hold_the_entries_of_both_moved_by_what_is_told() {
    let dir = tempfile::tempdir().unwrap();
    let files = Files::of_disk();
    let (a, b, c) = (
        dir.path().join("a.pack"),
        dir.path().join("b.pack"),
        dir.path().join("c.pack"),
    );
    let (first, second) = (write(&a, 3), write(&b, 5));
    let mut joined = PackJoiner::new(&files, &c);
    let mut moved = Vec::new();
    for path in [&a, &b] {
        let contents = contents(&files, path).unwrap().unwrap();
        moved.push(joined.append(&files, path, &contents).unwrap().unwrap());
    }
    let all = joined.finish().unwrap();
    assert_eq!(entries(&c), all);
    assert_eq!(moved[0], 0);
    assert_eq!(all[0], first[0]);
    assert_eq!(all[first.len()].offset, second[0].offset + moved[1]);
}
