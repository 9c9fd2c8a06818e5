//! Files next to photos: cameras and points of other programs, and masks.

use crate::archive::folder;

/// Cameras and points of other programs, kept for `calibrate`. Every `transforms….json` is kept too.
const CAMERA_FILES: [&str; 8] = [
    "cameras.bin",
    "cameras.txt",
    "images.bin",
    "images.txt",
    "points3D.bin",
    "points3D.txt",
    "points.ply",
    "sparse_pc.ply",
];
/// What names of folders begin with in which programs put models (`sparse/0`, `colmap/sparse/0`, `colmap_text`, `dense/sparse`).
const MODEL_FOLDERS: [&str; 12] = [
    "sparse",
    "colmap",
    "glomap",
    "dense",
    "distorted",
    "undistorted",
    "text",
    "txt",
    "bin",
    "model",
    "sfm",
    "reconstruction",
];
/// Longest number that is a folder of one of several models.
const MOST_DIGITS: usize = 3;
/// Extensions of photos that may have a mask next to them.
const PHOTO_ENDS: [&str; 8] = ["jpg", "jpeg", "png", "tif", "tiff", "webp", "JPG", "PNG"];

/// Whether a file holds cameras or points, at the top or in folders where programs put these.
pub(super) fn is_camera_file(path: &str) -> bool {
    let name = path.rsplit('/').next().unwrap_or_default();
    let is_transforms = name.starts_with("transforms") && name.ends_with(".json");
    (is_transforms || CAMERA_FILES.contains(&name)) && folder(path).split('/').all(is_model_folder)
}

/// Whether a folder of this name may hold models. The name is empty for a path at the top.
fn is_model_folder(name: &str) -> bool {
    let is_number = name.len() <= MOST_DIGITS && name.bytes().all(|byte| byte.is_ascii_digit());
    let name = name.to_ascii_lowercase();
    is_number || MODEL_FOLDERS.iter().any(|start| name.starts_with(start))
}

/// Whether a picture masks photos: in a folder `masks` (`mask`, `masks_2`), or named after a photo in its own folder
/// as `NAME.jpg.png` (COLMAP) or `NAME_mask.png`. `exists` reports whether a file exists.
pub(super) fn is_mask(path: &str, exists: &dyn Fn(&str) -> bool) -> bool {
    let in_masks = |part: &str| matches!(part, "masks" | "mask") || part.starts_with("masks_");
    if folder(path).to_ascii_lowercase().split('/').any(in_masks) {
        return true;
    }
    let bare = path.rsplit_once('.').map_or(path, |(bare, _)| bare);
    if PHOTO_ENDS.iter().any(|end| bare.ends_with(&format!(".{end}"))) && exists(bare) {
        return true;
    }
    let photo = bare.strip_suffix("_mask");
    photo.is_some_and(|photo| PHOTO_ENDS.iter().any(|end| exists(&format!("{photo}.{end}"))))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn models_are_found_where_programs_put_them_and_nowhere_else() {
        for path in [
            "transforms.json",
            "transforms_2.json",
            "sparse/0/cameras.bin",
            "sparse/images.txt",
            "colmap/sparse/0/images.txt",
            "colmap_text/cameras.txt",
            "colmap/text/points3D.txt",
            "dense/sparse/images.bin",
            "distorted/sparse/1/images.bin",
            "0/cameras.txt",
        ] {
            assert!(is_camera_file(path), "{path}");
        }
        for path in [
            "metrics.json",
            "other/cameras.txt",
            "sol/0/images.bin",
            "sparse/1234/cameras.txt",
            "notes.txt",
        ] {
            assert!(!is_camera_file(path), "{path}");
        }
    }

    #[test]
    fn masks_are_told_by_their_folder_or_by_the_photo_beside_them() {
        let photos = ["images/a.jpg", "b.png", "b_mask.png"];
        let exists = |name: &str| photos.contains(&name);
        for mask in [
            "masks/a.png",
            "mask/a.png",
            "scan/Masks/a.jpg",
            "masks_2/a.png",
            "images/a.jpg.png",
            "images/a_mask.png",
            "b_mask.png",
        ] {
            assert!(is_mask(mask, &exists), "{mask}");
        }
        for photo in [
            "images/a.jpg",
            "unmasked/a.png",
            "images/c_mask.png",
            "images/c.jpg.png",
            "gas_mask.png",
        ] {
            assert!(!is_mask(photo, &exists), "{photo}");
        }
    }
}
