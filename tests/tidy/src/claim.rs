//! What a sentence claims.

/// Words that make a sentence a claim.
const CLAIMS: [&str; 13] = [
    "all",
    "always",
    "equal",
    "every",
    "intact",
    "least",
    "most",
    "never",
    "none",
    "only",
    "same",
    "unaltered",
    "whole",
];
/// Words before a number that is left open.
const BEFORE_NUMBERS: [&str; 12] = [
    "above", "and", "at", "below", "by", "for", "least", "most", "of", "than", "to", "x",
];
/// Names of open places that hold a name or a text, not a number.
const NAMES: [&str; 25] = [
    "adapter",
    "archive",
    "cause",
    "codec",
    "device",
    "doing",
    "error",
    "field",
    "host",
    "id",
    "instrument",
    "key",
    "kind",
    "message",
    "mission",
    "name",
    "node",
    "object",
    "output",
    "place",
    "reason",
    "role",
    "source",
    "what",
    "who",
];
/// Parts of texts for programs: markup, scripts, statements of SQL, policies, tables of TOML.
const CODE: [&str; 6] = ["</", "#!/", "CREATE ", "-src '", "]\n", "seed = "];

/// Returns whether a text reads like a sentence and has a number, a place for one, or a word that claims something.
#[must_use]
pub fn is_claim(text: &str) -> bool {
    if CODE.iter().any(|code| text.contains(code)) {
        return false;
    }
    let bare: String = text.split('`').step_by(2).collect::<Vec<_>>().join("`");
    let words: Vec<&str> = bare.split_whitespace().collect();
    let is_word = |word: &&&str| {
        let word = word.trim_matches(|letter: char| letter.is_ascii_punctuation());
        word.len() > 1 && word.chars().skip(1).all(|letter| letter.is_lowercase())
    };
    if words.iter().filter(is_word).count() < 3 {
        return false;
    }
    let claims = |word: &str| {
        let word = word
            .trim_matches(|letter: char| !letter.is_alphabetic())
            .to_lowercase();
        CLAIMS.contains(&word.as_str())
    };
    let has_number = words.iter().enumerate().any(|(at, word)| {
        let Some(open) = word.find('{') else {
            return word.starts_with(|first: char| first.is_ascii_digit());
        };
        let name = word[open + 1..].split(['}', ':']).next();
        if name.is_some_and(|name| NAMES.contains(&name)) {
            return false;
        }
        let before = at.checked_sub(1).map_or("", |before| words[before]);
        let is_last = at + 1 == words.len();
        word[open..].contains(":.") || BEFORE_NUMBERS.contains(&before) || (!is_last && word.ends_with('}'))
    });
    has_number || words.iter().any(|word| claims(word))
}

#[cfg(test)]
mod tests {
    use super::is_claim;

    #[test]
    fn a_claim_is_a_sentence_with_a_number_or_a_word_that_claims() {
        for claim in [
            "{} of {all} claims have no test",
            "every photo is here",
            "90 % of the errors are inside",
            "the median is {median:.2}",
            "{count} are missing here",
            "at most {most} of them",
        ] {
            assert!(is_claim(claim), "{claim}");
        }
        for other in [
            "cannot read {path}",
            "`every` photo is here",
            "two words",
            "SELECT all FROM t WHERE x",
            "photos are read: {error}",
            "{place} does not allow to {doing} it",
            "CREATE TABLE IF NOT EXISTS pack(id INTEGER, at {})",
        ] {
            assert!(!is_claim(other), "{other}");
        }
    }
}
