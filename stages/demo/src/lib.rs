//! A built-in Mars: procedural, deterministic photos and labels with ground truth, without a network.
//!
//! Its files are like those of a real archive: images and PDS4 labels with Mars 2020 product names, good photos and
//! flawed ones. Invariant: the same options give the same bytes on every machine and for any number of threads. Only
//! + - * / and sqrt are used, and every pixel is a function of its position alone.

mod descent;
mod encode;
mod error;
mod flaws;
mod ground;
mod label;
mod lens;
mod light;
mod math;
mod plan;
mod render;
mod rocks;
#[cfg(test)]
mod tests;
mod tour;
mod truth;
mod world;

use std::ops::RangeInclusive;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicU64, Ordering};

use marf_cache::{ContentHash, ContentHasher, Digest, digest_of};
use marf_scene::{Camera, Image, Pose, Srgb};
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use label::Facts;
use lens::Lens;
use math::SrgbEncoder;
use plan::{Product, View};
use render::Shot;
use tour::{Capture, Stop};
use world::World;

pub use error::DemoError;
pub use plan::FlawKind;
pub use truth::{Flaw, RangeMap, TruePhoto, Truth};

/// Version of the demo's drawings and files. Raise it when any of their bytes may change.
pub const DEMO_VERSION: u32 = 1;

/// Sols that exist. 1 and 2 are the usual ones. Each hundred is of another site: 101 is the first at the
/// second.
pub const SOLS: RangeInclusive<u32> = plan::SOLS;

/// Options of the demo.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct DemoOptions {
    /// Width of the photos in pixels, from 16 to 4096.
    pub width_px: u32,
    /// Height of the photos in pixels, from 16 to 4096.
    pub height_px: u32,
    /// Seed of the landscape, of the tour and of the errors in the labels.
    pub seed: u64,
}

impl ContentHash for DemoOptions {
    fn hash_content(&self, hasher: &mut ContentHasher) {
        let fields: [(&str, &dyn ContentHash); 3] = [
            ("width_px", &self.width_px),
            ("height_px", &self.height_px),
            ("seed", &self.seed),
        ];
        hasher.record("DemoOptions", &fields);
    }
}

impl Default for DemoOptions {
    fn default() -> Self {
        Self {
            width_px: 640,
            height_px: 480,
            seed: 1,
        }
    }
}

/// A file of the demo's archive.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DemoFile {
    /// Name. Photos of a descent are below `images/`.
    pub name: String,
    /// Contents.
    pub bytes: Vec<u8>,
}

/// Receives progress as (files done, files in all) of a sol. Called from several threads.
pub type OnProgress<'a> = &'a (dyn Fn(u64, u64) + Sync);
/// Returns whether to stop. Called from several threads, before each photo.
pub type IsCancelled<'a> = &'a (dyn Fn() -> bool + Sync);

/// The demo with its options. The landscape of a site is built when first needed, in about half a second.
pub struct Demo {
    options: DemoOptions,
    /// By site, the first one first.
    worlds: [OnceLock<World>; SITES],
    /// The sol from which on its site is changed.
    change: Option<u32>,
    changed: OnceLock<World>,
}

/// Sites of all sols.
const SITES: usize = plan::site(*SOLS.end()) as usize;

impl Demo {
    /// Checks the options and returns the demo.
    ///
    /// # Errors
    /// [`DemoError::Size`].
    pub fn new(options: DemoOptions) -> Result<Self, DemoError> {
        check_size(options.width_px, options.height_px)?;
        Ok(Self {
            options,
            worlds: [const { OnceLock::new() }; SITES],
            change: None,
            changed: OnceLock::new(),
        })
    }

    /// Returns the demo with a change at the site of a sol, from that sol on: there is a new stone of 64 cm,
    /// and no dust on a strip of 1.4 by 0.3 m. Photos of all other sols keep their bytes.
    ///
    /// # Errors
    /// [`DemoError::Sol`].
    pub fn with_change(self, sol: u32) -> Result<Self, DemoError> {
        check(sol)?;
        Ok(Self {
            change: Some(sol),
            ..self
        })
    }

