//! A training that starts from the field of its node's last run: what it takes over, and when it does not fit.

use std::collections::BTreeSet;
use std::sync::Arc;

use marf_field::{Config, Field, PhotoHistory};
use marf_numeric::upper_median;
use marf_scene::{Pose, Scene};
use marf_schema::{
    output::STATE,
    train::{TrainParams, WarmStart},
};
use marf_stage::{Ctx, EARLIER, Inputs, StageError};

use super::{photo_set::PhotoSet, setup::Settings};
use crate::split::NamedFrame;

/// Fewest photos of the field that must still be in the scene, to check whether its frame is the same.
const LEAST_COMMON: usize = 2;
/// Farthest that half of the photos may have moved, as a share of the distance to what they show, or turned, radians. At 360 pixels a photo
/// is 5 pixels off.
const MOVED: f64 = 0.01;
/// Farthest that a scene may reach from the middle of the field's box, in half sides of it.
const REACH: f64 = 1.25;

/// What a training starts from.
pub(super) struct Start {
    /// The field of the last run. `None` for a cold start.
    pub field: Option<Field>,
    /// As setup and metrics report it. `None` without `warm_start`.
    pub report: Option<WarmStart>,
    /// The state to continue from. `None` for step 0.
    pub state: Option<Arc<[u8]>>,
}

impl Start {
    /// Decides whether the training starts from the field of its node's last run. If so, the settings follow that field.
    ///
    /// # Errors
    /// A field or a state that cannot be read from the store.
    pub fn decide(
        ctx: &Ctx<'_>,
        params: &TrainParams,
        inputs: &Inputs,
        photos: &PhotoSet<'_>,
        settings: &mut Settings,
    ) -> Result<Self, StageError> {
        let state = inputs.optional(STATE).map(|digest| ctx.get(digest)).transpose()?;
        let warm = if params.warm_start {
            Self::warm(ctx, inputs, photos, settings)?
        } else {
            Self::cold(None)
        };
        Ok(Self { state, ..warm })
    }

    fn warm(
        ctx: &Ctx<'_>,
        inputs: &Inputs,
        photos: &PhotoSet<'_>,
        settings: &mut Settings,
    ) -> Result<Self, StageError> {
        let Some(digest) = inputs.optional(EARLIER) else {
            let first = "this node has not finished before".to_owned();
            return Ok(Self::cold(Some(first)));
        };
        let scene = photos.scene;
        let judged: Vec<&str> = ids(&photos.split.held_out)
            .chain(ids(&photos.validation))
            .collect();
        let fitting = Field::decode(&ctx.get(digest)?)
            .map_err(|error| error.to_string())
            .and_then(|field| {
                let learnt = field
                    .learnt()
                    .ok_or("it does not name its photos: it was trained without `warm_start`")?;
                check_photos(learnt, scene, &judged, field.derived().depth)?;
                check_config(&field, settings)?;
                check_box(&field, learnt, scene)?;
                Ok(field)
            });
        match fitting {
            Ok(field) => {
                settings.follow(&field);
                Ok(Self {
                    field: Some(field),
                    report: Some(WarmStart::From(*digest)),
                    state: None,
                })
            }
            Err(why) => {
                ctx.progress.warn(&format!(
                    "it starts from scratch, not from the field of the last run: {why}"
                ));
                Ok(Self::cold(Some(why)))
            }
        }
    }

    fn cold(why: Option<String>) -> Self {
        Self {
            field: None,
            report: why.map(WarmStart::Cold),
            state: None,
        }
    }
}

fn ids<'a>(frames: &'a [NamedFrame<'_>]) -> impl Iterator<Item = &'a str> {
    frames.iter().map(|named| named.frame.id.as_str())
}

/// Checks that the field has seen no photo that judges it, and that the photos of both are where they were.
fn check_photos(learnt: &PhotoHistory, scene: &Scene, judged: &[&str], depth: f64) -> Result<(), String> {
    let mut seen = judged.iter().filter(|id| learnt.photo(id).is_some());
    if let Some(first) = seen.next() {
        let more = match seen.count() {
            0 => String::new(),
            more => format!(" and {more} more"),
        };
        return Err(format!("photo `{first}`{more}, held out now, it was trained on"));
    }
    if learnt.metres_per_unit != scene.metres_per_unit {
        let said = |unit: Option<f64>| unit.map_or("unknown".to_owned(), |metres| format!("{metres} m"));
        let [was, is] = [learnt.metres_per_unit, scene.metres_per_unit].map(said);
        return Err(format!("a unit of the scene is {is} and was {was}"));
    }
    let common = learnt.photos.iter().filter_map(|photo| {
        let frame = scene.frame(&photo.id)?;
        Some(moved(&photo.cam_from_world, &frame.cam_from_world, depth))
    });
    let moved: Vec<f64> = common.collect();
    if moved.len() < LEAST_COMMON {
        let (now, all) = (moved.len(), learnt.photos.len());
        return Err(format!(
            "of the {all} photos it was trained on {now} are in the scene"
        ));
    }
    match upper_median(moved) {
        Some(median) if median > MOVED => Err(format!(
            "half of its photos are {:.1} % of the distance to what they show, or as much of a radian, from where they were",
            100.0 * median
        )),
        _ => Ok(()),
    }
}

/// Returns how far a photo is from where it was: the larger of its way, as a share of `depth`, and its turn, radians.
fn moved(was: &Pose, is: &Pose, depth: f64) -> f64 {
    let way = (is.centre() - was.centre()).norm() / depth;
    // The Frobenius norm of the difference of two rotations is √2 times the angle between them, where that is small.
    way.max((is.rotation - was.rotation).norm() / std::f64::consts::SQRT_2)
}

/// Checks that the field was trained with these settings. Its length, and what pulled, may differ.
fn check_config(field: &Field, settings: &Settings) -> Result<(), String> {
    let [was, is] = [field.config(), &settings.config].map(table);
    let keys: BTreeSet<&String> = was.keys().chain(is.keys()).collect();
    let text = |value: Option<&serde_json::Value>| value.map_or("left out".to_owned(), ToString::to_string);
    let may_differ = |key: &str| ["steps", "depth_source"].contains(&key);
    match keys
        .into_iter()
        .find(|key| was.get(*key) != is.get(*key) && !may_differ(key))
    {
        Some(key) => Err(format!(
            "`field.{key}` is {} and was {}",
            text(is.get(key)),
            text(was.get(key))
        )),
        None => Ok(()),
    }
}

/// Returns the keys of a configuration with their values.
fn table(config: &Config) -> serde_json::Map<String, serde_json::Value> {
    match serde_json::to_value(config) {
        Ok(serde_json::Value::Object(table)) => table,
        // A configuration always serialises as a table.
        _ => serde_json::Map::new(),
    }
}

/// Checks that the scene has not outgrown the box of the field.
fn check_box(field: &Field, learnt: &PhotoHistory, scene: &Scene) -> Result<(), String> {
    let points: Vec<[f64; 3]> = scene.points.iter().map(|point| point.position).collect();
    let before: Vec<_> = learnt
        .photos
        .iter()
        .map(|photo| photo.cam_from_world.centre())
        .collect();
    let now: Vec<_> = scene
        .frames
        .iter()
        .map(|frame| frame.cam_from_world.centre())
        .collect();
    match field.derived().reach(&points, &before, &now) {
        reach if reach > REACH => Err(format!(
            "the scene reaches {reach:.2} half sides of its box from the middle, at most {REACH}"
        )),
        _ => Ok(()),
    }
}
