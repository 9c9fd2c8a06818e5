//! Dispatches in order: recording and submitting them.

use super::Gpu;
use super::array::Part;
use super::batch::Batch;
use super::kernel::{Bound, GROUP, Kernel, fold};

impl Gpu {
    /// Records dispatches and submits them at once, in one pass.
    pub fn submit(&self, record: impl FnOnce(&mut Recorder<'_>)) {
        let mut encoder = self.device.create_command_encoder(&Default::default());
        record(&mut Recorder::Pass(
            encoder.begin_compute_pass(&Default::default()),
        ));
        self.queue.submit([encoder.finish()]);
    }
}

/// Takes dispatches in order. Each sees the writes of those before it.
#[expect(clippy::large_enum_variant, reason = "one a submit, on the stack")]
pub enum Recorder<'a> {
    /// All go to one pass.
    Pass(wgpu::ComputePass<'a>),
    /// They are noted down.
    List(Work),
}

impl Recorder<'_> {
    /// Runs a kernel of [`GROUP`] threads a workgroup with at least `threads` threads.
    pub fn threads(&mut self, bound: &Bound, threads: usize) {
        self.groups(bound, fold(threads.div_ceil(GROUP)));
    }

    /// Runs a kernel with this many workgroups in x, y and z.
    pub fn groups(&mut self, bound: &Bound, [x, y, z]: [usize; 3]) {
        match self {
            Self::Pass(pass) => {
                pass.set_pipeline(&bound.pipeline);
                pass.set_bind_group(0, &bound.group, &[]);
                pass.dispatch_workgroups(x as u32, y as u32, z as u32);
            }
            Self::List(work) => work.add(bound.clone(), Groups::All([x, y, z])),
        }
    }
}

/// Workgroups of a dispatch.
#[derive(Clone, Copy)]
pub enum Groups {
    /// This many in x, y and z.
    All([usize; 3]),
    /// Those of the rays in use, with the number of slots: a card spends 1 to 9 ns on a workgroup that finds
    /// no ray.
    OfRays(usize, fn(usize) -> [usize; 3]),
}

impl Groups {
    fn for_rays(self, rays: usize) -> [usize; 3] {
        match self {
            Self::All(groups) => groups,
            Self::OfRays(slots, groups) => groups(rays.min(slots)),
        }
    }
}

/// Dispatches in order.
#[derive(Default)]
pub struct Work(Vec<(Bound, Groups)>);

impl Work {
    /// Adds a kernel and its workgroups.
    pub fn add(&mut self, bound: Bound, groups: Groups) {
        self.0.push((bound, groups));
    }

    /// Returns the recorded dispatches.
    pub fn recorded(record: impl FnOnce(&mut Recorder<'_>)) -> Self {
        let mut recorder = Recorder::List(Self::default());
        record(&mut recorder);
        match recorder {
            Recorder::List(work) => work,
            Recorder::Pass(_) => Self::default(),
        }
    }

    /// Returns the number of dispatches.
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// Returns parts of at most `most` dispatches each, in order.
    pub fn parts(&self, most: usize) -> impl Iterator<Item = Self> {
        self.0.chunks(most.max(1)).map(|part| Self(part.to_vec()))
    }

    /// Adds what another work does, behind.
    pub fn then(mut self, other: Self) -> Self {
        self.0.extend(other.0);
        self
    }

    /// Records all dispatches, for every slot of rays.
    pub fn record(&self, recorder: &mut Recorder<'_>) {
        self.record_for(recorder, usize::MAX);
    }

    /// Records all dispatches for `rays` rays: nothing is written for others.
    pub fn record_for(&self, recorder: &mut Recorder<'_>, rays: usize) {
        for (bound, groups) in &self.0 {
            recorder.groups(bound, groups.for_rays(rays));
        }
    }
}

/// Gives a kernel its buffers and workgroups.
pub fn dispatch(gpu: &Gpu, kernel: &Kernel, parts: &[Part<'_>], groups: [usize; 3]) -> Work {
    Work(vec![(gpu.bind(kernel, parts), Groups::All(groups))])
}

/// Gives a kernel its buffers, and the workgroups that rays need.
pub fn dispatch_rays(
    batch: Batch<'_>,
    kernel: &Kernel,
    parts: &[Part<'_>],
    groups: fn(usize) -> [usize; 3],
) -> Work {
    Work(vec![(
        batch.gpu.bind(kernel, parts),
        Groups::OfRays(batch.rays, groups),
    )])
}
