//! `train`: trains against the clock, for comparisons with other trainers.
//!
//! It has a training loop of its own: the clock counts optimiser steps alone, without the decoding, checkpoints and
//! probes of the stage `train`, and decides the number of steps. Such a result is not a function of parameters and
//! inputs, so it is not kept in the store.

mod effort;
mod line;
mod photos;

use std::path::PathBuf;
use std::time::Instant;

use clap::Args;
use marf_cache::Digest;
use marf_engine::{Cancel, Options};
use marf_field::{Config, DepthSource, Device, OpenSizes, Overrides, Pilot, Trainer, steps_in};
use marf_run::execute::{execute, options};
use marf_run::folder::PhotoFolder;
use marf_run::session::{Session, node_named};
use marf_run::{Error, files};
use marf_scene::{Scene, encode_png, metrics};
use marf_schema::calibrate::CalibrateParams;
use marf_schema::output;
use marf_schema::train::TrainParams;
use marf_stage::Params;
use serde::Deserialize;

use crate::options::TrainingOptions;
use crate::output::{AnyError, Result, eprint_line, go_on, print_json};
use crate::process::peak_mb;
use effort::Effort;
use line::{Budget, Line, table};
use photos::{Photos, photos};

/// The end of a training by the clock is planned again, from its rate so far, after each such part of it.
const PLANNED_EVERY: f64 = 1.0 / 16.0;

/// Arguments of `train`. `--set train.field.KEY=VALUE` and `--set train.seed=N` count too.
#[derive(Debug, Clone, Args)]
pub struct TrainArgs {
    /// A folder with images/ and a transforms.json that names train_filenames and test_filenames
    dir: PathBuf,
    /// Seconds of training, ascending. The paper's table has `10,60,300,600,900`
    #[arg(
        long,
        value_name = "SECONDS",
        default_value = "10,60,300",
        value_delimiter = ',',
        value_parser = clap::value_parser!(u32).range(1..)
    )]
    seconds: Vec<u32>,
    /// Steps instead of seconds, ascending: the same weights every time, to compare keys of the field
    #[arg(long, value_name = "STEPS", value_delimiter = ',', conflicts_with = "seconds")]
    steps: Vec<u64>,
    /// Folder for `<seconds>s/<name>.png` or `<steps>steps/<name>.png`
    #[arg(long, value_name = "DIR", default_value = "bench")]
    out: PathBuf,
    #[command(flatten)]
    options: TrainingOptions,
}

/// Keys of `train` that count. The seconds come from the command line.
#[derive(Debug, Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
struct Keys {
    seed: u64,
    scale: Option<u32>,
    field: Overrides,
    device: Device,
}

/// Trains once for each budget, at the size that the budget fills.
///
/// # Errors
/// A folder without photos or cameras, keys that do not count here, a device that fails, the wish to stop.
pub fn train(args: &TrainArgs, cancel: &Cancel) -> Result {
    let budgets = budgets(args);
    let context = args.options.context(cancel);
    let pipeline = PhotoFolder::new(&args.dir)?.training("bench");
    let session = Session::implicit(&context, &pipeline, "bench", &args.dir)?;
    let keys = keys(&session)?;
    let config = keys
        .field
        .over(&Config::default())
        .map_err(|error| Error::usage(format!("train.field.{}: {}", error.key, error.message)))?;
    if config.depth_source == DepthSource::Pairs {
        return Err("this loop matches no pairs of photos: `marf fit` does".into());
    }
    let scene = import(&session)?;
    let photos = photos(&session, &scene, keys.scale.unwrap_or(1))?;
    let threads = args.options.threads.map_or(0, std::num::NonZero::get);
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build()?;
    let bench = Bench {
        args,
        cancel,
        keys,
        photos,
        points: scene.points.iter().map(|point| point.position).collect(),
    };
    let lines = pool.install(|| bench.run(&config, &budgets))?;
    eprint_line(&table(&lines));
    Ok(())
}

fn budgets(args: &TrainArgs) -> Vec<Budget> {
    let mut budgets = Vec::new();
    if args.steps.is_empty() {
        budgets.extend(args.seconds.iter().copied().map(Budget::Seconds));
    } else {
        budgets.extend(args.steps.iter().map(|steps| Budget::Steps((*steps).max(1))));
    }
    budgets.sort_unstable();
    budgets.dedup();
    budgets
}

fn keys(session: &Session) -> Result<Keys> {
    let node = session.nodes.iter().find(|node| node.name == TrainParams::STAGE);
    let mut params = node.map(|node| node.params.clone()).unwrap_or_default();
    if let Some(table) = params.as_object_mut() {
        table.retain(|_, value| !value.is_null());
    }
    Ok(serde_json::from_value(params).map_err(|error| Error::usage(format!("train: {error}")))?)
}

/// Runs what leads to the cameras.
fn import(session: &Session) -> Result<Scene> {
    let options = Options {
        to: vec![CalibrateParams::STAGE.to_owned()],
        ..options(session)
    };
    let record = execute(session, &options)?.done()?;
    let node = node_named(&record, CalibrateParams::STAGE)?;
    Ok(Scene::decode(&session.output(node, output::SCENE)?)?)
}

/// A benchmark of the photos of one folder.
struct Bench<'a> {
    args: &'a TrainArgs,
    cancel: &'a Cancel,
    keys: Keys,
    photos: Photos,
    points: Vec<[f64; 3]>,
}

