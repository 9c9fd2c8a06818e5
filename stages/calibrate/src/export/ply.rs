//! Sparse points as PLY, which every viewer of point clouds reads.

use marf_scene::ply::{HeaderWriter, push_float};

use super::tracks::Tracks;

/// Writes the points as binary little-endian PLY: x, y, z as f32, red, green, blue as u8.
///
/// # Extremes
/// A coordinate beyond 3.4e38 is written as the largest f32 of its sign.
pub fn write_ply(tracks: &Tracks) -> Vec<u8> {
    let header = HeaderWriter::new(&[])
        .element("vertex", tracks.points.len())
        .properties("float", &["x", "y", "z"])
        .properties("uchar", &["red", "green", "blue"]);
    let mut bytes = header.into_bytes();
    for point in &tracks.points {
        for coordinate in point.position {
            push_float(&mut bytes, coordinate);
        }
        bytes.extend(point.color);
    }
    bytes
}

#[cfg(test)]
mod tests {
    use super::super::TrackPoint;
    use super::*;

    #[test]
    fn a_point_is_fifteen_bytes_behind_the_header() {
        let point = |x| TrackPoint {
            position: [x, -2.0, 0.5],
            color: [1, 2, 255],
            error_px: 0.0,
            observations: Vec::new(),
        };
        let bytes = write_ply(&Tracks {
            points: vec![point(1.0), point(1e300)],
        });
        let body = bytes.len() - 30;
        assert!(
            bytes[..body].starts_with(b"ply\nformat binary_little_endian 1.0\nelement vertex 2\n")
                && bytes[..body].ends_with(b"end_header\n")
        );
        let first = [&[0, 0, 128, 63, 0, 0, 0, 192, 0, 0, 0, 63, 1, 2, 255][..]].concat();
        assert_eq!(&bytes[body..body + 15], first);
        assert_eq!(&bytes[body + 15..body + 19], f32::MAX.to_le_bytes());
    }
}
