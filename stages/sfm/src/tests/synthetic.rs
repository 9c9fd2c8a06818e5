//! Synthetic photos with known ground truth, mapped from their correspondences.

use marf_numeric::{Rng, mix};
use marf_scene::{Camera, Pose};
use marf_sfm_features::two_view::{FocalKnown, VerifyOptions, ViewPoints, verify};
use nalgebra::{Vector2, Vector3};

use crate::align::{PosePair, Tolerance, align, pose_difference};
use crate::mapper::{MapOptions, MapperInput, Model, Tracks, map};
use crate::view_graph::{ComparedPair, SharedCamera, View, link_pair, max_error_px, refine_focal_lengths};

/// Synthetic photos and the errors added to them.
pub(super) struct Synthetic {
    pub camera: Camera,
    /// `cam_from_world`.
    pub poses: Vec<Pose>,
    pub points: Vec<Vector3<f64>>,
    /// Standard deviation of the positions, pixels.
    pub noise_px: f64,
    /// Share of matches that lead to a wrong feature.
    pub outliers: f64,
    /// Share of matches that lead to a similar point: the one half a list further.
    pub confused: f64,
    pub start: SharedCamera,
    /// Photos that share their camera with no other.
    pub apart: Vec<usize>,
    /// Photos in the middle of which a disc of this radius hides what is behind, pixels.
    pub hidden: Vec<(usize, f64)>,
}

/// Errors of a model after alignment with the ground truth.
#[derive(Debug)]
pub(super) struct Errors {
    pub photos: usize,
    /// Largest distance of a centre from the truth, as a share of the extent of the centres.
    pub position: f64,
    pub angle_rad: f64,
    /// Relative error of the focal length.
    pub focal: f64,
}

pub(super) fn camera() -> Camera {
    Camera::pinhole(960, 720, 800.0)
}

pub(super) fn known(camera: Camera) -> SharedCamera {
    SharedCamera {
        camera,
        focal: FocalKnown::Known,
        focal_sigma_share: Some(0.01),
    }
}

pub(super) fn guessed(focal_px: f64) -> SharedCamera {
    SharedCamera {
        camera: Camera {
            fx_px: focal_px,
            fy_px: focal_px,
            ..Camera::pinhole(960, 720, 1.0)
        },
        focal: FocalKnown::Guessed,
        focal_sigma_share: None,
    }
}

/// `count` points in a box of half sides `half` about `centre`.
pub(super) fn cloud(count: usize, centre: Vector3<f64>, half: Vector3<f64>, seed: u64) -> Vec<Vector3<f64>> {
    let mut rng = Rng::new(seed);
    let mut axis = |half: f64| (2.0 * rng.unit_f64() - 1.0) * half;
    (0..count)
        .map(|_| centre + Vector3::new(axis(half.x), axis(half.y), axis(half.z)))
        .collect()
}

/// Cameras on an arc of `angle_rad` at `radius` about the origin, looking at it.
pub(super) fn arc(count: usize, radius: f64, angle_rad: f64) -> Vec<Pose> {
    let pose = |index: usize| {
        let angle = angle_rad * (index as f64 / (count.max(2) - 1) as f64 - 0.5);
        // A little up and down.
        let height = 0.1 * radius * libm::sin(3.0 * index as f64);
        let eye = Vector3::new(radius * libm::sin(angle), height, -radius * libm::cos(angle));
        Pose::looking_at(eye, Vector3::zeros(), Vector3::y())
    };
    (0..count).map(pose).collect()
}

impl Synthetic {
    pub(super) fn new(poses: Vec<Pose>, points: Vec<Vector3<f64>>) -> Self {
        Self {
            camera: camera(),
            poses,
            points,
            noise_px: 0.3,
            outliers: 0.1,
            confused: 0.0,
            start: known(camera()),
            apart: Vec::new(),
            hidden: Vec::new(),
        }
    }

    /// Features of each photo, and for each point its feature there.
    fn observe(&self) -> (Vec<View>, Vec<Vec<Option<u32>>>) {
        let mut rng = Rng::new(99);
        let mut views = Vec::new();
        let mut features = Vec::new();
        for (photo, pose) in self.poses.iter().enumerate() {
            let apart = self.apart.iter().position(|&other| other == photo);
            let mut view = View {
                camera: apart.map_or(0, |index| index + 1),
                pixels: Vec::new(),
            };
            let seen = self.points.iter().map(|point| {
                let pixel = self.camera.project(&pose.point(point))?;
                let inside = (0.0..f64::from(self.camera.width)).contains(&pixel.x)
                    && (0.0..f64::from(self.camera.height)).contains(&pixel.y);
                let middle = Vector2::new(self.camera.cx_px, self.camera.cy_px);
                let behind =
                    |(hidden, radius): &(usize, f64)| *hidden == photo && (pixel - middle).norm() < *radius;
                (inside && !self.hidden.iter().any(behind)).then(|| {
                    view.pixels
                        .push(pixel + self.noise_px * Vector2::new(normal(&mut rng), normal(&mut rng)));
                    view.pixels.len() as u32 - 1
                })
            });
            features.push(seen.collect());
            views.push(view);
        }
        (views, features)
    }

