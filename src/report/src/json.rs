//! Documents of stages as tables of all their fields, whatever these are.

use std::collections::BTreeSet;

use marf_stage::Document;
use maud::{Markup, html};
use serde::Serialize;
use serde_json::Value;

use super::format::{count, figure, number};

/// Most rows of one table.
const MOST_ROWS: usize = 200;
/// Most entries of a list that are written out.
const MOST_ENTRIES: usize = 12;

/// Shows all fields of a document: single values as one table, each list of objects as its own. Empty lists
/// are left out.
pub(super) fn fields(document: &impl Document) -> Markup {
    tables(&value(document))
}

/// Returns a value as JSON, with the digits of its text.
pub(super) fn value(value: &impl Serialize) -> Value {
    // Through the text: a direct conversion would widen f32 to all digits of its f64. What JSON cannot hold is null.
    let text = serde_json::to_vec(value).unwrap_or_default();
    serde_json::from_slice(&text).unwrap_or_default()
}

fn tables(value: &Value) -> Markup {
    let mut singles = Vec::new();
    let mut lists = Vec::new();
    flatten("", value, &mut singles, &mut lists);
    html! {
        @if !singles.is_empty() {
            table.facts {
                @for (key, text) in &singles { tr { th scope="row" { (key) } td.number { (text) } } }
            }
        }
        @for (key, rows) in &lists {
            details {
                summary { @if key.is_empty() { "rows" } @else { (key) } ", " (count(rows.len(), "row")) }
                (table(rows))
            }
        }
    }
}

/// Shows a list of objects, one row each. Nested keys get a dot.
pub(super) fn table(rows: &[Value]) -> Markup {
    let columns = columns(rows);
    html! {
        div.scroll {
            table {
                thead { tr { @for column in &columns { (head(rows, column, column)) } } }
                tbody { @for row in rows.iter().take(MOST_ROWS) {
                    tr { @for column in &columns { (cell(row, column)) } }
                } }
            }
        }
        @if rows.len() > MOST_ROWS { p.quiet { (count(rows.len() - MOST_ROWS, "row")) " not shown." } }
    }
}

/// Keys of the rows in the order in which they first appear.
pub(super) fn columns(rows: &[Value]) -> Vec<String> {
    let mut known = BTreeSet::new();
    let mut columns = Vec::new();
    for row in rows {
        for (key, _) in flat(row) {
            if known.insert(key.clone()) {
                columns.push(key);
            }
        }
    }
    columns
}

/// The head of a column, on the side of its values.
pub(super) fn head(rows: &[Value], column: &str, name: &str) -> Markup {
    let value = |row: &Value| flat(row).into_iter().find(|(key, _)| key == column);
    let numbers = rows
        .iter()
        .find_map(value)
        .is_some_and(|(_, value)| value.is_number());
    html! { th.number[numbers] { (name) } }
}

/// One cell, numbers to the right.
pub(super) fn cell(row: &Value, column: &str) -> Markup {
    let found = flat(row).into_iter().find(|(key, _)| key == column);
    let Some((_, value)) = found else {
        return html! { td {} };
    };
    html! {
        @if value.is_number() { td.number { (figure_or_text(column, &value)) } } @else { td { (text(&value)) } }
    }
}

/// Single values of an object with dotted keys. Lists of objects are left to [`tables`].
fn flat(value: &Value) -> Vec<(String, Value)> {
    let mut found = Vec::new();
    walk("", value, &mut |key, value| {
        found.push((key.to_owned(), value.clone()))
    });
    found
}

fn flatten<'v>(
    key: &str,
    value: &'v Value,
    singles: &mut Vec<(String, String)>,
    lists: &mut Vec<(String, &'v [Value])>,
) {
    walk(key, value, &mut |key, value| match value {
        Value::Array(rows) if rows.is_empty() => {}
        Value::Array(rows) if rows.iter().any(Value::is_object) => lists.push((key.to_owned(), rows)),
        value => singles.push((key.to_owned(), figure_or_text(key, value))),
    });
}

fn walk<'v>(key: &str, value: &'v Value, found: &mut impl FnMut(&str, &'v Value)) {
    match value {
        Value::Object(fields) => {
            for (name, field) in fields {
                let dotted = if key.is_empty() {
                    name.clone()
                } else {
                    format!("{key}.{name}")
                };
                walk(&dotted, field, found);
            }
        }
        value => found(key, value),
    }
}

/// Returns a value as text. The key of a PSNR or SSIM sets its decimals.
fn figure_or_text(key: &str, value: &Value) -> String {
    let short = key.starts_with("psnr") || key.starts_with("ssim");
    match value.as_f64() {
        Some(value) if short => figure(key, value),
        _ => text(value),
    }
}

/// Returns a value as text.
pub(super) fn text(value: &Value) -> String {
    match value {
        Value::Null => "–".to_owned(),
        Value::Bool(true) => "yes".to_owned(),
        Value::Bool(false) => "no".to_owned(),
        Value::Number(found) => whole(found).unwrap_or_else(|| number(found.as_f64().unwrap_or(f64::NAN))),
        Value::String(text) => text.clone(),
        Value::Array(entries) => list(entries),
        Value::Object(_) => value.to_string(),
    }
}

/// Seeds and counts keep every digit: an f64 would round them above 2^53.
fn whole(value: &serde_json::Number) -> Option<String> {
    let digits = value.as_u64()?;
    (digits >= 1_000_000_000).then(|| digits.to_string())
}

fn list(entries: &[Value]) -> String {
    let shown: Vec<String> = entries.iter().take(MOST_ENTRIES).map(text).collect();
    let more = entries.len().saturating_sub(MOST_ENTRIES);
    match more {
        0 => shown.join(", "),
        more => format!("{}, and {more} more", shown.join(", ")),
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn nested_keys_get_a_dot_and_lists_of_objects_a_table() {
        let shown =
            tables(&json!({"a": {"b": 1, "c": [1, 2]}, "rows": [{"x": 1}, {"y": {"z": 2.5}}]})).into_string();
        for part in ["a.b", "1, 2", "rows, 2 rows", ">x</th>", ">y.z</th>", "2.5"] {
            assert!(shown.contains(part), "{part}: {shown}");
        }
    }

    #[test]
    fn a_seed_keeps_every_digit() {
        assert_eq!(text(&json!(u64::MAX)), "18446744073709551615");
        assert_eq!(text(&json!(12345)), "12,345");
        assert_eq!(text(&json!(-3.25)), "-3.25");
    }

    #[test]
    fn text_of_the_outside_is_escaped() {
        let shown = tables(&json!({"<b>": "<i>", "rows": [{"<u>": "<s>"}]})).into_string();
        assert!(
            !["<b>", "<i>", "<u>", "<s>"].iter().any(|tag| shown.contains(tag)),
            "{shown}"
        );
    }
}
