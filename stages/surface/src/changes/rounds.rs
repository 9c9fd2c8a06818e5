//! Nodes of a comparison, round by round.

use marf_cache::Digest;
use marf_schema::changes::ChangesParams;
use marf_schema::output::{SCENE, WEIGHTS};
use marf_schema::surface::{SurfaceParams, SurfaceReport};
use marf_schema::train::{Metrics, Setup, TrainParams};
use marf_stage::{Ctx, Document, Inputs, NodeSpec, Outputs, StageError};

use super::outputs::{digest, document};

/// The two times, as nodes call them.
const TIMES: [&str; 2] = ["before", "after"];

/// Cells that the views of a field may differ by and still show ground: rough ground is noisy, but not a
/// hole.
const SPREAD: f64 = 3.0;
/// Share of the reach of a surface within which it is compared: where a pixel is two cells wide. Beyond it two times differ by what their
/// photos resolve.
const REACH: f64 = 0.5;

/// Resolution and reach of surfaces, metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Size {
    pub cell_m: f64,
    /// Largest distance from a photo. `None`: the default of the surface.
    pub reach_m: Option<f64>,
}

/// The nodes below a comparison. Within a round all of the earlier time come first.
pub(super) struct Rounds<'s> {
    pub params: &'s ChangesParams,
    /// The scene of each time.
    pub scenes: [Digest; 2],
}

impl Rounds<'_> {
    /// Returns the nodes of the next round.
    pub fn next(&self, ctx: &Ctx<'_>, done: &[Outputs]) -> Result<Vec<NodeSpec>, StageError> {
        let params = self.params;
        let (begins, trained) = (2, 2 * params.b as usize);
        if done.len() < begins {
            return self.each(&|time| Ok(vec![self.training(time, 0, None)?]));
        }
        if done.len() < trained {
            return self.each(&|time| {
                let setup = digest(&done[time], Setup::OUTPUT)?;
                let mut nodes = Vec::new();
                for index in 1..params.b {
                    nodes.push(self.training(time, index, Some(setup))?);
                }
                if params.cell.is_none() {
                    nodes.push(self.surface(time, "cell", &done[time], None)?);
                }
                Ok(nodes)
            });
        }
        if done.len() >= self.before_surfaces() + trained {
            return Ok(Vec::new());
        }
        let size = self.size(ctx, done)?;
        self.each(&|time| {
            let members = self.trained(time, done).into_iter().enumerate();
            members
                .map(|(index, outputs)| {
                    self.surface(time, &format!("surface-{index:02}"), outputs, Some(size))
                })
                .collect()
        })
    }

    /// Returns the first training of each time, and the surfaces of all.
    pub fn results<'d>(
        &self,
        done: &'d [Outputs],
    ) -> Result<([&'d Outputs; 2], [&'d [Outputs]; 2]), StageError> {
        let b = self.params.b as usize;
        let miscounted =
            || StageError::new(format!("{} nodes are not those that were asked for", done.len()));
        let surfaces = done.get(self.before_surfaces()..).ok_or_else(miscounted)?;
        let (before, after) = surfaces.split_at_checked(b).ok_or_else(miscounted)?;
        match done {
            [first, second, ..] if after.len() == b => Ok(([first, second], [before, after])),
            _ => Err(miscounted()),
        }
    }

    fn each(
        &self,
        nodes: &dyn Fn(usize) -> Result<Vec<NodeSpec>, StageError>,
    ) -> Result<Vec<NodeSpec>, StageError> {
        Ok([nodes(0)?, nodes(1)?].concat())
    }

    /// Returns how many nodes come before the surfaces that are compared.
    fn before_surfaces(&self) -> usize {
        let params = self.params;
        2 * params.b as usize + if params.cell.is_none() { 2 } else { 0 }
    }

    /// Returns the nodes of the second round of a time.
    fn second<'d>(&self, time: usize, done: &'d [Outputs]) -> &'d [Outputs] {
        let each = self.before_surfaces() / 2 - 1;
        &done[2 + time * each..][..each]
    }

    /// Returns the trainings of a time.
    fn trained<'d>(&self, time: usize, done: &'d [Outputs]) -> Vec<&'d Outputs> {
        let further = self.second(time, done)[..self.params.b as usize - 1].iter();
        std::iter::once(&done[time]).chain(further).collect()
    }

    /// Returns the size of all surfaces: the cell given, or the coarser of those that the surfaces of the two times took.
    fn size(&self, ctx: &Ctx<'_>, done: &[Outputs]) -> Result<Size, StageError> {
        if let Some(cell_m) = self.params.cell {
            return Ok(Size {
                cell_m,
                reach_m: None,
            });
        }
        let (mut cell_m, mut reach_m) = (0.0_f64, f64::INFINITY);
        for time in 0..2 {
            let outputs = self.second(time, done).last().unwrap_or(&done[time]);
            let report: SurfaceReport = document(ctx, outputs)?;
            cell_m = cell_m.max(report.cell);
            reach_m = reach_m.min(REACH * report.reach);
        }
        Ok(Size {
            cell_m,
            reach_m: Some(reach_m),
        })
    }

    fn training(&self, time: usize, index: u32, setup: Option<Digest>) -> Result<NodeSpec, StageError> {
        let mut inputs = Inputs::default();
        inputs.0.insert(SCENE.to_owned(), self.scenes[time]);
        inputs
            .0
            .extend(setup.map(|setup| (Setup::OUTPUT.to_owned(), setup)));
        let name = format!("{}-train-{index:02}", TIMES[time]);
        NodeSpec::new(name, &training(self.params, index), &inputs)
    }

    fn surface(
        &self,
        time: usize,
        name: &str,
        trained: &Outputs,
        size: Option<Size>,
    ) -> Result<NodeSpec, StageError> {
        let mut inputs = Inputs::default();
        inputs.0.insert(SCENE.to_owned(), self.scenes[time]);
        for name in [WEIGHTS, Metrics::OUTPUT] {
            inputs.0.insert(name.to_owned(), digest(trained, name)?);
        }
        NodeSpec::new(
            format!("{}-{name}", TIMES[time]),
            &surface(self.params, size),
            &inputs,
        )
    }
}

/// Returns the training of member `index`.
pub(super) fn training(params: &ChangesParams, index: u32) -> TrainParams {
    TrainParams {
        quality: params.quality,
        steps: params.steps,
        scale: params.scale,
        seed: params.seed.wrapping_add(u64::from(index)),
        device: params.device.clone(),
        ..TrainParams::default()
    }
}

/// Returns the parameters of the surface of a field. `size`: `None` for one that follows from the photos.
pub(super) fn surface(params: &ChangesParams, size: Option<Size>) -> SurfaceParams {
    let cell_m = size.map(|size| size.cell_m);
    SurfaceParams {
        cell: cell_m,
        reach: size.and_then(|size| size.reach_m),
        map_cell: cell_m,
        most_spread: cell_m.map(|cell| SPREAD * cell),
        side_px: params.side_px,
        device: params.device.clone(),
        ..SurfaceParams::default()
    }
}
