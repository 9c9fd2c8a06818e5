//! "did you mean": the nearest of some known names.

/// Returns the name with the least edit distance (Damerau-Levenshtein, ties broken by alphabet), unless that is more
/// than 1 plus a quarter of the letters of `name`.
pub fn nearest<'a>(name: &str, known: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    let scored = known
        .into_iter()
        .map(|other| (strsim::damerau_levenshtein(name, other), other));
    let (distance, other) = scored.min()?;
    (distance <= 1 + name.chars().count() / 4).then_some(other)
}

/// Returns "did you mean `x`?" for the nearest name, if one is near.
pub fn did_you_mean<'a>(name: &str, known: impl IntoIterator<Item = &'a str>) -> Option<String> {
    nearest(name, known).map(|other| format!("did you mean `{other}`?"))
}

/// Returns "did you mean `x`?" for a message about a word that is not one of some known words, each in backticks: those of serde and of
/// [`marf_field::Device`]. None for other messages, and if no known word is near.
pub fn near_word(message: &str) -> Option<String> {
    let lists = ["unknown variant `", "unknown field `", "` is not a device: "];
    if !lists.iter().any(|list| message.contains(list)) {
        return None;
    }
    let mut words = message.split('`').skip(1).step_by(2);
    let given = words.next()?;
    did_you_mean(given, words)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_near_name_is_offered_and_a_far_one_is_not() {
        let known = ["input", "min_bytes"];
        assert_eq!(
            did_you_mean("min_byte", known).as_deref(),
            Some("did you mean `min_bytes`?")
        );
        assert_eq!(nearest("ids", ["idx", "ida"]), Some("ida"));
        for far in ["zzzzzz", ""] {
            assert_eq!(nearest(far, known), None, "{far}");
        }
    }

    #[test]
    fn a_word_of_a_list_has_its_nearest_and_other_messages_have_none() {
        let quality: serde_json::Error =
            serde_json::from_value::<marf_field::Quality>("drfat".into()).unwrap_err();
        let device = "gpi".parse::<marf_field::Device>().unwrap_err();
        for (message, word) in [
            (quality.to_string(), "draft"),
            (device.to_string(), "gpu"),
            ("unknown variant `a`, expected `b` or `c`".to_owned(), "b"),
        ] {
            assert_eq!(
                near_word(&message),
                Some(format!("did you mean `{word}`?")),
                "{message}"
            );
        }
        assert_eq!(near_word("`train` sets it too, not `trian`"), None);
        assert_eq!(
            near_word("unknown variant `magic`, expected `sfm` or `labels`"),
            None
        );
    }
}
