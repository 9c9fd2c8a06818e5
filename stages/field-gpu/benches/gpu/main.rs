//! Every kernel of a training step on a GPU with the ceilings of the device: `cargo bench -p marf-field
//! --bench gpu`.
//!
//! `MARF_BENCH_GPU` names the device (`gpu` or `gpu:NAME`). `MARF_BENCH_SAMPLES` is the samples of a batch,
//! several after each other between commas. `MARF_BENCH_STEPS` is the steps that are taken, then timed by
//! timestamps, then by the clock. `MARF_BENCH_VIEW` is the size of the picture, `MARF_BENCH_JSON` a file for
//! a line of JSON each. `-- collect DIR` instead prints the results of `benches/gpu.sh run` in a folder as
//! Markdown, with the model's expectation. `-- model` prints the model. `-- halvings` times steps of one
//! training, its steps along rays halved not at all, three times and six times, in turns. See
//! `benches/gpu.md`.
#![allow(clippy::print_stdout, clippy::print_stderr, clippy::expect_used, missing_docs)]

mod collect;
mod measured;
mod model;
#[path = "../../../field/benches/render/scene.rs"]
mod scene;
mod table;

use std::error::Error;
use std::io::Write as _;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::time::Instant;

use marf_field::{Config, Device, Gain, Trainer};
use marf_field_gpu::{BatchFill, Ceilings, Cost, Gpu, TimedTraining, ceilings};
use marf_scene::Camera;
use measured::{Kernel, Kernels, Line, View, ViewShape};

fn main() -> ExitCode {
    // `cargo bench` adds `--bench`. `cargo test --all-targets` builds and starts it, too.
    let mut arguments: Vec<String> = std::env::args().skip(1).collect();
    let count = arguments.len();
    arguments.retain(|argument| argument != "--bench");
    let done = match arguments.as_slice() {
        [verb] if verb == "model" => {
            print!("{}", table::expected());
            Ok(())
        }
        [verb] if verb == "halvings" => halvings(),
        [verb, folder] if verb == "collect" => collect::collect(&PathBuf::from(folder)),
        [] if count > 0 => run(),
        _ => return ExitCode::SUCCESS,
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::FAILURE
        }
    }
}

const HINT: &str = "set `MARF_BENCH_GPU=gpu:NAME` to a part of an adapter's name, say `gpu:llvmpipe` for the software adapter of Mesa";
/// Runs of a picture that are timed, after one that is not.
const VIEWS: usize = 5;
/// Turns of what is timed in turns.
const TURNS: usize = 3;

/// Returns the device that is wanted.
fn opened() -> Result<Arc<Gpu>, Box<dyn Error>> {
    let device: Device = setting("MARF_BENCH_GPU", Device::Gpu(None))?;
    let gpu = Gpu::shared(&device).map_err(|error| format!("{error}\n  hint: {HINT}"))?;
    Ok(gpu.ok_or(HINT)?)
}

/// Times steps of one training with short and long steps along rays, in turns.
fn halvings() -> Result<(), Box<dyn Error>> {
    let gpu = opened()?;
    let steps = setting("MARF_BENCH_STEPS", if gpu.is_software() { 32 } else { 512 })?;
    let batch_samples = setting(
        "MARF_BENCH_SAMPLES",
        if gpu.is_software() { 1 << 13 } else { 1 << 18 },
    )?;
    let config = Config {
        halvings: Some(6),
        batch_samples,
        ..fields()[0].1.clone()
    };
    let mut training = TimedTraining::new(&gpu, scene::views(), &config, 0)?;
    training.advance(steps)?;
    println!(
        "| halvings | steps a ray | rays | visited | trained | march, ms | scan, ms | all kernels of a step, ms |"
    );
    println!("|---|---|---|---|---|---|---|---|");
    for _ in 0..TURNS {
        for halvings in [0, 3, 6] {
            training.halve(halvings)?;
            // The rays of a step follow their samples within some steps.
            training.advance(steps)?;
            let timed = training.time(steps)?;
            let shape = training.shape(&timed);
            let named = |name: &'static str| {
                timed
                    .kernels
                    .iter()
                    .filter(move |kernel| name.is_empty() || kernel.name == name)
            };
            let ms = |name| 1e3 * named(name).map(|kernel| kernel.seconds).sum::<f64>();
            println!(
                "| {halvings} | {} | {:.0} | {:.0} | {:.0} | {:.3} | {:.3} | {:.3} |",
                shape.steps_a_ray,
                shape.rays,
                shape.visited,
                shape.kept,
                ms("march"),
                ms("scan"),
                ms("")
            );
        }
    }
    Ok(())
}

