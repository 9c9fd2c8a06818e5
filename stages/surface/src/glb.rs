//! A mesh as binary glTF 2.0: <https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html>.

use nalgebra::{Matrix3, Vector3};
use serde_json::{Value, json};

use crate::frame::ExportFrame;
use crate::mesh::{Mesh, Retrained, Vertex};

const FLOAT: u32 = 5126;
const UNSIGNED_SHORT: u32 = 5123;
const UNSIGNED_INT: u32 = 5125;
const ARRAY_BUFFER: u32 = 34962;
const ELEMENT_ARRAY_BUFFER: u32 = 34963;

/// Returns a mesh as GLB: y up where the scene knows up, one unit a metre where it has a scale, colours of vertices (linear, 16 bits).
///
/// Positions are f32 around a middle, which is the translation of the node, so that a mesh far from the origin keeps its detail. `extras`
/// of the node hold unit, what the colours are (`colors`), rotation and scale: `world = rotationᵀ · position / scale`, position as seen by a viewer. An empty mesh is a
/// node without a mesh. Vertices without a normal get one that points up: the format asks for unit vectors.
///
/// With a bootstrap, a vertex has `_DEPTH_STD` and `_COLOR_STD`: `depth_std` and `color_std` of [`crate::ply::mesh`].
pub fn mesh(mesh: &Mesh, frame: &ExportFrame, generator: &str, colors: &str) -> Vec<u8> {
    let (rotation, scale) = (frame.y_up(), frame.scale());
    let extras = extras(frame, &rotation, colors);
    let asset = json!({"version": "2.0", "generator": generator});
    if mesh.triangles.is_empty() {
        let json = json!({
            "asset": asset,
            "scene": 0,
            "scenes": [{"nodes": [0]}],
            "nodes": [{"name": "surface", "extras": extras}],
        });
        return container(&json, Vec::new());
    }
    let place = |position: &Vector3<f64>| rotation * position * scale;
    let (low, high) = bounds(mesh.vertices.iter().map(|vertex| place(&vertex.position)));
    let middle = ((low + high) / 2.0).map(|x| f64::from(x as f32));
    let mut buffer = Buffer::default();
    let positions: Vec<[f32; 3]> = mesh
        .vertices
        .iter()
        .map(|vertex| (place(&vertex.position) - middle).map(|x| x as f32).into())
        .collect();
    let (low, high) = bounds(positions.iter().map(|at| Vector3::from(at.map(f64::from))));
    let count = mesh.vertices.len();
    let position = buffer.put(
        positions.as_flattened().iter().flat_map(|x| x.to_le_bytes()),
        ARRAY_BUFFER,
        json!({
            "componentType": FLOAT, "count": count, "type": "VEC3",
            "min": [low.x, low.y, low.z], "max": [high.x, high.y, high.z],
        }),
    );
    let normals = mesh.vertices.iter().flat_map(|vertex| {
        let turned = (rotation * vertex.normal)
            .try_normalize(1e-9)
            .unwrap_or_else(Vector3::y);
        turned.map(|x| x as f32).data.0[0]
    });
    let normal = json!({"componentType": FLOAT, "count": count, "type": "VEC3"});
    let normal = buffer.put(normals.flat_map(f32::to_le_bytes), ARRAY_BUFFER, normal);
    let colors = mesh.vertices.iter().flat_map(|vertex| {
        let [r, g, b] = vertex.color.map(linear);
        [r, g, b, u16::MAX]
    });
    let color = json!({"componentType": UNSIGNED_SHORT, "normalized": true, "count": count, "type": "VEC4"});
    let color = buffer.put(colors.flat_map(u16::to_le_bytes), ARRAY_BUFFER, color);
    let mut attributes = json!({"POSITION": position, "NORMAL": normal, "COLOR_0": color});
    put_retrained(&mut buffer, &mut attributes, &mesh.vertices, scale as f32);
    let indices = mesh
        .triangles
        .as_flattened()
        .iter()
        .flat_map(|index| index.to_le_bytes());
    let index = json!({"componentType": UNSIGNED_INT, "count": 3 * mesh.triangles.len(), "type": "SCALAR"});
    let index = buffer.put(indices, ELEMENT_ARRAY_BUFFER, index);
    let json = json!({
        "asset": asset,
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"name": "surface", "mesh": 0, "translation": [middle.x, middle.y, middle.z], "extras": extras}],
        "meshes": [{"primitives": [{"attributes": attributes, "indices": index, "material": 0}]}],
        // Rough and no metal: the colours are those that photos saw.
        "materials": [{"pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 1.0}, "doubleSided": true}],
        "accessors": buffer.accessors,
        "bufferViews": buffer.views,
        "buffers": [{"byteLength": buffer.bytes.len()}],
    });
    container(&json, buffer.bytes)
}

