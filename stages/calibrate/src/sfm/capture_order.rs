//! The order in which photos were most likely taken.

use crate::photos::InputPhoto;

/// Returns the photos in the order they were most likely taken: by sol, then by name with numbers compared as numbers.
pub(crate) fn capture_order(items: &[InputPhoto]) -> Vec<usize> {
    let name = |photo: &usize| {
        let item = &items[*photo];
        (item.facts.sol, natural(&item.facts.file), item.id.clone())
    };
    let mut order: Vec<usize> = (0..items.len()).collect();
    order.sort_by_cached_key(name);
    order
}

/// Returns a name as alternating text and numbers, so that `img_9` comes before `img_10`.
fn natural(name: &str) -> Vec<(String, u128)> {
    let mut parts = Vec::new();
    let mut rest = name;
    while !rest.is_empty() {
        let text = rest.find(|c: char| c.is_ascii_digit()).unwrap_or(rest.len());
        let (text, after) = rest.split_at(text);
        let digits = after.find(|c: char| !c.is_ascii_digit()).unwrap_or(after.len());
        let (digits, after) = after.split_at(digits);
        let number = match digits {
            "" => 0,
            digits => digits.parse().unwrap_or(u128::MAX),
        };
        parts.push((text.to_owned(), number));
        rest = after;
    }
    parts
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_in_names_count_as_numbers() {
        let mut names = ["f10.jpg", "f9.jpg", "f1a.jpg", "e99.jpg", "f", ""];
        names.sort_by_key(|name| natural(name));
        assert_eq!(names, ["", "e99.jpg", "f", "f1a.jpg", "f9.jpg", "f10.jpg"]);
    }
}
