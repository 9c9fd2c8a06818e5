//! `ties`: relative poses of scenes, from points that photos of both show.

mod common_frame;
mod photo_pairs;
mod sightings;
mod world;

use marf_numeric::upper_median;
use marf_schema::output::SCENE;
use marf_schema::ties::{Apart, LabelGap, SceneTie, Ties, TiesParams};
use marf_sfm::align::{PointAlignment, Sighting, Similarity, align_points};
use marf_stage::{Ctx, Document, Inputs, Outputs, Port, Set, StageError, Threads, stage};
use nalgebra::Vector3;

use self::common_frame::{common_frames, stored};
use self::sightings::{PointPair, point_pairs};
use self::world::World;

/// Least share of points joined by matches that must agree: places that look alike agree in few.
const LEAST_SHARE: f64 = 0.25;
/// Largest factor between the metres of two scenes that both have a scale.
const MOST_SCALE: f64 = 1.1;

/// Ties scenes that show the same ground.
///
/// - In: the scenes, each with cameras and sparse points.
/// - Out: `ties`: the frame of each scene and, for each pair of scenes that photos join, their relative pose with its residual.
/// - Matches of photos of both scenes that agree with one rigid scene join points of one to points of the other. Most of these must agree
///   on one similarity. Scenes with a site stay where labels put them, and the report says how far that is from what they show. Others take
///   the frame of the scene that they share most points with. Nothing else ties: scenes without common ground keep separate frames.
/// - Cost: features of up to 40 photos a scene. `pairs` comparisons for two scenes of one site whose cameras are within 60 m, or if one of
///   the two has no site.
/// - Bad input: a scene without points, or places that look alike, are reported as apart.
pub struct TieScenes(TiesParams);

stage! {
    TieScenes { 0: TiesParams },
    Set,
    Threads::All,
    about: "how scenes lie to each other, where photos of both show the same ground",
    version: 2,
    ports: [Port::many("input", SCENE)],
    outputs: [Ties::OUTPUT],
}

impl Set for TieScenes {
    fn run(&self, ctx: &Ctx<'_>, inputs: &Inputs) -> Result<Outputs, StageError> {
        let worlds = inputs
            .each(SCENE)
            .map(|(node, digest)| World::read(ctx, node, digest));
        let mut worlds = worlds.collect::<Result<Vec<World>, _>>()?;
        worlds.sort_by(|a, b| a.name.cmp(&b.name));
        let count = worlds.len();
        let pairs = (0..count).flat_map(|a| (a + 1..count).map(move |b| [a, b]));
        let total = (count * count.saturating_sub(1) / 2) as u64;
        let (mut ties, mut found) = (Ties::default(), Vec::new());
        for (done, [a, b]) in pairs.enumerate() {
            ctx.check()?;
            ctx.progress.at(done as u64, total, "pairs of scenes compared");
            let scenes = [a, b].map(|one| worlds[one].name.clone());
            match self.tie(ctx, [&worlds[a], &worlds[b]])? {
                Verdict::Tied(tie, similarity) => {
                    found.push(([a, b], similarity, tie.inliers));
                    ties.ties.push(*tie);
                }
                Verdict::Apart(reason) => ties.apart.push(Apart { scenes, reason }),
                Verdict::Unseen => {}
            }
        }
        ties.scenes = common_frames(&worlds, &found);
        let bytes = ties
            .encode()
            .map_err(|error| StageError::new(error.to_string()))?;
        Ok(Outputs::from([(Ties::OUTPUT.to_owned(), ctx.put(&bytes)?)]))
    }
}

/// What two scenes have to do with each other.
enum Verdict {
    /// The tie, and the first world from the second.
    Tied(Box<SceneTie>, Similarity),
    /// Why they are not tied although photos of both were compared.
    Apart(String),
    /// By their labels, no photos of both can show the same ground.
    Unseen,
}

