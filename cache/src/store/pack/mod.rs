//! Packs: many small blobs, records and memos in one file that never changes.
//!
//! A pack is, in this order:
//! - `marf-pack-2\n`
//! - the body: for each entry its kind (u8: 0 blob, 1 record, 2 memo), its id (32 bytes), the length of its payload
//!   (u32 LE), the payload
//! - the table: for each entry kind, id, offset of the payload (u64 LE), length (u32 LE), generation (u32 LE)
//! - the offset of the table (u64 LE), the blake3 of table and offset, and `marf-pend-2\n`
//!
//! Without a valid table the entries are found by a scan of the body.
//!
//! The payload of a blob is its bytes. The payload of a record or memo is the blake3 of (kind, id, rest), then the
//! rest: the generation (u32 LE), and the JSON of the record or the blob and the maker of the memo. Of two entries of
//! one key the one of the higher generation is valid.

mod format;
mod read;
mod write;

pub(super) use format::{Contents, Entry, Kind, OVERHEAD, open, seal};
pub(super) use read::{Window, contents, has_head};
pub(super) use write::{PackJoiner, Writer};
