//! The text form: one record a line, an image takes two.

use super::model::{Model, lens, quaternion};

/// Returns numbers or words with spaces between.
fn line(words: impl IntoIterator<Item = String>) -> String {
    words.into_iter().collect::<Vec<_>>().join(" ") + "\n"
}

fn texts<T: ToString>(numbers: impl IntoIterator<Item = T>) -> impl Iterator<Item = String> {
    numbers.into_iter().map(|number| number.to_string())
}

/// Returns cameras.txt.
pub(super) fn cameras(model: &Model<'_>) -> String {
    let mut text = "# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n".to_owned();
    for (number, camera) in (1..).zip(&model.cameras) {
        let (_, name, params) = lens(camera);
        let size = texts([camera.width, camera.height]);
        let head: [String; 2] = [u32::to_string(&number), name.to_owned()];
        text += &line(head.into_iter().chain(size).chain(texts(params)));
    }
    text
}

/// Returns images.txt.
pub(super) fn images(model: &Model<'_>) -> String {
    let mut text =
        "# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME\n# POINTS2D[] as (X, Y, POINT3D_ID)\n"
            .to_owned();
    for (number, image) in (1..).zip(&model.images) {
        let pose = &image.frame.cam_from_world;
        let numbers = quaternion(&pose.rotation)
            .into_iter()
            .chain(pose.translation.iter().copied());
        let head = [u32::to_string(&number)].into_iter().chain(texts(numbers));
        text += &line(head.chain([image.camera.to_string(), image.frame.file.clone()]));
        let feature = |([x, y], point): &([f64; 2], u64)| format!("{x} {y} {point}");
        text += &line(image.features.iter().map(feature));
    }
    text
}

/// Returns points3D.txt.
pub(super) fn points(model: &Model<'_>) -> String {
    let mut text = "# POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)\n".to_owned();
    for (number, point) in (1..).zip(&model.points) {
        let head = [u64::to_string(&number)]
            .into_iter()
            .chain(texts(point.track.position));
        let color = texts(point.track.color).chain([point.track.error_px.to_string()]);
        let seen = point
            .seen
            .iter()
            .map(|(image, feature)| format!("{image} {feature}"));
        text += &line(head.chain(color).chain(seen));
    }
    text
}
