//! A scene that may be tied to others.

use marf_cache::Digest;
use marf_scene::{Photo, PhotoFacts, Scene, SiteFrame};
use marf_schema::calibrate::CalibrateParams;
use marf_sfm::align::Similarity;
use marf_sfm::view_graph::PosedCamera;
use marf_stage::{Ctx, StageError};
use nalgebra::{Matrix3, Vector3};

use crate::photos::InputPhoto;
use crate::sfm::{PhotoFeatures, features_of};

/// Separator between a node and its scene: `calibrate@site1-20`.
const OF: char = '@';

/// A scene with its name.
pub(super) struct World {
    pub name: String,
    pub scene: Scene,
}

impl World {
    /// Reads the scene that a node gives.
    pub(super) fn read(ctx: &Ctx<'_>, node: &str, digest: &Digest) -> Result<Self, StageError> {
        let scene = Scene::decode(&ctx.get(digest)?);
        Ok(Self {
            name: node.rsplit(OF).next().unwrap_or(node).to_owned(),
            scene: scene.map_err(|error| StageError::new(format!("the scene of `{node}`: {error}")))?,
        })
    }

    /// Returns the number of the site that labels tie the world to, and that site's frame from the world.
    pub(super) fn site_from_world(&self) -> Option<(i64, Similarity)> {
        let SiteFrame { site, origin_m } = self.scene.site?;
        let frame = Similarity {
            scale: 1.0,
            rotation: Matrix3::identity(),
            translation: Vector3::from(origin_m),
        };
        Some((site, frame))
    }

    /// Returns the camera of a photo with its pose in the site.
    pub(super) fn view_in_site(&self, photo: usize, site_from_world: &Similarity) -> PosedCamera {
        let frame = &self.scene.frames[photo];
        PosedCamera {
            camera: frame.camera,
            cam_from_world: site_from_world.pose(&frame.cam_from_world),
        }
    }

    /// Returns the features of a photo, found now or before.
    pub(super) fn features(&self, ctx: &Ctx<'_>, photo: usize) -> Result<PhotoFeatures, StageError> {
        let frame = &self.scene.frames[photo];
        let item = InputPhoto::new(
            frame.id.clone(),
            frame.image,
            PhotoFacts {
                file: frame.file.clone(),
                width: frame.camera.width,
                height: frame.camera.height,
                ..PhotoFacts::default()
            },
        );
        let mask = frame.mask.map(|mask| {
            Photo::decode_validated(&ctx.get(&mask)?)
                .map_err(|error| StageError::new(format!("the mask of photo `{}`: {error}", frame.id)))
        });
        let mask = mask.transpose()?.map(|mask| mask.image);
        features_of(ctx, &item, None, mask.as_ref(), &CalibrateParams::default())
    }
}
