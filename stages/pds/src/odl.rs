//! The object description language of PDS3 labels and of the label blocks of Mars 2020 products.

/// Deepest nesting of groups, and of lists in lists.
const MAX_DEPTH: usize = 16;
/// Most statements of one label. Real ones have some hundred.
const MAX_STATEMENTS: usize = 50_000;

/// A group or object with its contents.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Group {
    /// Name, upper case. Empty for the whole label.
    pub name: String,
    /// Keys in order, upper case, without a mission's prefix (`MSL:`).
    pub entries: Vec<(String, Value)>,
    /// Groups and objects in order.
    pub groups: Vec<Self>,
}

/// A value.
#[derive(Debug, Clone, PartialEq)]
pub enum Value {
    /// A word, number or quoted text. Units are in [`Value::Unit`].
    Text(String),
    /// A value with its unit.
    Unit(String, String),
    /// `(…)` or `{…}`.
    List(Vec<Self>),
}

/// Bytes that are not ODL.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("label line {line}: {what}")]
pub struct OdlError {
    /// Line, from 1.
    pub line: usize,
    /// What is wrong there.
    pub what: &'static str,
}

impl Group {
    /// Returns the first value of a key of this group, not of its groups.
    pub fn get(&self, key: &str) -> Option<&Value> {
        self.entries
            .iter()
            .find(|(name, _)| name == key)
            .map(|(_, value)| value)
    }

    /// Returns a key's value as text without unit.
    pub fn text(&self, key: &str) -> Option<&str> {
        self.get(key)?.text()
    }

    /// Returns all groups in this one, depth first.
    pub fn descendants(&self) -> Vec<&Self> {
        let mut found = Vec::new();
        let mut open: Vec<&Self> = self.groups.iter().rev().collect();
        while let Some(group) = open.pop() {
            found.push(group);
            open.extend(group.groups.iter().rev());
        }
        found
    }

    /// Returns the first group in this one that has one of these names.
    pub fn find(&self, names: &[&str]) -> Option<&Self> {
        self.descendants()
            .into_iter()
            .find(|group| names.contains(&group.name.as_str()))
    }
}

impl Value {
    /// Returns a single value's text.
    pub fn text(&self) -> Option<&str> {
        match self {
            Self::Text(text) | Self::Unit(text, _) => Some(text),
            Self::List(_) => None,
        }
    }

    /// Returns the values of a list, or the single value.
    pub fn items(&self) -> &[Self] {
        match self {
            Self::List(items) => items,
            single => std::slice::from_ref(single),
        }
    }

    /// Returns exactly `N` finite numbers.
    pub fn numbers<const N: usize>(&self) -> Option<[f64; N]> {
        let numbers: Option<Vec<f64>> = self
            .items()
            .iter()
            .map(|item| crate::values::number(item.text()?))
            .collect();
        numbers?.try_into().ok()
    }
}

/// Reads a label up to its `END`, or to the end of the bytes.
///
/// # Errors
/// The line that is not ODL.
pub fn parse(bytes: &[u8]) -> Result<Group, OdlError> {
    let mut reader = Reader { bytes, at: 0 };
    let mut open = vec![Group::default()];
    for _ in 0..MAX_STATEMENTS {
        reader.skip_blank();
        let Some(key) = reader.key()? else { break };
        if key == "END" {
            break;
        }
        statement(&mut reader, key, &mut open)?;
        if open.len() > MAX_DEPTH {
            return Err(reader.error("groups nested too deeply"));
        }
    }
    // Truncated labels end inside a group: its part that was read is kept.
    while open.len() > 1 {
        close(&mut open);
    }
    Ok(open.pop().unwrap_or_default())
}

fn statement(reader: &mut Reader<'_>, key: String, open: &mut Vec<Group>) -> Result<(), OdlError> {
    let has_value = reader.equals();
    match key.as_str() {
        "GROUP" | "OBJECT" | "BEGIN_GROUP" | "BEGIN_OBJECT" => {
            let name = if has_value { reader.value(0)? } else { None };
            let name = name
                .as_ref()
                .and_then(Value::text)
                .unwrap_or_default()
                .to_ascii_uppercase();
            open.push(Group {
                name,
                ..Group::default()
            });
        }
        "END_GROUP" | "END_OBJECT" => {
            if has_value {
                reader.value(0)?;
            }
            if open.len() < 2 {
                return Err(reader.error("a group ends that did not begin"));
            }
            close(open);
        }
        _ if has_value => {
            let value = reader.value(0)?.unwrap_or(Value::Text(String::new()));
            if let Some(group) = open.last_mut() {
                group.entries.push((key, value));
            }
        }
        _ => return Err(reader.error("a word without `=`")),
    }
    Ok(())
}

