//! The index of a PDS3 volume: a label that describes the columns of a fixed-width text table.

use std::io::{self, BufReader, Read};

use crate::label::MAX_LABEL_BYTES;
use crate::listing::is_plain;
use crate::odl::{self, Group, OdlError};
use crate::values;

/// Longest row that is read, bytes. The longest known row has some thousand.
const MAX_ROW_BYTES: usize = 1 << 16;
/// Most columns.
const MAX_COLUMNS: usize = 2_000;

/// The description of a table by its label.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Index {
    /// Name of the table's file, if the label says.
    pub file: Option<String>,
    /// Rows that the table has, if the label says.
    pub rows: Option<u64>,
    row_bytes: usize,
    columns: Vec<Column>,
}

#[derive(Debug, Clone, PartialEq, Eq)]
struct Column {
    /// Upper case.
    name: String,
    /// Index of the first byte, from 0.
    start: usize,
    bytes: usize,
}

/// An index that cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum IndexError {
    /// The label is not ODL.
    #[error("index {0}")]
    Odl(#[from] OdlError),
    /// The label is larger than any.
    #[error("an index label of {0} bytes, at most {MAX_LABEL_BYTES} are read")]
    TooLarge(usize),
    /// The label describes no text table, or not completely.
    #[error("index label: {0}")]
    Label(String),
    /// A row that does not fit the label.
    #[error("index table row {row}: {what}")]
    Row {
        /// Row, from 1.
        row: u64,
        /// What is wrong there.
        what: String,
    },
    /// The table has fewer rows than its label says.
    #[error("index table ends after {has} rows, its label says {said}")]
    Short {
        /// Rows that there are.
        has: u64,
        /// Rows that the label says.
        said: u64,
    },
    /// The table cannot be read further.
    #[error("index table row {row}: cannot be read: {error}")]
    Io {
        /// Row, from 1.
        row: u64,
        /// Why.
        error: std::io::ErrorKind,
    },
}

impl Index {
    /// Reads an index label: the first object with columns.
    ///
    /// # Errors
    /// What it lacks, or the column that does not fit.
    pub fn from_label(label: &[u8]) -> Result<Self, IndexError> {
        if label.len() > MAX_LABEL_BYTES {
            return Err(IndexError::TooLarge(label.len()));
        }
        let odl = odl::parse(label)?;
        let is_column = |group: &&Group| group.name == "COLUMN";
        let refuse = |what: &str| IndexError::Label(what.to_owned());
        let below = odl.descendants();
        let table = below
            .into_iter()
            .find(|group| group.name.ends_with("TABLE") && group.groups.iter().any(|inner| is_column(&inner)))
            .ok_or_else(|| refuse("no table with columns"))?;
        let form = table.text("INTERCHANGE_FORMAT").unwrap_or("ASCII");
        if !form.eq_ignore_ascii_case("ASCII") {
            return Err(IndexError::Label(format!("a table of {form:.20}, not of text")));
        }
        let row_bytes = size(table, "ROW_BYTES")
            .filter(|bytes| (2..=MAX_ROW_BYTES).contains(bytes))
            .ok_or_else(|| IndexError::Label(format!("ROW_BYTES is not 2 to {MAX_ROW_BYTES}")))?;
        let columns: Result<Vec<_>, _> = table
            .groups
            .iter()
            .filter(is_column)
            .take(MAX_COLUMNS)
            .map(|group| Column::from_group(group, row_bytes))
            .collect();
        Ok(Self {
            file: odl.get(&format!("^{}", table.name)).and_then(file_name),
            rows: table
                .text("ROWS")
                .and_then(|rows| u64::try_from(values::integer(rows)?).ok()),
            row_bytes,
            columns: columns?,
        })
    }

    /// Reads a table row by row. It may be larger than memory.
    ///
    /// After the first error there are no more rows. A table with fewer or more rows than in its label is an error
    /// after the last one.
    pub fn rows<R: Read>(&self, table: R) -> Rows<'_, R> {
        Rows {
            index: self,
            table: BufReader::with_capacity(1 << 16, table),
            row: 0,
            done: false,
        }
    }

    fn column(&self, name: &str) -> Option<&Column> {
        self.columns.iter().find(|column| column.name == name)
    }
}

impl Column {
    fn from_group(group: &Group, row_bytes: usize) -> Result<Self, IndexError> {
        let name = group.text("NAME").unwrap_or_default().to_ascii_uppercase();
        let place = size(group, "START_BYTE").zip(size(group, "BYTES"));
        let fits = |(start, bytes): &(usize, usize)| {
            *start > 0 && start.checked_add(*bytes).is_some_and(|end| end - 1 <= row_bytes)
        };
        match place.filter(fits) {
            Some((start, bytes)) => Ok(Self {
                name,
                start: start - 1,
                bytes,
            }),
            None => Err(IndexError::Label(format!(
                "column `{name:.40}` does not fit a row of {row_bytes} bytes"
            ))),
        }
    }
}

