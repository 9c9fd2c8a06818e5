//! `[store]`: where results are shared. It is not part of any key.

use std::path::{Path, PathBuf};

use schemars::JsonSchema;
use serde::Deserialize;
use serde_json::Value as Json;

use super::error::ConfigError;
use super::place::{placed, read};
use super::syntax::SyntaxNode;

/// The table.
pub(super) const TABLE: &str = "store";

/// Where results are shared with other machines. Not part of any key.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SharedStore {
    /// Address of the shared store: `s3://BUCKET/PREFIX` or `file:///FOLDER`.
    #[serde(rename = "remote")]
    #[schemars(extend("pattern" = "^(s3://[^/@?#]+|file:///[^@?#])"))]
    pub url: String,
    /// Share of the results of others that a run computes again and compares. Each run takes a different sample.
    #[serde(default)]
    #[schemars(range(min = 0, max = 1))]
    pub verify_share: f64,
    /// Files with the public keys (Ed25519, PEM) of trusted writers. Without it everybody is trusted.
    #[schemars(length(min = 1))]
    pub trust: Option<Vec<PathBuf>>,
}

/// Returns the shared store, or `None` if the pipeline has no shared store.
///
/// # Errors
/// Returns an error for an unknown key, an invalid address or an invalid share.
pub(super) fn shared(root: &SyntaxNode, base: &Path) -> Result<Option<SharedStore>, ConfigError> {
    let Some(table) = root.entry(TABLE) else {
        return Ok(None);
    };
    if table.value.entries().is_some_and(<[_]>::is_empty) {
        return Ok(None);
    }
    let shape = format!("write it as `[{TABLE}]` with `remote = \"s3://BUCKET/PREFIX\"`");
    let mut store: SharedStore = read(table, &shape)?;
    let refuse = |key: &str, message: &str| Err(placed(TABLE, table, key, message));
    if let Err(error) = marf_remote::check_address(&store.url) {
        let at = table.value.place("remote");
        return Err(ConfigError::at(at, error.to_string()).hint(error.hint()));
    }
    if !(0.0..=1.0).contains(&store.verify_share) {
        return refuse("verify_share", "a number from 0 to 1 is needed");
    }
    if store.trust.as_ref().is_some_and(Vec::is_empty) {
        return refuse("trust", "at least one file with public keys is needed");
    }
    for file in store.trust.iter_mut().flatten() {
        *file = base.join(&*file);
    }
    Ok(Some(store))
}

/// Returns the schema of the table. An empty table is accepted, and shares nothing.
pub(super) fn schema() -> Json {
    let mut schema = marf_stage::schema_of::<SharedStore>();
    schema.remove("required");
    schema.to_value()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{GlobalOptions, check};

    fn shared(table: &str) -> Result<Option<SharedStore>, String> {
        let text =
            format!("[archive.demo]\nkind = \"demo\"\n[node.extract]\narchive = \"demo\"\n[store]\n{table}");
        let checked = check(&text, &[], &GlobalOptions::default(), Path::new(""));
        checked
            .map(|pipeline| pipeline.shared)
            .map_err(|error| error.message)
    }

    #[test]
    fn a_share_to_verify_is_a_number_from_0_to_1() {
        let with = |share: &str| shared(&format!("remote = \"file:///s\"\n{share}"));
        let share = |text: &str| with(text).unwrap().unwrap().verify_share;
        assert_eq!(share(""), 0.0);
        assert_eq!(share("verify_share = 0.02"), 0.02);
        assert_eq!(share("verify_share = 1"), 1.0);
        for (bad, says) in [
            ("1.5", "a number from 0 to 1 is needed"),
            ("-0.1", "a number from 0 to 1 is needed"),
            ("\"all\"", "invalid type: string \"all\", expected f64"),
        ] {
            let message = with(&format!("verify_share = {bad}")).unwrap_err();
            assert_eq!(message, format!("store.verify_share: {says}"), "{bad}");
        }
        let alone = shared("verify_share = 0.5").unwrap_err();
        assert_eq!(alone, "store: missing field `remote`");
        assert_eq!(shared(""), Ok(None));
    }

    #[test]
    fn what_is_not_a_table_is_refused() {
        for bad in ["[\"s3://b/p\"]", "[]", "3"] {
            let root = crate::syntax::parse(&format!("store = {bad}")).unwrap();
            let error = super::shared(&root, Path::new("")).unwrap_err();
            assert_eq!(error.message, "`store` is not a table", "{bad}");
            assert!(
                error
                    .hint
                    .unwrap()
                    .starts_with("write it as `[store]` with `remote"),
                "{bad}"
            );
        }
    }

    #[test]
    fn trusted_keys_are_files_beside_the_pipeline() {
        let with = |line: &str| shared(&format!("remote = \"file:///s\"\n{line}"));
        let trust = with("trust = [\"a.pem\", \"/keys/b.pem\"]")
            .unwrap()
            .unwrap()
            .trust
            .unwrap();
        assert_eq!(trust, [Path::new("a.pem"), Path::new("/keys/b.pem")]);
        for bad in ["[]", "\"a.pem\"", "[1]"] {
            let message = with(&format!("trust = {bad}")).unwrap_err();
            assert!(message.starts_with("store.trust"), "{bad}: {message}");
        }
    }
}