impl TieScenes {
    fn tie(&self, ctx: &Ctx<'_>, worlds: [&World; 2]) -> Result<Verdict, StageError> {
        let params = &self.0;
        if !photo_pairs::may_overlap(worlds) {
            return Ok(Verdict::Unseen);
        }
        if let Some(world) = worlds.iter().find(|world| world.scene.points.is_empty()) {
            return Ok(Verdict::Apart(format!("`{}` has no sparse points", world.name)));
        }
        let pairs = photo_pairs::chosen(ctx, worlds, params.pairs as usize)?;
        if pairs.is_empty() {
            return Ok(Verdict::Unseen);
        }
        let (photo_pairs, points) = point_pairs(ctx, worlds, &pairs, params.seed)?;
        let sightings: Vec<[Sighting<'_>; 2]> = points.iter().map(|pair| pair.sightings(worlds)).collect();
        let min_points = params.min_points as usize;
        let Some(found) = align_points(&sightings, min_points, params.seed) else {
            let reason = match points.len() {
                0 => "no photos of both show the same".to_owned(),
                count => format!(
                    "{count} points of both look alike, and fewer than {min_points} agree on how they lie to each other"
                ),
            };
            return Ok(Verdict::Apart(reason));
        };
        if let Some(reason) = doubt(worlds, &found, points.len()) {
            return Ok(Verdict::Apart(reason));
        }
        let tie = told(worlds, photo_pairs, &points, &sightings, &found);
        Ok(Verdict::Tied(Box::new(tie), found.similarity))
    }
}

/// Returns why points that agree are not accepted as a tie.
fn doubt([first, second]: [&World; 2], found: &PointAlignment, points: usize) -> Option<String> {
    let agree = found.inliers.len();
    if (agree as f64) < LEAST_SHARE * points as f64 {
        return Some(format!(
            "of {points} points that look alike {agree} agree, as places do that look alike"
        ));
    }
    let metres = |world: &World| world.scene.metres_per_unit;
    let scale = found.similarity.scale * metres(first)? / metres(second)?;
    let is_off = !(1.0 / MOST_SCALE..=MOST_SCALE).contains(&scale);
    is_off.then(|| {
        format!(
            "a metre of `{}` would be {scale:.2} m of `{}`: they look alike, or a scale is wrong",
            second.name, first.name
        )
    })
}

/// Returns the report on a tie.
fn told(
    worlds: [&World; 2],
    photo_pairs: u32,
    points: &[PointPair],
    sightings: &[[Sighting<'_>; 2]],
    found: &PointAlignment,
) -> SceneTie {
    let similarity = &found.similarity;
    let agree = || found.inliers.iter().map(|&index| &sightings[index]);
    let off_px = agree().filter_map(|[a, b]| {
        let seen = a
            .camera
            .project(&a.cam_from_world.point(&similarity.point(&b.point)))?;
        let longer = f64::from(a.camera.width.max(a.camera.height));
        Some((seen - a.pixel).norm() * 1000.0 / longer)
    });
    let apart = agree().map(|[a, b]| (a.point - similarity.point(&b.point)).norm());
    SceneTie {
        scenes: worlds.map(|world| world.name.clone()),
        photo_pairs,
        points: points.len() as u32,
        inliers: found.inliers.len() as u32,
        median_px: median(off_px),
        median_m: worlds[0]
            .scene
            .metres_per_unit
            .map(|metres| metres * median(apart)),
        first_from_second: stored(similarity),
        labels: label_gap(worlds, found, sightings),
    }
}

/// Returns how far the frames of the labels of both are from where the points put them.
fn label_gap(
    worlds: [&World; 2],
    found: &PointAlignment,
    sightings: &[[Sighting<'_>; 2]],
) -> Option<LabelGap> {
    let [first, second] = worlds.map(World::site_from_world);
    let ((site, first), (other, second)) = (first?, second?);
    if site != other {
        return None;
    }
    let shifts = found.inliers.iter().map(|&index| {
        let [a, b] = &sightings[index];
        second.point(&b.point) - first.point(&a.point)
    });
    let shift = shifts.sum::<Vector3<f64>>() / found.inliers.len() as f64;
    Some(LabelGap {
        shift_m: shift.into(),
        angle_deg: found.similarity.angle_rad().to_degrees(),
        scale: found.similarity.scale,
    })
}

/// Returns the median. Without values it is NaN.
fn median(values: impl Iterator<Item = f64>) -> f64 {
    upper_median(values).unwrap_or(f64::NAN)
}
