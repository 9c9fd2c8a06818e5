//! `marf bench train`: trains against the clock, for comparisons with other trainers.
//!
//! It has a training loop of its own: the clock counts optimiser steps alone, without the decoding, checkpoints and
//! probes of the stage `train`, and decides how many there are. Such a result is no function of parameters and inputs,
//! so it is not kept in the store.

use std::path::Path;
use std::sync::Arc;

use marf_cache::Digest;
use marf_engine::{Cancel, Options};
use marf_field::{Config, Device, Field, Overrides, Trainer, View};
use marf_scene::{Image, Scene, Srgb, encode_png, metrics};
use marf_schema::calibrate::CalibrateParams;
use marf_schema::output;
use marf_schema::train::TrainParams;
use marf_stage::Params;
use serde::Deserialize;

use super::args::{Clock, TrainArgs};
use super::effort::{Effort, peak_mb};
use super::explain;
use super::line::{Budget, Explained, Line, table};
use super::pace::Paced;
use super::photos::{Photos, TestView, photos};
use crate::cli::feedback::Terminal;
use crate::terminal::{eprint_line, print_line};
use marf_run::execute::{execute, options};
use marf_run::folder;
use marf_run::session::{Session, node_named};
use marf_run::{Context, Error};
use marf_run::{budget, files};

/// The end of a training by the clock is planned again, from its rate so far, after each such part of it.
const PLANNED_EVERY: f64 = 1.0 / 16.0;

/// Keys of `train` that `marf bench train` takes; the seconds come from the command line.
#[derive(Debug, Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
struct BenchParams {
    seed: u64,
    scale: Option<u32>,
    field: Overrides,
    device: Device,
}

fn budgets(args: &TrainArgs) -> Result<Vec<Budget>, Error> {
    let seconds = args
        .seconds
        .iter()
        .map(|text| Ok(Budget::Seconds(budget::whole_seconds(text)?)));
    let mut budgets = match args.steps.as_slice() {
        [] => seconds.collect::<Result<Vec<_>, Error>>()?,
        steps => steps.iter().map(|steps| Budget::Steps((*steps).max(1))).collect(),
    };
    budgets.sort_unstable();
    budgets.dedup();
    Ok(budgets)
}

/// Most photos trained on that are explained, spread over all.
const EXPLAINED: usize = 24;

/// `marf bench train DIR`: a training a budget, of the size that the budget fills.
pub fn train(args: &TrainArgs, context: &Context) -> Result<(), Error> {
    let budgets = budgets(args)?;
    // Events of the import would stand between the lines.
    let quiet = Context {
        feedback: Arc::new(Terminal::with_progress()),
        ..context.clone()
    };
    let session = Session::implicit(&quiet, &folder::training("bench", &args.dir), "bench", &args.dir)?;
    let keys = keys(&session)?;
    let config = keys
        .field
        .over(&Config::default())
        .map_err(|error| Error::usage(format!("train.field.{}: {}", error.key, error.message)))?;
    let scene = import(&session)?;
    let most = if args.explain { EXPLAINED } else { 0 };
    let Photos {
        views,
        tests,
        explained,
    } = photos(&session, &scene, keys.scale.unwrap_or(1), most)?;
    let threads = context.threads.map_or(0, std::num::NonZero::get);
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
    let pool = pool.map_err(|error| Error::failed(format!("threads cannot be started: {error}")))?;
    let bench = Bench {
        clock: args.clock,
        threads: pool.current_num_threads(),
        out: &args.out,
        cancel: &context.cancel,
        device: &keys.device,
        seed: keys.seed,
        has_batch: keys.field.0.contains_key("batch_samples"),
        explained: args.explain.then_some(&explained),
    };
    let points: Vec<[f64; 3]> = scene.points.iter().map(|point| point.position).collect();
    let lines = pool.install(|| bench.run(&views, &tests, &points, &config, &budgets))?;
    eprint_line(&table(&lines));
    Ok(())
}