fn close(open: &mut Vec<Group>) {
    if let Some(done) = open.pop()
        && let Some(parent) = open.last_mut()
    {
        parent.groups.push(done);
    }
}

struct Reader<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl Reader<'_> {
    fn peek(&self) -> Option<u8> {
        self.bytes.get(self.at).copied()
    }

    fn error(&self, what: &'static str) -> OdlError {
        let before = self.bytes.get(..self.at).unwrap_or(self.bytes);
        OdlError {
            line: 1 + before.iter().filter(|byte| **byte == b'\n').count(),
            what,
        }
    }

    /// Skips white space, zero bytes between blocks, and comments.
    fn skip_blank(&mut self) {
        loop {
            while self
                .peek()
                .is_some_and(|byte| byte.is_ascii_whitespace() || byte == 0)
            {
                self.at += 1;
            }
            if !self.bytes[self.at..].starts_with(b"/*") {
                return;
            }
            let rest = &self.bytes[self.at..];
            let end = rest
                .windows(2)
                .position(|pair| pair == b"*/")
                .map_or(rest.len(), |end| end + 2);
            self.at += end;
        }
    }

    /// Reads a key in upper case, without its prefix. `None` at the end.
    fn key(&mut self) -> Result<Option<String>, OdlError> {
        let start = self.at;
        let part = |byte: u8| byte.is_ascii_alphanumeric() || b"_^:-".contains(&byte);
        while self.peek().is_some_and(part) {
            self.at += 1;
        }
        let word = &self.bytes[start..self.at];
        if word.is_empty() {
            return match self.peek() {
                None => Ok(None),
                Some(_) => Err(self.error("no keyword")),
            };
        }
        let word = String::from_utf8_lossy(word).to_ascii_uppercase();
        let plain = word.rsplit(':').next().unwrap_or_default();
        let lacks_pointer = word.starts_with('^') && !plain.starts_with('^');
        Ok(Some(if lacks_pointer {
            format!("^{plain}")
        } else {
            plain.to_owned()
        }))
    }

    fn equals(&mut self) -> bool {
        let start = self.at;
        self.skip_blank();
        if self.peek() == Some(b'=') {
            self.at += 1;
            return true;
        }
        self.at = start;
        false
    }

    fn value(&mut self, depth: usize) -> Result<Option<Value>, OdlError> {
        self.skip_blank();
        let value = match self.peek() {
            None => return Ok(None),
            Some(b'(') => Value::List(self.list(b')', depth)?),
            Some(b'{') => Value::List(self.list(b'}', depth)?),
            Some(quote @ (b'"' | b'\'')) => Value::Text(self.quoted(quote)?),
            Some(_) => Value::Text(self.word()),
        };
        Ok(Some(self.with_unit(value)))
    }

    fn list(&mut self, close: u8, depth: usize) -> Result<Vec<Value>, OdlError> {
        if depth >= MAX_DEPTH {
            return Err(self.error("lists nested too deeply"));
        }
        self.at += 1;
        let mut items = Vec::new();
        loop {
            self.skip_blank();
            match self.peek() {
                None => return Err(self.error("a list does not end")),
                Some(byte) if byte == close => {
                    self.at += 1;
                    return Ok(items);
                }
                Some(b',') => self.at += 1,
                Some(b')' | b'}' | b'=') => return Err(self.error("a list ends with the wrong sign")),
                Some(_) => items.extend(self.value(depth + 1)?),
            }
        }
    }

    /// Reads quoted text. Runs of white space become one blank.
    fn quoted(&mut self, quote: u8) -> Result<String, OdlError> {
        self.at += 1;
        let rest = &self.bytes[self.at..];
        let Some(length) = rest.iter().position(|byte| *byte == quote) else {
            return Err(self.error("a quoted text does not end"));
        };
        self.at += length + 1;
        let text = String::from_utf8_lossy(&rest[..length]);
        Ok(text.split_whitespace().collect::<Vec<_>>().join(" "))
    }

    fn word(&mut self) -> String {
        let start = self.at;
        let ends = |byte: u8| byte.is_ascii_whitespace() || b",(){}<\"'=\0".contains(&byte);
        while self.peek().is_some_and(|byte| !ends(byte)) {
            self.at += 1;
        }
        // A lone delimiter is skipped, or reading would not advance.
        if self.at == start {
            self.at += 1;
        }
        String::from_utf8_lossy(&self.bytes[start..self.at]).into_owned()
    }

    fn with_unit(&mut self, value: Value) -> Value {
        let start = self.at;
        self.skip_blank();
        let rest = &self.bytes[self.at..];
        let end = rest.iter().take(64).position(|byte| *byte == b'>');
        match (rest.first(), end, value) {
            (Some(b'<'), Some(end), Value::Text(text)) => {
                self.at += end + 1;
                Value::Unit(text, String::from_utf8_lossy(&rest[1..end]).trim().to_owned())
            }
            (.., value) => {
                self.at = start;
                value
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DEMO: &str = r#"PDS_VERSION_ID = PDS3
/* a comment = with signs ( */
RECORD_BYTES    = 64
^IMAGE         = ("DEMO.IMG", 3)
MSL:SOLUTION_ID = telemetry
ROVER_MOTION_COUNTER_NAME = ("SITE", "DRIVE",
                             "POSE")
ROVER_MOTION_COUNTER = (7, 42, 0)
TEXT = "a text with LINES = 64
   and a second line"
GROUP = IMAGE_REQUEST_PARMS
 LINES = 64
END_GROUP
GROUP = GEOMETRIC_CAMERA_MODEL_PARMS
 MODEL_COMPONENT_1 = ( 8.0e-01, 5.6e-01,
-1.92e+00 )
 ^MODEL_DESC = "GEOMETRIC_CM.TXT"
 OFFSETS = (1 <m>,2<m>, 3 <m>)
END_GROUP = GEOMETRIC_CAMERA_MODEL_PARMS
OBJECT = IMAGE
 LINES = 8
 EXPOSURE = 11.2 <ms>
 SAMPLE_BIT_MASK = 2#0000111111111111#
 SET = {A, 'B'}
 EMPTY = ()
END_OBJECT = IMAGE
END
garbage ((( after the end
"#;

    #[test]
    fn a_label_is_read_by_group() {
        let label = parse(DEMO.as_bytes()).unwrap();
        assert_eq!(label.text("RECORD_BYTES"), Some("64"));
        assert_eq!(label.text("SOLUTION_ID"), Some("telemetry"));
        assert_eq!(
            label.text("TEXT"),
            Some("a text with LINES = 64 and a second line")
        );
        assert_eq!(label.find(&["IMAGE"]).unwrap().text("LINES"), Some("8"));
        let pointer: Vec<_> = label
            .get("^IMAGE")
            .unwrap()
            .items()
            .iter()
            .filter_map(Value::text)
            .collect();
        assert_eq!(pointer, ["DEMO.IMG", "3"]);
        let camera = label.find(&["GEOMETRIC_CAMERA_MODEL_PARMS"]).unwrap();
        assert_eq!(
            camera.get("MODEL_COMPONENT_1").unwrap().numbers(),
            Some([0.8, 0.56, -1.92])
        );
        assert_eq!(camera.get("OFFSETS").unwrap().numbers(), Some([1.0, 2.0, 3.0]));
        let image = label.find(&["IMAGE"]).unwrap();
        assert_eq!(
            image.get("EXPOSURE"),
            Some(&Value::Unit("11.2".into(), "ms".into()))
        );
        assert_eq!(image.text("SAMPLE_BIT_MASK"), Some("2#0000111111111111#"));
        assert_eq!(image.get("SET").unwrap().items().len(), 2);
        assert_eq!(image.get("EMPTY").unwrap().items().len(), 0);
    }

    #[test]
    fn what_is_no_label_is_refused_with_its_line() {
        let deep = "GROUP = A\n".repeat(100);
        let lists = "A = ".to_owned() + &"(".repeat(1000);
        for (bad, line) in [
            ("A = (1, 2", 1),
            ("A = 1\nB = \"no end", 2),
            ("A = 1\n\nword\n= = =", 4),
            ("END_GROUP = A", 1),
            ("A = (1}", 1),
            ("\u{1}\u{2}", 1),
            (deep.as_str(), 16),
            (lists.as_str(), 1),
            ("just prose without a sign", 1),
        ] {
            let error = parse(bad.as_bytes()).unwrap_err();
            assert_eq!(error.line, line, "{bad:.20}: {error}");
        }
    }

    #[test]
    fn every_cut_of_a_label_ends() {
        for cut in 0..DEMO.len() {
            let _ = parse(&DEMO.as_bytes()[..cut]);
            let _ = parse(&DEMO.as_bytes()[cut..]);
        }
        let open = parse(b"GROUP = A\nB = 1\n").unwrap();
        assert_eq!(open.find(&["A"]).unwrap().text("B"), Some("1"));
    }
}
