//! The photos of a scene's folder as `train` takes them.

use marf_field::View;
use marf_run::session::Session;
use marf_scene::{Frame, Image, Photo, Scene, Srgb, picture_names};

use crate::output::Result;

/// A view to score: name of its picture, its frame, its photo.
#[derive(Clone)]
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
    /// Some of those trained on.
    pub explained: Vec<TestView>,
}

/// Decodes all photos, training and held-out. At most `most` of the training photos are explained.
///
/// # Errors
/// Returns an error if a photo cannot be decoded, or if no photo is held out.
pub fn photos(session: &Session, scene: &Scene, scale: u32, most: usize) -> Result<Photos> {
    let mut photos = Photos {
        views: Vec::new(),
        tests: Vec::new(),
        explained: Vec::new(),
    };
    let training = scene.frames.iter().filter(|frame| !frame.held_out).count();
    let every = training.checked_div(most).map(|_| training.div_ceil(most));
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
        if every.is_some_and(|every| photos.views.len().is_multiple_of(every)) {
            photos.explained.push(test.clone());
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
