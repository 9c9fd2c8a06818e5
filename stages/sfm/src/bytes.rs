//! States as bytes, exact to the bit: u64 and f64 in little endian.

use marf_scene::{Camera, Pose};
use nalgebra::{Matrix3, Vector3};

/// Writes a state; it begins with what it is of.
pub(crate) struct Writer(Vec<u8>);

/// Reads what [`Writer`] wrote; every method returns `None` at its end.
pub(crate) struct Reader<'a>(&'a [u8]);

impl Writer {
    /// Begins a state: eight letters that name its form, and the fingerprint of what it is of.
    pub fn new(form: &[u8; 8], of: u64) -> Self {
        let mut writer = Self(form.to_vec());
        writer.count(of);
        writer
    }

    /// Makes space for so many bytes more.
    pub fn reserve(&mut self, bytes: usize) {
        self.0.reserve_exact(bytes);
    }

    pub fn count(&mut self, value: u64) {
        self.0.extend(value.to_le_bytes());
    }

    pub fn number(&mut self, value: f64) {
        self.count(value.to_bits());
    }

    pub fn point(&mut self, point: &Vector3<f64>) {
        point.iter().for_each(|value| self.number(*value));
    }

    pub fn matrix(&mut self, matrix: &Matrix3<f64>) {
        matrix.iter().for_each(|value| self.number(*value));
    }

    pub fn pose(&mut self, pose: &Pose) {
        self.matrix(&pose.rotation);
        self.point(&pose.translation);
    }

    pub fn camera(&mut self, camera: &Camera) {
        self.count(u64::from(camera.width));
        self.count(u64::from(camera.height));
        numbers(camera).into_iter().for_each(|value| self.number(value));
    }

    /// Writes the length of a list and its elements.
    pub fn list<T>(&mut self, list: &[T], mut each: impl FnMut(&mut Self, &T)) {
        self.count(list.len() as u64);
        list.iter().for_each(|one| each(self, one));
    }

    /// Writes an element that may be absent.
    pub fn option<T>(&mut self, one: Option<&T>, each: impl FnOnce(&mut Self, &T)) {
        self.0.push(u8::from(one.is_some()));
        if let Some(one) = one {
            each(self, one);
        }
    }

    pub fn flags(&mut self, flags: &[bool]) {
        self.count(flags.len() as u64);
        let bytes = flags.chunks(8).map(|eight| {
            let bits = eight.iter().zip(0..).map(|(flag, bit)| u8::from(*flag) << bit);
            bits.sum::<u8>()
        });
        self.0.extend(bytes);
    }

    pub fn finish(self) -> Vec<u8> {
        self.0
    }
}

/// Focal lengths, principal point, distortion.
fn numbers(camera: &Camera) -> [f64; 8] {
    [
        camera.fx_px,
        camera.fy_px,
        camera.cx_px,
        camera.cy_px,
        camera.k1,
        camera.k2,
        camera.p1,
        camera.p2,
    ]
}

impl<'a> Reader<'a> {
    /// Begins to read; `None` if the state has another form or is of something else.
    pub fn new(bytes: &'a [u8], form: &[u8; 8], of: u64) -> Option<Self> {
        let mut reader = Self(bytes.strip_prefix(form)?);
        (reader.count()? == of).then_some(reader)
    }

    pub fn count(&mut self) -> Option<u64> {
        let (value, rest) = self.0.split_first_chunk()?;
        self.0 = rest;
        Some(u64::from_le_bytes(*value))
    }

    pub fn index(&mut self) -> Option<usize> {
        usize::try_from(self.count()?).ok()
    }

    pub fn number(&mut self) -> Option<f64> {
        Some(f64::from_bits(self.count()?))
    }

    pub fn point(&mut self) -> Option<Vector3<f64>> {
        Some(Vector3::new(self.number()?, self.number()?, self.number()?))
    }

    pub fn matrix(&mut self) -> Option<Matrix3<f64>> {
        Some(Matrix3::from_columns(&[
            self.point()?,
            self.point()?,
            self.point()?,
        ]))
    }

    pub fn pose(&mut self) -> Option<Pose> {
        Some(Pose {
            rotation: self.matrix()?,
            translation: self.point()?,
        })
    }

    pub fn camera(&mut self) -> Option<Camera> {
        Some(Camera {
            width: u32::try_from(self.count()?).ok()?,
            height: u32::try_from(self.count()?).ok()?,
            fx_px: self.number()?,
            fy_px: self.number()?,
            cx_px: self.number()?,
            cy_px: self.number()?,
            k1: self.number()?,
            k2: self.number()?,
            p1: self.number()?,
            p2: self.number()?,
        })
    }

    /// Reads a list of that length.
    pub fn list<T>(&mut self, length: usize, mut each: impl FnMut(&mut Self) -> Option<T>) -> Option<Vec<T>> {
        if self.index()? != length {
            return None;
        }
        (0..length).map(|_| each(self)).collect()
    }

