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
}
