//! `[keep]` and `[reject]`: photos that a person keeps or rejects, whatever the filters of the pipeline decide.

use std::collections::HashSet;

use schemars::JsonSchema;
use serde::Deserialize;
use serde_json::{Map, Value as Json, json};

use super::error::ConfigError;
use super::place::read;
use super::syntax::SyntaxNode;

/// The tables, each with one key `ids`. They are also the keys of a filter's `by_hand`.
pub(super) const LISTS: [&str; 2] = ["keep", "reject"];
/// The parameter of filters that takes the lists.
pub(super) const PARAM: &str = "by_hand";

/// One of the tables.
#[derive(Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct PhotoList {
    /// Product ids, or file names as the archive has them.
    #[serde(default)]
    ids: Vec<String>,
}

/// Returns the lists as `{"keep": [...], "reject": [...]}`, or `None` if the pipeline has neither.
///
/// # Errors
/// Returns an error for another key than `ids`, a value that is not a list of names, or a name in both lists.
pub(super) fn lists(root: &SyntaxNode) -> Result<Option<Map<String, Json>>, ConfigError> {
    let mut lists = Map::new();
    for name in LISTS {
        if let Some(table) = root.entry(name) {
            let shape = format!("write it as `[{name}]` with `ids = [\"product id or file name\", …]`");
            let PhotoList { ids } = read(table, &shape)?;
            lists.insert(name.to_owned(), json!(ids));
        }
    }
    let [keep, reject] = LISTS.map(|name| lists.get(name).and_then(Json::as_array).into_iter().flatten());
    let rejected: HashSet<&Json> = reject.collect();
    if let Some(both) = keep.into_iter().find(|name| rejected.contains(name)) {
        let message = format!("{both} is in `[keep]` and in `[reject]`");
        let hint = Some("take it out of one of them".to_owned());
        return Err(ConfigError::at(root.place("reject.ids"), message).hint(hint));
    }
    Ok((!lists.is_empty()).then_some(lists))
}

/// Returns list and name of every entry in the parameters of a filter.
pub fn entries(params: &Json) -> impl Iterator<Item = (&'static str, &str)> {
    let lists = params.get(PARAM).into_iter().flat_map(|own| {
        let names = |list| own.get(list).and_then(Json::as_array).into_iter().flatten();
        LISTS.map(|list| (list, names(list)))
    });
    lists.flat_map(|(list, names)| names.filter_map(move |name| Some((list, name.as_str()?))))
}

/// Adds the pipeline's lists to those of a filter's own `by_hand`.
pub(super) fn add_to(params: &mut Map<String, Json>, lists: &Map<String, Json>) {
    let own = params.entry(PARAM).or_insert_with(|| json!({}));
    // The stage refuses anything but a table.
    let Some(own) = own.as_object_mut() else { return };
    for (name, ids) in lists {
        let all = own.entry(name.as_str()).or_insert_with(|| json!([]));
        if let (Some(all), Some(ids)) = (all.as_array_mut(), ids.as_array()) {
            all.extend(ids.iter().cloned());
        }
    }
}

/// Returns the schema of one of the tables.
pub(super) fn schema(what: &str) -> Json {
    let mut schema = marf_stage::schema_of::<PhotoList>().to_value();
    schema["description"] = json!(format!(
        "Photos that every filter {what}, whatever it measures. Recorded in its key and as the verdict's reason."
    ));
    schema
}

#[cfg(test)]
mod tests {
    use super::super::error::Origin;
    use super::super::{GlobalOptions, check, syntax};
    use super::*;

    const HEAD: &str = "[archive.demo]\nkind = \"demo\"\n[node.extract]\narchive = \"demo\"\n[node.blur]\ninput = \"extract\"\n";

    fn blur_of(text: &str) -> Json {
        let pipeline = check(text, &[], &GlobalOptions::default(), std::path::Path::new("")).unwrap();
        pipeline.nodes[1].params.clone()
    }

    #[test]
    fn the_lists_reach_every_filter_and_join_its_own() {
        let text =
            format!("{HEAD}by_hand = {{ keep = [\"a\"] }}\n[keep]\nids = [\"b\"]\n[reject]\nids = [\"c\"]\n");
        assert_eq!(
            blur_of(&text)["by_hand"],
            json!({"keep": ["a", "b"], "reject": ["c"]})
        );
        assert_eq!(blur_of(HEAD).get("by_hand"), None);
    }

    #[test]
    fn what_is_no_list_of_names_is_refused_at_its_place() {
        for (text, at, says) in [
            ("[keep]\nid = [\"a\"]\n", "[\"a\"]", "did you mean `ids`?"),
            ("[keep]\nids = \"a\"\n", "\"a\"", "product id"),
            ("keep = []\n", "keep = []", "write it as `[keep]`"),
            (
                "keep = [\"a.jpg\"]\n",
                "keep = [\"a.jpg\"]",
                "write it as `[keep]`",
            ),
            ("[keep]\nids = [\"a\", 3]\n", "[\"a\", 3]", "product id"),
            (
                "[keep]\nids = [\"a\"]\n[reject]\nids = [\"a\"]\n",
                "[\"a\"]",
                "take it out",
            ),
        ] {
            let error = lists(&syntax::parse(text).unwrap()).unwrap_err();
            let place = match &error.at {
                Origin::Text(range) => range.start,
                Origin::Argument(argument) => panic!("{argument}"),
            };
            assert!(text[place..].starts_with(at), "{text}: {place}");
            assert!(error.hint.as_ref().unwrap().contains(says), "{error:?}");
        }
    }

    #[test]
    fn lists_without_a_filter_are_refused() {
        let text =
            "[archive.demo]\nkind = \"demo\"\n[node.extract]\narchive = \"demo\"\n[keep]\nids = [\"a\"]\n";
        let error = check(text, &[], &GlobalOptions::default(), std::path::Path::new(""))
            .err()
            .unwrap();
        assert!(error.message.contains("no node filters photos"), "{error:?}");
    }

    #[test]
    fn set_reaches_the_lists() {
        let set = ["keep.ids=[\"x\"]".to_owned()];
        let pipeline = check(HEAD, &set, &GlobalOptions::default(), std::path::Path::new("")).unwrap();
        assert_eq!(pipeline.nodes[1].params["by_hand"], json!({"keep": ["x"]}));
    }
}
