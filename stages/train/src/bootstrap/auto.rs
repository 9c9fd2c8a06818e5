//! How many members are enough: as many as it takes until two more no longer change how well their spread ranks errors.

use marf_cache::{Digest, digest_of};
use marf_field::{Device, Field};
use marf_scene::{Camera, Image, Photo, Pose, Scene, Srgb, picture_names};
use marf_schema::{
    bootstrap::Round,
    output::{PHOTO, WEIGHTS},
    train,
};
use marf_stage::{Ctx, Inputs, Outputs, StageError};

use super::{
    maps::{gray, moments},
    normality::mean,
    sparsification::{Norm, hundredths, sparsify},
};
use crate::{
    TrainError,
    child::Child,
    error::field_failed,
    io::read_scene,
    photos::{PhotoReader, ScaledPhoto},
    view::floats,
};

/// Members of the first round.
pub(super) const FIRST: u32 = 3;
/// Members of every further round.
pub(super) const MORE: u32 = 2;
/// Most members.
const MOST: u32 = 21;
/// A smaller change of AUSE counts as no change.
const LEAST_CHANGE: f64 = 0.01;
/// Longest side of the photos it is measured on, pixels.
pub(super) const SIDE_PX: u32 = 160;

/// Returns whether the last two members have changed AUSE by less than 0.01, or there are 21 members.
///
/// # Errors
/// No photo held out, or what keeps a field from being rendered.
pub(super) fn is_enough(
    ctx: &Ctx<'_>,
    device: &Device,
    inputs: &Inputs,
    done: &[Outputs],
) -> Result<bool, StageError> {
    if done.len() as u32 >= MOST {
        return Ok(true);
    }
    let rounds = rounds(ctx, device, inputs, done)?;
    let change = match rounds.as_slice() {
        [.., before, last] => (before.ause_mae - last.ause_mae).abs(),
        _ => f64::INFINITY,
    };
    Ok(change < LEAST_CHANGE)
}

/// Returns AUSE with the members of every round so far.
pub(super) fn rounds(
    ctx: &Ctx<'_>,
    device: &Device,
    inputs: &Inputs,
    done: &[Outputs],
) -> Result<Vec<Round>, StageError> {
    let scene = read_scene(ctx, inputs)?;
    let members = Child::numbered("member", done);
    let views = members
        .first()
        .map(|first| small_views(ctx, &scene, first))
        .transpose()?
        .unwrap_or_default();
    if views.is_empty() {
        let placed = scene.frames.len();
        return Err(TrainError::NoHeldOut { placed }.into());
    }
    let grays = members
        .iter()
        .map(|member| grays(ctx, device, member, &views))
        .collect::<Result<Vec<_>, StageError>>()?;
    let counts = (FIRST as usize..=members.len()).step_by(MORE as usize);
    let round = |count: usize| Round {
        b: count as u32,
        ause_mae: mean(
            views
                .iter()
                .enumerate()
                .map(|(view, small)| ause(small, view, &grays[..count])),
        ),
    };
    Ok(counts.map(round).collect())
}

/// Pixels of a photo that was held out.
struct SmallView {
    camera: Camera,
    cam_from_world: Pose,
    /// Gray of the photo, negative where its mask hides it.
    gray: Vec<f64>,
    /// Of the photo as the members wrote it.
    digest: Digest,
}

fn small_views(ctx: &Ctx<'_>, scene: &Scene, first: &Child<'_>) -> Result<Vec<SmallView>, StageError> {
    let scale = first.read::<train::Metrics>(ctx)?.scale;
    let photos = PhotoReader::new(ctx, scene, scale);
    let mut views = Vec::new();
    for (frame, name) in scene.frames.iter().zip(picture_names(scene)) {
        let output = format!("{PHOTO}{name}.png");
        let Some(digest) = first.outputs.get(&output) else {
            continue;
        };
        let photo = Photo::decode(&ctx.get(digest)?).map_err(|error| first.malformed(&output, &error))?;
        let image: Image<Srgb> = photo.image;
        let scaled = ScaledPhoto {
            camera: frame.camera.box_reduced(scale),
            image,
            alpha: Vec::new(),
            hidden: photos.hidden(frame)?,
            falloff: None,
        };
        let small = scaled.thinned_to(SIDE_PX);
        let grays = small.image.pixels.iter().enumerate().map(|(pixel, rgb)| {
            let is_hidden = small.hidden.get(pixel).copied().unwrap_or(false);
            if is_hidden {
                -1.0
            } else {
                gray(&rgb.map(|value| f32::from(value) / 255.0))
            }
        });
        let grays: Vec<f64> = grays.collect();
        views.push(SmallView {
            camera: small.camera,
            cam_from_world: frame.cam_from_world,
            gray: grays,
            digest: *digest,
        });
    }
    Ok(views)
}

/// Returns the gray renders of a member at every view. Each is a memo, so that a further round renders only its own members.
fn grays(
    ctx: &Ctx<'_>,
    device: &Device,
    member: &Child<'_>,
    views: &[SmallView],
) -> Result<Vec<Vec<f32>>, StageError> {
    let weights = *member.digest(WEIGHTS)?;
    let mut field: Option<Field> = None;
    let of_view = views.iter().map(|view| {
        ctx.check()?;
        let key = digest_of(&(
            "gray render 2",
            (weights, view.digest),
            (marf_field_gpu::backend_id(device), SIDE_PX),
        ));
        let known = ctx.memos.load(&key).and_then(|bytes| floats(&bytes));
        if let Some(known) = known.filter(|known| known.len() == view.gray.len()) {
            return Ok(known);
        }
        let field = match &mut field {
            Some(field) => field,
            None => {
                let decoded = Field::decode(&ctx.get(&weights)?);
                let decoded = decoded.map_err(|error| member.malformed(WEIGHTS, &error))?;
                let decoded = marf_field_gpu::open(device).and_then(|backend| decoded.with_backend(backend));
                field.insert(decoded.map_err(field_failed)?)
            }
        };
        let render = field
            .render(&view.camera, &view.cam_from_world)
            .map_err(field_failed)?;
        let grays: Vec<f32> = render.rgb.iter().map(|rgb| gray(rgb) as f32).collect();
        let bytes: Vec<u8> = grays.iter().flat_map(|value| value.to_le_bytes()).collect();
        ctx.memos.save(&key, &bytes);
        Ok(grays)
    });
    of_view.collect()
}

/// Returns AUSE of the members' standard deviation at one view, mean absolute error.
fn ause(small: &SmallView, view: usize, grays: &[Vec<Vec<f32>>]) -> f64 {
    let mut values = vec![0.0; grays.len()];
    let open = small.gray.iter().enumerate().filter(|(_, photo)| **photo >= 0.0);
    let pixels = open.map(|(pixel, photo)| {
        for (slot, member) in values.iter_mut().zip(grays) {
            *slot = f64::from(member[view][pixel]);
        }
        let moments = moments(&mut values);
        (moments.sample as f32, (moments.mean - photo).abs() as f32)
    });
    let (std, error): (Vec<_>, Vec<_>) = pixels.unzip();
    sparsify(&std, &error, &hundredths(), Norm::Mae).ause
}
