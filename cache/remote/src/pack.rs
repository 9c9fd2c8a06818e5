//! Packs: concatenated small blobs, with an index in a second object.
//!
//! ```text
//! index:  "marf pack 1\n"  (digest of the blob, 32 bytes, its offset, u64, its length, u32)*  digest of all before, 32 bytes
//! ```
//! Entries are sorted by digest, numbers are little-endian. The name of a pack is the digest of its bytes.

use bytes::Bytes;
use marf_cache::Digest;

/// Blobs from this length on are objects of their own, as in the local store.
pub(crate) const LARGE_BYTES: u64 = 64 << 10;
/// A pack is closed when it holds this many bytes.
pub(crate) const PACK_BYTES: u64 = 32 << 20;

const MAGIC: &[u8] = b"marf pack 1\n";
const ENTRY: usize = 44;
const CHECKSUM: usize = 32;

/// Where a blob is in its pack.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Entry {
    pub(crate) digest: Digest,
    pub(crate) offset: u64,
    pub(crate) len: u32,
}

/// A pack and its index, as they are written.
pub(crate) struct Pack {
    pub(crate) id: Digest,
    pub(crate) bytes: Bytes,
    pub(crate) index: Bytes,
}

/// The entries of all packs as one sorted list, 48 bytes a blob.
#[derive(Default)]
pub(crate) struct Catalogue {
    packs: Vec<Digest>,
    /// With the numbers of their packs.
    places: Vec<(Entry, u32)>,
}

/// A pack that is being filled.
#[derive(Default)]
pub(crate) struct PackWriter {
    bytes: Vec<u8>,
    entries: Vec<Entry>,
}

impl Entry {
    /// Returns the bytes of the blob in the bytes of its pack, or `None` if the pack is cut.
    pub(crate) fn bytes_in<'a>(&self, pack: &'a [u8]) -> Option<&'a [u8]> {
        let begin = usize::try_from(self.offset).ok()?;
        pack.get(begin..begin.checked_add(self.len as usize)?)
    }
}

impl Catalogue {
    /// Returns the packs.
    pub(crate) fn packs(&self) -> &[Digest] {
        &self.packs
    }

    /// Adds packs with their entries.
    pub(crate) fn add(&mut self, packs: Vec<(Digest, Vec<Entry>)>) {
        for (pack, entries) in packs {
            let number = self.packs.len() as u32;
            self.packs.push(pack);
            self.places
                .extend(entries.into_iter().map(|entry| (entry, number)));
        }
        self.places.sort_unstable();
        self.places.dedup_by_key(|(entry, _)| entry.digest);
    }

    /// Returns where a blob is, and its pack.
    pub(crate) fn find(&self, digest: &Digest) -> Option<(Entry, Digest)> {
        let at = self
            .places
            .binary_search_by(|(entry, _)| entry.digest.cmp(digest))
            .ok()?;
        let (entry, pack) = *self.places.get(at)?;
        Some((entry, *self.packs.get(pack as usize)?))
    }
}

impl PackWriter {
    pub(crate) fn add(&mut self, digest: Digest, blob: &[u8]) {
        self.entries.push(Entry {
            digest,
            offset: self.bytes.len() as u64,
            // A blob of a pack is smaller than 64 KiB.
            len: blob.len() as u32,
        });
        self.bytes.extend_from_slice(blob);
    }

    /// Returns the bytes so far.
    pub(crate) fn len(&self) -> u64 {
        self.bytes.len() as u64
    }

    pub(crate) fn finish(mut self) -> Pack {
        self.entries.sort_unstable();
        Pack {
            id: Digest::from_content(&self.bytes),
            index: Bytes::from(encode_index(&self.entries)),
            bytes: Bytes::from(self.bytes),
        }
    }
}

pub(crate) fn encode_index(entries: &[Entry]) -> Vec<u8> {
    let mut bytes = MAGIC.to_vec();
    for entry in entries {
        bytes.extend_from_slice(entry.digest.as_bytes());
        bytes.extend_from_slice(&entry.offset.to_le_bytes());
        bytes.extend_from_slice(&entry.len.to_le_bytes());
    }
    let checksum = Digest::from_content(&bytes);
    bytes.extend_from_slice(checksum.as_bytes());
    bytes
}

/// Reads an index, or returns `None` if it is incomplete or damaged.
pub(crate) fn decode_index(bytes: &[u8]) -> Option<Vec<Entry>> {
    let (body, checksum) = bytes.split_at_checked(bytes.len().checked_sub(CHECKSUM)?)?;
    if Digest::from_content(body).as_bytes() != checksum {
        return None;
    }
    let (entries, rest) = body.strip_prefix(MAGIC)?.as_chunks::<ENTRY>();
    rest.is_empty()
        .then(|| entries.iter().map(decode_entry).collect())?
}

/// Reads an entry, or returns `None` if its end overflows or its blob does not belong in a pack.
fn decode_entry(bytes: &[u8; ENTRY]) -> Option<Entry> {
    let (digest, numbers) = bytes.split_first_chunk::<32>()?;
    let (offset, len) = numbers.split_first_chunk::<8>()?;
    let offset = u64::from_le_bytes(*offset);
    let len = u32::from_le_bytes(len.try_into().ok()?);
    offset.checked_add(u64::from(len))?;
    if u64::from(len) >= LARGE_BYTES {
        return None;
    }
    Some(Entry {
        digest: Digest::from_bytes(*digest),
        offset,
        len,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pack(blobs: &[&[u8]]) -> Pack {
        let mut writer = PackWriter::default();
        blobs
            .iter()
            .for_each(|blob| writer.add(Digest::from_content(blob), blob));
        writer.finish()
    }

    #[test]
    fn an_index_tells_where_each_blob_is_sorted_by_digest() {
        let blobs: [&[u8]; 4] = [b"one", b"", b"three", b"four"];
        let pack = pack(&blobs);
        assert_eq!(pack.id, Digest::from_content(b"onethreefour"));
        let entries = decode_index(&pack.index).unwrap();
        assert_eq!(entries.len(), 4);
        assert!(entries.is_sorted_by(|a, b| a.digest < b.digest));
        for entry in entries {
            let at = entry.offset as usize..entry.offset as usize + entry.len as usize;
            assert_eq!(Digest::from_content(&pack.bytes[at]), entry.digest);
        }
    }

    #[test]
    fn an_index_that_is_cut_or_flipped_is_none() {
        let index = pack(&[b"one", b"two"]).index;
        for len in 0..index.len() {
            assert_eq!(decode_index(&index[..len]), None, "cut at {len}");
        }
        for at in 0..index.len() {
            let mut bytes = index.to_vec();
            bytes[at] ^= 1;
            assert_eq!(decode_index(&bytes), None, "flipped at {at}");
        }
        assert_eq!(decode_index(&pack(&[]).index), Some(Vec::new()));
    }

    #[test]
    fn an_entry_beyond_all_places_or_too_long_makes_the_index_none() {
        let entry = |offset, len| Entry {
            digest: Digest::from_content(b"far"),
            offset,
            len,
        };
        assert!(decode_index(&encode_index(&[entry(u64::MAX - 7, 7)])).is_some());
        assert_eq!(decode_index(&encode_index(&[entry(u64::MAX - 7, 8)])), None);
        assert!(decode_index(&encode_index(&[entry(7, 65_535)])).is_some());
        assert_eq!(decode_index(&encode_index(&[entry(7, 65_536)])), None);
    }
}