fn run() -> Result<(), Box<dyn Error>> {
    let gpu = opened()?;
    let (samples, steps, view) = if gpu.is_software() {
        (1 << 13, 32, "64x48")
    } else {
        (1 << 18, 512, "640x480")
    };
    let batches: Batches = setting("MARF_BENCH_SAMPLES", Batches(vec![samples]))?;
    let steps = setting("MARF_BENCH_STEPS", steps)?;
    let view: Size = setting("MARF_BENCH_VIEW", view.parse()?)?;
    println!("{}", gpu.id());
    for (name, config) in fields() {
        println!("\n{name}, counted\n");
        counted(&gpu, &config)?;
    }
    let most = ceilings(&gpu)?;
    println!(
        "copy of 64 MB {:.1} GB/s, fused multiply-add {:.0} GFLOP/s",
        most.bytes_per_s / 1e9,
        most.operations_per_s / 1e9
    );
    for batch_samples in batches.0 {
        for (name, config) in fields() {
            let config = Config {
                batch_samples,
                ..config
            };
            let kernels = kernels(&gpu, name, &config, steps, &most)?;
            print!("\n{}", table::kernels(&kernels));
            keep(&Line::Kernels(kernels))?;
        }
    }
    for (name, config) in fields() {
        let seen = picture(&gpu, name, &config, view, steps)?;
        print!("\n{}", table::view(&seen));
        keep(&Line::View(seen))?;
    }
    Ok(())
}

/// Adds a line to the file of `MARF_BENCH_JSON`, if that is set.
fn keep(line: &Line) -> Result<(), Box<dyn Error>> {
    let Some(path) = std::env::var_os("MARF_BENCH_JSON") else {
        return Ok(());
    };
    let mut file = std::fs::OpenOptions::new().create(true).append(true).open(path)?;
    writeln!(file, "{}", serde_json::to_string(line)?)?;
    Ok(())
}

/// Sizes of batches.
struct Batches(Vec<u32>);

impl std::str::FromStr for Batches {
    type Err = std::num::ParseIntError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        Ok(Self(text.split(',').map(str::parse).collect::<Result<_, _>>()?))
    }
}

/// Width and height of a picture.
#[derive(Clone, Copy)]
struct Size(u32, u32);

impl std::str::FromStr for Size {
    type Err = Box<dyn Error>;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let (width, height) = text.split_once('x').ok_or("a size is WIDTHxHEIGHT")?;
        Ok(Self(width.parse()?, height.parse()?))
    }
}

/// Samples of the step that is counted: a card's.
const COUNTED: f64 = (1 << 18) as f64;

