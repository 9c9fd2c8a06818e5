//! A training step part by part, each with the time of its kernel alone for as many samples: `cargo bench -p
//! marf-field --bench step`. See `benches/step.md`.
//!
//! Fields have the sizes that budgets of 10, 60 and 300 s give rover4, fox4 and lego. They are trained on the
//! synthetic scene of the bench `gpu`, which needs no photos. Its rays have other lengths, so samples a ray
//! are printed. One thread. `[NAME]` as argument runs only those whose name contains it. `MARF_BENCH_STEPS`
//! is the number of steps before the timed ones, and of those.
#![allow(clippy::print_stdout, clippy::expect_used, missing_docs)]

#[path = "../kernels/ceilings.rs"]
#[expect(dead_code, reason = "shared with the bench of the kernels")]
mod ceilings;
#[path = "../kernels/clock.rs"]
mod clock;
#[path = "../kernels/data.rs"]
mod data;
mod scene;
#[path = "../kernels/work.rs"]
#[expect(dead_code, reason = "shared with the bench of the kernels")]
mod work;

use clock::Threads;
use marf_field::Config;
use marf_field::cpu::simd::InstructionSet;
use marf_field::watch::{PARTS, Part};
use marf_field::{Counts, StepProfile, WatchedTraining};
use work::Field;

/// Name, cells a side of the finest level, binary logarithm of the table.
const FIELDS: [(&str, u32, u32); 9] = [
    ("rover4, 10 s", 1454, 15),
    ("rover4, 60 s", 1454, 17),
    ("rover4, 300 s", 1454, 19),
    ("fox4, 10 s", 1376, 15),
    ("fox4, 60 s", 1376, 17),
    ("fox4, 300 s", 1376, 19),
    ("lego, 10 s", 2048, 15),
    ("lego, 60 s", 2048, 17),
    ("lego, 300 s", 2048, 19),
];

/// Steps from one update of the occupancy to the next: times are the median of means over this many.
const PERIOD: usize = 16;

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    if !arguments.iter().any(|argument| argument == "--bench") {
        return; // `cargo test --all-targets` builds and starts it, too
    }
    let wanted = arguments.iter().find(|argument| !argument.starts_with('-'));
    let steps: usize =
        std::env::var("MARF_BENCH_STEPS").map_or(256, |text| text.parse().expect("a number of steps"));
    let level = InstructionSet::best();
    println!(
        "{level:?}, 1 thread, {steps} steps, then {steps} that are timed (medians), no hardware counters are read"
    );
    let threads = Threads::new(1);
    for (name, finest, log2_table) in FIELDS {
        if wanted.is_none_or(|wanted| name.contains(wanted.as_str())) {
            let config = Config {
                finest_resolution: Some(finest),
                log2_table: Some(log2_table),
                ..Config::default()
            };
            println!("\n## {name}: {finest} cells, T = 2^{log2_table}\n");
            table(&config, steps.next_multiple_of(PERIOD), level, &threads);
        }
    }
}

/// Trains a field and prints its table.
fn table(config: &Config, steps: usize, level: InstructionSet, threads: &Threads) {
    let (facts, blocks) = threads.run(|| {
        let mut training = WatchedTraining::new(scene::views(), config, 0, level).expect("a training");
        let mut block = || mean((0..PERIOD).map(|_| training.step().expect("a step")).collect());
        for _ in 0..steps / PERIOD {
            block();
        }
        let blocks: Vec<StepProfile> = (0..steps / PERIOD).map(|_| block()).collect();
        (training.facts(), blocks)
    });
    let median = |number: &dyn Fn(&StepProfile) -> f64| {
        let mut numbers: Vec<f64> = blocks.iter().map(number).collect();
        numbers.sort_by(f64::total_cmp);
        numbers[numbers.len() / 2]
    };
    let count = |number: fn(&Counts) -> u64| median(&|block| number(&block.counts) as f64);
    let counts = [
        count(|counts| counts.rays),
        count(|counts| counts.visited),
        count(|counts| counts.samples),
    ];
    let alone = alone(&Field::from_facts(&facts, config), level, threads, counts);
    println!("| part | ms a step | its kernel alone | of the part |\n|---|---|---|---|");
    let (mut parts_s, mut kernels_s) = (0.0, 0.0);
    for (index, (part, kernel_s)) in PARTS.into_iter().zip(alone).enumerate() {
        let part_s = median(&|block| block.parts_s[index]);
        parts_s += part_s;
        kernels_s += kernel_s.unwrap_or(0.0);
        let kernel = kernel_s.map_or_else(
            || "|".to_owned(),
            |kernel_s| format!("{:.3} | {:.0} %", 1e3 * kernel_s, 100.0 * kernel_s / part_s),
        );
        println!("| {part:?} | {:.3} | {kernel} |", 1e3 * part_s);
    }
    let whole_s = median(&|block| block.wall_s);
    println!("| the rest | {:.3} | | |", 1e3 * (whole_s - parts_s));
    println!(
        "| all | {:.3} | {:.3} | {:.0} % |",
        1e3 * whole_s,
        1e3 * kernels_s,
        100.0 * kernels_s / whole_s
    );
    let [rays, visited, samples] = counts;
    println!(
        "\n{rays:.0} rays, {visited:.0} samples visited, {samples:.0} trained ({:.1} a ray); {:.1} % of \
         the cells occupied; {:.2} M samples/s",
        samples / rays,
        100.0 * facts.occupied_share,
        samples / whole_s / 1e6
    );
}

/// Returns the mean of some steps.
fn mean(steps: Vec<StepProfile>) -> StepProfile {
    let count = steps.len() as f64;
    let sum = |number: fn(&Counts) -> u64| {
        steps.iter().map(|step| number(&step.counts)).sum::<u64>() / count as u64
    };
    StepProfile {
        counts: Counts {
            rays: sum(|counts| counts.rays),
            visited: sum(|counts| counts.visited),
            samples: sum(|counts| counts.samples),
        },
        parts_s: std::array::from_fn(|part| steps.iter().map(|step| step.parts_s[part]).sum::<f64>() / count),
        wall_s: steps.iter().map(|step| step.wall_s).sum::<f64>() / count,
    }
}

/// Returns the seconds of the kernel of each part alone for these rays, visited samples and trained samples.
/// `None` if a part has no kernel of its own.
fn alone(
    field: &Field,
    level: InstructionSet,
    threads: &Threads,
    [rays, visited, samples]: [f64; 3],
) -> [Option<f64>; PARTS.len()] {
    let limits = field.limits(threads);
    let rates = work::KERNELS.map(|(name, run)| (name, 1e6 * run(field, level, threads, &limits, 1.0)[0]));
    let numbers = field.numbers();
    let seconds = |name: &str, count: f64| {
        let rate = rates.iter().find(|(kernel, _)| *kernel == name);
        count / rate.expect("a kernel of this name").1
    };
    let backward = |net: &str, count: f64| {
        seconds(&format!("{net} forward and backward"), count) - seconds(&format!("{net} forward"), count)
    };
    PARTS.map(|part| {
        Some(match part {
            Part::March => seconds("march (rays)", rays),
            Part::Lookup => seconds("encode", visited),
            Part::Density => seconds("density forward", visited),
            Part::Colour => seconds("colour forward", samples),
            Part::Losses => seconds("composite forward and backward", samples),
            Part::ColourBackward => backward("colour", samples),
            Part::DensityBackward => backward("density", samples),
            Part::Scatter => seconds("scatter", samples),
            Part::Adam => seconds("adam (numbers)", numbers),
            _ => return None,
        })
    })
}
