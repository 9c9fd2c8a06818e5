use std::fmt;

use super::Solved;
use crate::two_view::RelationKind;

/// Fewer features than this cannot hold a photo.
const FEW_FEATURES: usize = 60;
/// Numbers of a motion counter that say where the rover stands: site, drive, pose.
const PLACE: usize = 3;
/// Names of photos a reason spells out.
const NAMED: usize = 8;

/// Why a photo has no place in the scene.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Cause {
    Features {
        found: usize,
    },
    Overlap {
        most: usize,
    },
    Rotation {
        turns: usize,
        /// Where the rover stood, if the labels say the same of all photos of these pairs.
        place: Option<Vec<i64>>,
    },
    Component {
        rank: usize,
        files: Vec<String>,
        mapped: Mapped,
    },
    Pose {
        links: usize,
    },
    /// No photos at all have matches and parallax enough to begin with.
    Start {
        angle_deg: f64,
        fewest: Fewest,
    },
    /// There is no other photo.
    Alone,
}

/// How many photos make a scene: two are believed only where there are no more.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Fewest {
    Two,
    Three,
}

/// Whether photos apart from the scene were placed among themselves.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Mapped {
    Yes,
    No,
}

/// `component` is the rank of each photo's group of linked photos.
pub(super) fn cause(solved: &Solved<'_>, component: &[usize], photo: usize) -> Cause {
    let found = solved.prepared[photo].features.keypoints.len();
    let links: Vec<_> = solved
        .task
        .links
        .iter()
        .filter(|link| link.photos.contains(&photo))
        .collect();
    if links.is_empty() {
        let own = solved.compared.iter().filter(|one| one.photos.contains(&photo));
        let most = own.map(|one| one.verified.inliers.len()).max().unwrap_or(0);
        return match found {
            0..FEW_FEATURES => Cause::Features { found },
            _ if solved.prepared.len() == 1 => Cause::Alone,
            _ => Cause::Overlap { most },
        };
    }
    if links
        .iter()
        .all(|link| link.relation.kind == RelationKind::Rotation)
    {
        return Cause::Rotation {
            turns: links.len(),
            place: one_place(solved, links.iter().flat_map(|link| link.photos)),
        };
    }
    if solved.models.is_empty() {
        let angles = links
            .iter()
            .map(|link| link.relation.median_angle_rad.to_degrees());
        return Cause::Start {
            angle_deg: angles.fold(0.0, f64::max),
            fewest: if solved.prepared.len() > 2 {
                Fewest::Three
            } else {
                Fewest::Two
            },
        };
    }
    let main = solved.models.first().and_then(|model| model.photos().next());
    let apart = main.is_some_and(|main| component[main] != component[photo]);
    let mapped = solved
        .models
        .iter()
        .skip(1)
        .find(|model| model.poses[photo].is_some());
    if !apart && mapped.is_none() {
        return Cause::Pose { links: links.len() };
    }
    let file = |photo: usize| solved.items[photo].facts.file.clone();
    let members: Vec<usize> = match mapped {
        Some(model) => model.photos().collect(),
        None => (0..component.len())
            .filter(|&other| component[other] == component[photo])
            .collect(),
    };
    Cause::Component {
        rank: component[photo] + 1,
        files: members.into_iter().map(file).collect(),
        mapped: if mapped.is_some() { Mapped::Yes } else { Mapped::No },
    }
}

/// Site, drive and pose of the rover's motion counter, where all these photos' labels have the same: then only its mast
/// moved between them.
fn one_place(solved: &Solved<'_>, photos: impl Iterator<Item = usize>) -> Option<Vec<i64>> {
    let place = |photo: usize| {
        let prior = solved.items[photo].facts.prior.as_ref()?;
        prior.motion_counter.get(..PLACE).map(<[i64]>::to_vec)
    };
    let mut places = photos.map(place);
    let first = places.next()??;
    places
        .all(|place| place.as_ref() == Some(&first))
        .then_some(first)
}

impl Cause {
    /// The cause without what differs from photo to photo.
    pub(super) fn kind(&self) -> &'static str {
        match self {
            Self::Features { .. } => "too few features: too blurred, too dark or without texture",
            Self::Overlap { .. } => "no overlap: too few matches with any other photo hold",
            Self::Rotation { .. } => {
                "panorama: pure rotation on the spot, without parallax there is no depth to find"
            }
            Self::Component { .. } => "a component of their own: nothing links them to the scene",
            Self::Pose { .. } => "linked to the scene, but no pose fits",
            Self::Start {
                fewest: Fewest::Two, ..
            } => "no pair of photos has both matches and parallax enough to begin with",
            Self::Start {
                fewest: Fewest::Three,
                ..
            } => "no three photos that overlap have both matches and parallax enough to begin with",
            Self::Alone => "a single photo: depth takes two or more, from different places",
        }
    }

    /// What the labels say of a panorama, to follow its kind; empty where they say nothing.
    pub(super) fn place(&self) -> String {
        match self {
            Self::Rotation {
                place: Some(place), ..
            } => format!("; the labels agree: the rover stood still, at site, drive, pose {place:?}"),
            _ => String::new(),
        }
    }

    /// What to try.
    pub(super) fn hint(&self) -> &'static str {
        match self {
            Self::Features { .. } => {
                "leave out blurred photos (`blur`), raise `feature_side_px`, or set `first_octave = \"doubled\"`"
            }
            Self::Overlap { .. } => {
                "add the photos between (widen `extract.sols`), compare all with `pairs = \"exhaustive\"`, or \
                 lower `min_matches`"
            }
            Self::Rotation { .. } => {
                "a panorama of pure rotation cannot be calibrated from photos: add photos from other places, or \
                 take the label's cameras with method = \"labels\""
            }
            Self::Component { .. } => {
                "add photos that link the parts, compare all with `pairs = \"exhaustive\"`, or calibrate the \
                 parts one by one"
            }
            Self::Pose { .. } => "raise `max_features`, or lower `min_matches`",
            Self::Start { .. } | Self::Alone => {
                "add photos from places farther apart (a tenth of the distance to what they show), or take the \
                 label's cameras with method = \"labels\""
            }
        }
    }
}

impl fmt::Display for Cause {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Alone => f.write_str(self.kind()),
            Self::Features { found } => write!(f, "{} ({found} found)", self.kind()),
            Self::Overlap { most } => {
                write!(f, "no overlap: at most {most} matches with any other photo hold")
            }
            Self::Rotation { turns, .. } => write!(f, "{} ({turns} pairs){}", self.kind(), self.place()),
            Self::Component { rank, files, mapped } => {
                let named = files
                    .iter()
                    .take(NAMED)
                    .map(String::as_str)
                    .collect::<Vec<_>>()
                    .join(", ");
                let more = if files.len() > NAMED { ", …" } else { "" };
                let among = match mapped {
                    Mapped::Yes => "placed among themselves",
                    Mapped::No => "not placed",
                };
                write!(
                    f,
                    "component {rank}: {} photos {among} ({named}{more}), ",
                    files.len()
                )?;
                f.write_str("no verified pair links them to the scene")
            }
            Self::Start { angle_deg, .. } => {
                write!(f, "{} (widest angle {angle_deg:.2} degrees)", self.kind())
            }
            Self::Pose { links } => write!(f, "{}: {links} pairs hold", self.kind()),
        }
    }
}
