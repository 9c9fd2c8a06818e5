use crate::Point;

/// Longest header. Those of other programs stay below 2 KB.
const MAX_HEADER_BYTES: usize = 64 * 1024;

/// A PLY file that cannot be read.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{problem}")]
pub struct PlyError {
    /// Line of the header, or the vertex. Empty for the whole file.
    pub place: String,
    /// The fault, with the value.
    pub problem: String,
}

impl PlyError {
    fn new(place: impl Into<String>, problem: impl Into<String>) -> Self {
        Self {
            place: place.into(),
            problem: problem.into(),
        }
    }

    /// Returns the error of the whole file.
    fn whole(problem: impl Into<String>) -> Self {
        Self::new("", problem)
    }
}

/// Reads the vertices of a PLY file as points, in their order.
///
/// Forms `ascii` and `binary_little_endian`, version 1.0, lines ending in LF or CRLF. A vertex has x, y, z as float or double. Red, green
/// and blue are read if all three are uchar. Other scalars are skipped, and so are elements before and after the vertices. The number of
/// photos that see a point is not known: `views` is 0.
///
/// # Errors
/// Names the line of the header, or the vertex. Refused are another form, a header without end within 64 KiB, missing x, y, z, and a list
/// at or before the vertices. So are a file shorter than its counts or longer than its last vertex, and a coordinate that is NaN or
/// infinite. No memory is reserved for a count before the file is known to have it.
pub fn read_points(bytes: &[u8]) -> Result<Vec<Point>, PlyError> {
    let header = Header::read(bytes)?;
    let (vertex, before) = match header.elements.split_last() {
        Some((last, before)) if last.name == "vertex" => (last, before),
        _ => return Err(PlyError::whole("has no element `vertex`")),
    };
    let layout = Layout::new(vertex).map_err(PlyError::whole)?;
    let body = bytes.get(header.body..).unwrap_or_default();
    let form = header
        .form
        .ok_or_else(|| PlyError::whole("has no line `format`"))?;
    let skipped = skipped(form, before, vertex, body.len()).map_err(PlyError::whole)?;
    let read = match form {
        Form::Ascii => ascii(vertex, &layout, body, skipped),
        Form::LittleEndian => binary(vertex, &layout, body, skipped),
    }?;
    if read.left_bytes > 0 && header.more == More::Nothing {
        let problem = format!("{} bytes after the last vertex", read.left_bytes);
        return Err(PlyError::whole(problem));
    }
    Ok(read.points)
}

/// How the body is written.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Form {
    Ascii,
    LittleEndian,
}

/// Type of a property.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Scalar {
    Float,
    Double,
    Uchar,
    /// One that is only skipped, of this many bytes.
    Other(usize),
}

impl Scalar {
    /// Returns the type of a name.
    fn named(name: &str) -> Option<Self> {
        Some(match name {
            "float" | "float32" => Self::Float,
            "double" | "float64" => Self::Double,
            "uchar" | "uint8" => Self::Uchar,
            "char" | "int8" => Self::Other(1),
            "short" | "int16" | "ushort" | "uint16" => Self::Other(2),
            "int" | "int32" | "uint" | "uint32" => Self::Other(4),
            _ => return None,
        })
    }

    /// Returns its size.
    fn bytes(self) -> usize {
        match self {
            Self::Float => 4,
            Self::Double => 8,
            Self::Uchar => 1,
            Self::Other(bytes) => bytes,
        }
    }
}

/// A kind of record, its count as announced.
struct Element {
    name: String,
    count: u64,
    properties: Vec<(String, Scalar)>,
}

impl Element {
    /// Bytes of a record. For a text it is the least number: a character and a separator for each property.
    fn width(&self, form: Form) -> usize {
        match form {
            Form::Ascii => 2 * self.properties.len(),
            Form::LittleEndian => self.properties.iter().map(|(_, scalar)| scalar.bytes()).sum(),
        }
    }
}

/// Whether anything follows the vertices.
#[derive(Clone, Copy, PartialEq, Eq)]
enum More {
    Nothing,
    Elements,
}

/// The header, up to the body.
struct Header {
    form: Option<Form>,
    /// Elements up to and with the vertices.
    elements: Vec<Element>,
    more: More,
    /// Where the body begins.
    body: usize,
}