impl Bench<'_> {
    /// Counts making the trainer and its steps, but not decoding, compiling for a GPU, rendering or scoring.
    fn run(&self, config: &Config, budgets: &[Budget]) -> Result<Vec<Line>> {
        let mut lines = Vec::new();
        for budget in budgets {
            let expected = Config {
                steps: config.steps.or(Some(budget.expected_steps())),
                ..config.clone()
            };
            let (paced, paced_s) = match budget {
                Budget::Seconds(seconds) => self.paced(&expected, f64::from(*seconds))?,
                Budget::Steps(_) => (expected, 0.0),
            };
            let config = Config {
                steps: config.steps.or(paced.steps),
                ..paced
            };
            let (mut trainer, effort) = self.trained(&config, *budget, paced_s)?;
            let mut line = self.evaluate(&mut trainer, &effort, *budget)?;
            line.paced_s = paced_s;
            print_json(&line)?;
            lines.push(line);
        }
        Ok(lines)
    }

    /// Returns a trainer at step 0. Making it counts, opening the device does not.
    fn trainer(&self, config: &Config, effort: &mut Effort) -> Result<Trainer> {
        let views = self.photos.views.clone();
        let trainer = effort.timed(|| Trainer::new(views, &self.points, config, self.keys.seed))?;
        Ok(trainer.with_backend(marf_field_gpu::open(&self.keys.device)?)?)
    }

    /// Trains for a part of a time. Returns the configuration that suits the pace of the device, and the seconds that it took.
    fn paced(&self, config: &Config, seconds: f64) -> Result<(Config, f64)> {
        let new_trainer = |config: &Config| self.trainer(config, &mut Effort::default());
        let first = new_trainer(config)?;
        let begun = Instant::now();
        let pilot = Pilot::<AnyError> {
            seconds,
            open: if self.keys.field.0.contains_key("batch_samples") {
                OpenSizes::Table
            } else {
                OpenSizes::BatchAndTable
            },
            new_trainer: &new_trainer,
            left_s: &|| seconds - begun.elapsed().as_secs_f64(),
            check: &|| Ok(go_on(self.cancel)?),
            failed: Into::into,
        };
        let (trainer, pace) = pilot.run(first, config)?;
        let used_s = begun.elapsed().as_secs_f64();
        let config = Config {
            steps: Some(steps_in(seconds - used_s, pace.steps)),
            batch_samples: trainer.batch_samples(),
            ..config.clone()
        };
        Ok((config, used_s))
    }

    /// Trains for a budget, `used_s` seconds of it already used.
    fn trained(&self, config: &Config, budget: Budget, used_s: f64) -> Result<(Trainer, Effort)> {
        let mut effort = Effort::default();
        let mut trainer = self.trainer(config, &mut effort)?;
        let mut planned = PLANNED_EVERY;
        loop {
            let most = match budget {
                Budget::Seconds(seconds) => {
                    let left_s = f64::from(seconds) - used_s;
                    if trainer.steps() > 0 && effort.wall_s >= left_s {
                        break;
                    }
                    let share = effort.wall_s / left_s.max(f64::MIN_POSITIVE);
                    if share >= planned {
                        trainer.plan((trainer.steps() as f64 / share) as u64);
                        planned += PLANNED_EVERY;
                    }
                    u64::MAX
                }
                Budget::Steps(steps) if trainer.steps() >= steps => break,
                Budget::Steps(steps) => steps - trainer.steps(),
            };
            go_on(self.cancel)?;
            let step = effort.timed(|| trainer.advance(most))?;
            effort.add(&step);
        }
        let last = effort.timed(|| trainer.settle())?;
        effort.add(&last);
        Ok((trainer, effort))
    }

    /// Renders and scores the test views as of now.
    fn evaluate(&self, trainer: &mut Trainer, effort: &Effort, budget: Budget) -> Result<Line> {
        let field = trainer.field()?;
        let folder = self.args.out.join(budget.to_string());
        let mut rendering = Effort::default();
        let (mut psnr, mut paper, mut ssim) = (Vec::new(), Vec::new(), Vec::new());
        for test in &self.photos.tests {
            let render = rendering.timed(|| {
                let render = field.render(&test.frame.camera, &test.frame.cam_from_world);
                render.map(|render| render.to_image())
            })?;
            rendering.rays += render.pixels.len() as u64;
            let score = metrics::psnr(&render, &test.photo, &[]);
            psnr.push(score.map_err(|error| format!("{}: {error}", test.name))?);
            paper.extend(metrics::psnr_paper(&render, &test.photo, &[]));
            ssim.extend(metrics::ssim(&render, &test.photo, &[]));
            files::write(&folder.join(format!("{}.png", test.name)), &encode_png(&render)?)?;
        }
        Ok(Line {
            budget,
            clock: effort.wall_s,
            paced_s: 0.0,
            cpu_s: effort.cpu_s,
            steps: trainer.steps(),
            batch_samples: field.config().batch_samples,
            log2_table: field.facts().sizes.log2_table.value,
            checkpoint: Digest::from_content(&trainer.save()?),
            rays_per_s: effort.rays as f64 / effort.wall_s,
            samples_per_s: effort.samples as f64 / effort.wall_s,
            rss_mb: peak_mb(),
            psnr: mean(&psnr).unwrap_or_default(),
            psnr_paper: mean(&paper),
            ssim: mean(&ssim),
            render_s: rendering.wall_s / self.photos.tests.len() as f64,
            render_rays_per_s: rendering.rays as f64 / rendering.wall_s,
        })
    }
}

fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}
