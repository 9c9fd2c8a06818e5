//! Splats as viewers read them.

use marf_scene::ply::{HeaderWriter, push_float};
use nalgebra::{Vector3, Vector4};

use super::{Splat, THIN};
use crate::frame::ExportFrame;
use crate::ply::with_frame;

/// The constant spherical harmonic, 1 / (2 √π): a colour is 0.5 + 0.282… · f_dc.
const SH_0: f64 = 0.282_094_791_773_878_14;
/// The properties, in order.
pub const PROPERTIES: [&str; 17] = [
    "x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1",
    "scale_2", "rot_0", "rot_1", "rot_2", "rot_3",
];

/// Returns splats as binary little-endian PLY in the layout of the reference code of 3-D Gaussian splatting,
/// which viewers read. Positions are in the axes of the scene, in metres if the scene has a scale.
///
/// Properties of a vertex, all float:
/// - x, y, z and nx, ny, nz
/// - f_dc_0 to 2: sRGB, as (colour - 0.5) / 0.2821. The colour does not depend on the direction, so there is
///   no f_rest.
/// - opacity (logit)
/// - scale_0 to 2: natural logarithm of the standard deviations along the disc's axes, the third along its
///   normal
/// - rot_0 to 3: unit quaternion w, x, y, z that turns z into the normal
pub fn ply(splats: &[Splat], frame: &ExportFrame, comments: &[String]) -> Vec<u8> {
    let header = HeaderWriter::new(&with_frame(frame, comments))
        .element("vertex", splats.len())
        .properties("float", &PROPERTIES);
    let mut bytes = header.into_bytes();
    for splat in splats {
        for number in numbers(splat, frame.scale()) {
            push_float(&mut bytes, number);
        }
    }
    bytes
}

/// Reads splats from the bytes of [`ply`], in the unit of the file. The third axis is taken as their normal.
///
/// # Errors
/// One sentence: another layout, a file that is cut off, or a number that is not finite.
pub fn read(bytes: &[u8]) -> Result<Vec<Splat>, String> {
    const END: &[u8] = b"end_header\n";
    let end = bytes.windows(END.len()).position(|window| window == END);
    let (header, body) = bytes.split_at(end.ok_or("the splats have no header")? + END.len());
    let header = String::from_utf8_lossy(header);
    let properties = header
        .lines()
        .filter_map(|line| line.strip_prefix("property float "));
    if !properties.eq(PROPERTIES) {
        return Err("the splats have other properties than marf writes".to_owned());
    }
    let size = 4 * PROPERTIES.len();
    if !body.len().is_multiple_of(size) {
        return Err(format!(
            "the last splat is cut off after {} bytes",
            body.len() % size
        ));
    }
    body.chunks_exact(size)
        .enumerate()
        .map(|(index, bytes)| read_one(index, bytes))
        .collect()
}

fn read_one(index: usize, bytes: &[u8]) -> Result<Splat, String> {
    let mut values = [0.0_f64; PROPERTIES.len()];
    for (value, bytes) in values.iter_mut().zip(bytes.as_chunks::<4>().0) {
        *value = f64::from(f32::from_le_bytes(*bytes));
    }
    if !values.iter().all(|value| value.is_finite()) {
        return Err(format!("splat {index} has a number that is not finite"));
    }
    let [x, y, z, nx, ny, nz, red, green, blue, logit, wide, ..] = values;
    Ok(Splat {
        position: Vector3::new(x, y, z),
        normal: Vector3::new(nx, ny, nz),
        sigma: libm::exp(wide),
        color: [red, green, blue].map(|channel| (0.5 + SH_0 * channel).clamp(0.0, 1.0) as f32),
        opacity: (1.0 / (1.0 + libm::exp(-logit))) as f32,
    })
}

fn numbers(splat: &Splat, scale: f64) -> [f64; 17] {
    let [x, y, z]: [f64; 3] = (splat.position * scale).into();
    let [nx, ny, nz]: [f64; 3] = splat.normal.into();
    let [red, green, blue] = splat.color.map(|channel| (f64::from(channel) - 0.5) / SH_0);
    let opacity = f64::from(splat.opacity);
    let sigma = (splat.sigma * scale).max(f64::MIN_POSITIVE);
    let [wide, thin] = [sigma, THIN * sigma].map(libm::log);
    let [w, i, j, k] = turned_to(nx, ny, nz);
    let logit = libm::log(opacity / (1.0 - opacity));
    [
        x, y, z, nx, ny, nz, red, green, blue, logit, wide, wide, thin, w, i, j, k,
    ]
}

/// Returns the unit quaternion (w, x, y, z) of the shortest turn from z to a unit vector: (1 + z · n, z × n),
/// normalised. For -z it is half a turn about x.
fn turned_to(nx: f64, ny: f64, nz: f64) -> [f64; 4] {
    let turn = Vector4::new(1.0 + nz, -ny, nx, 0.0);
    turn.try_normalize(1e-12).unwrap_or_else(Vector4::y).into()
}

