//! `scenes`: the photos of a mission split by place, so that each place is calibrated and trained by itself.

mod by_label;
mod by_overlap;
mod group;
mod label_position;

use std::collections::{BTreeMap, BTreeSet};

use marf_cache::manifest::{Leaf, LeafRef, ROWS_A_LEAF, Root, Row};
use marf_cache::{Digest, manifest::ManifestError};
use marf_schema::calibrate::CalibrateParams;
use marf_schema::output::PHOTOS_OF;
use marf_schema::scenes::{By, Scenes, ScenesParams, Stop};
use marf_stage::{COMPANIONS, Ctx, Document, Inputs, Outputs, PHOTOS, Port, Set, StageError, Threads, stage};

use self::by_label::{joined, places};
use self::group::{Group, SplitInput, mean, name_apart};
use self::label_position::LabelPosition;
use crate::photos::{InputPhoto, item, rows};
use crate::sfm::{Overlap, capture_order, overlaps};

/// Splits photos by place.
///
/// - In: the photos. Where photos are compared, also the files next to them, for masks.
/// - Out: `scenes` (the group of each photo and why), `photos/NAME` (the photos of each scene) and `photos` (those of all scenes).
/// - By labels: photos of one site and drive are one place. Drive by drive, places join the nearest group within `max_span_m` and
///   `max_photos`. Photos without a usable label join the group they share most verified matches with.
/// - Cost: by labels only their rows. By overlap features and matches, which are kept for `calibrate`.
/// - Bad input: a wrong site makes a separate group, too small for a scene. Such groups are named and left out. No scene at all stops the
///   node.
pub struct SplitByPlace(ScenesParams);

stage! {
    SplitByPlace { 0: ScenesParams },
    Set,
    Threads::All,
    about: "splits the photos of a mission by place, so that the nodes after it run once for each scene",
    version: 3,
    ports: [
        Port::required("input", PHOTOS),
        Port::optional("cameras", COMPANIONS),
    ],
    outputs: [Scenes::OUTPUT, PHOTOS, PHOTOS_OF],
}

impl Set for SplitByPlace {
    fn run(&self, ctx: &Ctx<'_>, inputs: &Inputs) -> Result<Outputs, StageError> {
        let rows = rows(ctx, inputs)?;
        let items = rows.iter().map(|(_, row)| item(row.clone()));
        let items = items.collect::<Result<Vec<InputPhoto>, _>>()?;
        let labels = items
            .iter()
            .enumerate()
            .map(|(index, item)| LabelPosition::from_photo(index, item));
        let labels: Vec<Option<LabelPosition>> = labels.collect();
        let (groups, overlaps) = self.groups(ctx, inputs, &items, &labels)?;
        let known = SplitInput {
            items: &items,
            labels: &labels,
            overlaps: &overlaps,
        };
        let (scenes, told) = self.judged(groups, &known)?;
        let mut outputs = Outputs::new();
        for scene in &scenes {
            let chosen: BTreeSet<usize> = scene.members.iter().copied().collect();
            let photos = set_of(ctx, &rows, &chosen)?;
            outputs.insert(format!("{PHOTOS_OF}{}", scene.name), photos);
        }
        let all = scenes.iter().flat_map(|scene| scene.members.iter().copied());
        outputs.insert(PHOTOS.to_owned(), set_of(ctx, &rows, &all.collect())?);
        let told = told
            .encode()
            .map_err(|error| StageError::new(error.to_string()))?;
        outputs.insert(Scenes::OUTPUT.to_owned(), ctx.put(&told)?);
        Ok(outputs)
    }
}

impl SplitByPlace {
    /// Returns groups of all photos, and the overlaps that were looked for.
    fn groups(
        &self,
        ctx: &Ctx<'_>,
        inputs: &Inputs,
        items: &[InputPhoto],
        labels: &[Option<LabelPosition>],
    ) -> Result<(Vec<Group>, Vec<Overlap>), StageError> {
        let params = &self.0;
        let max_photos = params.max_photos as usize;
        let mut free: BTreeSet<usize> = (0..items.len()).collect();
        let by_hand = params.groups.iter();
        let mut groups: Vec<Group> = by_hand
            .map(|(name, wanted)| Group::by_hand(name, wanted, items, &mut free))
            .collect();
        let order: Vec<usize> = capture_order(items)
            .into_iter()
            .filter(|index| free.contains(index))
            .collect();
        let label_of = |index: &usize| labels[*index].filter(|_| params.by != By::Overlap);
        let with = order.iter().filter_map(|index| Some((*index, label_of(index)?)));
        let without: Vec<usize> = order
            .iter()
            .copied()
            .filter(|index| label_of(index).is_none())
            .collect();
        let places = places(&with.collect::<Vec<_>>(), max_photos);
        let joined = joined(&places, params.max_span_m, max_photos);
        groups.extend(joined.iter().map(|places| by_label::group(places)));
        let mut found = Vec::new();
        match params.by {
            _ if without.is_empty() => {}
            By::Label => groups.push(Group {
                name: "unlabelled".to_owned(),
                reason:
                    "no label has their site and position (`by = \"auto\"` groups them by what they show)"
                        .to_owned(),
                members: without,
            }),
            By::Auto | By::Overlap => {
                found = overlaps(ctx, inputs, items, &CalibrateParams::default())?;
                by_overlap::join(&mut groups, &without, &found, items, max_photos);
            }
        }
        name_apart(&mut groups);
        groups.sort_by(|a, b| a.name.cmp(&b.name));
        Ok((groups, found))
    }

