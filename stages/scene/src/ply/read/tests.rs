use super::*;

fn read(bytes: &[u8]) -> Result<Vec<Point>, String> {
    read_points(bytes).map_err(|error| {
        if error.place.is_empty() {
            return error.problem;
        }
        format!("{}: {}", error.place, error.problem)
    })
}

/// Header lines between the first and the last, and a body.
fn ply(lines: &str, body: &[u8]) -> Vec<u8> {
    [format!("ply\n{lines}end_header\n").as_bytes(), body].concat()
}

const XYZ: &str = "property float x\nproperty float y\nproperty float z\n";
const ASCII: &str = "format ascii 1.0\n";
const BINARY: &str = "format binary_little_endian 1.0\n";

#[test]
fn columns_stand_in_any_order_among_others() {
    let lines = "comment any \u{fc}\nelement vertex 2\nproperty uchar blue\nproperty double z\nproperty short n\n\
        property uchar red\nproperty float32 x\nproperty float64 y\nproperty uint8 green\n\
        element face 1\nproperty list uchar int vertex_indices\n";
    let point = |position, color| Point {
        position,
        color: Some(color),
        views: 0,
    };
    let expected = [
        point([1.5, -2.0, 0.1], [1, 2, 3]),
        point([0.0, 1e300, -7.0], [255, 0, 9]),
    ];
    let text = ply(
        &format!("{ASCII}{lines}"),
        b"3 0.1 -5 1 1.5 -2 2\n\n9 -7 0 255 0 1e300 0\n3 0 1 1\n",
    );
    assert_eq!(read(&text).unwrap(), expected);
    let mut body = Vec::new();
    for point in &expected {
        let ([x, y, z], [red, green, blue]) = (point.position, point.color.unwrap());
        body.push(blue);
        body.extend(z.to_le_bytes());
        body.extend([0xff, 0xff, red]);
        body.extend((x as f32).to_le_bytes());
        body.extend(y.to_le_bytes());
        body.push(green);
    }
    body.extend([3, 1, 2]);
    assert_eq!(read(&ply(&format!("{BINARY}{lines}"), &body)).unwrap(), expected);
}

#[test]
fn an_element_before_the_vertices_is_skipped() {
    let lines = format!("element camera 2\nproperty int a\nelement void 9\nelement vertex 1\n{XYZ}");
    let text = ply(&format!("{ASCII}{lines}"), b"7\n8\n1 2 3");
    let mut body = vec![0xff; 8];
    body.extend([1.0_f32, 2.0, 3.0].map(f32::to_le_bytes).concat());
    for bytes in [text, ply(&format!("{BINARY}{lines}"), &body)] {
        assert_eq!(read(&bytes).unwrap()[0].position, [1.0, 2.0, 3.0]);
    }
}

#[test]
fn lines_may_end_as_windows_ends_them() {
    let text = ply(&format!("{ASCII}element vertex 1\n{XYZ}"), b"1 2 3\n");
    let text = String::from_utf8(text).unwrap().replace('\n', "\r\n");
    assert_eq!(read(text.as_bytes()).unwrap()[0].position, [1.0, 2.0, 3.0]);
    let header = String::from_utf8(ply(&format!("{BINARY}element vertex 1\n{XYZ}"), b"")).unwrap();
    let body = [1.0_f32, 2.0, 3.0].map(f32::to_le_bytes).concat();
    let bytes = [header.replace('\n', "\r\n").as_bytes(), &body].concat();
    assert_eq!(read(&bytes).unwrap()[0].position, [1.0, 2.0, 3.0]);
}

#[test]
fn no_vertices_are_no_points() {
    for form in [ASCII, BINARY] {
        let points = read(&ply(&format!("{form}element vertex 0\n{XYZ}"), b""));
        assert_eq!(points, Ok(Vec::new()), "{form}");
    }
}

#[test]
fn colours_that_are_no_bytes_are_not_taken() {
    let lines = format!("{ASCII}element vertex 1\n{XYZ}property float red\nproperty uchar green\n");
    assert_eq!(read(&ply(&lines, b"1 2 3 0.5 6\n")).unwrap()[0].color, None);
}

