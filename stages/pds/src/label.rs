//! The contents that all kinds of labels are read into.

use marf_scene::{Cahvor, CameraPrior, Pose, RoverPlace, Sensor};
use nalgebra::{Matrix3, Vector3};

/// Largest label that is read: real ones have at most 300 kB.
pub const MAX_LABEL_BYTES: usize = 2 << 20;
/// Largest tolerated deviation of a quaternion's length from 1.
const QUATERNION_TOLERANCE: f64 = 1e-3;

/// The contents of a photo's label.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Label {
    /// Product id, as written.
    pub(crate) product: Option<String>,
    /// Sol.
    pub sol: Option<u32>,
    /// Instrument, as the label names it.
    pub instrument: Option<String>,
    /// Colour filter.
    pub filter: Option<String>,
    /// The label calls its photo a thumbnail.
    pub thumbnail: bool,
    /// Whether the camera sees colour.
    pub sensor: Option<Sensor>,
    /// Where the rover stood.
    pub place: Option<RoverPlace>,
    /// Camera model and pose.
    pub prior: Option<CameraPrior>,
    /// Focal length, mm, where the label has it.
    pub(crate) focal_mm: Option<f64>,
    /// Pixels of the detector averaged into one, along one side.
    pub(crate) averaged: u32,
    /// (width, height) of the photo the model is for.
    pub(crate) size: Option<(u32, u32)>,
    /// Where the pixels lie, if the label describes an array.
    pub array: Option<Array>,
    /// What the array's values are, where they are not light.
    pub(crate) derived: Derived,
    /// The file of the array as a whole.
    pub file: FileFacts,
    /// The label says that the pixels of a colour mosaic are interpolated.
    pub interpolated: bool,
    /// Phase of the colour mosaic, if the pixels are not interpolated yet.
    pub mosaic: Option<BayerPhase>,
    /// Where on the detector the photo starts, for mosaics and other photos.
    pub phase: Option<BayerPhase>,
    /// What could not be used, and why.
    pub notes: Vec<String>,
}

/// What the values of a product of geometry are.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct Derived {
    /// Type, as the label names it (`XYZ_MAP`).
    pub kind: Option<String>,
    /// Frame of coordinates and of `origin`, with the counters it is valid for.
    pub place: Option<RoverPlace>,
    /// Point that ranges are measured from, metres.
    pub origin: Option<[f64; 3]>,
}

/// First line and sample of the photo on the detector, 0-based: the phase of its RGGB mosaic.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct BayerPhase {
    /// First line.
    pub line: u32,
    /// First sample.
    pub sample: u32,
}

/// What a label says of a whole file.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct FileFacts {
    /// Its size, bytes.
    pub bytes: Option<u64>,
    /// Its MD5, in lower case.
    pub md5: Option<String>,
}

/// An array of pixels in a file.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Array {
    /// Name of the file, if not the label's own.
    pub file: Option<String>,
    /// Where the first record starts, bytes.
    pub offset: u64,
    /// Bands, lines, samples.
    pub shape: [u32; 3],
    /// How the three are nested.
    pub order: BandStorage,
    /// Type of one sample.
    pub sample: Sample,
    /// Bytes before each record's samples (VICAR's NBB, PDS3's LINE_PREFIX_BYTES).
    pub prefix_bytes: u32,
    /// Bytes after each record's samples.
    pub suffix_bytes: u32,
    /// Significant bits of an unscaled sample, if the label says.
    pub bits: Option<u32>,
    /// Value = stored x scale + offset: of each band, or one for all. Empty if the label does not scale.
    pub scaling: Vec<(f64, f64)>,
    /// Factor that turns radiance scaled to the sun in the zenith back into the measured one.
    pub from_zenith: Option<f64>,
    /// Radiance of a white surface under the sun, W / (m2 sr nm): of each band, or one for all.
    pub sunlight: Vec<f64>,
    /// Stored values that mean "no value", or less light than can be stored.
    pub missing: Vec<f64>,
    /// Stored values that mean more light than can be stored.
    pub saturated: Vec<f64>,
    /// Name of the table that made 8-bit codes of counts, where the label says that the stored values are codes.
    pub companded_by: Option<String>,
    /// What the scaled value is.
    pub quantity: Quantity,
    /// The first line is displayed at the bottom.
    pub upside_down: bool,
    /// The first sample of a line is displayed at the right.
    pub mirrored: bool,
}

impl Array {
    /// Whether pixels are displayed in the order in which they are stored.
    pub fn is_upright(&self) -> bool {
        !self.upside_down && !self.mirrored
    }
}

/// Nesting of bands, lines and samples. The last varies fastest.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum BandStorage {
    /// Band, line, sample.
    #[default]
    BandSequential,
    /// Line, band, sample.
    LineInterleaved,
    /// Line, sample, band.
    PixelInterleaved,
}

