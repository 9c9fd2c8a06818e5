//! Every kernel against the ceiling that binds it, measured in the same run: `cargo bench -p marf-field --bench kernels`.
//!
//! Two fields: `fixed` is 16 levels x 2 features, T = 2^19, networks 64 wide. `default` is 8 x 4, T = 2^15, 32 wide.
//! Points are along rays, 64 a ray. One line a kernel, instruction set and number of threads. `[KERNEL]` as
//! argument runs only those whose name contains it.
#![allow(clippy::print_stdout, clippy::expect_used, missing_docs)]

mod ceilings;
#[expect(dead_code, reason = "shared with the bench of whole steps")]
mod clock;
mod data;
#[expect(dead_code, reason = "shared with the bench of whole steps")]
mod work;

use clock::Threads;
use marf_field::cpu::simd::InstructionSet;
use work::Field;

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    if !arguments.iter().any(|argument| argument == "--bench") {
        return; // `cargo test --all-targets` builds and starts it, too
    }
    let wanted = arguments.iter().find(|argument| !argument.starts_with('-'));
    let wanted = |name: &str| wanted.is_none_or(|wanted| name.contains(wanted.as_str()));
    for field in [Field::fixed(), Field::default()] {
        for count in [1, 2] {
            let threads = Threads::new(count);
            println!("\n{} field, {count} thread(s)", field.name);
            let limits = field.limits(&threads);
            println!("{limits}");
            println!("| kernel | set | M/s | share | ceiling |\n|---|---|---|---|---|");
            for level in InstructionSet::all() {
                let peak = ceilings::gflops(level, &threads);
                println!("| multiply-add | {} | {peak:.0} GF/s | | |", set(level));
                for (name, run) in work::KERNELS {
                    if wanted(name) {
                        let [rate, most] = run(&field, level, &threads, &limits, peak);
                        let (share, kind) = (100.0 * rate / most, limits.kind(name));
                        println!(
                            "| {name} | {} | {rate:.2} | {share:.0} % | {kind}: {most:.1} |",
                            set(level)
                        );
                    }
                }
            }
        }
    }
}

/// The instruction set's name without its token.
fn set(level: InstructionSet) -> String {
    let name = format!("{level:?}");
    name.split('(').next().unwrap_or_default().to_owned()
}
