//! One form of JSON as bytes.

use serde_json::{Number, Value};

/// Largest whole number up to which every whole f64 has neighbours less than 1 away.
const MAX_WHOLE: f64 = 9_007_199_254_740_992.0;

/// Returns JSON without white space, keys sorted by their bytes, whole numbers without a decimal point, other numbers in
/// their shortest form that reads back to the same f64.
///
/// Equal values have equal bytes. JSON has no NaN and no infinity: `serde_json` has already made them `null`.
pub fn canonical_json(value: &Value) -> Vec<u8> {
    let mut bytes = Vec::new();
    write(value, &mut bytes);
    bytes
}

fn write(value: &Value, bytes: &mut Vec<u8>) {
    match value {
        Value::Array(values) => {
            bytes.push(b'[');
            for (index, value) in values.iter().enumerate() {
                comma(index, bytes);
                write(value, bytes);
            }
            bytes.push(b']');
        }
        Value::Object(table) => {
            let mut entries: Vec<_> = table.iter().collect();
            entries.sort_unstable_by_key(|(key, _)| key.as_bytes());
            bytes.push(b'{');
            for (index, (key, value)) in entries.into_iter().enumerate() {
                comma(index, bytes);
                bytes.extend_from_slice(Value::from(key.as_str()).to_string().as_bytes());
                bytes.push(b':');
                write(value, bytes);
            }
            bytes.push(b'}');
        }
        Value::Number(number) => bytes.extend_from_slice(whole(number).to_string().as_bytes()),
        leaf => bytes.extend_from_slice(leaf.to_string().as_bytes()),
    }
}

fn comma(index: usize, bytes: &mut Vec<u8>) {
    if index > 0 {
        bytes.push(b',');
    }
}

/// Returns a whole f64 as an integer, so that `30.0` and `30` are equal. -0 becomes 0.
fn whole(number: &Number) -> Number {
    match number.as_f64() {
        Some(value) if number.is_f64() && value.fract() == 0.0 && value.abs() <= MAX_WHOLE => {
            Number::from(value as i64)
        }
        _ => number.clone(),
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use serde_json::json;

    use super::*;

    fn text(value: &Value) -> String {
        String::from_utf8(canonical_json(value)).unwrap()
    }

    #[test]
    fn keys_are_sorted_and_whole_numbers_are_integers() {
        let value = json!({"b": [1.0, -0.0, 0.1, 1e300, -7, u64::MAX], "a": {"ü": null, "\"": true}});
        assert_eq!(
            text(&value),
            "{\"a\":{\"\\\"\":true,\"ü\":null},\"b\":[1,0,0.1,1e+300,-7,18446744073709551615]}"
        );
    }

    proptest! {
        #[test]
        fn a_number_reads_back_to_the_same_value(bits: u64) {
            let number = f64::from_bits(bits);
            prop_assume!(number.is_finite());
            let back: f64 = serde_json::from_str(&text(&json!(number))).unwrap();
            prop_assert!(back == number, "{number} {back}");
        }
    }
}
