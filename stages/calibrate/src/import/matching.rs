//! Which photo each camera of a file is for.

use std::collections::{BTreeMap, BTreeSet};

use marf_schema::calibrate::Missing;

use super::cameras::{Role, View};
use super::choose::folder;
use super::photo_names::{Match, PhotoNames};
use crate::photos::InputPhoto;

/// Photos with their views, and what has no partner.
pub(super) struct MatchedViews<'a> {
    pub pairs: Vec<(usize, &'a View)>,
    pub unplaced: Vec<(usize, String)>,
    pub missing: Vec<Missing>,
    /// The folder that was chosen among several with photos of the same names, and why.
    pub choice: Option<String>,
}

/// Finds the photo of each view of the file `source`.
///
/// A view that names no photo, or one of several without a reason to prefer one, is missing. Of two equal views of one photo the second is
/// missing. If they differ, the photo has no camera.
pub(super) fn match_views<'a>(source: &str, views: &'a [View], items: &[InputPhoto]) -> MatchedViews<'a> {
    let photos = PhotoNames::new(items);
    let matches: Vec<Match> = views.iter().map(|view| photos.find(&view.file)).collect();
    let folders = Folders::new(source, views, &matches, items);
    let (mut taken, mut conflicts) = (BTreeMap::<usize, &View>::new(), BTreeMap::new());
    let mut missing = Vec::new();
    for (view, found) in views.iter().zip(&matches) {
        let miss = |reason: String| Missing {
            file: view.file.clone(),
            reason,
        };
        let item = match folders.photo(view, found, items) {
            Ok(item) => item,
            Err(reason) => {
                missing.push(miss(reason));
                continue;
            }
        };
        let Some(first) = taken.get(&item) else {
            taken.insert(item, view);
            continue;
        };
        if first.is_repeated_by(view) {
            missing.push(miss(format!("{} repeats {}", view.place, first.place)));
            if view.role == Role::HeldOut {
                taken.insert(item, view);
            }
        } else {
            conflicts.insert(
                item,
                format!(
                    "{source} has two different cameras for it, at {} and at {}",
                    first.place, view.place
                ),
            );
        }
    }
    missing.sort_by(|a, b| a.file.cmp(&b.file));
    let unplaced = (0..items.len()).filter_map(|index| {
        let reason = conflicts.get(&index).cloned();
        let reason = reason.or_else(|| folders.reason(index, &taken));
        Some((
            index,
            reason.or_else(|| without_view(source, taken.get(&index).copied()))?,
        ))
    });
    let unplaced: Vec<(usize, String)> = unplaced.collect();
    let pairs = taken
        .into_iter()
        .filter(|(item, view)| view.role != Role::Unlisted && !conflicts.contains_key(item))
        .collect();
    MatchedViews {
        pairs,
        unplaced,
        missing,
        choice: folders.choice,
    }
}

/// Returns why a photo with this view is not placed, or `None` if it is.
fn without_view(source: &str, view: Option<&View>) -> Option<String> {
    match view {
        None => Some(format!("{source} has no camera for it")),
        Some(view) if view.role == Role::Unlisted => Some(format!(
            "{source} lists it neither for training nor for measuring"
        )),
        Some(_) => None,
    }
}

/// Folders that hold photos of the same names (`images`, `images_2`, `images_4`), and which of them is meant.
struct Folders {
    chosen: Option<String>,
    choice: Option<String>,
    /// Photos in the other folders.
    others: BTreeSet<usize>,
}

/// How well the photos of a folder fit the cameras.
#[derive(Debug, Default)]
struct Fit {
    photos: usize,
    /// Photos of exactly the size of their camera.
    same_size: usize,
}

impl Folders {
    /// Chooses the folder of names that mean several photos: the one with most photos of exactly the cameras' sizes. Of equals it is
    /// `images` next to the model, then `images` at the top. Without such a reason none is chosen.
    fn new(source: &str, views: &[View], matches: &[Match], items: &[InputPhoto]) -> Self {
        let mut fits: BTreeMap<String, Fit> = BTreeMap::new();
        let mut others = BTreeSet::new();
        for (view, found) in views.iter().zip(matches) {
            let Match::Several(several) = found else {
                continue;
            };
            for index in several {
                others.insert(*index);
                let fit = fits.entry(prefix(view, &items[*index])).or_default();
                fit.photos += 1;
                fit.same_size += usize::from(view.lens.size == Some(items[*index].stored_size_px()));
            }
        }
        let most = fits.values().map(|fit| fit.same_size).max().unwrap_or_default();
        let best: Vec<&String> = fits
            .iter()
            .filter(|(_, fit)| fit.same_size == most)
            .map(|(folder, _)| folder)
            .collect();
        let usual = usual_folders(source);
        let usual = usual.iter().find(|folder| best.contains(folder)).cloned();
        let (chosen, why) = match (best.as_slice(), most, usual) {
            ([only], 1.., _) => (Some((*only).clone()), "its photos have the sizes of the cameras"),
            (_, _, usual) => (usual, "the usual folder"),
        };
        let choice = chosen.as_ref().map(|chosen| {
            let all: Vec<String> = fits.keys().map(|folder| shown(folder)).collect();
            format!("photos of {} ({why}) among {}", shown(chosen), all.join(", "))
        });
        Self {
            chosen,
            choice,
            others,
        }
    }

    /// Returns the photo of a view.
    fn photo(&self, view: &View, found: &Match, items: &[InputPhoto]) -> Result<usize, String> {
        let several = match found {
            Match::Absent => {
                return Err("not among the photos: filtered out, or not in the archive".to_owned());
            }
            Match::One(index) => return Ok(*index),
            Match::Several(several) => several,
        };
        let is_chosen = |index: &&usize| self.chosen.as_ref() == Some(&prefix(view, &items[**index]));
        several.iter().find(is_chosen).copied().ok_or_else(|| {
            let names: Vec<&str> = several
                .iter()
                .map(|index| items[*index].facts.file.as_str())
                .collect();
            format!("several photos have this name: {}", names.join(", "))
        })
    }

    /// Returns why a photo of another folder is not used.
    fn reason(&self, index: usize, taken: &BTreeMap<usize, &View>) -> Option<String> {
        let other = self.others.contains(&index) && !taken.contains_key(&index);
        let chosen = self.chosen.as_ref().filter(|_| other)?;
        Some(format!("the photo of the same name in {} is used", shown(chosen)))
    }
}

/// Returns the part of a photo's path that the name of a view lacks.
fn prefix(view: &View, item: &InputPhoto) -> String {
    let (own, named) = (folder(&item.facts.file), folder(&view.file));
    own.strip_suffix(&named).unwrap_or(&own).to_owned()
}

/// Returns where photos usually are, the likeliest first: programs that undistort write `images` next to `sparse`.
fn usual_folders(source: &str) -> Vec<String> {
    let mut folders = Vec::new();
    let mut above = folder(source);
    while !above.is_empty() {
        above = folder(above.trim_end_matches('/'));
        folders.push(format!("{above}images/"));
    }
    folders.extend(["images/", "", "input/"].map(str::to_owned));
    folders
}

fn shown(folder: &str) -> String {
    match folder {
        "" => "the top folder".to_owned(),
        folder => format!("`{folder}`"),
    }
}