    /// Returns a digest of everything [`Demo::files`] depends on. Draws nothing.
    ///
    /// # Errors
    /// [`DemoError::Sol`].
    pub fn fingerprint(&self, sol: u32) -> Result<Digest, DemoError> {
        check(sol)?;
        Ok(match plan::site(sol) {
            _ if self.is_changed(sol) => digest_of(&((DEMO_VERSION, "changed"), sol, &self.options)),
            1 => digest_of(&(DEMO_VERSION, sol, &self.options)),
            site => digest_of(&((DEMO_VERSION, site), sol, &self.options)),
        })
    }

    /// Draws the images of a sol and writes their labels: about 20 good photos and 13 flawed ones, each file
    /// followed by its label. Takes about half a second a photo and core.
    ///
    /// # Errors
    /// [`DemoError::Sol`], [`DemoError::Cancelled`], [`DemoError::Encode`].
    pub fn files(
        &self,
        sol: u32,
        progress: OnProgress<'_>,
        cancelled: IsCancelled<'_>,
    ) -> Result<Vec<DemoFile>, DemoError> {
        let tour = self.tour(sol)?;
        let total = tour.views.iter().map(|view| view.products.len() as u64).sum();
        let done = AtomicU64::new(0);
        let encoder = SrgbEncoder::new();
        let files = tour.views.par_iter().map(|view| {
            if cancelled() {
                return Err(DemoError::Cancelled);
            }
            let files = self.view(&tour, view, &encoder)?;
            let finished = view.products.len() as u64;
            progress(done.fetch_add(finished, Ordering::Relaxed) + finished, total);
            Ok(files)
        });
        Ok(files.collect::<Result<Vec<_>, _>>()?.concat())
    }

    /// Returns the ground truth of a sol. Draws nothing.
    ///
    /// # Errors
    /// [`DemoError::Sol`].
    pub fn ground_truth(&self, sol: u32) -> Result<Truth, DemoError> {
        let tour = self.tour(sol)?;
        let mut truth = Truth {
            photos: Vec::new(),
            flaws: Vec::new(),
        };
        for view in &tour.views {
            let good = view.good().map(Product::file);
            let photo = good.clone().map(|file| self.true_photo(&tour, view, file));
            truth.photos.extend(photo);
            truth.flaws.extend(view.products.iter().filter_map(|product| {
                Some(Flaw {
                    file: product.file(),
                    kind: product.flaw?,
                    twin: good.clone(),
                })
            }));
        }
        Ok(truth)
    }

    /// Returns the true range map of a good photo.
    ///
    /// # Errors
    /// [`DemoError::Sol`], [`DemoError::File`].
    pub fn ranges(&self, sol: u32, file: &str) -> Result<RangeMap, DemoError> {
        let tour = self.tour(sol)?;
        let shows = |view: &&View| view.good().is_some_and(|photo| photo.file() == file);
        let view = tour.views.iter().find(shows).ok_or_else(|| DemoError::File {
            file: file.to_owned(),
            sol,
        })?;
        let shot = self.shot(self.world_on(sol), self.taken(&tour, view).site);
        Ok(RangeMap {
            width: shot.width,
            height: shot.height,
            range_m: shot.ranges_m(),
        })
    }

    /// Returns the picture that a camera takes on a sol: without noise, through an ideal pinhole (its distortion is left out).
    /// Frames as in [`TruePhoto`].
    ///
    /// # Errors
    /// [`DemoError::Sol`], [`DemoError::Size`].
    pub fn picture(&self, sol: u32, cam_from_site: &Pose, camera: &Camera) -> Result<Image<Srgb>, DemoError> {
        check(sol)?;
        check_size(camera.width, camera.height)?;
        let shot = Shot {
            world: self.world_on(sol),
            lens: Lens::pinhole(cam_from_site, camera),
            width: camera.width,
            height: camera.height,
        };
        Ok(shot.photo(&SrgbEncoder::new()))
    }

    fn is_changed(&self, sol: u32) -> bool {
        let change = self.change.filter(|change| *change <= sol);
        change.is_some_and(|change| plan::site(change) == plan::site(sol))
    }

    /// Returns the landscape of a site before any change.
    fn world(&self, site: u32) -> &World {
        let world = &self.worlds[(site - 1) as usize % SITES];
        world.get_or_init(|| World::new(self.seed(site), false))
    }