    fn compare(&self, views: &[View], features: &[Vec<Option<u32>>]) -> Vec<ComparedPair> {
        let mut rng = Rng::new(5);
        let mut compared = Vec::new();
        for a in 0..views.len() {
            for b in a + 1..views.len() {
                let half = self.points.len() / 2;
                let mut seen_as = |point: usize| {
                    let is_confused = self.confused > 0.0 && rng.unit_f64() < self.confused;
                    let shift = if is_confused { half } else { 0 };
                    features[b][(point + shift) % self.points.len()]
                };
                let both = features[a].iter().enumerate();
                let mut matches: Vec<[u32; 2]> = both
                    .filter_map(|(point, a)| Some([(*a)?, seen_as(point)?]))
                    .collect();
                for pair in &mut matches {
                    if rng.unit_f64() < self.outliers {
                        pair[1] = rng.below(views[b].pixels.len() as u64) as u32;
                    }
                }
                let points = |photo: usize| ViewPoints {
                    camera: &self.start.camera,
                    pixels: &views[photo].pixels,
                };
                let options = VerifyOptions {
                    max_error_px: max_error_px(&self.camera),
                    min_inliers: 15,
                };
                let verified = verify([&points(a), &points(b)], &matches, self.start.focal, &options, 3);
                compared.push(ComparedPair {
                    photos: [a, b],
                    verified,
                });
            }
        }
        compared
    }

    /// Returns the models.
    pub(super) fn solve(&self) -> Vec<Model> {
        self.with_input(|input| map(input).unwrap())
    }

    /// Calls `work` with the input of the mapper.
    pub(super) fn with_input<R>(&self, work: impl FnOnce(&MapperInput<'_>) -> R) -> R {
        self.stoppable(&|| false, work)
    }

    /// As [`Synthetic::with_input`], stopped once `stop` is true.
    pub(super) fn stoppable<R>(
        &self,
        stop: &(dyn Fn() -> bool + Sync),
        work: impl FnOnce(&MapperInput<'_>) -> R,
    ) -> R {
        let (views, features) = self.observe();
        let compared = self.compare(&views, &features);
        let mut shared = vec![self.start.clone(); 1 + self.apart.len()];
        refine_focal_lengths(&mut shared, &views, &compared);
        let seed = |pair: &ComparedPair| {
            let indices = pair.verified.inliers.iter().flatten();
            indices.fold(0, |seed, &index| mix(seed ^ u64::from(index)))
        };
        let link = |pair: &ComparedPair| link_pair(&views, &shared, pair, 15, seed(pair));
        let links: Vec<_> = compared.iter().filter_map(link).collect();
        let input = MapperInput {
            views: &views,
            cameras: &shared,
            links: &links,
            tracks: Tracks::build(&views, &links),
            options: MapOptions::automatic(&shared, 0),
            stop,
            registered: &|_| (),
        };
        work(&input)
    }

    /// Returns the errors of the largest model. `None` without a model.
    pub(super) fn errors(&self) -> Option<Errors> {
        let models = self.solve();
        let model = models.first()?;
        let pair = |photo: usize| PosePair {
            cam_from_source: model.poses[photo].unwrap(),
            cam_from_target: self.poses[photo],
        };
        let pairs: Vec<PosePair> = model.photos().map(pair).collect();
        let any = Tolerance {
            distance: f64::INFINITY,
            angle_rad: f64::INFINITY,
        };
        let aligned = align(&pairs, &any)?;
        let centres: Vec<_> = pairs.iter().map(|pair| pair.cam_from_target.centre()).collect();
        let distances = centres
            .iter()
            .flat_map(|a| centres.iter().map(move |b| (a - b).norm()));
        let extent = distances.fold(0.0, f64::max);
        let off: Vec<(f64, f64)> = pairs
            .iter()
            .map(|pair| pose_difference(pair, &aligned.similarity))
            .collect();
        Some(Errors {
            photos: pairs.len(),
            position: off.iter().map(|off| off.0).fold(0.0, f64::max) / extent,
            angle_rad: off.iter().map(|off| off.1).fold(0.0, f64::max),
            focal: (model.cameras[0].fx_px / self.camera.fx_px - 1.0).abs(),
        })
    }
}

/// A sum of twelve uniform numbers: near enough to a normal one.
fn normal(rng: &mut Rng) -> f64 {
    (0..12).map(|_| rng.unit_f64()).sum::<f64>() - 6.0
}
