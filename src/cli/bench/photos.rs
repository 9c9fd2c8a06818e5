//! The photos of a scene's folder as `marf bench train` takes them.

use marf_field::View;
use marf_scene::{Frame, Image, Photo, Scene, Srgb, picture_names};

use marf_run::Error;
use marf_run::session::Session;

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

/// Decodes all photos, those to train on and those held out; at most `most` of the former are explained.
///
/// # Errors
/// A photo that cannot be decoded; no photo held out.
pub fn photos(session: &Session, scene: &Scene, scale: u32, most: usize) -> Result<Photos, Error> {
    let (mut views, mut tests, mut explained) = (Vec::new(), Vec::new(), Vec::new());
    let training = scene.frames.iter().filter(|frame| !frame.held_out).count();
    let every = training.checked_div(most).map(|_| training.div_ceil(most));
    for (frame, name) in scene.frames.iter().zip(picture_names(scene)) {
        let photo = Photo::decode(&session.store.get(&frame.image)?);
        let photo = photo.map_err(|error| Error::failed(format!("photo `{}`: {error}", frame.id)))?;
        let photo = photo.image.box_reduced(scale);
        let camera = frame.camera.box_reduced(scale);
        let frame = Frame {
            camera,
            ..frame.clone()
        };
        if frame.held_out {
            tests.push(TestView { name, frame, photo });
        } else {
            if every.is_some_and(|every| views.len() % every == 0) {
                let (frame, photo) = (frame.clone(), photo.clone());
                explained.push(TestView { name, frame, photo });
            }
            views.push(View {
                id: frame.id.clone(),
                camera,
                cam_from_world: frame.cam_from_world,
                image: photo.into(),
            });
        }
    }
    if tests.is_empty() {
        return Err(Error::failed("no photo is held out: `test_filenames` names none"));
    }
    Ok(Photos {
        views,
        tests,
        explained,
    })
}