/// Type of one stored sample.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Sample {
    /// Integer or float.
    pub kind: SampleKind,
    /// 1, 2, 4 or 8 (4 or 8 for floats).
    pub bytes: u32,
    /// Most significant byte first.
    pub big_endian: bool,
}

/// Kind of number.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum SampleKind {
    /// Unsigned integer.
    #[default]
    Unsigned,
    /// Integer in two's complement.
    Signed,
    /// IEEE 754.
    Float,
}

/// What an array's scaled values are.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Quantity {
    /// Counts of the detector, in proportion to light.
    #[default]
    Counts,
    /// Spectral radiance, W / (m2 sr nm).
    Radiance,
    /// I/F: radiance over that of a white surface under the sun.
    Reflectance,
}

impl Label {
    /// Sets where the rover stood, which holds whether its camera can be used or not.
    pub(crate) fn set_place(&mut self, frame: String, pose: FramePose, counter: Vec<i64>) {
        let site_from_frame = pose.resolve(&mut self.notes);
        self.place = Some(RoverPlace {
            frame,
            site_from_frame,
            motion_counter: counter,
        });
    }

    /// Sets the camera, or adds a note why it cannot be used. The place must have been set and the photo's size read
    /// before: the lens is checked up to its corners.
    pub(crate) fn set_camera(&mut self, model: &Cahvor) {
        let (width, height) = self.size.unwrap_or((1, 1));
        let checked = model.normalised().and_then(|model| {
            model.check_lens(width, height)?;
            Ok(model)
        });
        match checked {
            Ok(model) => {
                let place = self.place.clone();
                self.prior = place.map(|place| CameraPrior {
                    model,
                    frame: place.frame,
                    site_from_frame: place.site_from_frame,
                    motion_counter: place.motion_counter,
                });
            }
            Err(error) => self.refuse_camera(&error),
        }
    }

    /// Drops the camera where pixels are displayed in another direction, with a note.
    pub(crate) fn drop_camera_of_turned_pixels(&mut self) {
        let is_turned = self.array.as_ref().is_some_and(|array| !array.is_upright());
        if is_turned && self.prior.take().is_some() {
            self.notes.push(
                "label has no usable camera: it is for the pixels as stored, and they are displayed in another direction".to_owned(),
            );
        }
    }

    /// Notes that the label's camera cannot be used.
    pub(crate) fn refuse_camera(&mut self, error: &dyn std::error::Error) {
        self.notes.push(format!("label has no usable camera: {error}"));
    }
}

/// The pose of a frame in its site, as a label states it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum FramePose {
    /// The camera is in the site's frame.
    IsSite,
    /// v_site = R(q) v_frame + offset, with q scalar first.
    Given {
        /// Scalar first.
        quaternion: [f64; 4],
        /// Metres.
        offset: [f64; 3],
    },
    /// The label does not say.
    Unknown,
}

impl FramePose {
    pub(crate) fn resolve(self, notes: &mut Vec<String>) -> Option<Pose> {
        match self {
            Self::IsSite => Some(Pose::identity()),
            Self::Unknown => {
                notes.push("label does not place its camera's frame in a site".to_owned());
                None
            }
            Self::Given { quaternion, offset } => {
                let pose = pose(quaternion, offset);
                if pose.is_none() {
                    notes.push(format!("quaternion {quaternion:?} is not of length 1: no pose"));
                }
                pose
            }
        }
    }
}

/// Returns v_site = R(q) v + offset for a quaternion, scalar first, of length 1 within 1e-3.
pub fn pose(quaternion: [f64; 4], offset: [f64; 3]) -> Option<Pose> {
    let length = quaternion.iter().map(|value| value * value).sum::<f64>().sqrt();
    let finite = offset.iter().all(|value| value.is_finite());
    let unit = (length - 1.0).abs() <= QUATERNION_TOLERANCE; // false for NaN
    if !finite || !unit {
        return None;
    }
    let [w, x, y, z] = quaternion.map(|value| value / length);
    let rotation = Matrix3::new(
        1.0 - 2.0 * (y * y + z * z),
        2.0 * (x * y - w * z),
        2.0 * (x * z + w * y),
        2.0 * (x * y + w * z),
        1.0 - 2.0 * (x * x + z * z),
        2.0 * (y * z - w * x),
        2.0 * (x * z - w * y),
        2.0 * (y * z + w * x),
        1.0 - 2.0 * (x * x + y * y),
    );
    Some(Pose {
        rotation,
        translation: Vector3::from(offset),
    })
}