fn size(group: &Group, key: &str) -> Option<usize> {
    usize::try_from(values::integer(group.text(key)?)?).ok()
}

/// Returns the file of a pointer (`"EDRINDEX.TAB"` or `("EDRINDEX.TAB", 1)`), if it is a plain name.
fn file_name(pointer: &odl::Value) -> Option<String> {
    let name = pointer.items().first()?.text()?;
    is_plain(name.as_bytes()).then(|| name.to_owned())
}

/// The rows of a table, see [`Index::rows`].
pub struct Rows<'a, R> {
    index: &'a Index,
    table: BufReader<R>,
    /// Rows read so far.
    row: u64,
    done: bool,
}

impl<'a, R: Read> Iterator for Rows<'a, R> {
    type Item = Result<Row<'a>, IndexError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.done {
            return None;
        }
        let row = self.row();
        self.done = !matches!(row, Ok(Some(_)));
        row.transpose()
    }
}

impl<'a, R: Read> Rows<'a, R> {
    fn row(&mut self) -> Result<Option<Row<'a>>, IndexError> {
        let row = self.row + 1;
        let mut bytes = Vec::with_capacity(self.index.row_bytes);
        let wanted = self.index.row_bytes as u64;
        let read = io::copy(&mut self.table.by_ref().take(wanted), &mut bytes);
        read.map_err(|error| IndexError::Io {
            row,
            error: error.kind(),
        })?;
        if bytes.is_empty() {
            return match self.index.rows {
                Some(said) if said > self.row => Err(IndexError::Short { has: self.row, said }),
                _ => Ok(None),
            };
        }
        let refuse = |what: String| Err(IndexError::Row { row, what });
        let line_end = bytes.iter().position(|byte| *byte == b'\n').map(|end| end + 1);
        if line_end != Some(self.index.row_bytes) {
            let has = line_end.map_or(format!("{} without line end", bytes.len()), |end| end.to_string());
            return refuse(format!("{has} bytes, its label says {wanted}"));
        }
        if self.index.rows.is_some_and(|said| row > said) {
            return refuse("beyond the rows that its label says".to_owned());
        }
        self.row = row;
        // The encoding of bytes beyond ASCII is unknown: they are replaced.
        let text = bytes
            .into_iter()
            .map(|byte| if byte.is_ascii() { char::from(byte) } else { '?' });
        Ok(Some(Row {
            index: self.index,
            text: text.collect(),
        }))
    }
}

/// One row of a table.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Row<'a> {
    index: &'a Index,
    /// ASCII.
    text: String,
}

/// Where a product is stored, as far as the index says.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct ProductLocation {
    /// Volume.
    pub volume: Option<String>,
    /// Folder in the volume, parts joined by `/`, without `/` at either end. Each part is a plain name.
    pub path: Option<String>,
    /// File name, a plain name.
    pub file: Option<String>,
    /// Product id.
    pub product: Option<String>,
    /// Sol.
    pub sol: Option<u32>,
    /// Instrument.
    pub instrument: Option<String>,
}

impl Row<'_> {
    /// Returns a column without the blanks and quotes around it. `None` if the label has no such column.
    pub fn text(&self, column: &str) -> Option<&str> {
        let column = self.index.column(column)?;
        let cell = self.text.get(column.start..column.start + column.bytes)?.trim();
        let inner = cell.strip_prefix('"').unwrap_or(cell);
        Some(inner.strip_suffix('"').unwrap_or(inner).trim())
    }

    /// Returns where the product is stored. Paths and names that are not plain are `None`: they are untrusted and
    /// become addresses.
    pub fn location(&self) -> ProductLocation {
        let known = |names: &[&str]| names.iter().find_map(|name| values::known(self.text(name)?));
        let specification = known(&["FILE_SPECIFICATION_NAME"]).map(|whole| whole.replace('\\', "/"));
        let (mut path, mut file) = match specification.as_deref().map(|whole| whole.rsplit_once('/')) {
            Some(Some((path, file))) => (Some(path.to_owned()), Some(file.to_owned())),
            Some(None) => (None, specification),
            None => (None, None),
        };
        path = known(&["PATH_NAME"]).or(path);
        file = known(&["FILE_NAME"]).or(file);
        ProductLocation {
            volume: known(&["VOLUME_ID"]),
            path: path.and_then(|path| plain_path(&path)),
            file: file.filter(|file| is_plain(file.as_bytes())),
            product: known(&["PRODUCT_ID"]),
            sol: known(&["PLANET_DAY_NUMBER"]).and_then(|sol| values::sol(&sol)),
            instrument: known(&["INSTRUMENT_ID"]),
        }
    }
}

fn plain_path(path: &str) -> Option<String> {
    let path = path.trim_matches('/');
    let plain = path.split('/').all(|part| is_plain(part.as_bytes()));
    plain.then(|| path.to_owned())
}

#[cfg(test)]
mod tests;
