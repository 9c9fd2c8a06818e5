//! Packs: many small blobs in one file, with a sorted index beside it.
//!
//! Pack = `marf-pack-1\n`, then for each blob its digest (32 bytes), its length (u32 LE), its bytes.
//! Index = `marf-pidx-1\n`, then for each blob in the order of digests: digest, offset of its bytes (u64 LE),
//! length (u32 LE); last the blake3 of all that. Without a valid index the entries are scanned from the pack.

use std::{
    collections::BTreeMap,
    fs::{self, File},
    io::{self, Read, Seek, SeekFrom},
    path::Path,
    sync::Arc,
};

use super::{error::StoreError, files};
use crate::Digest;

const PACK_MAGIC: &[u8; 12] = b"marf-pack-1\n";
const INDEX_MAGIC: &[u8; 12] = b"marf-pidx-1\n";
const DIGEST: usize = 32;
const HEAD: usize = DIGEST + 4;
const INDEX_ROW: usize = DIGEST + 8 + 4;

/// A blob of a pack: its digest, and offset and length of its bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Entry {
    pub(super) digest: Digest,
    pub(super) offset: u64,
    pub(super) len: u32,
}

/// Writes a pack and its index under temporary names.
pub(super) fn write(
    pack: &Path,
    index: &Path,
    blobs: &BTreeMap<Digest, Arc<[u8]>>,
) -> Result<Vec<Entry>, StoreError> {
    let mut bytes = PACK_MAGIC.to_vec();
    let mut entries = Vec::with_capacity(blobs.len());
    for (digest, blob) in blobs {
        // Blobs of a pack are shorter than 64 KiB.
        let len = blob.len() as u32;
        bytes.extend_from_slice(digest.as_bytes());
        bytes.extend_from_slice(&len.to_le_bytes());
        entries.push(Entry {
            digest: *digest,
            offset: bytes.len() as u64,
            len,
        });
        bytes.extend_from_slice(blob);
    }
    files::write_new(pack, &[&bytes])?;
    files::write_new(index, &[&encode(&entries)])?;
    Ok(entries)
}

fn encode(entries: &[Entry]) -> Vec<u8> {
    let mut bytes = INDEX_MAGIC.to_vec();
    for entry in entries {
        bytes.extend_from_slice(entry.digest.as_bytes());
        bytes.extend_from_slice(&entry.offset.to_le_bytes());
        bytes.extend_from_slice(&entry.len.to_le_bytes());
    }
    let checksum = Digest::of(&bytes);
    bytes.extend_from_slice(checksum.as_bytes());
    bytes
}

fn decode(bytes: &[u8]) -> Option<Vec<Entry>> {
    let (body, checksum) = bytes.split_at_checked(bytes.len().checked_sub(DIGEST)?)?;
    if Digest::of(body).as_bytes() != checksum {
        return None;
    }
    let rows = body.strip_prefix(INDEX_MAGIC.as_slice())?.chunks_exact(INDEX_ROW);
    rows.map(|row| {
        Some(Entry {
            digest: digest_at(row)?,
            offset: u64::from_le_bytes(row.get(DIGEST..DIGEST + 8)?.try_into().ok()?),
            len: u32::from_le_bytes(row.get(DIGEST + 8..)?.try_into().ok()?),
        })
    })
    .collect()
}

fn digest_at(bytes: &[u8]) -> Option<Digest> {
    let bytes: [u8; DIGEST] = bytes.get(..DIGEST)?.try_into().ok()?;
    Some(Digest::from_bytes(bytes))
}

/// Returns the entries of a pack, from its index or, without a valid one, by a scan of the pack.
pub(super) fn load(pack: &Path) -> Result<Vec<Entry>, StoreError> {
    let index = fs::read(pack.with_extension("idx")).ok();
    if let Some(entries) = index.as_deref().and_then(decode) {
        return Ok(entries);
    }
    let bytes = fs::read(pack).map_err(StoreError::io("read", pack))?;
    Ok(scan(&bytes))
}

/// Returns the entries whose bytes have their digest, up to the first truncated blob.
fn scan(bytes: &[u8]) -> Vec<Entry> {
    let mut entries = Vec::new();
    let mut at = PACK_MAGIC.len();
    while let Some((digest, len)) = head_at(bytes, at) {
        let Some(blob) = bytes.get(at + HEAD..at + HEAD + len as usize) else {
            break;
        };
        if Digest::of(blob) == digest {
            let offset = (at + HEAD) as u64;
            entries.push(Entry { digest, offset, len });
        }
        at += HEAD + len as usize;
    }
    entries
}

fn head_at(bytes: &[u8], at: usize) -> Option<(Digest, u32)> {
    let head = bytes.get(at..at + HEAD)?;
    let len = u32::from_le_bytes(head.get(DIGEST..)?.try_into().ok()?);
    Some((digest_at(head)?, len))
}

/// Reads the bytes of one blob without a check of their digest.
pub(super) fn read(pack: &Path, offset: u64, len: u32) -> io::Result<Vec<u8>> {
    let mut file = File::open(pack)?;
    file.seek(SeekFrom::Start(offset))?;
    let mut bytes = vec![0; len as usize];
    file.read_exact(&mut bytes)?;
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn blobs(count: u8) -> BTreeMap<Digest, Arc<[u8]>> {
        let blobs = (0..count).map(|value| Arc::from(vec![value; usize::from(value) * 7]));
        blobs.map(|blob: Arc<[u8]>| (Digest::of(&blob), blob)).collect()
    }

    #[test]
    fn a_pack_without_its_index_lists_the_same() {
        let dir = tempfile::tempdir().unwrap();
        let pack = dir.path().join("a.pack");
        let written = write(&pack, &pack.with_extension("idx"), &blobs(40)).unwrap();
        assert_eq!(load(&pack).unwrap(), written);
        fs::remove_file(pack.with_extension("idx")).unwrap();
        assert_eq!(load(&pack).unwrap(), written);
    }

    #[test]
    fn a_flipped_bit_in_the_index_is_noticed_wherever_it_is() {
        let entries = vec![Entry {
            digest: Digest::of(b"a"),
            offset: 48,
            len: 1,
        }];
        let good = encode(&entries);
        assert_eq!(decode(&good), Some(entries));
        for bit in 0..good.len() * 8 {
            let mut bad = good.clone();
            bad[bit / 8] ^= 1 << (bit % 8);
            assert_eq!(decode(&bad), None, "bit {bit}");
        }
    }

    #[test]
    fn a_truncated_pack_keeps_its_whole_blobs() {
        let dir = tempfile::tempdir().unwrap();
        let pack = dir.path().join("a.pack");
        let written = write(&pack, &pack.with_extension("idx"), &blobs(9)).unwrap();
        let bytes = fs::read(&pack).unwrap();
        let cut = bytes.len() - 1;
        let listed = scan(&bytes[..cut]);
        assert!(
            !listed.is_empty() && listed.len() < written.len(),
            "{}",
            listed.len()
        );
        assert!(listed.iter().all(|entry| written.contains(entry)));
    }
}
