//! Why a photo was not placed.

use std::fmt;

use marf_sfm::mapper::HiddenPhoto;
use marf_sfm_features::two_view::RelativePoseKind;

use super::reconstruction::Reconstruction;

/// Fewer features than this are too few to place a photo.
const FEW_FEATURES: usize = 60;
/// Leading numbers of a motion counter that identify the position of the rover: site, drive, pose.
const PLACE: usize = 3;
/// Largest number of file names in a reason.
const NAMED: usize = 8;

/// Why a photo was not placed.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Cause {
    FewFeatures {
        found: usize,
    },
    NoOverlap {
        most: usize,
    },
    PureRotation {
        pairs: usize,
        /// Site, drive and pose of the rover, if they are the same for all photos of these pairs.
        place: Option<Vec<i64>>,
    },
    OtherComponent {
        rank: usize,
        files: Vec<String>,
        /// Whether they were placed relative to each other.
        has_model: bool,
    },
    NoPose {
        links: usize,
    },
    /// No pair of photos has enough matches and parallax to start a model.
    NoInitialPair {
        angle_deg: f64,
        /// Whether there are more than two photos: a scene then takes three.
        needs_three: bool,
    },
    /// There is no other photo.
    SinglePhoto,
    /// Something hides a part of it that its neighbours show.
    Hidden(HiddenPhoto),
}

/// Returns why a photo was not placed. `component` is the rank of each photo's connected component.
pub(super) fn cause(reconstruction: &Reconstruction<'_>, component: &[usize], photo: usize) -> Cause {
    let mut hidden = reconstruction.intruders.iter().flat_map(|found| &found.hidden);
    if let Some(hidden) = hidden.find(|hidden| hidden.photo == photo) {
        return Cause::Hidden(*hidden);
    }
    let found = reconstruction.features[photo].features.keypoints.len();
    let links: Vec<_> = reconstruction
        .input
        .links
        .iter()
        .filter(|link| link.photos.contains(&photo))
        .collect();
    if links.is_empty() {
        let own = reconstruction
            .compared
            .iter()
            .filter(|one| one.photos.contains(&photo));
        let most = own.map(|one| one.verified.inliers.len()).max().unwrap_or(0);
        return match found {
            0..FEW_FEATURES => Cause::FewFeatures { found },
            _ if reconstruction.features.len() == 1 => Cause::SinglePhoto,
            _ => Cause::NoOverlap { most },
        };
    }
    if links
        .iter()
        .all(|link| link.relative_pose.kind == RelativePoseKind::Rotation)
    {
        return Cause::PureRotation {
            pairs: links.len(),
            place: one_place(reconstruction, links.iter().flat_map(|link| link.photos)),
        };
    }
    if reconstruction.models.is_empty() {
        let angles = links
            .iter()
            .map(|link| link.relative_pose.median_angle_rad.to_degrees());
        return Cause::NoInitialPair {
            angle_deg: angles.fold(0.0, f64::max),
            needs_three: reconstruction.features.len() > 2,
        };
    }
    let main = reconstruction
        .models
        .first()
        .and_then(|model| model.photos().next());
    let apart = main.is_some_and(|main| component[main] != component[photo]);
    let mapped = reconstruction
        .models
        .iter()
        .skip(1)
        .find(|model| model.poses[photo].is_some());
    if !apart && mapped.is_none() {
        return Cause::NoPose { links: links.len() };
    }
    let file = |photo: usize| reconstruction.items[photo].facts.file.clone();
    let members: Vec<usize> = match mapped {
        Some(model) => model.photos().collect(),
        None => (0..component.len())
            .filter(|&other| component[other] == component[photo])
            .collect(),
    };
    Cause::OtherComponent {
        rank: component[photo] + 1,
        files: members.into_iter().map(file).collect(),
        has_model: mapped.is_some(),
    }
}

/// Returns site, drive and pose of the rover if the labels of all photos have the same: then only its mast moved between
/// them.
fn one_place(reconstruction: &Reconstruction<'_>, photos: impl Iterator<Item = usize>) -> Option<Vec<i64>> {
    let place = |photo: usize| {
        let counter = reconstruction.items[photo].facts.motion_counter();
        counter.get(..PLACE).map(<[i64]>::to_vec)
    };
    let mut places = photos.map(place);
    let first = places.next()??;
    places
        .all(|place| place.as_ref() == Some(&first))
        .then_some(first)
}

