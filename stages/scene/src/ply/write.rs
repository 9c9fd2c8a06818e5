use std::fmt::Write as _;

/// Writes the header of a binary little-endian file.
#[derive(Debug, Clone)]
pub struct HeaderWriter {
    text: String,
}

impl HeaderWriter {
    /// Begins a header with comments. A line break in one becomes a space.
    pub fn new(comments: &[String]) -> Self {
        let lines = comments
            .iter()
            .map(|comment| format!("comment {}\n", comment.replace(['\n', '\r'], " ")));
        let comments: String = lines.collect();
        Self {
            text: format!("ply\nformat binary_little_endian 1.0\n{comments}"),
        }
    }

    /// Announces `count` records, whose properties follow.
    #[must_use]
    pub fn element(mut self, name: &str, count: usize) -> Self {
        // Writing to a string never fails.
        let _ = writeln!(self.text, "element {name} {count}");
        self
    }

    /// Adds properties of a type (`float`, `uchar`, `list uchar int`) to the element announced last.
    #[must_use]
    pub fn properties(mut self, kind: &str, names: &[&str]) -> Self {
        for name in names {
            let _ = writeln!(self.text, "property {kind} {name}");
        }
        self
    }

    /// Returns the whole header. The records follow it.
    pub fn into_bytes(self) -> Vec<u8> {
        (self.text + "end_header\n").into_bytes()
    }
}

/// Appends a number as `float`. One beyond 3.4e38 becomes the largest f32 of its sign.
pub fn push_float(bytes: &mut Vec<u8>, number: f64) {
    bytes.extend((number as f32).clamp(f32::MIN, f32::MAX).to_le_bytes());
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_header_lists_comments_elements_and_properties_in_order() {
        let header = HeaderWriter::new(&["two\nlines".to_owned()])
            .element("vertex", 2)
            .properties("float", &["x", "y"])
            .element("face", 1)
            .properties("list uchar int", &["vertex_indices"]);
        let text = String::from_utf8(header.into_bytes()).unwrap();
        assert_eq!(
            text,
            "ply\nformat binary_little_endian 1.0\ncomment two lines\nelement vertex 2\nproperty float x\nproperty float y\n\
             element face 1\nproperty list uchar int vertex_indices\nend_header\n"
        );
    }

    #[test]
    fn a_number_beyond_single_precision_is_the_largest_of_its_sign() {
        let mut bytes = Vec::new();
        push_float(&mut bytes, -1e300);
        assert_eq!(bytes, f32::MIN.to_le_bytes());
    }
}
