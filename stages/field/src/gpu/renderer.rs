//! Pictures of a field on a device.

use std::fmt;
use std::ops::Range;
use std::sync::Arc;

use marf_scene::{Camera, Pose};
use marf_shaders::{PixelRange, counts, faults};
use parking_lot::Mutex;

use super::Gpu;
use super::array::Array;
use super::forward::{Forward, Kernels, Lanes, Purpose, check_columns, write_walks};
use super::kernel::Bound;
use super::march::{Alive, March, Marching, bit_words, round, step_table, whole_walk};
use super::picture::{PICTURE, Picture};
use super::rays::{ViewRays, camera};
use super::record::Work;
use super::tables::Grid;
use super::weights::DeviceWeights;
use crate::backend::Renderer;
use crate::model::Model;
use crate::render::MIDDLE;
use crate::{Background, FieldError, GpuError, Render};

/// Rays at once, and samples they share.
const RAYS: usize = 1 << 14;
const CAPACITY: usize = 1 << 17;
/// Samples that a ray gets in the first round; later rounds take twice as many.
const FIRST_ROUND: u32 = 8;
/// Rounds between two reads of how many rays go on.
const LOOK_EVERY: usize = 2;

/// A field on a device, and what its pictures are made with; one picture at a time.
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
    marching: Marching,
    forward: Forward,
    begin: Work,
    paint: Work,
    finish: Work,
    alive: Bound,
}

impl GpuRenderer {
    /// Copies a model to a device and compiles the kernels.
    ///
    /// # Errors
    /// A device that lacks something or has too little memory.
    pub fn new(gpu: &Arc<Gpu>, model: &Model) -> Result<Self, FieldError> {
        Ok(Self(Mutex::new(Canvas::new(gpu, model)?)))
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
        let canvas = self.0.lock();
        canvas.rows(model, camera, cam_from_world, rows)
    }
}

impl Canvas {
    fn new(gpu: &Arc<Gpu>, model: &Model) -> Result<Self, GpuError> {
        let device = gpu.as_ref();
        let features = model.weights.features;
        check_columns(device, &model.weights, [CAPACITY, RAYS], Purpose::Picture)?;
        let grid = Grid::new(device, &model.weights.shapes, features)?;
        let weights = DeviceWeights::new(device, &grid, &model.weights)?;
        let slots = [CAPACITY, RAYS];
        let lanes = Lanes::new(device, &weights, slots, &model.steps)?;
        device.write(&lanes.steps, 0, &step_table(&model.steps));
        let bits = device.filled("occupied cells", &bit_words(&model.bits))?;
        let asked = device.uniform("pixels asked for", bytemuck::Zeroable::zeroed())?;
        let picture = device.zeros("picture", PICTURE * RAYS)?;
        let kernels = Kernels::new(device, features, &weights.layers)?;
        let painter = Picture::new(device)?;
        let batch = lanes.batch(device);
        let shown = (&lanes.shown, &lanes.state);
        let columns = lanes.columns();
        let [begin, paint] = painter.paint(batch, counts::RAYS, columns, lanes.colours().rgb, shown)?;
        let background = match model.config.background {
            Background::Direction => Some(weights.background()),
            Background::Black => None,
        };
        let half_side = model.frame.half_side as f32;
        let directions = &lanes.rays.directions;
        let ends = [&lanes.state, &picture];
        let finish = painter.finish(batch, (counts::RAYS, half_side), directions, background, ends)?;
        let (walk, progress) = (&lanes.walks[0], &lanes.progress);
        Ok(Self {
            view: ViewRays::new(device)?.bind(device, &asked, &lanes.rays, progress),
            marching: March::new(device)?.bind(device, lanes.marched(&bits)),
            forward: Forward::new(device, &kernels, &grid, &weights, &lanes)?,
            alive: Alive::new(device)?.bind(device, walk, &lanes.state, progress, &lanes.counts),
            begin,
            paint,
            finish,
            gpu: gpu.clone(),
            lanes,
            asked,
            picture,
        })
    }

    fn rows(
        &self,
        model: &Model,
        seen: &Camera,
        cam_from_world: &Pose,
        rows: Range<u32>,
    ) -> Result<Render, FieldError> {
        let mut whole = Render::empty(seen.width, rows.end.saturating_sub(rows.start));
        let first = rows.start as usize * seen.width as usize;
        let view = camera(seen, &cam_from_world.inverse(), &model.frame);
        for start in (0..whole.rgb.len()).step_by(RAYS) {
            let count = RAYS.min(whole.rgb.len() - start);
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
                let number = |row: usize| picture[row * RAYS + pixel];
                whole.rgb[start + pixel] = [0, 1, 2].map(number);
                whole.opacity[start + pixel] = number(3);
                whole.depth[start + pixel] = number(4);
            }
        }
        Ok(whole)
    }

    /// Carries the rays of some pixels to their end, round by round.
    fn rays(&self, model: &Model, range: PixelRange) -> Result<(), FieldError> {
        let (gpu, lanes) = (&self.gpu, &self.lanes);
        let count = range.count as usize;
        let whole = whole_walk(count, RAYS, CAPACITY, &model.steps, model.bits.side);
        gpu.write(&self.asked, 0, &[range]);
        gpu.submit(|recorder| {
            recorder.threads(&self.view, count);
            self.begin.record(recorder);
        });
        let mut limit = FIRST_ROUND;
        for number in 1.. {
            write_walks(gpu, lanes, round(whole, limit));
            gpu.submit(|recorder| {
                self.marching.record(recorder, count);
                self.forward.densities.record(recorder);
                self.forward.colours.record(recorder);
                self.paint.record(recorder);
                recorder.threads(&self.alive, count);
            });
            if number % LOOK_EVERY == 0 && gpu.read(&lanes.counts)?[counts::ALIVE as usize] == 0 {
                break;
            }
            limit = limit.saturating_mul(2);
        }
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
}