fn keys(session: &Session) -> Result<BenchParams, Error> {
    let node = session.nodes.iter().find(|node| node.name == TrainParams::STAGE);
    let mut params = node.map(|node| node.params.clone()).unwrap_or_default();
    if let Some(table) = params.as_object_mut() {
        table.retain(|_, value| !value.is_null());
    }
    serde_json::from_value(params).map_err(|error| Error::usage(format!("train: {error}")))
}

/// Runs what leads to the cameras.
fn import(session: &Session) -> Result<Scene, Error> {
    let options = Options {
        to: vec![CalibrateParams::STAGE.to_owned()],
        ..options(session)
    };
    let record = execute(session, &options)?.done()?;
    let node = node_named(&record, CalibrateParams::STAGE)?;
    let bytes = session.output(node, output::SCENE)?;
    Scene::decode(&bytes).map_err(|error| Error::failed(error.to_string()))
}

/// Settings of a benchmark.
struct Bench<'a> {
    clock: Clock,
    threads: usize,
    out: &'a Path,
    cancel: &'a Cancel,
    device: &'a Device,
    seed: u64,
    /// Whether a key says the samples of a step.
    has_batch: bool,
    /// Photos trained on whose error is explained, if that was asked for.
    explained: Option<&'a Vec<TestView>>,
}