/// Prints the costs of the kernels of a step of 2^18 samples, predicted by a small batch.
fn counted(gpu: &Arc<Gpu>, config: &Config) -> Result<(), Box<dyn Error>> {
    let config = Config {
        batch_samples: 1 << 13,
        gain: Gain::PerPhotoAndOffset,
        ..config.clone()
    };
    // The first steps along rays are the longest.
    let mut training = TimedTraining::new(gpu, scene::views(), &config, 0)?;
    training.advance(1)?;
    let apart = training.apart()?;
    println!(
        "of the corners of all samples {:.1} % are added one by one\n",
        100.0 * apart
    );
    let filled = BatchFill {
        visited: COUNTED,
        kept: COUNTED,
        rays: COUNTED / 10.0,
        moved: 1.0,
        apart,
    };
    let costs = training.costs(&filled).ok_or("a kernel has no cost")?;
    println!("| kernel | dispatches | MB | million atomic additions |\n|---|---|---|---|");
    let line = |name, dispatches, bytes: f64, atomics: f64| {
        println!(
            "| {name} | {dispatches} | {:.1} | {:.2} |",
            bytes / 1e6,
            atomics / 1e6
        );
    };
    for cost in &costs {
        let Cost { name, dispatches, .. } = *cost;
        line(name, dispatches, cost.bytes, cost.atomics);
    }
    let sum = |amount: fn(&Cost) -> f64| costs.iter().map(amount).sum::<f64>();
    let dispatches = costs.iter().map(|cost| cost.dispatches).sum();
    line(
        "all",
        dispatches,
        sum(|cost| cost.bytes),
        sum(|cost| cost.atomics),
    );
    Ok(())
}

/// Reads a variable of the environment.
fn setting<T: std::str::FromStr>(name: &str, otherwise: T) -> Result<T, String> {
    match std::env::var(name) {
        Err(_) => Ok(otherwise),
        Ok(text) => text
            .parse()
            .map_err(|_| format!("`{name}={text}` is not understood")),
    }
}

fn fields() -> [(&'static str, Config); 2] {
    let small = Config {
        levels: Some(8),
        log2_table: Some(15),
        ..Config::default()
    };
    [
        ("8 levels x 4, T = 2^15, networks 32 wide", small),
        (
            "16 levels x 2, T = 2^19, networks 64 wide, colour of 2 layers",
            Config::fixed(),
        ),
    ]
}

fn kernels(
    gpu: &Arc<Gpu>,
    field: &str,
    config: &Config,
    steps: u64,
    most: &Ceilings,
) -> Result<Kernels, Box<dyn Error>> {
    let mut training = TimedTraining::new(gpu, scene::views(), config, 0)?;
    training.advance(steps)?;
    let timed = training.time(steps)?;
    let begin = Instant::now();
    let samples = training.advance(steps)?;
    let wall_s = begin.elapsed().as_secs_f64();
    Ok(Kernels {
        device: gpu.id().to_owned(),
        field: field.to_owned(),
        batch_samples: config.batch_samples,
        shape: training.shape(&timed),
        copy_bytes_per_s: most.bytes_per_s,
        operations_per_s: most.operations_per_s,
        clock_s: wall_s / steps as f64,
        samples_per_s: samples as f64 / wall_s,
        update_s: timed.update_s,
        kernels: timed.kernels.iter().map(Kernel::from).collect(),
    })
}

/// Trains a field and times pictures of it.
fn picture(
    gpu: &Arc<Gpu>,
    name: &str,
    config: &Config,
    size: Size,
    steps: u64,
) -> Result<View, Box<dyn Error>> {
    let Size(width, height) = size;
    let views = scene::views();
    let pose = views[1].cam_from_world;
    let mut trainer = Trainer::new(views, &[], config, 0)?.with_backend(gpu.clone())?;
    while trainer.steps() < steps {
        trainer.advance(steps - trainer.steps())?;
    }
    let field = trainer.field()?;
    let camera = Camera::pinhole(width, height, f64::from(width));
    let mut seconds = Vec::new();
    for _ in 0..=VIEWS {
        let begin = Instant::now();
        field.render(&camera, &pose)?;
        seconds.push(begin.elapsed().as_secs_f64());
    }
    seconds.remove(0);
    seconds.sort_by(f64::total_cmp);
    Ok(View {
        device: gpu.id().to_owned(),
        field: name.to_owned(),
        width,
        height,
        shape: ViewShape::new(&field),
        seconds,
    })
}
