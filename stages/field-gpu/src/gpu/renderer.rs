//! Pictures of a field on a device.

use std::fmt;
use std::ops::Range;
use std::sync::Arc;
use std::time::Instant;

use marf_scene::{Camera, Pose};
use marf_shaders::{PixelRange, Walk, counts, faults};
use parking_lot::Mutex;

use super::Gpu;
use super::array::Array;
use super::batch::BatchSize;
use super::forward::{Forward, Kernels, Lanes, Purpose, check_columns, write_walks};
use super::kernel::Bound;
use super::march::{Alive, March, MarchPasses, bit_words, round, step_table, whole_walk};
use super::order::{AT_ONCE, FIRST_ROUND};
use super::picture::{PICTURE, Picture};
use super::rays::{ViewRays, camera};
use super::record::Work;
use super::submits::Submits;
use super::tables::Grid;
use super::weights::DeviceWeights;
use marf_field::backend::Renderer;
use marf_field::model::Model;
use marf_field::render::MIDDLE;
use marf_field::{Background, FieldError, GpuError, Render};

/// Rounds between two reads of how many rays continue.
const LOOK_EVERY: u64 = 2;

/// A field on a device, and the arrays of its pictures. One picture at a time.
pub struct GpuRenderer(Mutex<Canvas>);

impl fmt::Debug for GpuRenderer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("GpuRenderer")
    }
}

struct Canvas {
    gpu: Arc<Gpu>,
    lanes: Lanes,
    asked: Array<PixelRange>,
    picture: Array<f32>,
    view: Bound,
    marching: MarchPasses,
    forward: Forward,
    begin: Work,
    paint: Work,
    finish: Work,
    alive: Bound,
    submits: Submits,
}

impl GpuRenderer {
    /// Copies a model to a device and compiles the kernels.
    ///
    /// # Errors
    /// A device that lacks something or has too little memory.
    pub fn new(gpu: &Arc<Gpu>, model: &Model) -> Result<Self, FieldError> {
        let size = at_once(gpu, model)?;
        Ok(Self(Mutex::new(Canvas::new(gpu, model, size)?)))
    }
}

impl Renderer for GpuRenderer {
    fn rows(
        &self,
        model: &Model,
        camera: &Camera,
        cam_from_world: &Pose,
        rows: Range<u32>,
    ) -> Result<Render, FieldError> {
        let mut canvas = self.0.lock();
        canvas.rows(model, camera, cam_from_world, rows)
    }
}

/// Returns the slots of samples and rays that a picture is made with at once.
///
/// # Errors
/// A device that does not even hold the fewest samples.
fn at_once(gpu: &Gpu, model: &Model) -> Result<BatchSize, GpuError> {
    let fits = |size: BatchSize| check_columns(gpu, &model.weights, size, Purpose::Picture);
    let sizes = AT_ONCE.map(|[samples, rays]| BatchSize { samples, rays });
    let [.., fewest] = sizes;
    let most = sizes
        .into_iter()
        .find(|size| gpu.is_card() && fits(*size).is_ok());
    match most {
        Some(size) => Ok(size),
        None => fits(fewest).map(|()| fewest),
    }
}

impl Canvas {
    fn new(gpu: &Arc<Gpu>, model: &Model, size: BatchSize) -> Result<Self, GpuError> {
        let device = gpu.as_ref();
        let features = model.weights.features;
        let grid = Grid::new(device, &model.weights.shapes, features)?;
        let weights = DeviceWeights::new(device, &grid, &model.weights)?;
        let lanes = Lanes::new(device, &weights, size, &model.steps)?;
        device.write(&lanes.steps, 0, &step_table(&model.steps));
        let bits = device.filled("occupied cells", &bit_words(&model.bits))?;
        let asked = device.uniform("pixels asked for", bytemuck::Zeroable::zeroed())?;
        let picture = device.zeros("picture", PICTURE * size.rays)?;
        let kernels = Kernels::new(device, features, &weights.layers)?;
        let painter = Picture::new(device, model.frame.half_side as f32)?;
        let batch = lanes.batch(device);
        let (columns, rgb) = (lanes.columns(), lanes.colours().rgb);
        let [begin, paint] = painter.paint(batch, columns, rgb, &lanes.shown, &lanes.state)?;
        let background = match model.config.background {
            Background::Direction => Some(weights.background()),
            Background::Black => None,
        };
        let directions = &lanes.rays.directions;
        let finish = painter.finish(batch, directions, background, &lanes.state, &picture)?;
        let (walk, progress) = (&lanes.walks[0], &lanes.progress);
        Ok(Self {
            view: ViewRays::new(device)?.bind(device, &asked, &lanes.rays, progress),
            marching: March::new(device)?.bind(device, lanes.marched(&bits)),
            forward: Forward::new(device, &kernels, &grid, &weights, &lanes)?,
            alive: Alive::new(device)?.bind(device, walk, &lanes.state, progress, &lanes.counts),
            begin,
            paint,
            finish,
            submits: Submits::default(),
            gpu: gpu.clone(),
            lanes,
            asked,
            picture,
        })
    }

