//! The text form: one record a line, `#` starts a comment, an image takes two lines.

use std::collections::BTreeMap;
use std::str::FromStr;

use marf_scene::Point;

use super::record::{Image, lens};
use crate::import::cameras::ImportError;
use crate::import::lens::Lens;
use crate::import::paths::BYTE_ORDER_MARK;

/// The words of a line.
struct Words<'a> {
    file: &'a str,
    place: String,
    rest: &'a str,
}

impl<'a> Words<'a> {
    /// Returns an error at this line.
    fn fail(&self, problem: impl Into<String>) -> ImportError {
        ImportError::new(self.file, &self.place, problem)
    }

    /// Returns the next word.
    fn word(&mut self, what: &str) -> Result<&'a str, ImportError> {
        let rest = self.rest.trim_ascii_start();
        let (word, rest) = rest.split_at(
            rest.find(|letter: char| letter.is_ascii_whitespace())
                .unwrap_or(rest.len()),
        );
        self.rest = rest;
        let is_word = !word.is_empty();
        is_word
            .then_some(word)
            .ok_or_else(|| self.fail(format!("the line ends before {what}")))
    }

    /// Returns the next word as a number.
    fn number<T: FromStr>(&mut self, what: &str) -> Result<T, ImportError> {
        let word = self.word(what)?;
        word.parse()
            .map_err(|_| self.fail(format!("`{word}` is not {what}")))
    }

    fn floats<const N: usize>(&mut self, what: &str) -> Result<[f64; N], ImportError> {
        let mut floats = [0.0; N];
        for float in &mut floats {
            *float = self.number(what)?;
        }
        Ok(floats)
    }
}

/// Lines without comments, with their numbers.
fn lines<'a>(file: &'a str, bytes: &'a [u8]) -> Result<impl Iterator<Item = Words<'a>>, ImportError> {
    let bytes = bytes.strip_prefix(BYTE_ORDER_MARK).unwrap_or(bytes);
    let text = std::str::from_utf8(bytes).map_err(|_| ImportError::new(file, "", "not UTF-8 text"))?;
    let records = text
        .lines()
        .enumerate()
        .filter(|(_, line)| !line.starts_with('#'));
    Ok(records.map(move |(index, line)| Words {
        file,
        place: format!("line {}", index + 1),
        rest: line,
    }))
}

fn is_blank(line: &Words<'_>) -> bool {
    line.rest.trim_ascii().is_empty()
}

/// Reads cameras.txt.
pub(super) fn lenses(file: &str, bytes: &[u8]) -> Result<BTreeMap<u32, Lens>, ImportError> {
    let mut lenses = BTreeMap::new();
    for mut line in lines(file, bytes)?.filter(|line| !is_blank(line)) {
        let id = line.number("the camera's number")?;
        let name = line.word("the lens")?;
        let size = [line.number("the width")?, line.number("the height")?];
        let mut params = Vec::new();
        while !is_blank(&line) {
            params.push(line.number("a parameter of the lens")?);
        }
        lenses.insert(
            id,
            lens(name, size, &params).map_err(|problem| line.fail(problem))?,
        );
    }
    Ok(lenses)
}

/// Reads images.txt.
pub(super) fn images(file: &str, bytes: &[u8]) -> Result<Vec<Image>, ImportError> {
    let mut images = Vec::new();
    let mut lines = lines(file, bytes)?;
    while let Some(mut line) = lines.next() {
        if is_blank(&line) {
            continue;
        }
        line.number::<u32>("the image's number")?;
        let (quaternion, translation) = (line.floats("the rotation")?, line.floats("the translation")?);
        let camera = line.number("the camera's number")?;
        // To the end of the line: a name may hold blanks, also several in a row.
        let name = line.rest.trim_ascii().to_owned();
        if name.is_empty() {
            return Err(line.fail("the line ends before the name"));
        }
        // The features' line may be empty, but it is there.
        let (features, observations) = match lines.next() {
            Some(second) => observations(second)?,
            None => (0, Vec::new()),
        };
        images.push(Image {
            place: line.place,
            quaternion,
            translation,
            camera,
            name,
            features,
            observations,
        });
    }
    Ok(images)
}

/// Number of features, and position and point of those that have one.
type Observations = (u32, Vec<([f64; 2], u64)>);

/// Reads the second line of an image.
fn observations(mut line: Words<'_>) -> Result<Observations, ImportError> {
    let (mut features, mut found) = (0, Vec::new());
    while !is_blank(&line) {
        let position = line.floats("a feature's position")?;
        let point: i64 = line.number("a feature's point")?;
        features += 1;
        if let Ok(point) = u64::try_from(point) {
            found.push((position, point));
        }
    }
    Ok((features, found))
}

/// Reads points3D.txt.
pub(super) fn points(file: &str, bytes: &[u8]) -> Result<BTreeMap<u64, Point>, ImportError> {
    let mut points = BTreeMap::new();
    for mut line in lines(file, bytes)?.filter(|line| !is_blank(line)) {
        let id = line.number("the point's number")?;
        let position: [f64; 3] = line.floats("the position")?;
        let color = [line.number("red")?, line.number("green")?, line.number("blue")?];
        line.floats::<1>("the error")?;
        if position.iter().any(|number| !number.is_finite()) {
            return Err(line.fail(format!("a point at {position:?}")));
        }
        let point = Point {
            position,
            color: Some(color),
            views: (line.rest.split_ascii_whitespace().count() / 2) as u32,
        };
        points.insert(id, point);
    }
    Ok(points)
}
