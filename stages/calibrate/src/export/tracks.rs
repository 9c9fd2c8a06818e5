//! Sparse points with the photos that see them.

use marf_scene::Point;

const MAGIC: &[u8; 14] = b"marf-tracks-1\n";

/// Sparse points and where each was seen; every number is finite.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Tracks {
    /// The points.
    pub points: Vec<TrackPoint>,
}

/// A point of the surface and its sights.
#[derive(Debug, Clone, PartialEq)]
pub struct TrackPoint {
    /// Position in the world.
    pub position: [f64; 3],
    /// sRGB.
    pub color: [u8; 3],
    /// Mean distance of the sights from the point's projections, pixels.
    pub error_px: f64,
    /// Where it was seen.
    pub sights: Vec<Sight>,
}

/// A feature that belongs to a point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sight {
    /// Index of the frame in the scene.
    pub frame: u32,
    /// Position in that frame's image, pixels.
    pub pixel: [f64; 2],
}

impl Tracks {
    /// Takes over points of which only the number of sights is known; without a colour they are grey.
    pub fn without_sights(points: &[Point]) -> Self {
        let point = |point: &Point| TrackPoint {
            position: point.position,
            color: point.color.unwrap_or([128; 3]),
            error_px: 0.0,
            sights: Vec::new(),
        };
        Self {
            points: points.iter().map(point).collect(),
        }
    }

    /// Returns the bytes: a magic line, then for each point position and error (f64), colour (u8), the number
    /// of sights (u32), and for each sight frame (u32) and pixel (f64); all little-endian.
    pub fn encode(&self) -> Vec<u8> {
        let mut bytes = MAGIC.to_vec();
        let floats = |bytes: &mut Vec<u8>, numbers: &[f64]| {
            bytes.extend(numbers.iter().flat_map(|number| number.to_le_bytes()));
        };
        for point in &self.points {
            floats(&mut bytes, &point.position);
            floats(&mut bytes, &[point.error_px]);
            bytes.extend(point.color);
            bytes.extend((point.sights.len() as u32).to_le_bytes());
            for sight in &point.sights {
                bytes.extend(sight.frame.to_le_bytes());
                floats(&mut bytes, &sight.pixel);
            }
        }
        bytes
    }

    /// Reads what [`Tracks::encode`] wrote; none if it is anything else or a number is not finite.
    pub fn decode(bytes: &[u8]) -> Option<Self> {
        let mut rest = bytes.strip_prefix(MAGIC.as_slice())?;
        let mut points = Vec::new();
        while !rest.is_empty() {
            let [x, y, z, error_px] = floats(&mut rest)?;
            let color = *chunk(&mut rest)?;
            let count = u32::from_le_bytes(*chunk(&mut rest)?);
            let sights = (0..count).map(|_| sight(&mut rest));
            points.push(TrackPoint {
                position: [x, y, z],
                color,
                error_px,
                sights: sights.collect::<Option<_>>()?,
            });
        }
        Some(Self { points })
    }
}

fn sight(rest: &mut &[u8]) -> Option<Sight> {
    Some(Sight {
        frame: u32::from_le_bytes(*chunk(rest)?),
        pixel: floats(rest)?,
    })
}

fn chunk<'a, const N: usize>(rest: &mut &'a [u8]) -> Option<&'a [u8; N]> {
    let (head, tail) = rest.split_first_chunk()?;
    *rest = tail;
    Some(head)
}

fn floats<const N: usize>(rest: &mut &[u8]) -> Option<[f64; N]> {
    let mut numbers = [0.0; N];
    for number in &mut numbers {
        *number = f64::from_le_bytes(*chunk(rest)?);
    }
    numbers.iter().all(|number| number.is_finite()).then_some(numbers)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn two() -> Tracks {
        let sight = |frame| Sight {
            frame,
            pixel: [0.1, f64::MAX],
        };
        let point = |sights| TrackPoint {
            position: [1.0, -0.0, f64::MIN_POSITIVE / 4.0],
            color: [0, 128, 255],
            error_px: 0.1 + 0.2,
            sights,
        };
        Tracks {
            points: vec![point(vec![sight(0), sight(u32::MAX)]), point(vec![])],
        }
    }

    #[test]
    fn tracks_survive_their_bytes_and_no_part_of_them() {
        let bytes = two().encode();
        // 14 + 2 x (4 x 8 + 3 + 4) + 2 x (4 + 2 x 8), counted by hand.
        assert_eq!(bytes.len(), 132);
        assert_eq!(Tracks::decode(&bytes), Some(two()));
        for cut in 0..bytes.len() {
            assert_ne!(Tracks::decode(&bytes[..cut]), Some(two()), "cut at {cut}");
        }
        assert_eq!(
            Tracks::decode(&Tracks::default().encode()),
            Some(Tracks::default())
        );
    }

    #[test]
    fn no_number_that_is_not_finite_and_no_announced_length_gets_in() {
        for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            let mut tracks = two();
            tracks.points[0].sights[1].pixel[0] = bad;
            assert_eq!(Tracks::decode(&tracks.encode()), None, "{bad}");
        }
        let mut bytes = two().encode();
        bytes[49..53].copy_from_slice(&u32::MAX.to_le_bytes());
        assert_eq!(Tracks::decode(&bytes), None);
    }
}
