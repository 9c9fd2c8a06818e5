//! BagIt bags (RFC 8493), version 1.0: payload under `data/`, SHA-256 manifests of payload and tag files.

mod form;
mod path;
mod read;
mod write;

pub use form::{FileDigest, MANIFEST, PAYLOAD};
pub use path::{decode_path, encode_path, is_safe};
pub use read::{Bag, BagFault, read_member};
pub use write::BagWriter;
