//! What was measured as Markdown, beside the ceilings of the device and what the model expects of a card.

use std::fmt::Write as _;

use super::measured::{Kernel, Kernels, View};
use super::model;

/// Returns the kernels of a training.
pub fn kernels(found: &Kernels) -> String {
    let mut text = format!(
        "### {}, {} samples a batch\n\n| kernel | calls a step | ms a step | share | rate | of the ceiling | model, ms | bound by |\n|---|---|---|---|---|---|---|---|\n",
        found.field, found.batch_samples
    );
    let whole = found.step_s();
    let mut expected = model::lines(&found.shape);
    for kernel in &found.kernels {
        let place = expected.iter().position(|line| line.kernel == kernel.name);
        let line = place.map(|place| expected.remove(place));
        let model = line.map_or_else(
            || " | ".to_owned(),
            |line| format!("{:.3} | {}", 1e3 * line.seconds, line.bound),
        );
        let _ = writeln!(
            text,
            "| {} | {:.1} | {:.3} | {:.1} % | {} | {model} |",
            kernel.name,
            kernel.calls,
            1e3 * kernel.seconds,
            100.0 * kernel.seconds / whole,
            rate(kernel, found)
        );
    }
    for line in expected {
        let (name, ms) = (line.kernel, 1e3 * line.seconds);
        let _ = writeln!(text, "| {name} | - | - | - | | | {ms:.3} | {} |", line.bound);
    }
    let model_s: f64 = model::lines(&found.shape).iter().map(|line| line.seconds).sum();
    let _ = writeln!(
        text,
        "| updates of the occupancy | | {:.3} | {:.1} % | | | | |",
        1e3 * found.update_s,
        100.0 * found.update_s / whole
    );
    let shape = &found.shape;
    let _ = writeln!(
        text,
        "\nof a step that was timed: {:.0} rays, {:.0} samples visited, {:.0} trained, {:.0} steps a ray",
        shape.rays, shape.visited, shape.kept, shape.steps_a_ray
    );
    let _ = writeln!(
        text,
        "a step: {:.3} ms by timestamps, {:.3} ms by the clock without, {:.3} ms by the model without updates; {:.2} M samples/s",
        1e3 * whole,
        1e3 * found.clock_s,
        1e3 * model_s,
        found.samples_per_s / 1e6
    );
    text
}

fn rate(kernel: &Kernel, found: &Kernels) -> String {
    let (amount, unit, ceiling) = match (kernel.bytes, kernel.operations) {
        (Some(bytes), _) => (bytes, "GB/s", found.copy_bytes_per_s),
        (None, Some(operations)) => (operations, "GFLOP/s", found.operations_per_s),
        (None, None) => return "| ".to_owned(),
    };
    let rate = amount / kernel.seconds;
    format!("{:.1} {unit} | {:.0} %", rate / 1e9, 100.0 * rate / ceiling)
}

/// Returns the times of a picture.
pub fn view(found: &View) -> String {
    let ms = |at: usize| 1e3 * found.seconds.get(at).copied().unwrap_or(f64::NAN);
    let last = found.seconds.len().saturating_sub(1);
    format!(
        "a picture of {} x {} pixels, {}: {:.1} / {:.1} / {:.1} ms (min / median / max of {})\n",
        found.width,
        found.height,
        found.field,
        ms(0),
        ms(last / 2),
        ms(last),
        found.seconds.len()
    )
}