    /// Reads a list of any length; every element takes at least a byte.
    pub fn any_list<T>(&mut self, each: impl FnMut(&mut Self) -> Option<T>) -> Option<Vec<T>> {
        let (length, _) = self.0.split_first_chunk()?;
        let length = usize::try_from(u64::from_le_bytes(*length)).ok()?;
        if length > self.0.len() {
            return None;
        }
        self.list(length, each)
    }

    pub fn option<T>(&mut self, each: impl FnOnce(&mut Self) -> Option<T>) -> Option<Option<T>> {
        let (is_some, rest) = self.0.split_first()?;
        self.0 = rest;
        match is_some {
            0 => Some(None),
            1 => Some(Some(each(self)?)),
            _ => None,
        }
    }

    pub fn flags(&mut self, length: usize) -> Option<Vec<bool>> {
        if self.index()? != length {
            return None;
        }
        let (bytes, rest) = self.0.split_at_checked(length.div_ceil(8))?;
        self.0 = rest;
        let bit = |index: usize| bytes[index / 8] >> (index % 8) & 1 == 1;
        Some((0..length).map(bit).collect())
    }

    /// Ends reading; `None` if something is left.
    pub fn end(&self) -> Option<()> {
        self.0.is_empty().then_some(())
    }
}

/// A fingerprint of numbers: two that differ in one bit of one number have different ones but for one in 2^64.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Fingerprint(u64);

impl Fingerprint {
    pub fn new() -> Self {
        Self(0x9e37_79b9_7f4a_7c15)
    }

    /// Adds a number (splitmix64).
    pub fn add(&mut self, value: u64) {
        let mut mixed = (self.0 ^ value).wrapping_add(0x9e37_79b9_7f4a_7c15);
        mixed = (mixed ^ mixed >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        mixed = (mixed ^ mixed >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
        self.0 = mixed ^ mixed >> 31;
    }

    /// Adds the bytes of a state, eight at a time, with their number.
    pub fn add_state(&mut self, writer: Writer) {
        let bytes = writer.finish();
        let (words, rest) = bytes.as_chunks::<8>();
        words.iter().for_each(|word| self.add(u64::from_le_bytes(*word)));
        rest.iter().for_each(|byte| self.add(u64::from(*byte)));
        self.add(bytes.len() as u64);
    }

    pub fn value(self) -> u64 {
        self.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FORM: &[u8; 8] = b"a form 1";

    #[test]
    fn a_state_comes_back_to_the_bit_and_a_cut_or_foreign_one_does_not() {
        let flags: Vec<bool> = (0..19).map(|index| index % 3 == 0).collect();
        let camera = Camera {
            k1: -0.0,
            p2: f64::MIN_POSITIVE / 4.0,
            ..Camera::pinhole(640, 480, 500.1)
        };
        let pose = Pose {
            rotation: Matrix3::new(0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 0.1 + 0.2),
            translation: Vector3::new(1e300, -1e-300, 0.0),
        };
        let mut writer = Writer::new(FORM, 7);
        writer.flags(&flags);
        writer.camera(&camera);
        writer.option(Some(&pose), Writer::pose);
        writer.option::<Pose>(None, Writer::pose);
        writer.list(&[1.0, f64::INFINITY], |writer, value| writer.number(*value));
        let bytes = writer.finish();
        let read = |bytes: &[u8], of: u64| {
            let mut reader = Reader::new(bytes, FORM, of)?;
            let read = (
                reader.flags(19)?,
                reader.camera()?,
                reader.option(Reader::pose)?,
                reader.option(Reader::pose)?,
                reader.any_list(Reader::number)?,
            );
            reader.end()?;
            Some(read)
        };
        let whole = (flags, camera, Some(pose), None, vec![1.0, f64::INFINITY]);
        assert_eq!(read(&bytes, 7), Some(whole));
        assert_eq!(read(&bytes, 8), None);
        for length in 0..bytes.len() {
            assert_eq!(read(&bytes[..length], 7), None, "{length} bytes");
        }
        assert_eq!(read(&[&bytes[..], &[0]].concat(), 7), None);
        let huge = [FORM.as_slice(), &7_u64.to_le_bytes(), &[0xff; 8]].concat();
        let mut reader = Reader::new(&huge, FORM, 7).unwrap();
        assert_eq!(reader.any_list(Reader::number), None);
    }

    #[test]
    fn a_fingerprint_knows_every_bit_and_the_order() {
        let of = |values: &[u64]| {
            let mut found = Fingerprint::new();
            values.iter().for_each(|value| found.add(*value));
            found
        };
        for bit in 0..64 {
            assert_ne!(of(&[1, 2, 3]), of(&[1, 2 ^ 1 << bit, 3]), "bit {bit}");
        }
        assert_ne!(of(&[1, 2]), of(&[2, 1]));
        assert_ne!(of(&[0]), of(&[0, 0]));
    }
}