impl Cause {
    /// Returns the cause without what differs from photo to photo.
    pub(super) fn kind(&self) -> &'static str {
        match self {
            Self::FewFeatures { .. } => "too few features: too blurred, too dark or without texture",
            Self::NoOverlap { .. } => "no overlap: too few matches with any other photo hold",
            Self::PureRotation { .. } => {
                "panorama: pure rotation on the spot gives no parallax, so no depth can be found"
            }
            Self::OtherComponent { .. } => "a component of their own: nothing links them to the scene",
            Self::NoPose { .. } => "linked to the scene, but no pose fits",
            Self::NoInitialPair {
                needs_three: false, ..
            } => "no pair of photos has both matches and parallax enough to begin with",
            Self::NoInitialPair { .. } => {
                "no three photos that overlap have both matches and parallax enough to begin with"
            }
            Self::SinglePhoto => "a single photo: depth takes two or more, from different places",
            Self::Hidden(_) => "something that no other photo shows hides a large part",
        }
    }

    /// Returns the note of the labels on a panorama, to follow its kind. Empty if they do not agree.
    pub(super) fn place(&self) -> String {
        match self {
            Self::PureRotation {
                place: Some(place), ..
            } => format!(" (the labels agree: the rover did not drive: site, drive, pose {place:?})"),
            _ => String::new(),
        }
    }

    /// Returns a hint for the user.
    pub(super) fn hint(&self) -> &'static str {
        match self {
            Self::FewFeatures { .. } => {
                "leave out blurred photos (`blur`), raise `feature_side_px`, or set `first_octave = \"doubled\"`"
            }
            Self::NoOverlap { .. } => {
                "add the photos between (widen `sols` of the archive), compare all with `pairs = \"exhaustive\"`, or \
                 lower `min_matches`"
            }
            Self::PureRotation { .. } => {
                "a panorama of pure rotation cannot be calibrated from photos: add photos from other places, or \
                 take the label's cameras with method = \"labels\""
            }
            Self::OtherComponent { .. } => {
                "add photos that link the parts, compare all with `pairs = \"exhaustive\"`, or calibrate the \
                 parts one by one"
            }
            Self::Hidden(_) => "hide that part by a mask in `masks`, or leave the photo out",
            Self::NoPose { .. } => "raise `max_features`, or lower `min_matches`",
            Self::NoInitialPair { .. } | Self::SinglePhoto => {
                "add photos from places farther apart (a tenth of the distance to what they show), or take the \
                 label's cameras with method = \"labels\""
            }
        }
    }
}

impl fmt::Display for Cause {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::SinglePhoto => f.write_str(self.kind()),
            Self::FewFeatures { found } => write!(f, "{} ({found} found)", self.kind()),
            Self::NoOverlap { most } => {
                write!(f, "no overlap: at most {most} matches with any other photo hold")
            }
            Self::PureRotation { pairs, .. } => write!(f, "{} ({pairs} pairs){}", self.kind(), self.place()),
            Self::OtherComponent {
                rank,
                files,
                has_model,
            } => {
                let named = files
                    .iter()
                    .take(NAMED)
                    .map(String::as_str)
                    .collect::<Vec<_>>()
                    .join(", ");
                let more = if files.len() > NAMED { ", …" } else { "" };
                let among = if *has_model {
                    "placed among themselves"
                } else {
                    "not placed"
                };
                write!(
                    f,
                    "component {rank}: {} photos {among} ({named}{more}), ",
                    files.len()
                )?;
                f.write_str("no verified pair links them to the scene")
            }
            Self::NoInitialPair { angle_deg, .. } => {
                write!(f, "{} (widest angle {angle_deg:.2} degrees)", self.kind())
            }
            Self::NoPose { links } => write!(f, "{}: {links} pairs hold", self.kind()),
            Self::Hidden(hidden) => write!(
                f,
                "something that no other photo shows hides {} of the {} % of it that can be compared: of {} points that its neighbours show there, it shows {}",
                hidden.hidden_cells, hidden.compared_cells, hidden.expected, hidden.shown
            ),
        }
    }
}