impl Bench<'_> {
    /// Counts what makes the trainer and its steps; not decoding, compiling for a GPU, rendering or scoring.
    fn run(
        &self,
        views: &[View],
        tests: &[TestView],
        points: &[[f64; 3]],
        config: &Config,
        budgets: &[Budget],
    ) -> Result<Vec<Line>, Error> {
        let mut lines = Vec::new();
        for budget in budgets {
            let expected = Config {
                steps: config.steps.or(Some(budget.expected_steps())),
                ..config.clone()
            };
            let (paced, paced_s) = self.paced(views, points, &expected, *budget)?;
            let config = Config {
                steps: config.steps.or(paced.steps),
                ..paced
            };
            let (mut trainer, effort) = self.trained(views.to_vec(), points, &config, *budget, paced_s)?;
            let mut line = self.evaluate(&mut trainer, tests, &effort, *budget)?;
            line.paced_s = paced_s;
            line.explained = self.explain(&mut trainer, views, tests)?;
            let text = serde_json::to_string(&line);
            print_line(&text.map_err(|error| Error::failed(error.to_string()))?);
            lines.push(line);
        }
        Ok(lines)
    }

    /// Returns the configuration of a training, and the seconds of its budget that finding it took: by the clock its size
    /// follows the pace of the device.
    fn paced(
        &self,
        views: &[View],
        points: &[[f64; 3]],
        config: &Config,
        budget: Budget,
    ) -> Result<(Config, f64), Error> {
        let Budget::Seconds(seconds) = budget else {
            return Ok((config.clone(), 0.0));
        };
        let paced = Paced {
            device: self.device,
            cancel: self.cancel,
            points,
            seed: self.seed,
            has_batch: self.has_batch,
        };
        paced.config(views, config, f64::from(seconds))
    }

    /// Trains for a budget of which some seconds are used.
    fn trained(
        &self,
        views: Vec<View>,
        points: &[[f64; 3]],
        config: &Config,
        budget: Budget,
        used_s: f64,
    ) -> Result<(Trainer, Effort), Error> {
        let failed = |error: marf_field::FieldError| Error::failed(error.to_string());
        let mut effort = Effort::default();
        let mut trainer = effort
            .timed(|| Trainer::new(views, points, config, self.seed))
            .and_then(|trainer| trainer.with_backend(marf_field_gpu::open(self.device)?))
            .map_err(failed)?;
        let is_open = |trainer: &Trainer, effort: &Effort| match budget {
            Budget::Seconds(seconds) => {
                trainer.steps() == 0 || self.seconds(effort) < f64::from(seconds) - used_s
            }
            Budget::Steps(steps) => trainer.steps() < steps,
        };
        let mut planned = PLANNED_EVERY;
        while is_open(&trainer, &effort) {
            if self.cancel.is_set() {
                return Err(Error::Interrupted);
            }
            if let Budget::Seconds(seconds) = budget {
                let share = self.seconds(&effort) / (f64::from(seconds) - used_s).max(f64::MIN_POSITIVE);
                if share >= planned {
                    trainer.plan((trainer.steps() as f64 / share) as u64);
                    planned += PLANNED_EVERY;
                }
            }
            let most = match budget {
                Budget::Seconds(_) => u64::MAX,
                Budget::Steps(steps) => steps - trainer.steps(),
            };
            let step = effort.timed(|| trainer.advance(most)).map_err(failed)?;
            effort.rays += step.rays;
            effort.samples += step.samples;
        }
        let last = effort.timed(|| trainer.settle()).map_err(failed)?;
        effort.rays += last.rays;
        effort.samples += last.samples;
        Ok((trainer, effort))
    }

    fn seconds(&self, effort: &Effort) -> f64 {
        match self.clock {
            Clock::Wall => effort.wall_s,
            Clock::Cpu => effort.cpu_s / self.threads as f64,
        }
    }

    /// Renders and scores the test views as of now.
    fn evaluate(
        &self,
        trainer: &mut Trainer,
        tests: &[TestView],
        effort: &Effort,
        budget: Budget,
    ) -> Result<Line, Error> {
        let failed = |error: marf_field::FieldError| Error::failed(error.to_string());
        let field = trainer.field().map_err(failed)?;
        let folder = self.out.join(budget.to_string());
        let mut rendering = Effort::default();
        let (mut psnr, mut paper, mut ssim) = (Vec::new(), Vec::new(), Vec::new());
        for test in tests {
            let render = rendering.timed(|| rendered(&field, test)).map_err(failed)?;
            rendering.rays += render.pixels.len() as u64;
            let fail = |error: &dyn std::fmt::Display| Error::failed(format!("{}: {error}", test.name));
            psnr.push(metrics::psnr(&render, &test.photo, &[]).map_err(|error| fail(&error))?);
            paper.extend(metrics::psnr_paper(&render, &test.photo, &[]));
            ssim.extend(metrics::ssim(&render, &test.photo, &[]));
            let png = encode_png(&render).map_err(|error| fail(&error))?;
            files::write(&folder.join(format!("{}.png", test.name)), &png)?;
        }
        let clock = self.seconds(effort);
        Ok(Line {
            budget,
            clock,
            paced_s: 0.0,
            cpu_s: effort.cpu_s,
            steps: trainer.steps(),
            batch_samples: field.config().batch_samples,
            log2_table: field.facts().sizes.log2_table.value,
            checkpoint: Digest::from_content(&trainer.save().map_err(failed)?),
            rays_per_s: effort.rays as f64 / clock,
            samples_per_s: effort.samples as f64 / clock,
            rss_mb: peak_mb(),
            psnr: mean(&psnr).unwrap_or_default(),
            psnr_paper: mean(&paper),
            ssim: mean(&ssim),
            render_s: rendering.wall_s / tests.len() as f64,
            render_rays_per_s: rendering.rays as f64 / rendering.wall_s,
            explained: None,
        })
    }

    /// Finds out where the error is, if that was asked for.
    fn explain(
        &self,
        trainer: &mut Trainer,
        views: &[View],
        tests: &[TestView],
    ) -> Result<Option<Explained>, Error> {
        let Some(photos) = self.explained else {
            return Ok(None);
        };
        let failed = |error: marf_field::FieldError| Error::failed(error.to_string());
        let field = trainer.field().map_err(failed)?;
        let cameras: Vec<_> = views.iter().map(|view| view.cam_from_world).collect();
        let explained = Explained {
            trained: explain::explain(&field, photos, &[]).map_err(failed)?,
            held_out: explain::explain(&field, tests, &cameras).map_err(failed)?,
        };
        eprint_line(&explain::table(&explained.trained, &explained.held_out));
        Ok(Some(explained))
    }
}

fn rendered(field: &Field, test: &TestView) -> Result<Image<Srgb>, marf_field::FieldError> {
    let render = field.render(&test.frame.camera, &test.frame.cam_from_world)?;
    Ok(render.to_image())
}

fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}