    /// Returns the landscape on a sol.
    fn world_on(&self, sol: u32) -> &World {
        let site = plan::site(sol);
        if self.is_changed(sol) {
            self.changed.get_or_init(|| World::new(self.seed(site), true))
        } else {
            self.world(site)
        }
    }

    /// Returns the seed of a site's landscape and tour.
    fn seed(&self, site: u32) -> u64 {
        self.options.seed ^ (u64::from(site - 1) << 48)
    }

    fn tour(&self, sol: u32) -> Result<Tour, DemoError> {
        check(sol)?;
        let site = plan::site(sol);
        let sol_of_site = sol - (site - 1) * plan::SOLS_A_SITE;
        let stops = tour::stops(self.world(site), self.seed(site), sol_of_site);
        let drives: Vec<u32> = stops.iter().map(|stop| stop.drive).collect();
        Ok(Tour {
            sol,
            views: plan::views(sol, &drives),
            stops,
        })
    }

    fn taken(&self, tour: &Tour, view: &View) -> Capture {
        let size_px = [self.options.width_px, self.options.height_px];
        let seed = self.seed(plan::site(tour.sol));
        let stop = &tour.stops[view.pointing.stop];
        tour::take(stop, &view.pointing, view.eye, size_px, seed)
    }

    /// Returns what a camera of the demo's size sees.
    fn shot<'a>(&self, world: &'a World, lens: Lens) -> Shot<'a> {
        Shot {
            world,
            lens,
            width: self.options.width_px,
            height: self.options.height_px,
        }
    }

    fn true_photo(&self, tour: &Tour, view: &View, file: String) -> TruePhoto {
        let taken = self.taken(tour, view);
        let stop = &tour.stops[view.pointing.stop];
        let (cam_from_site, pinhole) =
            truth::pinhole_of(&taken.site, self.options.width_px, self.options.height_px);
        TruePhoto {
            file,
            rover_model: taken.rover.cahvor(),
            site_from_rover: truth::pose_of(&stop.site_from_rover),
            site_model: taken.site.cahvor(),
            cam_from_site,
            pinhole,
        }
    }

    /// Returns the files of one view, all made from one drawing.
    fn view(&self, tour: &Tour, view: &View, encoder: &SrgbEncoder) -> Result<Vec<DemoFile>, DemoError> {
        let taken = self.taken(tour, view);
        let mut flaws = view.products.iter().map(|product| product.flaw);
        let photo = if flaws.any(|flaw| flaw.is_none_or(FlawKind::shows_mars)) {
            self.shot(self.world_on(tour.sol), taken.site).photo(encoder)
        } else {
            Image::from_fn(self.options.width_px, self.options.height_px, |_, _| [0; 3])
        };
        let mut files = Vec::new();
        for product in &view.products {
            let salt = math::mix32(product.clock_s ^ self.options.seed as u32);
            let image = encode::picture(product, &photo, salt)?;
            let factor = self.options.width_px / image.width;
            let facts = Facts {
                sol: tour.sol,
                view,
                product,
                stop: &tour.stops[view.pointing.stop],
                taken: &taken,
                labelled_lens: taken.labelled_rover.reduced(factor),
                image: &image,
            };
            let label = DemoFile {
                name: format!("{}.xml", product.id),
                bytes: label::xml(&facts).into_bytes(),
            };
            let name = product.file();
            let bytes = image.bytes;
            files.extend([DemoFile { name, bytes }, label]);
        }
        Ok(files)
    }
}

/// Stops and views of one sol.
struct Tour {
    sol: u32,
    stops: Vec<Stop>,
    views: Vec<View>,
}

fn check(sol: u32) -> Result<(), DemoError> {
    SOLS.contains(&sol).then_some(()).ok_or(DemoError::Sol { sol })
}

fn check_size(width_px: u32, height_px: u32) -> Result<(), DemoError> {
    let drawable = |side: u32| (16..=4096).contains(&side);
    (drawable(width_px) && drawable(height_px))
        .then_some(())
        .ok_or(DemoError::Size { width_px, height_px })
}