impl Header {
    /// Reads the header.
    fn read(bytes: &[u8]) -> Result<Self, PlyError> {
        let head = bytes.get(..MAX_HEADER_BYTES).unwrap_or(bytes);
        let mut header = Self {
            form: None,
            elements: Vec::new(),
            more: More::Nothing,
            body: 0,
        };
        let lines = head.split_inclusive(|byte| *byte == b'\n');
        // A last line without its end is one that was cut.
        for (index, line) in lines.filter(|line| line.ends_with(b"\n")).enumerate() {
            header.body += line.len();
            let text = String::from_utf8_lossy(line);
            let words: Vec<&str> = text.split_ascii_whitespace().collect();
            let read = match (index, words.as_slice()) {
                (0, ["ply"]) => Ok(()),
                (0, _) => Err("no PLY file: it does not begin with `ply`".to_owned()),
                (_, ["end_header"]) => return Ok(header),
                (_, words) => header.line(words),
            };
            read.map_err(|problem| PlyError::new(format!("line {}", index + 1), problem))?;
        }
        let problem = format!("no `end_header` in its first {} bytes", head.len());
        Err(PlyError::whole(problem))
    }

    /// Reads one line of the header.
    fn line(&mut self, words: &[&str]) -> Result<(), String> {
        match words {
            [] | ["comment" | "obj_info", ..] => Ok(()),
            ["format", form, version] => {
                self.form = Some(form_of(form, version)?);
                Ok(())
            }
            ["element", name, count] => self.element(name, count),
            ["property", ..] if self.more == More::Elements => Ok(()),
            ["property", "list", ..] => {
                Err("a list property, at or before the vertices only scalars are read".to_owned())
            }
            ["property", scalar, name] => self.property(scalar, name),
            words => Err(format!(
                "`{}` is not a line of a PLY header",
                short(&words.join(" "))
            )),
        }
    }

    /// Reads a line `element`.
    fn element(&mut self, name: &str, count: &str) -> Result<(), String> {
        let count = count.parse();
        let count = count.map_err(|_| format!("`{name}` has no count that can be read"))?;
        if self.elements.last().is_some_and(|last| last.name == "vertex") {
            self.more = More::Elements;
            return Ok(());
        }
        self.elements.push(Element {
            name: name.to_owned(),
            count,
            properties: Vec::new(),
        });
        Ok(())
    }

    /// Reads a line `property`.
    fn property(&mut self, scalar: &str, name: &str) -> Result<(), String> {
        let read = Scalar::named(scalar);
        let scalar = read.ok_or_else(|| format!("`{}` is not a type of a property", short(scalar)))?;
        let element = self.elements.last_mut();
        let element = element.ok_or_else(|| "a property of no element".to_owned())?;
        if element.properties.iter().any(|(known, _)| known == name) {
            return Err(format!("the property `{}` comes twice", short(name)));
        }
        element.properties.push((name.to_owned(), scalar));
        Ok(())
    }
}

/// Returns the form of a line `format`.
fn form_of(form: &str, version: &str) -> Result<Form, String> {
    match (form, version) {
        ("ascii", "1.0") => Ok(Form::Ascii),
        ("binary_little_endian", "1.0") => Ok(Form::LittleEndian),
        _ => Err(format!(
            "the form `{} {}` is not read: supported are ascii 1.0 and binary_little_endian 1.0",
            short(form),
            short(version)
        )),
    }
}

/// A word cut where it would flood a line.
fn short(word: &str) -> &str {
    word.char_indices().nth(40).map_or(word, |(cut, _)| &word[..cut])
}

/// Place of a property in a record.
#[derive(Clone, Copy)]
struct Column {
    index: usize,
    offset: usize,
    scalar: Scalar,
}

/// The columns that are read.
struct Layout {
    position: [Column; 3],
    color: Option<[Column; 3]>,
}

impl Layout {
    /// Returns the columns of a vertex.
    fn new(vertex: &Element) -> Result<Self, String> {
        let find = |name: &str| {
            let index = vertex.properties.iter().position(|(known, _)| known == name)?;
            let before = vertex.properties.iter().take(index);
            Some(Column {
                index,
                offset: before.map(|(_, scalar)| scalar.bytes()).sum(),
                scalar: vertex.properties.get(index)?.1,
            })
        };
        let axis = |name: &str| match find(name) {
            Some(column) if matches!(column.scalar, Scalar::Float | Scalar::Double) => Ok(column),
            Some(_) => Err(format!("`{name}` of its vertices is neither float nor double")),
            None => Err(format!("its vertices have no `{name}`")),
        };
        let band = |name: &str| find(name).filter(|column| column.scalar == Scalar::Uchar);
        Ok(Self {
            position: [axis("x")?, axis("y")?, axis("z")?],
            color: band("red")
                .zip(band("green"))
                .zip(band("blue"))
                .map(|((red, green), blue)| [red, green, blue]),
        })
    }

    /// Returns the point of a vertex.
    fn point(&self, record: &Record<'_>) -> Result<Point, String> {
        let [x, y, z] = self.position.map(|column| record.number(column));
        let position = [x?, y?, z?];
        if position.iter().any(|number| !number.is_finite()) {
            return Err(format!("a point at {position:?}"));
        }
        let color = self.color.map(|bands| {
            let [red, green, blue] = bands.map(|column| record.number(column));
            Ok::<_, String>([red?, green?, blue?].map(|band| band as u8))
        });
        Ok(Point {
            position,
            color: color.transpose()?,
            views: 0,
        })
    }
}