#[cfg(test)]
mod tests {
    use marf_scene::Scene;
    use nalgebra::{Quaternion, UnitQuaternion};
    use ply_rs_bw::parser::Parser;
    use ply_rs_bw::ply::{DefaultElement, Property};

    use super::*;

    fn splat(normal: Vector3<f64>) -> Splat {
        Splat {
            position: Vector3::new(1.0, -2.0, 0.5),
            normal,
            sigma: 0.25,
            color: [0.5, 1.0, 0.0],
            opacity: 0.9,
        }
    }

    #[test]
    fn a_viewer_finds_what_the_reference_code_writes() {
        let frame = ExportFrame::new(&Scene {
            metres_per_unit: Some(2.0),
            ..Scene::default()
        });
        let bytes = ply(&[splat(Vector3::z())], &frame, &[]);
        let read = Parser::<DefaultElement>::new().read_ply(&mut &bytes[..]).unwrap();
        assert!(
            read.header
                .comments
                .iter()
                .any(|comment| comment.contains("unit: metres"))
        );
        let vertex = &read.payload["vertex"][0];
        let value = |name: &str| match vertex[name] {
            Property::Float(value) => value,
            ref other => panic!("{name}: {other:?}"),
        };
        assert_eq!(PROPERTIES.len(), vertex.len());
        for (name, wanted) in [
            ("x", 2.0),
            ("y", -4.0),
            ("nz", 1.0),
            ("f_dc_0", 0.0),
            // 0.5 * 2 √π.
            ("f_dc_1", 1.772_453_9),
            ("f_dc_2", -1.772_453_9),
            // ln 9, ln 0.5, ln 0.05.
            ("opacity", 2.197_224_6),
            ("scale_0", -std::f32::consts::LN_2),
            ("scale_1", -std::f32::consts::LN_2),
            ("scale_2", -2.995_732_3),
            ("rot_0", 1.0),
            ("rot_3", 0.0),
        ] {
            assert!((value(name) - wanted).abs() < 1e-6, "{name}: {}", value(name));
        }
    }

    #[test]
    fn what_is_written_is_read_again_and_what_is_cut_off_is_refused() {
        let written = splat(Vector3::new(0.6, 0.0, -0.8));
        let bytes = ply(&[written, written], &ExportFrame::new(&Scene::default()), &[]);
        let found = read(&bytes).unwrap();
        assert_eq!(found.len(), 2);
        assert!((found[1].position - written.position).norm() < 1e-6, "{found:?}");
        assert!((found[1].normal - written.normal).norm() < 1e-6, "{found:?}");
        assert!((found[1].sigma - written.sigma).abs() < 1e-6, "{found:?}");
        assert!((found[1].opacity - written.opacity).abs() < 1e-6, "{found:?}");
        for (found, written) in found[1].color.iter().zip(written.color) {
            assert!((found - written).abs() < 1e-6);
        }
        assert!(
            read(&bytes[..bytes.len() - 3])
                .unwrap_err()
                .contains("cut off after 65 bytes")
        );
        assert!(
            read(b"ply\nend_header\n")
                .unwrap_err()
                .contains("other properties")
        );
        let mut broken = bytes.clone();
        let first = bytes.len() - 4 * PROPERTIES.len();
        broken[first..first + 4].copy_from_slice(&f32::NAN.to_le_bytes());
        assert!(read(&broken).unwrap_err().contains("splat 1"));
    }

    #[test]
    fn the_rotation_turns_z_into_the_normal_whatever_it_is() {
        for normal in [
            [0.0, 0.0, 1.0],
            [0.0, 0.0, -1.0],
            [1.0, 0.0, 0.0],
            [0.0, -1.0, 0.0],
            [0.6, 0.0, -0.8],
            [0.48, -0.64, 0.6],
            [1e-5, 0.0, -1.0],
        ] {
            let normal = Vector3::from(normal).normalize();
            let [w, x, y, z] = turned_to(normal.x, normal.y, normal.z);
            let quaternion = Quaternion::new(w, x, y, z);
            assert!((quaternion.norm() - 1.0).abs() < 1e-9, "{normal}");
            let turned = UnitQuaternion::new_normalize(quaternion) * Vector3::z();
            assert!((turned - normal).norm() < 1e-6, "{normal}: {turned}");
        }
    }

    #[test]
    fn nothing_is_a_header_alone_that_says_that_the_scale_is_not_known() {
        let bytes = ply(&[], &ExportFrame::new(&Scene::default()), &[]);
        let text = String::from_utf8(bytes).unwrap();
        assert!(
            text.contains("scale is not known") && text.ends_with("end_header\n"),
            "{text}"
        );
    }
}
