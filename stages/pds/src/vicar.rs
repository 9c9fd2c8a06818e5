//! VICAR labels: `KEY=value` separated by blanks, system items first, then properties.
//!
//! They are read into the same groups as ODL, so that one reader of labels serves both.

use crate::odl::{Group, Value};

/// Largest label that is read.
const MAX_LABEL: usize = 1 << 20;
/// Most items of one label.
const MAX_ITEMS: usize = 50_000;

/// Reads the label at the start of the bytes, and the one continued at the end of the file where it says EOL=1.
/// `None` if there is none.
pub fn parse(bytes: &[u8]) -> Option<Group> {
    if !bytes.starts_with(b"LBLSIZE=") {
        return None;
    }
    let size = size_of(bytes)?;
    let mut label = Group::default();
    read(bytes.get(..size.min(MAX_LABEL))?, &mut label);
    if label.text("EOL") == Some("1")
        && let Some(rest) = end_label(&label, bytes, size)
    {
        read(rest, &mut label);
    }
    Some(label)
}

fn size_of(bytes: &[u8]) -> Option<usize> {
    let digits = bytes.get("LBLSIZE=".len()..)?;
    let length = digits
        .iter()
        .take(9)
        .take_while(|byte| byte.is_ascii_digit())
        .count();
    std::str::from_utf8(&digits[..length]).ok()?.parse().ok()
}

/// Returns the label's continuation, after all records of the image.
fn end_label<'a>(label: &Group, bytes: &'a [u8], size: usize) -> Option<&'a [u8]> {
    let number = |key: &str| label.text(key)?.parse::<usize>().ok();
    let records = match label.text("ORG")? {
        "BIP" => number("N2")?.checked_mul(number("N3")?)?,
        _ => number("NL")?.checked_mul(number("NB")?)?,
    };
    let records = records.checked_add(number("NLB").unwrap_or(0))?;
    let start = size.checked_add(records.checked_mul(number("RECSIZE")?)?)?;
    let rest = bytes.get(start..)?;
    let length = size_of(rest)?;
    rest.get(..length.min(rest.len()).min(MAX_LABEL))
}

/// Adds items to `label`. `PROPERTY='X'` and `TASK='X'` begin a group.
fn read(text: &[u8], label: &mut Group) {
    let mut reader = Reader { text, at: 0 };
    let mut group = std::mem::take(label);
    let mut done: Vec<Group> = std::mem::take(&mut group.groups);
    let mut system = None;
    for _ in 0..MAX_ITEMS {
        let Some((key, value)) = reader.item() else { break };
        if key == "PROPERTY" || key == "TASK" {
            let name = value.text().unwrap_or_default().to_ascii_uppercase();
            let next = Group {
                name,
                ..Group::default()
            };
            let previous = std::mem::replace(&mut group, next);
            match system {
                None => system = Some(previous),
                Some(_) => done.push(previous),
            }
        } else {
            group.entries.push((key, value));
        }
    }
    *label = match system {
        None => group,
        Some(system) => {
            done.push(group);
            system
        }
    };
    label.groups = done;
}

struct Reader<'a> {
    text: &'a [u8],
    at: usize,
}

impl Reader<'_> {
    fn peek(&self) -> Option<u8> {
        self.text.get(self.at).copied().filter(|byte| *byte != 0)
    }

    fn skip_blank(&mut self) {
        while self.peek().is_some_and(|byte| byte.is_ascii_whitespace()) {
            self.at += 1;
        }
    }

    /// Reads one `KEY=value`. `None` at the end or without an item.
    fn item(&mut self) -> Option<(String, Value)> {
        self.skip_blank();
        let start = self.at;
        while self
            .peek()
            .is_some_and(|byte| byte.is_ascii_alphanumeric() || byte == b'_')
        {
            self.at += 1;
        }
        let key = String::from_utf8_lossy(&self.text[start..self.at]).to_ascii_uppercase();
        self.skip_blank();
        if key.is_empty() || self.peek() != Some(b'=') {
            return None;
        }
        self.at += 1;
        self.skip_blank();
        let value = if self.peek() == Some(b'(') {
            self.list()?
        } else {
            Value::Text(self.scalar()?)
        };
        Some((key, value))
    }

    fn list(&mut self) -> Option<Value> {
        self.at += 1;
        let mut items = Vec::new();
        loop {
            self.skip_blank();
            match self.peek()? {
                b')' => {
                    self.at += 1;
                    return Some(Value::List(items));
                }
                b',' => self.at += 1,
                _ => items.push(Value::Text(self.scalar()?)),
            }
        }
    }

    /// Reads a number, word, or text in single quotes (a doubled quote is one).
    fn scalar(&mut self) -> Option<String> {
        let mut text = Vec::new();
        if self.peek()? == b'\'' {
            loop {
                self.at += 1;
                match self.peek()? {
                    b'\'' if self.text.get(self.at + 1) == Some(&b'\'') => {
                        self.at += 1;
                        text.push(b'\'');
                    }
                    b'\'' => break,
                    byte => text.push(byte),
                }
            }
            self.at += 1;
        } else {
            while let Some(byte) = self
                .peek()
                .filter(|byte| !byte.is_ascii_whitespace() && !b",()".contains(byte))
            {
                text.push(byte);
                self.at += 1;
            }
            if text.is_empty() {
                return None;
            }
        }
        Some(String::from_utf8_lossy(&text).trim().to_owned())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn demo(eol: u8) -> Vec<u8> {
        let items = format!(
            "FORMAT='HALF'  TYPE='IMAGE'  EOL={eol}  RECSIZE=16  ORG='BSQ'  NL=2  NS=8  NB=1  NLB=0  \
             PROPERTY='GEOMETRIC_CAMERA_MODEL'  MODEL_TYPE='CAHV'  MODEL_COMPONENT_1=(1.0,2.0, -3.5)  \
             TASK='IT''S'  USER='me'"
        );
        let mut label = format!("LBLSIZE=320  {items}").into_bytes();
        label.resize(320, 0);
        label.resize(352, 7);
        label
    }

    #[test]
    fn items_and_properties_are_read() {
        let label = parse(&demo(0)).unwrap();
        assert_eq!(
            (label.text("NL"), label.text("FORMAT")),
            (Some("2"), Some("HALF"))
        );
        let camera = label.find(&["GEOMETRIC_CAMERA_MODEL"]).unwrap();
        assert_eq!(
            camera.get("MODEL_COMPONENT_1").unwrap().numbers(),
            Some([1.0, 2.0, -3.5])
        );
        assert_eq!(label.find(&["IT'S"]).unwrap().text("USER"), Some("me"));
    }

    #[test]
    fn a_label_continued_at_the_end_is_read() {
        let mut bytes = demo(1);
        bytes.extend_from_slice(b"LBLSIZE=48  PROPERTY='MORE'  SOL=12             ");
        let label = parse(&bytes).unwrap();
        assert_eq!(label.find(&["MORE"]).unwrap().text("SOL"), Some("12"));
        assert_eq!(label.text("NL"), Some("2"));
    }

    #[test]
    fn hostile_labels_end() {
        let whole = demo(1);
        for cut in 0..whole.len() {
            let _ = parse(&whole[..cut]);
        }
        for bad in [
            "",
            "LBLSIZE=",
            "LBLSIZE=99999999999999999999",
            "LBLSIZE=9 A=(((((",
            "LBLSIZE=20 A=''''''''''",
        ] {
            let _ = parse(bad.as_bytes());
        }
        assert_eq!(parse(b"PDS_VERSION_ID"), None);
    }
}
