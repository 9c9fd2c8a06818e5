//! The photos of a scene's folder as `train` takes them.

use marf_field::View;
use marf_run::session::Session;
use marf_scene::{Frame, Image, Photo, Scene, Srgb, picture_names};

use crate::output::Result;

/// A view to score: name of its picture, its frame, its photo.
pub struct TestView {
    pub name: String,
    pub frame: Frame,
    pub photo: Image<Srgb>,
}

/// The photos of a scene.
pub struct Photos {
    /// Trained on.
    pub views: Vec<View>,
    /// Held out.
    pub tests: Vec<TestView>,
}

/// Decodes all photos, training and held-out.
///
/// # Errors
/// Returns an error if a photo cannot be decoded, or if no photo is held out.
pub fn photos(session: &Session, scene: &Scene, scale: u32) -> Result<Photos> {
    let mut photos = Photos {
        views: Vec::new(),
        tests: Vec::new(),
    };
    for (frame, name) in scene.frames.iter().zip(picture_names(scene)) {
        let photo = Photo::decode(&session.store.get(&frame.image)?)
            .map_err(|error| format!("photo `{}`: {error}", frame.id))?;
        let frame = Frame {
            camera: frame.camera.box_reduced(scale),
            ..frame.clone()
        };
        let test = TestView {
            name,
            photo: photo.image.box_reduced(scale),
            frame,
        };
        if test.frame.held_out {
            photos.tests.push(test);
            continue;
        }
        photos.views.push(View {
            id: test.frame.id,
            camera: test.frame.camera,
            cam_from_world: test.frame.cam_from_world,
            image: test.photo.into(),
            distances: Vec::new(),
        });
    }
    if photos.tests.is_empty() {
        return Err("no photo is held out: `test_filenames` names none".into());
    }
    Ok(photos)
}