    fn rows(
        &mut self,
        model: &Model,
        seen: &Camera,
        cam_from_world: &Pose,
        rows: Range<u32>,
    ) -> Result<Render, FieldError> {
        let mut whole = Render::empty(seen.width, rows.end.saturating_sub(rows.start));
        let first = rows.start as usize * seen.width as usize;
        let view = camera(seen, &cam_from_world.inverse(), &model.frame);
        let rays = self.lanes.rays.slots;
        for start in (0..whole.rgb.len()).step_by(rays) {
            let count = rays.min(whole.rgb.len() - start);
            let range = PixelRange {
                camera: view,
                first: (first + start) as u32,
                count: count as u32,
                jitter: MIDDLE,
                pad: 0,
            };
            self.rays(model, range)?;
            let picture = self.gpu.read(&self.picture)?;
            for pixel in 0..count {
                let number = |row: usize| picture[row * rays + pixel];
                whole.rgb[start + pixel] = [0, 1, 2].map(number);
                whole.opacity[start + pixel] = number(3);
                whole.depth[start + pixel] = number(4);
            }
        }
        Ok(whole)
    }

    /// Carries the rays of some pixels to their end, round by round.
    fn rays(&mut self, model: &Model, range: PixelRange) -> Result<(), FieldError> {
        let count = range.count as usize;
        let whole = whole_walk(
            count,
            self.lanes.rays.slots,
            self.lanes.capacity,
            &model.steps,
            model.bits.side,
        );
        self.gpu.write(&self.asked, 0, &[range]);
        self.gpu.submit(|recorder| {
            recorder.threads(&self.view, count);
            self.begin.record(recorder);
        });
        let mut limit = FIRST_ROUND;
        while self.rounds(whole, &mut limit, count)? > 0 {}
        let (gpu, lanes) = (&self.gpu, &self.lanes);
        if gpu.read(&lanes.faults)?.iter().any(|fault| *fault != 0) {
            gpu.write(&lanes.faults, 0, &[0; faults::LEN]);
            return Err(FieldError::Malformed {
                what: "field",
                reason: "a raw density or colour is not finite where a picture looks".to_owned(),
            });
        }
        gpu.write(&lanes.counts, counts::RAYS as usize, &[count as u32]);
        gpu.submit(|recorder| self.finish.record(recorder));
        Ok(())
    }

    /// Carries rays on by some rounds, and returns how many are not at their end.
    fn rounds(&mut self, whole: Walk, limit: &mut u32, count: usize) -> Result<u32, GpuError> {
        let begun = Instant::now();
        for _ in 0..LOOK_EVERY {
            write_walks(&self.gpu, &self.lanes, round(whole, *limit));
            self.submits.submit(&self.gpu, |recorder| {
                self.marching.record(recorder, count);
                self.forward.densities.record(recorder);
                self.forward.colours.record_for(recorder, count);
                self.paint.record_for(recorder, count);
                recorder.threads(&self.alive, count);
            });
            *limit = limit.saturating_mul(2);
        }
        let alive = self.gpu.read(&self.lanes.counts)?[counts::ALIVE as usize];
        self.submits.took(LOOK_EVERY, begun);
        Ok(alive)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gpu::testing::{advance, gpu, worst};
    use marf_field::test_scene::{ball, small};
    use marf_field::{Trainer, View};

    #[test]
    fn a_picture_is_the_same_with_any_number_of_rays_at_once() {
        let Some(gpu) = gpu("a_picture_is_the_same_with_any_number_of_rays_at_once") else {
            return;
        };
        let views = ball(4, 24);
        let mut trainer = Trainer::new(views.clone(), &[], &small(), 1).unwrap();
        advance(&mut trainer, 60);
        let field = trainer.field().unwrap();
        let made = |rays: usize| {
            let size = BatchSize {
                samples: 8 * rays,
                rays,
            };
            let mut canvas = Canvas::new(&gpu, &field.model, size).unwrap();
            let View {
                camera,
                cam_from_world,
                ..
            } = &views[1];
            canvas.rows(&field.model, camera, cam_from_world, 0..24).unwrap()
        };
        let [few, many] = [256, 1 << 14].map(made);
        assert!(few.opacity.iter().any(|opacity| *opacity > 0.5));
        // Rays whose samples do not fit wait for the next round: sums over rounds are cut elsewhere.
        let (apart, _) = worst(few.rgb.as_flattened(), many.rgb.as_flattened());
        println!("apart by {apart:e}");
        assert!(apart < 2e-6, "{apart:e}");
    }

    #[test]
    fn only_a_card_gets_many_rays_at_once_and_only_as_many_as_it_holds() {
        let Some(gpu) = gpu("only_a_card_gets_many_rays_at_once_and_only_as_many_as_it_holds") else {
            return;
        };
        let field = Trainer::new(ball(1, 8), &[], &small(), 1)
            .unwrap()
            .field()
            .unwrap();
        let [samples, rays] = if gpu.is_card() { AT_ONCE[0] } else { AT_ONCE[2] };
        assert_eq!(at_once(&gpu, &field.model), Ok(BatchSize { samples, rays }));
    }
}
