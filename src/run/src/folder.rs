//! Pipelines of one folder, for verbs that take one.

use std::path::Path;

/// Returns the beginning of a pipeline with the photos of a folder.
pub fn photos(name: &str, dir: &Path) -> String {
    let path = toml::Value::String(dir.to_string_lossy().into_owned());
    format!(
        "name = \"{name}\"\n[archive.folder]\nkind = \"folder\"\npath = {path}\n[node.extract]\narchive = \"folder\"\n"
    )
}

/// Returns a pipeline that finds the cameras of photos.
pub fn calibration(name: &str, dir: &Path, method: &str) -> String {
    format!(
        "{}[node.calibrate]\ninput = \"extract\"\ncameras = \"extract\"\nmethod = \"{}\"\n",
        photos(name, dir),
        method
    )
}

/// Returns a pipeline that finds the cameras of photos and writes them for other programs; `photos_at`: the folder of the photos as seen
/// from transforms.json.
pub fn cameras(name: &str, dir: &Path, method: &str, photos_at: &str, undistort: bool) -> String {
    let photos_at = toml::Value::String(photos_at.to_owned());
    format!(
        "{}[node.cameras]\ninput = \"calibrate\"\nphotos = \"extract\"\nphotos_at = {photos_at}\nundistort = {undistort}\n",
        calibration(name, dir, method)
    )
}

/// Returns a pipeline that trains a field on photos, with cameras that lie beside them or by structure from motion; keys of the training
/// may follow.
pub fn training(name: &str, dir: &Path) -> String {
    format!(
        "{}[node.train]\ninput = \"calibrate\"\n",
        calibration(name, dir, "auto")
    )
}