/// A number of a vertex.
type OfVertex<'a> = &'a dyn Fn(&Retrained) -> f32;

/// Adds how far retrainings differ at each vertex, if a bootstrap was looked at.
fn put_retrained(buffer: &mut Buffer, attributes: &mut Value, vertices: &[Vertex], scale: f32) {
    if vertices.iter().all(|vertex| vertex.retrained.is_none()) {
        return;
    }
    let depth = |retrained: &Retrained| retrained.depth * scale;
    let color = |retrained: &Retrained| retrained.color;
    let values: [(&str, OfVertex<'_>); 2] = [("_DEPTH_STD", &depth), ("_COLOR_STD", &color)];
    for (name, value) in values {
        let known = vertices.iter().map(|vertex| {
            let value = vertex.retrained.as_ref().map_or(-1.0, value);
            if value < 0.0 { -1.0 } else { value }
        });
        let form = json!({"componentType": FLOAT, "count": vertices.len(), "type": "SCALAR"});
        attributes[name] = buffer
            .put(known.flat_map(f32::to_le_bytes), ARRAY_BUFFER, form)
            .into();
    }
}

/// Bytes with their views and the forms of their numbers. All parts are whole words.
#[derive(Default)]
struct Buffer {
    bytes: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
}

impl Buffer {
    /// Adds numbers of a form and returns the index of their accessor.
    fn put(&mut self, bytes: impl Iterator<Item = u8>, target: u32, mut form: Value) -> usize {
        let start = self.bytes.len();
        self.bytes.extend(bytes);
        self.views.push(json!({
            "buffer": 0, "byteOffset": start, "byteLength": self.bytes.len() - start, "target": target,
        }));
        form["bufferView"] = (self.views.len() - 1).into();
        self.accessors.push(form);
        self.accessors.len() - 1
    }
}

fn extras(frame: &ExportFrame, rotation: &Matrix3<f64>, colors: &str) -> Value {
    let rows: [[f64; 3]; 3] = [0, 1, 2].map(|row| [0, 1, 2].map(|column| rotation[(row, column)]));
    json!({
        "unit": frame.unit(),
        "colors": colors,
        "metres_per_world_unit": frame.metres_per_unit,
        "up": if frame.up.is_some() { "+y" } else { "not known; axes of the scene" },
        "rotation_from_world": rows,
        "scale_from_world": frame.scale(),
    })
}

fn bounds(points: impl Iterator<Item = Vector3<f64>>) -> (Vector3<f64>, Vector3<f64>) {
    let empty = (Vector3::repeat(f64::INFINITY), Vector3::repeat(f64::NEG_INFINITY));
    points.fold(empty, |(low, high), point| (low.inf(&point), high.sup(&point)))
}

/// Returns the linear value of an sRGB channel (IEC 61966-2-1) in 16 bits.
fn linear(channel: f32) -> u16 {
    let channel = channel.clamp(0.0, 1.0);
    let linear = if channel <= 0.040_45 {
        channel / 12.92
    } else {
        libm::powf((channel + 0.055) / 1.055, 2.4)
    };
    (linear * f32::from(u16::MAX) + 0.5) as u16
}

/// Puts JSON and buffer into one file: a header of 12 bytes and two chunks of whole words.
fn container(json: &Value, mut buffer: Vec<u8>) -> Vec<u8> {
    let mut text = json.to_string().into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');
    buffer.resize(buffer.len().next_multiple_of(4), 0);
    let chunk = |kind: &[u8; 4], bytes: Vec<u8>| {
        let length = (bytes.len() as u32).to_le_bytes();
        [&length[..], kind, &bytes].concat()
    };
    let mut chunks = chunk(b"JSON", text);
    if !buffer.is_empty() {
        chunks.extend(chunk(b"BIN\0", buffer));
    }
    let length = (12 + chunks.len()) as u32;
    [&b"glTF"[..], &2_u32.to_le_bytes(), &length.to_le_bytes(), &chunks].concat()
}

#[cfg(test)]
mod tests {
    use marf_scene::Scene;

    use super::*;

    /// A triangle far from the origin in a site frame (z down), of units of 2 m.
    fn example() -> (Mesh, ExportFrame) {
        let vertex = |north: f64, east: f64| Vertex {
            position: Vector3::new(5e5 + north, east, -1.0),
            normal: -Vector3::z(),
            color: [1.0, 0.5, 0.0],
            photos: 3,
            spread: 0.0,
            retrained: None,
        };
        let mesh = Mesh {
            vertices: vec![vertex(0.0, 0.0), vertex(0.0, 1.0), vertex(0.001, 0.0)],
            triangles: vec![[0, 1, 2]],
        };
        let frame = ExportFrame::new(&Scene {
            up: Some([0.0, 0.0, -1.0]),
            metres_per_unit: Some(2.0),
            ..Scene::default()
        });
        (mesh, frame)
    }

    #[test]
    fn another_program_reads_metres_with_y_up() {
        let (example, frame) = example();
        let bytes = mesh(&example, &frame, "test", "");
        let read = gltf::Gltf::from_slice(&bytes).unwrap();
        let blob = read.blob.clone().unwrap();
        let node = read.nodes().next().unwrap();
        let (translation, ..) = node.transform().decomposed();
        let primitive = node.mesh().unwrap().primitives().next().unwrap();
        let reader = primitive.reader(|_| Some(&blob));
        let positions: Vec<[f32; 3]> = reader.read_positions().unwrap().collect();
        // East is x, up is y, south is z. 1 mm of a unit remains distinct at 1,000 km.
        let apart = positions[2][2] - positions[0][2];
        assert!((apart + 0.002).abs() < 1e-6, "{apart}");
        assert!((positions[1][0] - positions[0][0] - 2.0).abs() < 1e-6);
        assert!((positions[0][1] + translation[1] - 2.0).abs() < 1e-6);
        assert!((f64::from(translation[2]) + 1e6).abs() < 0.1, "{translation:?}");
        let normals: Vec<[f32; 3]> = reader.read_normals().unwrap().collect();
        assert_eq!(normals[0], [0.0, 1.0, 0.0]);
        let colors: Vec<[u16; 4]> = reader.read_colors(0).unwrap().into_rgba_u16().collect();
        // 0.5 in sRGB is 0.2140 linear.
        assert_eq!(colors[0], [65_535, 14_027, 0, 65_535]);
        let indices: Vec<u32> = reader.read_indices().unwrap().into_u32().collect();
        assert_eq!(indices, [0, 1, 2]);
        let bounds = primitive.bounding_box();
        assert!(
            positions
                .iter()
                .all(|at| (0..3).all(|i| at[i] >= bounds.min[i] && at[i] <= bounds.max[i]))
        );
        assert_eq!(bytes.len() % 4, 0);
    }

    #[test]
    fn another_program_reads_how_far_retrainings_differ() {
        let (mut example, frame) = example();
        let depths = |bytes: &[u8]| {
            let read = gltf::Gltf::from_slice(bytes).unwrap();
            let blob = read.blob.clone().unwrap();
            let primitive = read.meshes().next().unwrap().primitives().next().unwrap();
            let of = |name: &str| {
                let semantic = gltf::Semantic::Extras(name.to_owned());
                let values =
                    gltf::accessor::Iter::<f32>::new(primitive.get(&semantic)?, |_| Some(blob.as_slice()));
                Some(values?.collect::<Vec<_>>())
            };
            (of("DEPTH_STD"), of("COLOR_STD"))
        };
        assert_eq!(depths(&mesh(&example, &frame, "test", "")), (None, None));
        for (vertex, depth) in example.vertices.iter_mut().zip([0.25, -1.0, 0.5]) {
            vertex.retrained = Some(Retrained { depth, color: 0.125 });
        }
        let expected = (Some(vec![0.5, -1.0, 1.0]), Some(vec![0.125; 3]));
        assert_eq!(depths(&mesh(&example, &frame, "test", "")), expected);
    }

    #[test]
    fn an_empty_mesh_is_a_node_without_a_mesh() {
        let bytes = mesh(&Mesh::default(), &example().1, "test", "");
        let read = gltf::Gltf::from_slice(&bytes).unwrap();
        assert_eq!((read.nodes().count(), read.meshes().count()), (1, 0));
    }
}
