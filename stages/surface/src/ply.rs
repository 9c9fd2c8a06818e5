//! Surfaces and points as PLY.

use marf_scene::ply::{HeaderWriter, push_float};

use crate::frame::ExportFrame;
use crate::mesh::{Mesh, Vertex};

/// Returns a mesh as binary little-endian PLY, in the axes of the scene, in metres where the scene has a scale.
///
/// A vertex: x, y, z, nx, ny, nz (float), red, green, blue (uchar, sRGB), photos (ushort: photos that show
/// it, at most 65,535), spread (float). The spread is the root mean square of the distances of the views'
/// surfaces from it along the normal, in the unit of the file, or -1 if only one view shows it. With a
/// bootstrap also depth_std (float, the same unit) and color_std (float, gray of sRGB, white = 1): how far
/// its retrainings differ, -1 where too few show it. A face: a list of three ints. Comments state unit and
/// axes.
///
/// # Extremes
/// A coordinate beyond 3.4e38 is written as the largest f32 of its sign. An empty mesh is a file with a header alone.
pub fn mesh(mesh: &Mesh, frame: &ExportFrame, comments: &[String]) -> Vec<u8> {
    let header = header(frame, comments, &mesh.vertices)
        .element("face", mesh.triangles.len())
        .properties("list uchar int", &["vertex_indices"]);
    let mut bytes = header.into_bytes();
    write_vertices(&mut bytes, &mesh.vertices, frame.scale());
    for triangle in &mesh.triangles {
        bytes.push(3);
        bytes.extend(triangle.iter().flat_map(|vertex| vertex.to_le_bytes()));
    }
    bytes
}

/// Returns points as PLY, with the properties of the vertices of [`mesh`].
pub fn points(points: &[Vertex], frame: &ExportFrame, comments: &[String]) -> Vec<u8> {
    let mut bytes = header(frame, comments, points).into_bytes();
    write_vertices(&mut bytes, points, frame.scale());
    bytes
}

fn header(frame: &ExportFrame, comments: &[String], vertices: &[Vertex]) -> HeaderWriter {
    let header = HeaderWriter::new(&with_frame(frame, comments))
        .element("vertex", vertices.len())
        .properties("float", &["x", "y", "z", "nx", "ny", "nz"])
        .properties("uchar", &["red", "green", "blue"])
        .properties("ushort", &["photos"])
        .properties("float", &["spread"]);
    if vertices.iter().any(|vertex| vertex.retrained.is_some()) {
        return header.properties("float", &["depth_std", "color_std"]);
    }
    header
}

/// Returns the comments of a header: unit and axes, and more.
pub fn with_frame(frame: &ExportFrame, more: &[String]) -> Vec<String> {
    let mut comments = vec![
        format!("unit: {}", frame.unit()),
        format!("axes: those of the scene; {}", frame.up_words()),
    ];
    comments.extend_from_slice(more);
    comments
}

fn write_vertices(bytes: &mut Vec<u8>, vertices: &[Vertex], scale: f64) {
    for vertex in vertices {
        let position = vertex.position * scale;
        for number in position.iter().chain(&vertex.normal) {
            push_float(bytes, *number);
        }
        bytes.extend(vertex.color.map(to_byte));
        bytes.extend((vertex.photos.min(u32::from(u16::MAX)) as u16).to_le_bytes());
        let known = |value: f32, scale: f64| if value < 0.0 { -1.0 } else { value * scale as f32 };
        bytes.extend(known(vertex.spread, scale).to_le_bytes());
        if let Some(retrained) = vertex.retrained {
            bytes.extend(known(retrained.depth, scale).to_le_bytes());
            bytes.extend(known(retrained.color, 1.0).to_le_bytes());
        }
    }
}

/// Returns a channel in [0, 1] as a byte.
pub fn to_byte(channel: f32) -> u8 {
    (channel.clamp(0.0, 1.0) * 255.0 + 0.5) as u8
}

#[cfg(test)]
mod tests {
    use marf_scene::Scene;
    use nalgebra::Vector3;
    use ply_rs_bw::parser::Parser;
    use ply_rs_bw::ply::{DefaultElement, Property};

    use super::*;

    fn example() -> Mesh {
        let vertex = |x: f64| Vertex {
            position: Vector3::new(x, -2.0, 0.5),
            normal: Vector3::z(),
            color: [0.0, 0.5, 1.0],
            photos: 70_000,
            spread: 0.25,
            retrained: None,
        };
        Mesh {
            vertices: vec![vertex(1.0), vertex(1e300), vertex(3.0)],
            triangles: vec![[0, 1, 2]],
        }
    }

    #[test]
    fn another_program_reads_what_was_written() {
        let frame = ExportFrame::new(&Scene {
            metres_per_unit: Some(2.0),
            ..Scene::default()
        });
        let bytes = mesh(&example(), &frame, &["two\nlines".to_owned()]);
        let read = Parser::<DefaultElement>::new().read_ply(&mut &bytes[..]).unwrap();
        assert!(
            read.header
                .comments
                .iter()
                .any(|comment| comment.contains("unit: metres"))
        );
        let vertex = &read.payload["vertex"];
        assert_eq!(vertex.len(), 3);
        assert_eq!(vertex[0]["x"], Property::Float(2.0));
        assert_eq!(vertex[1]["x"], Property::Float(f32::MAX));
        assert_eq!(vertex[0]["nz"], Property::Float(1.0));
        assert_eq!(
            (&vertex[0]["green"], &vertex[0]["blue"]),
            (&Property::UChar(128), &Property::UChar(255))
        );
        assert_eq!(vertex[0]["photos"], Property::UShort(65_535));
        assert_eq!(vertex[0]["spread"], Property::Float(0.5));
        assert_eq!(
            read.payload["face"][0]["vertex_indices"],
            Property::ListInt(vec![0, 1, 2])
        );
    }

    #[test]
    fn retrainings_are_two_properties_more() {
        let frame = ExportFrame::new(&Scene {
            metres_per_unit: Some(2.0),
            ..Scene::default()
        });
        let mut mesh = example();
        for vertex in &mut mesh.vertices {
            vertex.retrained = Some(crate::Retrained {
                depth: 0.25,
                color: -1.0,
            });
        }
        let bytes = super::mesh(&mesh, &frame, &[]);
        let read = Parser::<DefaultElement>::new().read_ply(&mut &bytes[..]).unwrap();
        let vertex = &read.payload["vertex"][2];
        assert_eq!(
            (&vertex["depth_std"], &vertex["color_std"]),
            (&Property::Float(0.5), &Property::Float(-1.0))
        );
    }

    #[test]
    fn nothing_is_a_header_alone_that_says_that_the_scale_is_not_known() {
        let frame = ExportFrame::new(&Scene::default());
        let bytes = points(&[], &frame, &[]);
        let text = String::from_utf8(bytes.clone()).unwrap();
        assert!(
            text.contains("scale is not known") && text.ends_with("end_header\n"),
            "{text}"
        );
        let read = Parser::<DefaultElement>::new().read_ply(&mut &bytes[..]).unwrap();
        assert!(read.payload.get("vertex").is_none_or(Vec::is_empty));
    }
}
