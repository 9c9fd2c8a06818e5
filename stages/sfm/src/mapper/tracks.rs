//! Tracks: features of several photos that are one point of the scene.

use nalgebra::Vector2;

use crate::view_graph::{Link, View};

/// A feature of a photo that belongs to a track.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Observation {
    /// Index of the track.
    pub track: u32,
    /// Index of the photo.
    pub photo: u32,
    /// Index of the feature in the photo.
    pub feature: u32,
    /// Where it was observed.
    pub pixel: Vector2<f64>,
}

/// The tracks of a view graph.
///
/// A track never holds two features of one photo. Observations are sorted by track and photo.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Tracks {
    /// Of all tracks.
    pub observations: Vec<Observation>,
    starts: Vec<u32>,
    of_photo: Vec<Vec<u32>>,
}

impl Tracks {
    /// Returns the tracks of the matches of all links, links with most inliers first. A match that would put a second
    /// feature of a photo into a track is left out.
    pub fn build(views: &[View], links: &[Link]) -> Self {
        let mut order: Vec<&Link> = links.iter().collect();
        order.sort_by_key(|link| (std::cmp::Reverse(link.relative_pose.inliers.len()), link.photos));
        let mut sets = DisjointSets::new(views);
        for link in order {
            for &[a, b] in &link.relative_pose.inliers {
                let [first, second] = link.photos;
                sets.union(FeatureId::new(first, a), FeatureId::new(second, b));
            }
        }
        Self::collect(views, sets)
    }

    /// Returns the sets with more than one feature as tracks.
    fn collect(views: &[View], sets: DisjointSets) -> Self {
        let mut members: Vec<Vec<FeatureId>> = sets
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
            tracks.starts.push(tracks.observations.len() as u32);
            for &FeatureId { photo, feature } in members {
                tracks.of_photo[photo].push(tracks.observations.len() as u32);
                tracks.observations.push(Observation {
                    track: track as u32,
                    photo: photo as u32,
                    feature,
                    pixel: views[photo].pixels[feature as usize],
                });
            }
        }
        tracks.starts.push(tracks.observations.len() as u32);
        tracks
    }

    /// Returns the number of tracks.
    pub fn len(&self) -> usize {
        self.starts.len().saturating_sub(1)
    }

    /// Whether there is no track.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Returns the indices of all tracks.
    pub fn all(&self) -> Vec<usize> {
        (0..self.len()).collect()
    }

    /// Returns the indices of the tracks that some photos observe, sorted.
    pub fn of_photos(&self, photos: &[usize]) -> Vec<usize> {
        let observations = photos.iter().flat_map(|&photo| self.in_photo(photo));
        let mut tracks: Vec<usize> = observations
            .map(|observation| self.observations[observation].track as usize)
            .collect();
        tracks.sort_unstable();
        tracks.dedup();
        tracks
    }

    /// Returns the indices of the observations of a track.
    pub fn range(&self, track: usize) -> std::ops::Range<usize> {
        self.starts[track] as usize..self.starts[track + 1] as usize
    }

    /// Returns the indices of the observations in a photo.
    pub fn in_photo(&self, photo: usize) -> impl Iterator<Item = usize> + '_ {
        self.of_photo[photo]
            .iter()
            .map(|&observation| observation as usize)
    }
}

/// A feature by its photo and its index there.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct FeatureId {
    photo: usize,
    feature: u32,
}

impl FeatureId {
    fn new(photo: usize, feature: u32) -> Self {
        Self { photo, feature }
    }
}

/// Disjoint sets of features, each sorted by photo.
struct DisjointSets {
    first: Vec<usize>,
    set_of: Vec<usize>,
    members: Vec<Vec<FeatureId>>,
}

impl DisjointSets {
    fn new(views: &[View]) -> Self {
        let mut first = Vec::with_capacity(views.len());
        let mut members = Vec::new();
        for (photo, view) in views.iter().enumerate() {
            first.push(members.len());
            members.extend((0..view.pixels.len() as u32).map(|feature| vec![FeatureId::new(photo, feature)]));
        }
        Self {
            first,
            set_of: (0..members.len()).collect(),
            members,
        }
    }

    /// Returns the position of a feature in the list of all.
    fn index(&self, id: FeatureId) -> usize {
        self.first[id.photo] + id.feature as usize
    }

    /// Unites the sets of two features unless they would hold two features of one photo.
    fn union(&mut self, a: FeatureId, b: FeatureId) {
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

/// Returns both lists merged in order of photo. `None` if they share a photo.
fn merged(a: &[FeatureId], b: &[FeatureId]) -> Option<Vec<FeatureId>> {
    let mut merged = [a, b].concat();
    merged.sort_unstable();
    let clash = merged.windows(2).any(|pair| pair[0].photo == pair[1].photo);
    (!clash).then_some(merged)
}
