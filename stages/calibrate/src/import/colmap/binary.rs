//! The binary form: little-endian records behind a count.

use std::collections::BTreeMap;

use marf_scene::Point;

use super::record::{Image, LENSES, lens};
use crate::import::cameras::ImportError;
use crate::import::lens::Lens;

/// Longest name of an image.
const MAX_NAME_BYTES: usize = 4096;

/// The unread rest of a file.
struct Bytes<'a> {
    file: &'a str,
    rest: &'a [u8],
}

impl<'a> Bytes<'a> {
    /// Returns the next bytes.
    fn take(&mut self, len: usize, place: &str) -> Result<&'a [u8], ImportError> {
        let ends = || {
            ImportError::new(
                self.file,
                place,
                format!("the file ends {} bytes early", len - self.rest.len()),
            )
        };
        let (head, rest) = self.rest.split_at_checked(len).ok_or_else(ends)?;
        self.rest = rest;
        Ok(head)
    }

    fn array<const N: usize>(&mut self, place: &str) -> Result<[u8; N], ImportError> {
        let mut array = [0; N];
        array.copy_from_slice(self.take(N, place)?);
        Ok(array)
    }

    fn u32(&mut self, place: &str) -> Result<u32, ImportError> {
        Ok(u32::from_le_bytes(self.array(place)?))
    }

    fn u64(&mut self, place: &str) -> Result<u64, ImportError> {
        Ok(u64::from_le_bytes(self.array(place)?))
    }

    fn floats<const N: usize>(&mut self, place: &str) -> Result<[f64; N], ImportError> {
        let mut floats = [0.0; N];
        for float in &mut floats {
            *float = f64::from_le_bytes(self.array(place)?);
        }
        Ok(floats)
    }

    /// A count of records of at least `least` bytes, which must still be there.
    fn count(&mut self, least: u64, place: &str) -> Result<u64, ImportError> {
        let count = self.u64(place)?;
        let there = self.rest.len() as u64;
        if count.checked_mul(least).is_none_or(|bytes| bytes > there) {
            let problem =
                format!("{count} records of {least} or more bytes are announced, {there} bytes are left");
            return Err(ImportError::new(self.file, place, problem));
        }
        Ok(count)
    }

    /// A name that ends with a zero byte.
    fn name(&mut self, place: &str) -> Result<String, ImportError> {
        let fail = |problem: &str| ImportError::new(self.file, place, problem);
        let end = self.rest.iter().take(MAX_NAME_BYTES).position(|byte| *byte == 0);
        let end = end.ok_or_else(|| fail("a name without end"))?;
        let name = std::str::from_utf8(&self.rest[..end]).map_err(|_| fail("a name that is not UTF-8"))?;
        let name = name.to_owned();
        self.rest = &self.rest[end + 1..];
        Ok(name)
    }

    /// Refuses bytes after the last record.
    fn finish(self) -> Result<(), ImportError> {
        if self.rest.is_empty() {
            return Ok(());
        }
        Err(ImportError::new(
            self.file,
            "",
            format!("{} bytes after the last record", self.rest.len()),
        ))
    }
}

/// Reads cameras.bin.
pub(super) fn lenses(file: &str, bytes: &[u8]) -> Result<BTreeMap<u32, Lens>, ImportError> {
    let mut bytes = Bytes { file, rest: bytes };
    let mut lenses = BTreeMap::new();
    for index in 0..bytes.count(24, "")? {
        let place = format!("camera record {index}");
        let (id, model) = (bytes.u32(&place)?, bytes.u32(&place)?);
        let size = [bytes.u64(&place)?, bytes.u64(&place)?];
        let fail = |problem| ImportError::new(file, &place, problem);
        let known = LENSES.get(model as usize);
        let (name, count) = known.ok_or_else(|| fail(format!("the lens number {model} is unknown")))?;
        let mut params = Vec::with_capacity(*count);
        for _ in 0..*count {
            params.extend(bytes.floats::<1>(&place)?);
        }
        lenses.insert(id, lens(name, size, &params).map_err(fail)?);
    }
    bytes.finish()?;
    Ok(lenses)
}

/// Reads images.bin.
pub(super) fn images(file: &str, bytes: &[u8]) -> Result<Vec<Image>, ImportError> {
    let mut bytes = Bytes { file, rest: bytes };
    let mut images = Vec::new();
    for index in 0..bytes.count(73, "")? {
        let place = format!("image record {index}");
        bytes.u32(&place)?;
        let (quaternion, translation) = (bytes.floats(&place)?, bytes.floats(&place)?);
        let (camera, name) = (bytes.u32(&place)?, bytes.name(&place)?);
        let features = bytes.count(24, &place)?;
        let mut observations = Vec::new();
        for _ in 0..features {
            let (position, point) = (bytes.floats(&place)?, bytes.u64(&place)?);
            // u64::MAX means "no point".
            if point != u64::MAX {
                observations.push((position, point));
            }
        }
        images.push(Image {
            place,
            quaternion,
            translation,
            camera,
            name,
            features: u32::try_from(features).unwrap_or(u32::MAX),
            observations,
        });
    }
    bytes.finish()?;
    Ok(images)
}

/// Reads points3D.bin.
pub(super) fn points(file: &str, bytes: &[u8]) -> Result<BTreeMap<u64, Point>, ImportError> {
    let mut bytes = Bytes { file, rest: bytes };
    let mut points = BTreeMap::new();
    for index in 0..bytes.count(51, "")? {
        let place = format!("point record {index}");
        let id = bytes.u64(&place)?;
        let (position, color) = (bytes.floats::<3>(&place)?, bytes.array::<3>(&place)?);
        bytes.floats::<1>(&place)?;
        let views = bytes.count(8, &place)?;
        bytes.take(views as usize * 8, &place)?;
        if position.iter().any(|number| !number.is_finite()) {
            return Err(ImportError::new(file, place, format!("a point at {position:?}")));
        }
        let point = Point {
            position,
            color: Some(color),
            views: u32::try_from(views).unwrap_or(u32::MAX),
        };
        points.insert(id, point);
    }
    bytes.finish()?;
    Ok(points)
}
