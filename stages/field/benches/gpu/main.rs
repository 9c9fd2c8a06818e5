//! Every kernel of a training step on a GPU beside the ceilings of the device: `cargo bench -p marf-field --bench gpu`.
//!
//! `MARF_BENCH_GPU` names the device (`gpu` or `gpu:NAME`), `MARF_BENCH_SAMPLES` the samples of a batch,
//! `MARF_BENCH_STEPS` the steps that are taken, then timed by timestamps, then by the clock. See `benches/gpu.md`.
#![allow(clippy::print_stdout, clippy::print_stderr, clippy::expect_used, missing_docs)]

mod scene;

use std::error::Error;
use std::process::ExitCode;
use std::sync::Arc;
use std::time::Instant;

use marf_field::bench::{Ceilings, Cost, Filled, Gpu, KernelTime, Load, Timed, TimedTraining, ceilings};
use marf_field::{Config, Device, Gain};

fn main() -> ExitCode {
    if !std::env::args().any(|argument| argument == "--bench") {
        return ExitCode::SUCCESS; // `cargo test --all-targets` builds and starts it, too
    }
    match run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::FAILURE
        }
    }
}

const HINT: &str = "set `MARF_BENCH_GPU=gpu:NAME` to a part of an adapter's name, say `gpu:llvmpipe` for the software adapter of Mesa";

fn run() -> Result<(), Box<dyn Error>> {
    let device: Device = setting("MARF_BENCH_GPU", Device::Gpu(None))?;
    let gpu = Gpu::shared(&device)
        .map_err(|error| format!("{error}\n  hint: {HINT}"))?
        .ok_or(HINT)?;
    let (samples, steps) = if gpu.is_software() {
        (1 << 13, 32)
    } else {
        (1 << 18, 512)
    };
    let samples = setting("MARF_BENCH_SAMPLES", samples)?;
    let steps = setting("MARF_BENCH_STEPS", steps)?;
    println!("{}\n{samples} samples a batch, {steps} steps each", gpu.id());
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
    for (name, config) in fields() {
        let config = Config {
            batch_samples: samples,
            ..config
        };
        println!("\n{name}\n");
        field(&gpu, &config, steps, &most)?;
    }
    Ok(())
}

/// Samples of the step that is counted: a card's.
const COUNTED: f64 = (1 << 18) as f64;

/// Prints what the kernels of a step of 2^18 samples do; a small batch tells.
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
    let filled = Filled {
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
    let sum = |of: fn(&Cost) -> f64| costs.iter().map(of).sum::<f64>();
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

fn field(gpu: &Arc<Gpu>, config: &Config, steps: u64, most: &Ceilings) -> Result<(), Box<dyn Error>> {
    let mut training = TimedTraining::new(gpu, scene::views(), config, 0)?;
    training.advance(steps)?;
    let timed = training.time(steps)?;
    let begin = Instant::now();
    let samples = training.advance(steps)?;
    let wall_s = begin.elapsed().as_secs_f64();
    table(&timed, most);
    let each = |count: u64| count as f64 / timed.steps as f64;
    println!(
        "\nof a step that was timed: {:.0} rays, {:.0} samples visited, {:.0} trained",
        each(timed.rays),
        each(timed.visited),
        each(timed.samples)
    );
    println!(
        "a step: {:.3} ms by timestamps, {:.3} ms by the clock without; {:.2} M samples/s",
        1e3 * step_s(&timed),
        1e3 * wall_s / steps as f64,
        samples as f64 / wall_s / 1e6
    );
    Ok(())
}

fn step_s(timed: &Timed) -> f64 {
    timed.update_s + timed.kernels.iter().map(|kernel| kernel.seconds).sum::<f64>()
}

fn table(timed: &Timed, most: &Ceilings) {
    println!(
        "| kernel | calls a step | ms a step | share | rate | of the ceiling |\n|---|---|---|---|---|---|"
    );
    let whole = step_s(timed);
    for kernel in &timed.kernels {
        let KernelTime {
            name, calls, seconds, ..
        } = kernel;
        println!(
            "| {name} | {calls:.1} | {:.3} | {:.1} % | {} |",
            1e3 * seconds,
            100.0 * seconds / whole,
            rate(kernel, most)
        );
    }
    println!(
        "| updates of the occupancy | | {:.3} | {:.1} % | | |",
        1e3 * timed.update_s,
        100.0 * timed.update_s / whole
    );
}

fn rate(kernel: &KernelTime, most: &Ceilings) -> String {
    let (amount, unit, ceiling) = match kernel.load {
        None => return "|".to_owned(),
        Some(Load::Bytes(bytes)) => (bytes, "GB/s", most.bytes_per_s),
        Some(Load::Operations(operations)) => (operations, "GFLOP/s", most.operations_per_s),
    };
    let rate = amount / kernel.seconds;
    format!("{:.1} {unit} | {:.0} %", rate / 1e9, 100.0 * rate / ceiling)
}
