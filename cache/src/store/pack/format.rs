//! The form of a pack: its entries, their checksums, and the numbers of the layout.

use crate::Digest;

pub(super) const MAGIC: &[u8; 12] = b"marf-pack-2\n";
pub(super) const END: &[u8; 12] = b"marf-pend-2\n";
pub(super) const DIGEST: usize = 32;
/// Bytes of kind, id and length.
pub(super) const HEAD: usize = 1 + DIGEST + 4;
pub(super) const ROW: usize = 1 + DIGEST + 8 + 4 + 4;
/// Bytes of the offset of the table, its digest and the closing magic.
pub(super) const TAIL: usize = 8 + DIGEST + 12;
/// Bytes of checksum and generation at the start of the payload of a record or memo.
pub(super) const SEALED_HEAD: usize = DIGEST + 4;
/// Bytes read and written at once.
pub(super) const CHUNK: usize = 8 << 20;

/// Bytes of a pack that an object takes in addition to its payload.
pub(in crate::store) const OVERHEAD: u64 = (HEAD + ROW) as u64;

/// Offset of the first entry of a pack.
pub(super) const BODY: u64 = 12;

/// What an entry of a pack is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(in crate::store) enum Kind {
    Blob,
    Record,
    Memo,
}

/// An entry of a pack: what it is, and offset and length of its payload.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::store) struct Entry {
    pub(in crate::store) kind: Kind,
    pub(in crate::store) id: Digest,
    pub(in crate::store) offset: u64,
    pub(in crate::store) len: u32,
    pub(in crate::store) generation: u32,
}

/// The entries of a pack.
pub(in crate::store) struct Contents {
    pub(in crate::store) entries: Vec<Entry>,
    /// False if the table was damaged, so that the body was scanned.
    pub(in crate::store) has_table: bool,
}

impl Kind {
    pub(in crate::store) fn from_code(code: u8) -> Option<Self> {
        match code {
            0 => Some(Self::Blob),
            1 => Some(Self::Record),
            2 => Some(Self::Memo),
            _ => None,
        }
    }

    pub(in crate::store) fn code(self) -> u8 {
        match self {
            Self::Blob => 0,
            Self::Record => 1,
            Self::Memo => 2,
        }
    }

    /// Its name in reports.
    pub(in crate::store) fn name(self) -> &'static str {
        match self {
            Self::Blob => "blob",
            Self::Record => "record",
            Self::Memo => "memo",
        }
    }
}

fn seal_of(kind: Kind, id: &Digest, rest: &[u8]) -> Digest {
    let mut hasher = blake3::Hasher::new();
    hasher.update(&[kind.code()]).update(id.as_bytes()).update(rest);
    Digest::from_bytes(*hasher.finalize().as_bytes())
}

/// Returns the payload of a record or memo.
pub(in crate::store) fn seal(kind: Kind, id: &Digest, generation: u32, content: &[u8]) -> Vec<u8> {
    let rest = [&generation.to_le_bytes(), content].concat();
    [seal_of(kind, id, &rest).as_bytes(), rest.as_slice()].concat()
}

/// Returns the content of a payload that matches its entry, or `None` if it is damaged.
pub(in crate::store) fn open<'a>(kind: Kind, id: &Digest, payload: &'a [u8]) -> Option<&'a [u8]> {
    if kind == Kind::Blob {
        return (Digest::from_content(payload) == *id).then_some(payload);
    }
    let (checksum, rest) = payload.split_at_checked(DIGEST)?;
    let whole = seal_of(kind, id, rest).as_bytes() == checksum;
    whole.then(|| payload.get(SEALED_HEAD..)).flatten()
}

pub(super) fn generation_of(kind: Kind, payload: &[u8]) -> u32 {
    match kind {
        Kind::Blob => 0,
        _ => u32_at(payload, DIGEST).unwrap_or(0),
    }
}

fn array_at<const N: usize>(bytes: &[u8], at: usize) -> Option<[u8; N]> {
    bytes.get(at..at.checked_add(N)?)?.try_into().ok()
}

pub(super) fn digest_at(bytes: &[u8], at: usize) -> Option<Digest> {
    array_at(bytes, at).map(Digest::from_bytes)
}

pub(super) fn u32_at(bytes: &[u8], at: usize) -> Option<u32> {
    array_at(bytes, at).map(u32::from_le_bytes)
}

pub(super) fn u64_at(bytes: &[u8], at: usize) -> Option<u64> {
    array_at(bytes, at).map(u64::from_le_bytes)
}
