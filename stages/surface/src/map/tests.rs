use marf_scene::Scene;

use super::*;
use crate::mesh::Vertex;

/// A site frame (z down) in units of 2 m.
fn frame() -> ExportFrame {
    ExportFrame::new(&Scene {
        up: Some([0.0, 0.0, -1.0]),
        metres_per_unit: Some(2.0),
        ..Scene::default()
    })
}

/// A floor 1 unit below the origin from (0, 0) to (3, 2) (north, east), and a roof above its southern half.
fn house() -> Mesh {
    let vertex = |north: f64, east: f64, down: f64| Vertex {
        position: Vector3::new(north, east, down),
        normal: -Vector3::z(),
        color: if down > 0.5 {
            [1.0, 0.0, 0.0]
        } else {
            [0.0, 0.0, 1.0]
        },
        photos: 3,
        spread: if down > 0.5 { 0.001 } else { -1.0 },
        retrained: None,
    };
    let quad = |north: f64, down: f64| {
        [
            vertex(0.0, 0.0, down),
            vertex(0.0, 2.0, down),
            vertex(north, 0.0, down),
            vertex(north, 2.0, down),
        ]
    };
    Mesh {
        vertices: [quad(3.0, 1.0), quad(1.5, 0.25)].concat(),
        triangles: vec![[0, 1, 2], [1, 3, 2], [4, 5, 6], [5, 7, 6]],
    }
}

fn values(png: &[u8]) -> Vec<u16> {
    image::load_from_memory(png).unwrap().into_luma16().into_raw()
}

#[test]
fn north_is_at_the_top_and_the_highest_surface_is_seen() {
    let map = SurfaceMap::draw(&house(), &frame(), 1.0).unwrap();
    let report = &map.report;
    // 4 m to the east, 6 m to the north. The border at 4 m and 6 m belongs to one pixel more.
    assert_eq!((report.columns, report.rows), (5, 7));
    assert_eq!((report.lowest_m, report.interval_m), (-2.0, 0.001));
    let png = map.height_png().unwrap();
    let says = |text: &str| png.windows(text.len()).any(|window| window == text.as_bytes());
    // North is the first axis of the site, east the second, and down the third.
    assert!(says(
        "0.0, 1.0, 0.0], top [1.0, 0.0, 0.0], up [0.0, 0.0, -1.0]; metres from the origin of the world of the scene"
    ));
    let heights = values(&png);
    let row = |row: usize| &heights[row * 5..row * 5 + 5];
    assert_eq!(row(0), [0; 5], "beyond the border");
    assert_eq!(row(1), [1, 1, 1, 1, 0], "the floor in the north");
    assert_eq!(
        row(6),
        [1501, 1501, 1501, 1501, 0],
        "the roof, 1.5 m higher, in the south"
    );
    assert_eq!(map.world_file(), "1\n0\n0\n-1\n0.5\n6.5\n");
    let spread = values(&map.spread_png().unwrap());
    assert_eq!((spread[5], spread[30]), (3, 0), "2 mm, and not known");
    let photo = image::load_from_memory(&map.photo_png().unwrap())
        .unwrap()
        .into_rgba8();
    assert_eq!(
        (photo.get_pixel(0, 1).0, photo.get_pixel(0, 6).0),
        ([255, 0, 0, 255], [0, 0, 255, 255])
    );
    assert_eq!(photo.get_pixel(0, 0).0, [0; 4]);
}

#[test]
fn a_geotiff_holds_the_same_map_with_its_place() {
    use tiff::decoder::{Decoder, DecodingResult};
    use tiff::tags::Tag;

    let map = SurfaceMap::draw(&house(), &frame(), 1.0).unwrap();
    let bytes = map.height_tiff().unwrap();
    assert_eq!(bytes, map.height_tiff().unwrap());
    let mut read = Decoder::new(std::io::Cursor::new(bytes)).unwrap();
    assert_eq!(read.dimensions().unwrap(), (5, 7));
    let DecodingResult::F32(heights) = read.read_image().unwrap() else {
        panic!("no floats");
    };
    assert!(heights[0].is_nan(), "beyond the border");
    assert_eq!((heights[5], heights[30]), (-2.0, -0.5));
    let numbers = |read: &mut Decoder<_>, tag| read.get_tag_f64_vec(tag).unwrap();
    assert_eq!(numbers(&mut read, Tag::ModelPixelScaleTag), [1.0, 1.0, 0.0]);
    // The corner of the first pixel, whose centre is that of the world file.
    assert_eq!(
        numbers(&mut read, Tag::ModelTiepointTag),
        [0.0, 0.0, 0.0, 0.0, 7.0, 0.0]
    );
    let name = read.get_tag_ascii_string(Tag::GeoAsciiParamsTag).unwrap();
    assert_eq!(name, "metres from the origin of the world of the scene|");
    let mut read = Decoder::new(std::io::Cursor::new(map.photo_tiff().unwrap())).unwrap();
    let DecodingResult::U8(pixels) = read.read_image().unwrap() else {
        panic!("no bytes");
    };
    assert_eq!(
        (&pixels[20..24], &pixels[120..124]),
        (&[255, 0, 0, 255][..], &[0, 0, 255, 255][..])
    );
    assert_eq!(pixels[..4], [0; 4]);
}

#[test]
fn what_a_scene_cannot_give_is_refused_with_the_reason() {
    let why = |mesh: &Mesh, frame: &ExportFrame, pixel: f64| {
        SurfaceMap::draw(mesh, frame, pixel).unwrap_err().to_string()
    };
    assert!(why(&house(), &ExportFrame::new(&Scene::default()), 1.0).contains("no scale"));
    assert!(why(&Mesh::default(), &frame(), 1.0).contains("empty"));
    // 4 m by 6 m, and a pixel more at the border.
    let many = why(&house(), &frame(), 1e-5);
    assert!(
        many.ends_with(" pixels of 0.00001 m are too many: widen `map_cell`"),
        "{many}"
    );
    assert!(many.contains("400000 x 600001"), "{many}");
    assert!(why(&house(), &frame(), 100.0).ends_with("no surface covers the centre of a pixel of 100 m"));
}

#[test]
fn intervals_are_round_and_hold_the_range() {
    for (range, expected) in [
        (0.0, 0.001),
        (65.0, 0.001),
        (66.0, 0.002),
        (200.0, 0.005),
        (400.0, 0.01),
    ] {
        assert_eq!(interval(range), expected, "{range}");
    }
}