    /// Returns the groups that are scenes, and the report on all groups.
    fn judged(&self, groups: Vec<Group>, known: &SplitInput<'_>) -> Result<(Vec<Group>, Scenes), StageError> {
        let min_photos = self.0.min_photos as usize;
        let (mut scenes, mut told) = (Vec::new(), Scenes::default());
        for group in groups {
            let is_unlabelled =
                self.0.by == By::Label && group.members.iter().all(|one| known.labels[*one].is_none());
            let fault = if is_unlabelled {
                Some(group.reason.clone())
            } else {
                group.fault(known, min_photos)
            };
            match fault {
                None => {
                    told.scenes.push(group.told(known));
                    scenes.push(group);
                }
                Some(reason) => {
                    let mut skipped = group.told(known);
                    skipped.reason = reason;
                    told.skipped.push(skipped);
                }
            }
        }
        if scenes.is_empty() {
            return Err(none(&told, known.items.len()));
        }
        told.stops = stops(known, &scenes);
        Ok((scenes, told))
    }
}

/// Returns the error that no group is a scene, with the largest of them.
fn none(told: &Scenes, photos: usize) -> StageError {
    let largest = told.skipped.iter().max_by_key(|group| group.photos.len());
    let error = StageError::new(format!(
        "none of {} groups of {photos} photos is a scene",
        told.skipped.len()
    ));
    let error = match largest {
        Some(group) => error.cause(format!("the largest, `{}`: {}", group.name, group.reason)),
        None => error,
    };
    error.hint("lower `min_photos`, raise `max_span_m`, widen `sols`, or name photos in `groups`")
}

/// Returns the stops of the rover, by site and drive.
fn stops(known: &SplitInput<'_>, scenes: &[Group]) -> Vec<Stop> {
    let mut scene_of: BTreeMap<usize, &str> = BTreeMap::new();
    for scene in scenes {
        scene_of.extend(scene.members.iter().map(|member| (*member, scene.name.as_str())));
    }
    let mut by_stop: BTreeMap<by_label::Stop, Vec<usize>> = BTreeMap::new();
    for (index, label) in known.labels.iter().enumerate() {
        if let Some(label) = label {
            by_stop.entry((label.site, label.drive)).or_default().push(index);
        }
    }
    let stop = |((site, drive), members): (by_label::Stop, Vec<usize>)| {
        let labels = members.iter().filter_map(|member| known.labels[*member].as_ref());
        let centre = mean(labels.map(|label| &label.centre));
        let scenes = members.iter().filter_map(|member| scene_of.get(member));
        let scenes: BTreeSet<&str> = scenes.copied().collect();
        Stop {
            site,
            drive,
            position_m: [centre.x, centre.y],
            photos: members.len() as u64,
            scenes: scenes.into_iter().map(str::to_owned).collect(),
        }
    };
    by_stop.into_iter().map(stop).collect()
}

/// Stores the set of chosen rows, and returns the digest of its root.
fn set_of(ctx: &Ctx<'_>, rows: &[(u32, Row)], chosen: &BTreeSet<usize>) -> Result<Digest, StageError> {
    let broken = |error: ManifestError| StageError::new(format!("the set of photos: {error}"));
    let mut by_shard: BTreeMap<u32, Vec<Row>> = BTreeMap::new();
    for (shard, row) in chosen.iter().map(|index| &rows[*index]) {
        by_shard.entry(*shard).or_default().push(row.clone());
    }
    let mut root = Root::default();
    for (shard, mut rows) in by_shard {
        rows.sort_by(|a, b| a.id.cmp(&b.id));
        for rows in rows.chunks(ROWS_A_LEAF) {
            root.leaves.push(LeafRef {
                shard,
                rows: rows.len() as u32,
                leaf: ctx.put(&Leaf::new(rows.to_vec()).map_err(broken)?.encode())?,
            });
        }
    }
    root.write(|bytes| ctx.put(bytes))
}
