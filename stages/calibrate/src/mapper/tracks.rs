use nalgebra::Vector2;

use super::{Link, View};

/// A feature of a photo as part of a track.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct TrackSight {
    pub track: u32,
    pub photo: u32,
    pub feature: u32,
    pub pixel: Vector2<f64>,
}

/// Features that are one point of the scene, as far as pairs of photos tell.
///
/// A track never holds two features of one photo. Sights are sorted by track and photo.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct Tracks {
    pub sights: Vec<TrackSight>,
    starts: Vec<u32>,
    of_photo: Vec<Vec<u32>>,
}

impl Tracks {
    /// Joins the matches of all links, those of the richest links first; a match that would put a second
    /// feature of a photo into a track is left out.
    pub(crate) fn build(views: &[View], links: &[Link]) -> Self {
        let mut order: Vec<&Link> = links.iter().collect();
        order.sort_by_key(|link| (std::cmp::Reverse(link.relation.inliers.len()), link.photos));
        let mut forest = Forest::new(views);
        for link in order {
            for &[a, b] in &link.relation.inliers {
                forest.join((link.photos[0], a), (link.photos[1], b));
            }
        }
        Self::collect(views, forest)
    }

    fn collect(views: &[View], forest: Forest) -> Self {
        let mut members: Vec<Vec<Member>> = forest
            .members
            .into_iter()
            .filter(|members| members.len() > 1)
            .collect();
        members.sort();
        let mut tracks = Self {
            of_photo: vec![Vec::new(); views.len()],
            ..Self::default()
        };
        for (track, members) in members.iter().enumerate() {
            tracks.starts.push(tracks.sights.len() as u32);
            for &(photo, feature) in members {
                tracks.of_photo[photo].push(tracks.sights.len() as u32);
                tracks.sights.push(TrackSight {
                    track: track as u32,
                    photo: photo as u32,
                    feature,
                    pixel: views[photo].pixels[feature as usize],
                });
            }
        }
        tracks.starts.push(tracks.sights.len() as u32);
        tracks
    }

    pub(crate) fn len(&self) -> usize {
        self.starts.len().saturating_sub(1)
    }

    /// Indices of all tracks.
    pub(crate) fn all(&self) -> Vec<usize> {
        (0..self.len()).collect()
    }

    /// Indices of the tracks that some of the photos see, sorted.
    pub(crate) fn of_photos(&self, photos: &[usize]) -> Vec<usize> {
        let sights = photos.iter().flat_map(|&photo| self.in_photo(photo));
        let mut tracks: Vec<usize> = sights.map(|sight| self.sights[sight].track as usize).collect();
        tracks.sort_unstable();
        tracks.dedup();
        tracks
    }

    /// Indices of the sights of a track.
    pub(crate) fn range(&self, track: usize) -> std::ops::Range<usize> {
        self.starts[track] as usize..self.starts[track + 1] as usize
    }

    /// Indices of the sights in a photo.
    pub(crate) fn in_photo(&self, photo: usize) -> impl Iterator<Item = usize> + '_ {
        self.of_photo[photo].iter().map(|&sight| sight as usize)
    }
}

/// Photo and feature.
type Member = (usize, u32);

/// Sets of features that know their members, sorted by photo.
struct Forest {
    first: Vec<usize>,
    set_of: Vec<usize>,
    members: Vec<Vec<Member>>,
}

impl Forest {
    fn new(views: &[View]) -> Self {
        let mut first = Vec::with_capacity(views.len());
        let mut members = Vec::new();
        for (photo, view) in views.iter().enumerate() {
            first.push(members.len());
            members.extend((0..view.pixels.len() as u32).map(|feature| vec![(photo, feature)]));
        }
        Self {
            first,
            set_of: (0..members.len()).collect(),
            members,
        }
    }

    fn index(&self, (photo, feature): Member) -> usize {
        self.first[photo] + feature as usize
    }

    fn join(&mut self, a: Member, b: Member) {
        let (a, b) = (self.set_of[self.index(a)], self.set_of[self.index(b)]);
        if a == b {
            return;
        }
        let Some(merged) = merged(&self.members[a], &self.members[b]) else {
            return;
        };
        let (large, small) = if self.members[a].len() >= self.members[b].len() {
            (a, b)
        } else {
            (b, a)
        };
        for member in std::mem::take(&mut self.members[small]) {
            let index = self.index(member);
            self.set_of[index] = large;
        }
        self.members[large] = merged;
    }
}

/// Both lists in order of photo; `None` if they share one.
fn merged(a: &[Member], b: &[Member]) -> Option<Vec<Member>> {
    let mut merged = [a, b].concat();
    merged.sort_unstable();
    let clash = merged.windows(2).any(|pair| pair[0].0 == pair[1].0);
    (!clash).then_some(merged)
}
