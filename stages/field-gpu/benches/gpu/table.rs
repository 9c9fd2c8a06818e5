//! Measurements as Markdown, with the ceilings of the device and the model's expectation for a card.

use std::fmt::Write as _;

use super::measured::{Kernel, Kernels, View, ViewShape};
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
        "a step: {:.3} ms by timestamps, {:.3} ms by the clock without, {:.3} ms by the model without updates, {:.2} M samples/s",
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

/// Returns the model's expectation for a card: a step of two batches, and pictures of 640 x 480 pixels.
pub fn expected() -> String {
    let [small, large] = [15, 18].map(|log2| model::lines(&model::middle(f64::from(1 << log2))));
    let mut text =
        "| kernel | 2^15 samples, µs | 2^18, µs | 2^18 is bound by |\n|---|---|---|---|\n".to_owned();
    for (small, large) in small.iter().zip(&large) {
        let _ = writeln!(
            text,
            "| {} | {:.0} | {:.0} | {} |",
            large.kernel,
            1e6 * small.seconds,
            1e6 * large.seconds,
            large.bound
        );
    }
    let sum = |lines: &[model::Line]| lines.iter().map(|line| line.seconds).sum::<f64>();
    let [small_s, large_s] = [sum(&small), sum(&large)];
    let _ = writeln!(
        text,
        "| **sum** | **{:.0}** | **{:.0}** | |\n| **M samples/s** | **{:.0}** | **{:.0}** | |\n",
        1e6 * small_s,
        1e6 * large_s,
        f64::from(1 << 15) / small_s * 1e-6,
        f64::from(1 << 18) / large_s * 1e-6
    );
    for shape in model::pictures() {
        let (text_of, ms) = picture(&shape, 640.0 * 480.0);
        let [_, width] = shape.density[0];
        let _ = writeln!(
            text,
            "640 x 480 pixels, {} levels, networks {width} wide: {ms:.1} ms\n\n{text_of}",
            shape.levels
        );
    }
    text
}

/// Returns the lines of a picture by the model, and their sum in milliseconds.
fn picture(shape: &ViewShape, pixels: f64) -> (String, f64) {
    let mut text = "| part | model, ms | bound by |\n|---|---|---|\n".to_owned();
    let lines = model::view(shape, pixels);
    for line in &lines {
        let _ = writeln!(
            text,
            "| {} | {:.3} | {} |",
            line.kernel,
            1e3 * line.seconds,
            line.bound
        );
    }
    (text, lines.iter().map(|line| 1e3 * line.seconds).sum())
}

/// Returns the times of a picture, and what the model expects of a card.
pub fn view(found: &View) -> String {
    let ms = |at: usize| 1e3 * found.seconds.get(at).copied().unwrap_or(f64::NAN);
    let last = found.seconds.len().saturating_sub(1);
    let pixels = f64::from(found.width) * f64::from(found.height);
    let (lines, model_ms) = picture(&found.shape, pixels);
    format!(
        "### A picture of {} x {} pixels, {}\n\n{:.1} / {:.1} / {:.1} ms (min / median / max of {}), {:.1} ms by the model:\n\n{lines}",
        found.width,
        found.height,
        found.field,
        ms(0),
        ms(last / 2),
        ms(last),
        found.seconds.len(),
        model_ms
    )
}
