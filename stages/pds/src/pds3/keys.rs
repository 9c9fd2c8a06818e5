//! Values of keys as labels have them.

use crate::odl::{Group, Value};
use crate::values;

/// Returns the value of a key of the label itself. VICAR has those in a property.
pub(super) fn identification<'a>(odl: &'a Group, key: &str) -> Option<&'a Value> {
    odl.get(key).or_else(|| odl.find(&["IDENTIFICATION"])?.get(key))
}

pub(super) fn top<'a>(odl: &'a Group, key: &str) -> Option<&'a str> {
    identification(odl, key)?.text()
}

pub(super) fn text(group: &Group, key: &str) -> Option<String> {
    values::known(group.text(key)?)
}

pub(super) fn unsigned(group: &Group, key: &str) -> Option<u32> {
    values::integer(group.text(key)?).and_then(|value| u32::try_from(value).ok())
}