/// A vertex as it is in the file, of the length of its element.
enum Record<'a> {
    Words(Vec<&'a str>),
    Bytes(&'a [u8]),
}

impl Record<'_> {
    fn number(&self, column: Column) -> Result<f64, String> {
        match self {
            Self::Words(words) => text_number(words[column.index], column.scalar),
            Self::Bytes(bytes) => Ok(byte_number(&bytes[column.offset..], column.scalar)),
        }
    }
}

/// Returns a word as a number.
fn text_number(word: &str, scalar: Scalar) -> Result<f64, String> {
    let number = match scalar {
        Scalar::Uchar => word.parse::<u8>().ok().map(f64::from),
        _ => word.parse().ok(),
    };
    number.ok_or_else(|| format!("`{}` is not a number of its property", short(word)))
}

/// The number that the bytes begin with. Only positions and colours are read.
fn byte_number(bytes: &[u8], scalar: Scalar) -> f64 {
    let (mut single, mut double) = ([0; 4], [0; 8]);
    match scalar {
        Scalar::Float => {
            single.copy_from_slice(&bytes[..4]);
            f64::from(f32::from_le_bytes(single))
        }
        Scalar::Double => {
            double.copy_from_slice(&bytes[..8]);
            f64::from_le_bytes(double)
        }
        Scalar::Uchar | Scalar::Other(_) => f64::from(bytes[0]),
    }
}

/// Returns the length of the elements before the vertices: bytes, or for a text the lines that are not empty.
///
/// Refuses counts that the body is too short for.
fn skipped(form: Form, before: &[Element], vertex: &Element, there: usize) -> Result<usize, String> {
    let bytes = |element: &Element| element.count.checked_mul(element.width(form) as u64);
    let sum = |elements: &[Element]| {
        let mut sizes = elements.iter().map(bytes);
        sizes.try_fold(0, |sum: u64, size| sum.checked_add(size?))
    };
    let earlier = sum(before);
    let needed = earlier
        .zip(bytes(vertex))
        .and_then(|(earlier, own)| earlier.checked_add(own));
    // The last line of a text may lack its end.
    let most = there as u64 + u64::from(form == Form::Ascii);
    if needed.is_none_or(|needed| needed > most) {
        return Err(format!(
            "{} vertices of {} or more bytes are announced, {there} bytes follow the header",
            vertex.count,
            vertex.width(form)
        ));
    }
    let filled = before.iter().filter(|element| !element.properties.is_empty());
    Ok(match form {
        Form::Ascii => filled.map(|element| element.count as usize).sum(),
        Form::LittleEndian => earlier.unwrap_or(0) as usize,
    })
}

/// The vertices of a body.
struct Vertices {
    points: Vec<Point>,
    /// Bytes that follow them.
    left_bytes: usize,
}

/// Reads vertices of a binary body.
fn binary(vertex: &Element, layout: &Layout, body: &[u8], skipped: usize) -> Result<Vertices, PlyError> {
    let width = vertex.width(Form::LittleEndian);
    // `skipped` has found the body long enough for both.
    let (own, after) = body[skipped..].split_at(vertex.count as usize * width);
    let points = own.chunks_exact(width).enumerate().map(|(index, record)| {
        let point = layout.point(&Record::Bytes(record));
        point.map_err(|problem| PlyError::new(format!("vertex {index}"), problem))
    });
    Ok(Vertices {
        points: points.collect::<Result<_, _>>()?,
        left_bytes: after.len(),
    })
}

/// Reads vertices of a text body.
fn ascii(vertex: &Element, layout: &Layout, body: &[u8], skipped: usize) -> Result<Vertices, PlyError> {
    let columns = vertex.properties.len();
    let text = std::str::from_utf8(body).map_err(|_| PlyError::whole("its body is not text"))?;
    let mut lines = text
        .lines()
        .filter(|line| !line.trim_ascii().is_empty())
        .skip(skipped);
    let points = (0..vertex.count).map(|index| {
        let fail = |problem: String| PlyError::new(format!("vertex {index}"), problem);
        let line = lines.next();
        let line = line.ok_or_else(|| fail(format!("the file ends, {} are announced", vertex.count)))?;
        let words: Vec<&str> = line.split_ascii_whitespace().take(columns + 1).collect();
        if words.len() != columns {
            return Err(fail(format!("a line of other than {columns} numbers")));
        }
        layout.point(&Record::Words(words)).map_err(fail)
    });
    Ok(Vertices {
        points: points.collect::<Result<_, _>>()?,
        left_bytes: lines.map(str::len).sum(),
    })
}

#[cfg(test)]
mod tests;
