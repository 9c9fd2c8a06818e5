//! Merges: many small packs become few large ones.
//!
//! Packs are in tiers by their bytes, each eight times the one below. A tier that has eight packs is joined into one
//! pack, which belongs to the next tier. An object is written at most once a tier, and there are at most seven packs a
//! tier at rest. Packs of 32 MiB and more stay as they are.
//!
//! The new pack is durable before the index knows it, and the index knows it before the old packs are removed. A
//! reader that finds a pack gone asks the index again.

use super::{
    error::StoreError,
    files::Access,
    locks::{Guard, Lock, Share},
    objects::Objects,
    pack::{self, Contents, PackJoiner},
};

/// Packs of a tier that are joined.
const WIDTH: usize = 8;
/// Bytes of the largest pack of the lowest tier.
const SMALLEST: u64 = 64 << 10;
/// Packs from this length on are not joined.
const LARGEST: u64 = 32 << 20;

/// Returns the tier of a pack, or `None` if it stays as it is.
fn tier(bytes: u64) -> Option<u32> {
    if bytes >= LARGEST {
        return None;
    }
    let mut tier = 0;
    let mut limit = SMALLEST;
    while bytes > limit {
        limit *= WIDTH as u64;
        tier += 1;
    }
    Some(tier)
}

/// Joins packs until no tier has too many. Does nothing while another process does so.
pub(super) fn merge(objects: &Objects) -> Result<(), StoreError> {
    if objects.access == Access::ReadOnly {
        return Ok(());
    }
    while let Some(files) = candidates(objects)? {
        let Some(guard) = objects.locks.try_take(Lock::Rewrite, Share::Exclusive)? else {
            return Ok(());
        };
        if objects.notices.is_interrupted() || !join(objects, &guard, &files)? {
            return Ok(());
        }
    }
    Ok(())
}

/// Returns the packs of the lowest tier that has too many.
fn candidates(objects: &Objects) -> Result<Option<Vec<String>>, StoreError> {
    let mut tiers: Vec<Vec<String>> = Vec::new();
    for file in objects.index.listed()? {
        let path = objects.pack_path(&file);
        let bytes = objects.files.meta(&path).map(|meta| meta.bytes);
        let Some(tier) = bytes.and_then(tier) else {
            continue;
        };
        tiers.resize_with(tiers.len().max(tier as usize + 1), Vec::new);
        if let Some(files) = tiers.get_mut(tier as usize) {
            files.push(file);
        }
    }
    Ok(tiers.into_iter().find(|files| files.len() >= WIDTH))
}

/// Joins packs into one. Returns whether the index took it.
fn join(objects: &Objects, _rewriting: &Guard, files: &[String]) -> Result<bool, StoreError> {
    let staging = objects.staging()?;
    let name = format!("{}.pack", staging.next_name());
    let temporary = staging.path(&name);
    let mut joined = PackJoiner::new(&objects.files, &temporary);
    let mut moved = Vec::new();
    let mut newest = None;
    for file in files {
        let path = objects.pack_path(file);
        let Some(contents) = whole(objects, file)? else {
            continue;
        };
        if let Some(by) = joined.append(&objects.files, &path, &contents)? {
            newest = newest.max(objects.files.meta(&path).map(|meta| meta.modified));
            moved.push((file.clone(), by));
        }
    }
    if moved.len() < 2 {
        objects.files.remove_file(&temporary)?;
        return Ok(false);
    }
    joined.finish()?;
    objects.publish_pack(&temporary, &name)?;
    if let Some(newest) = newest {
        // The age of a pack is that of its youngest object.
        objects.files.set_modified(&objects.pack_path(&name), newest);
    }
    if !objects.index.join(&name, &moved)? {
        objects.files.remove_file(&objects.pack_path(&name))?;
        return Ok(false);
    }
    for (file, _) in &moved {
        objects.files.remove_file(&objects.pack_path(file))?;
    }
    Ok(true)
}

/// Returns the entries of a pack that can be joined: it has its table.
fn whole(objects: &Objects, file: &str) -> Result<Option<Contents>, StoreError> {
    let contents = pack::contents(&objects.files, &objects.pack_path(file))?;
    Ok(contents.filter(|contents| contents.has_table))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tier_is_eight_times_the_one_below() {
        assert_eq!([0, 1, SMALLEST].map(tier), [Some(0); 3]);
        assert_eq!([SMALLEST + 1, SMALLEST * 8].map(tier), [Some(1); 2]);
        assert_eq!(tier(SMALLEST * 8 + 1), Some(2));
        assert_eq!([LARGEST - 1, LARGEST, u64::MAX].map(tier), [Some(3), None, None]);
    }
}
