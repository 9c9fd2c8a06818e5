//! Values of a record.

use marf_pds::feed::field;
use marf_pds::values;
use serde_json::Value;

/// Returns the sol of a record.
pub(super) fn sol_of(record: &Value) -> Option<u32> {
    field(record, "sol").and_then(|sol| values::sol(&sol))
}

/// Returns the record's id if it can be part of a file name, so that no text of a server becomes a path.
pub(super) fn id_of(record: &Value) -> Option<String> {
    let id = field(record, "imageid")?;
    let plain = |byte: u8| byte.is_ascii_alphanumeric() || byte == b'_' || byte == b'-';
    (id.len() <= 80 && id.bytes().all(plain)).then_some(id)
}
