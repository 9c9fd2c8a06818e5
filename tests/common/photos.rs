//! A folder of photos to train on. The laboratory's tests use it, too.

/// Four photos in a row. The last is a test photo.
pub fn photos() -> tempfile::TempDir {
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path().join("photos/images");
    std::fs::create_dir_all(&folder).unwrap();
    for number in 0..4_u32 {
        let picture = image::RgbImage::from_fn(32, 24, |x, y| {
            image::Rgb([x * 7 + number, y * 10, x * y % 256].map(|value| value as u8))
        });
        picture.save(folder.join(format!("{number}.png"))).unwrap();
    }
    let name = |number: u32| format!("images/{number}.png");
    let frame = |number: u32| {
        let matrix = [[1, 0, 0, number], [0, 1, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]];
        serde_json::json!({"file_path": name(number), "transform_matrix": matrix})
    };
    let transforms = serde_json::json!({
        "w": 32, "h": 24, "fl_x": 30.5, "fl_y": 31.0, "cx": 16.0, "cy": 12.0,
        "frames": [frame(0), frame(1), frame(2), frame(3)],
        "train_filenames": [name(0), name(1), name(2)], "test_filenames": [name(3)],
    });
    let path = dir.path().join("photos/transforms.json");
    std::fs::write(path, transforms.to_string()).unwrap();
    dir
}
