//! Values as folded JSON.

use maud::{Markup, html};
use serde::Serialize;

/// Shows a value as JSON below a title.
pub(super) fn folded(title: &str, value: &impl Serialize) -> Markup {
    // Strings and sorted maps always serialise, and numbers that JSON cannot hold are null.
    let text = serde_json::to_string_pretty(value).unwrap_or_default();
    html! { details { summary { (title) } pre { (text) } } }
}