#[test]
fn a_wrong_header_is_named_by_its_line() {
    let cases = [
        (b"".to_vec(), "no `end_header`"),
        (b"PLY\n".to_vec(), "line 1: no PLY file"),
        (
            b"ply\nformat ascii 1.0\n".to_vec(),
            "no `end_header` in its first 21 bytes",
        ),
        (
            ply(&"comment\n".repeat(9000), b""),
            "no `end_header` in its first 65536 bytes",
        ),
        (
            ply("format binary_big_endian 1.0\n", b""),
            "line 2: the form `binary_big_endian 1.0` is not read",
        ),
        (
            ply("format ascii 2.0\n", b""),
            "line 2: the form `ascii 2.0` is not read",
        ),
        (
            ply(&format!("element vertex 0\n{XYZ}"), b""),
            "has no line `format`",
        ),
        (ply(ASCII, b""), "has no element `vertex`"),
        (ply("element face 1\n", b""), "has no element `vertex`"),
        (ply("property float x\n", b""), "line 2: a property of no element"),
        (ply("element vertex -1\n", b""), "line 2: `vertex` has no count"),
        (
            ply("element vertex 99999999999999999999\n", b""),
            "line 2: `vertex` has no count",
        ),
        (
            ply("element face 1\nproperty list uchar int i\n", b""),
            "line 3: a list property",
        ),
        (
            ply("element vertex 1\nproperty quad x\n", b""),
            "line 3: `quad` is not a type",
        ),
        (
            ply("element vertex 1\nproperty float x\nproperty int x\n", b""),
            "line 4: the property `x` comes twice",
        ),
        (
            ply("element vertex 1\nproperty int x\n", b""),
            "`x` of its vertices is neither float nor double",
        ),
        (
            ply("element vertex 1\nproperty float x\n", b""),
            "its vertices have no `y`",
        ),
        (ply("\u{1}\u{2}\n", b""), "is not a line of a PLY header"),
    ];
    for (bytes, part) in cases {
        let error = read(&bytes).unwrap_err();
        assert!(error.contains(part), "{part}: {error}");
    }
}

#[test]
fn a_count_is_not_trusted_with_memory() {
    for form in [ASCII, BINARY] {
        for count in ["1000000000000000000", "18446744073709551615", "2"] {
            let lines = format!("{form}element vertex {count}\n{XYZ}");
            let error = read(&ply(&lines, b"1 2 3\n")).unwrap_err();
            let said = format!("{count} vertices of");
            assert!(
                error.contains(&said) && error.contains("6 bytes follow"),
                "{error}"
            );
            let lines = format!("{form}element camera {count}\nproperty double f\nelement vertex 1\n{XYZ}");
            assert!(read(&ply(&lines, b"1 2 3\n")).is_err(), "{lines}");
        }
    }
}

#[test]
fn every_cut_and_every_surplus_of_a_body_is_refused() {
    let body = [1.0_f32; 6].map(f32::to_le_bytes).concat();
    let whole = ply(&format!("{BINARY}element vertex 2\n{XYZ}"), &body);
    for cut in 0..whole.len() {
        assert!(read(&whole[..cut]).is_err(), "cut at {cut}");
    }
    let more = read(&[&whole[..], b"xy"].concat()).unwrap_err();
    assert_eq!(more, "2 bytes after the last vertex");
    let lines = format!("{ASCII}element vertex 2\n{XYZ}");
    for (body, part) in [
        (
            "100.25 200.5 300.75\n",
            "vertex 1: the file ends, 2 are announced",
        ),
        ("1 2 3\n4 5 6\n7 8 9\n", "5 bytes after the last vertex"),
        ("1 2 3\n4 5 6 7\n", "vertex 1: a line of other than 3 numbers"),
        ("1 2 3\n4 5       \n", "vertex 1: a line of other than 3 numbers"),
        ("1 2 3\n4 five 6\n", "vertex 1: `five` is not a number"),
    ] {
        let error = read(&ply(&lines, body.as_bytes())).unwrap_err();
        assert!(error.contains(part), "{error}");
    }
    let error = read(&ply(&lines, &[0xff; 20])).unwrap_err();
    assert!(error.contains("its body is not text"), "{error}");
    let colored = format!("{lines}property uchar red\nproperty uchar green\nproperty uchar blue\n");
    let error = read(&ply(&colored, b"1 2 3 4 5 6\n1 2 3 4 256 6\n")).unwrap_err();
    assert!(
        error.contains("vertex 1: `256` is not a number of its property"),
        "{error}"
    );
}

#[test]
fn a_coordinate_that_is_not_finite_is_refused_with_its_vertex() {
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        let lines = format!("element vertex 2\n{XYZ}");
        let body = [1.0, 1.0, 1.0, 1.0, bad, 1.0].map(f32::to_le_bytes).concat();
        let text = format!("1 1 1\n1 {bad} 1\n");
        for bytes in [
            ply(&format!("{BINARY}{lines}"), &body),
            ply(&format!("{ASCII}{lines}"), text.as_bytes()),
        ] {
            let error = read(&bytes).unwrap_err();
            assert!(error.starts_with("vertex 1: a point at [1.0, "), "{error}");
        }
    }
}