/// Returns counters in the order of [`CameraPrior`]: SITE, DRIVE and POSE first, then the others in the label's
/// order. Empty without SITE, as the first number would be read as SITE.
pub fn ordered_counter(entries: &[(String, i64)]) -> Vec<i64> {
    const FIRST: [&str; 3] = ["SITE", "DRIVE", "POSE"];
    let of = |name: &str| {
        entries
            .iter()
            .find(|(own, _)| own == name)
            .map(|(_, value)| *value)
    };
    if of("SITE").is_none() {
        return Vec::new();
    }
    // Without POSE (Opportunity counts IDD there) the others follow DRIVE in their order.
    let first = FIRST.iter().map_while(|name| of(name));
    let taken = FIRST.iter().take_while(|name| of(name).is_some()).count();
    let others = entries
        .iter()
        .filter(|(name, _)| !FIRST[..taken].contains(&name.as_str()));
    first.chain(others.map(|(_, value)| *value)).collect()
}

/// Whether all of SITE, DRIVE and POSE that both sets have are equal.
pub fn same_place(a: &[(String, i64)], b: &[(String, i64)]) -> bool {
    ["SITE", "DRIVE", "POSE"].iter().all(|name| {
        let of = |entries: &[(String, i64)]| entries.iter().find(|(own, _)| own == name).map(|entry| entry.1);
        of(a).zip(of(b)).is_none_or(|(a, b)| a == b)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn entries(text: &str) -> Vec<(String, i64)> {
        let entry = |(index, name): (usize, &str)| (name.to_owned(), 10 + index as i64);
        text.split_whitespace().enumerate().map(entry).collect()
    }

    #[test]
    fn counters_come_in_the_promised_order() {
        for (names, counter) in [
            ("SITE DRIVE POSE ARM", &[10, 11, 12, 13][..]),
            ("ARM POSE DRIVE SITE", &[13, 12, 11, 10]),
            ("SITE DRIVE IDD PMA", &[10, 11, 12, 13]),
            ("PMA SITE POSE", &[11, 10, 12]),
            ("SITE", &[10]),
            ("DRIVE POSE", &[]),
            ("", &[]),
        ] {
            assert_eq!(ordered_counter(&entries(names)), counter, "{names}");
        }
    }

    #[test]
    fn counters_that_differ_are_another_place() {
        let here = entries("SITE DRIVE POSE ARM");
        for (other, same) in [
            ("SITE DRIVE POSE", true),
            ("SITE", true),
            ("", true),
            ("DRIVE SITE", false),
            ("ARM", true),
        ] {
            assert_eq!(same_place(&here, &entries(other)), same, "{other}");
        }
    }

    #[test]
    fn a_lens_that_turns_over_inside_the_photo_is_no_camera() {
        let model = Cahvor {
            c: [0.0; 3],
            a: [1.0, 0.0, 0.0],
            h: [3500.0, 14_800.0, 0.0],
            v: [600.0, 0.0, 14_800.0],
            o: Some([1.0, 0.0, 0.0]),
            r: Some([0.0, -1.0, 0.0]),
            e: None,
        };
        for (width, usable) in [(9000, true), (10_000, false)] {
            let mut label = Label {
                size: Some((width, 1200)),
                ..Label::default()
            };
            label.set_place("SITE_FRAME".to_owned(), FramePose::IsSite, vec![1]);
            label.set_camera(&model);
            assert_eq!(label.prior.is_some(), usable, "{:?}", label.notes);
            assert_eq!(
                label.place.as_ref().map(|place| place.motion_counter.as_slice()),
                Some(&[1][..])
            );
            assert_eq!(label.notes.is_empty(), usable);
            let explained = label
                .notes
                .iter()
                .all(|note| note.contains("turn over at chi = 0.5774"));
            assert!(explained, "{:?}", label.notes);
        }
    }

    /// From the reference: yaw +73.74 degrees, a point 1 m ahead of the rover.
    #[test]
    fn a_quaternion_turns_rover_into_site() {
        let pose = pose([0.8, 0.0, 0.0, 0.6], [12.5, -3.25, 0.125]).unwrap();
        let point = pose.point(&Vector3::x());
        assert!(
            (point - Vector3::new(12.78, -2.29, 0.125)).norm() < 1e-12,
            "{point}"
        );
        assert!(pose.is_valid());
    }

    #[test]
    fn a_quaternion_that_is_no_rotation_is_refused() {
        for bad in [
            [1.875, 0.447_21, -0.9165, -0.816_56],
            [0.0; 4],
            [f64::NAN, 0.0, 0.0, 0.0],
            [1.002, 0.0, 0.0, 0.0],
        ] {
            assert_eq!(pose(bad, [0.0; 3]), None, "{bad:?}");
        }
        assert_eq!(pose([1.0, 0.0, 0.0, 0.0], [f64::INFINITY, 0.0, 0.0]), None);
    }
}
