//! Expected time of every kernel of a step on a card: amounts counted from the kernels' texts over rates of
//! the card, line by line. The first run on a card can refute each line by itself.
//!
//! No line is fitted to a measurement. Amounts are those of the kernels as they are, repeated reads counted
//! where no cache is expected to hold them. Rates are those of an H100-class card from its data sheet, cut to
//! what plain kernels reach.

use marf_field_gpu::Shape;

use super::measured::ViewShape;

/// Bytes a second of the card's memory: 3.35e12 on paper (H100 SXM).
const MEMORY: f64 = 3.0e12;
/// Bytes a second of its second cache, sectors of 32 bytes.
const CACHE: f64 = 5.5e12;
/// 64-bit integer additions a second that reach entries of the second cache: one a sector and clock in 24 of its slices.
const ATOMICS: f64 = 44e9;
/// Seconds of one step of a thread that waits for each of its reads: about 300 clocks of 1.75 GHz.
const WAIT_S: f64 = 0.17e-6;
/// Seconds between two dispatches that see each other's writes.
const GAP_S: f64 = 5e-6;
/// Seconds of a read of few bytes back to the host, the wait for what was submitted before counted apart.
const READ_S: f64 = 60e-6;
/// Bytes a second between card and host.
const LINK: f64 = 20e9;
/// Rays of a picture at once on a card.
const RAYS_AT_ONCE: f64 = 65_536.0;
/// Rounds of a picture, of 8, 16, 32 and 64 samples a ray at most. Reads between them, and those at the end.
const ROUNDS: f64 = 4.0;
const READS: f64 = 4.0;
/// Samples a pixel of a trained field: those of the first two rounds for every ray that meets matter.
const SAMPLES_A_PIXEL: f64 = 24.0;
/// Operations a second that fused networks reach, two a multiply-add: a third of 60e12 on paper, weights and activations from
/// workgroup memory.
const ARITHMETIC: f64 = 20e12;
/// Workgroups of the pass back, each with a gradient of its own: six for each of 132 multiprocessors.
const GROUPS_BACK: f64 = 792.0;
/// Threads of the largest workgroups.
const GROUP: f64 = 256.0;
/// Operations of a step along a ray: its place in the box and its cell's bit.
const STEP: f64 = 40.0;
/// Reads of a thread that do not wait for each other, at once.
const IN_FLIGHT: f64 = 8.0;
/// Share of the corners of samples that are added one by one: eight samples of a ray merge those that they share (counted on first steps).
const APART: f64 = 0.44;
/// Bytes of a sector of the second cache.
const SECTOR: f64 = 32.0;

/// A line of the model.
#[derive(Debug, Clone, PartialEq)]
pub struct Line {
    /// The kernel.
    pub kernel: &'static str,
    /// Seconds a step, the gaps before its dispatches among them.
    pub seconds: f64,
    /// What binds it.
    pub bound: String,
}

/// What a kernel needs in a step.
struct Need {
    kernel: &'static str,
    calls: f64,
    amount: f64,
    bottleneck: Bottleneck,
}

/// What binds a kernel.
#[derive(Clone, Copy)]
enum Bottleneck {
    Memory,
    Cache,
    Atomics,
    Arithmetic,
    Waits,
}

impl Need {
    fn line(&self) -> Line {
        let (rate, unit, name) = match self.bottleneck {
            Bottleneck::Memory => (MEMORY, 1e-6, "MB of memory"),
            Bottleneck::Cache => (CACHE, 1e-6, "MB of the second cache"),
            Bottleneck::Atomics => (ATOMICS, 1e-6, "M atomics"),
            Bottleneck::Arithmetic => (ARITHMETIC, 1e-9, "GFLOP"),
            Bottleneck::Waits => (1.0 / WAIT_S, 1.0, "reads one after the other"),
        };
        Line {
            kernel: self.kernel,
            seconds: self.amount / rate + self.calls * GAP_S,
            bound: match self.calls {
                0.0 => format!("{:.1} {name}", self.amount * unit),
                calls => format!("{:.1} {name}, {calls:.0} gaps", self.amount * unit),
            },
        }
    }
}

/// Returns the lines of a step of this shape, updates of the occupancy apart.
pub fn lines(shape: &Shape) -> Vec<Line> {
    samples(shape)
        .into_iter()
        .chain(networks(shape))
        .chain(light(shape))
        .chain(tables(shape))
        .map(|need| need.line())
        .collect()
}

fn need(kernel: &'static str, calls: f64, amount: f64, bottleneck: Bottleneck) -> Need {
    Need {
        kernel,
        calls,
        amount,
        bottleneck,
    }
}

/// Rays, their samples, and the choice of those that show.
fn samples(shape: &Shape) -> Vec<Need> {
    let Shape {
        rays, visited, kept, ..
    } = *shape;
    // A ray reads camera and pixel and writes 56 bytes.
    let drawn = rays * (56.0 + 2.0 * SECTOR);
    let looked_up = visited * (shape.levels * 8) as f64 * SECTOR;
    let runs = (rays / GROUP).ceil();
    vec![
        need("rays", 1.0, drawn, Bottleneck::Memory),
        // Count and write take all steps of all rays, which no thread has alone.
        need(
            "march",
            2.0,
            2.0 * rays * shape.steps_a_ray * STEP,
            Bottleneck::Arithmetic,
        ),
        // The threads of a workgroup read the numbers of all rays in front of theirs.
        need("scan", 2.0, 2.0 * runs / IN_FLIGHT, Bottleneck::Waits),
        need("hash_encode", 1.0, looked_up, Bottleneck::Cache),
        need("kept", 1.0, 4.0 * visited + 4.0 * kept, Bottleneck::Memory),
    ]
}

/// Returns the operations of layers for a sample.
fn products(layers: &[[usize; 2]]) -> f64 {
    let numbers = layers.iter().map(|[inputs, outputs]| inputs * outputs);
    2.0 * numbers.sum::<usize>() as f64
}

/// Both networks forward and back, each in one dispatch: activations of a tile stay in workgroup memory.
fn networks(shape: &Shape) -> Vec<Need> {
    let Shape { visited, kept, .. } = *shape;
    let (density, color) = (products(&shape.density), products(&shape.color));
    let numbers = (density + color) / 2.0 + 64.0;
    // Back: the layers once more, the slopes of their inputs, the gradients of their weights.
    let back = 3.0 * (density + color);
    vec![
        need("density", 1.0, visited * density, Bottleneck::Arithmetic),
        need("shade", 1.0, kept * color, Bottleneck::Arithmetic),
        need("back", 1.0, kept * back, Bottleneck::Arithmetic),
        need("sum", 1.0, 4.0 * numbers * GROUPS_BACK, Bottleneck::Memory),
        need("adam_net", 1.0, 48.0 * numbers, Bottleneck::Memory),
    ]
}

/// Opacities, colours and losses: a thread a ray reads its samples one after the other.
fn light(shape: &Shape) -> Vec<Need> {
    let Shape {
        rays, visited, kept, ..
    } = *shape;
    let a_ray = |samples: f64| (samples / rays.max(1.0)).max(1.0);
    let runs = (rays / GROUP).ceil();
    vec![
        need("opacity", 1.0, a_ray(visited), Bottleneck::Waits),
        need("compare", 1.0, a_ray(kept), Bottleneck::Waits),
        need("spread", 1.0, 2.0 * a_ray(kept), Bottleneck::Waits),
        need("totals", 1.0, runs, Bottleneck::Waits),
    ]
}

/// Gradients into tables, and their steps.
fn tables(shape: &Shape) -> Vec<Need> {
    let row = 4.0 * shape.features as f64;
    let entries = 4.0 * shape.table_numbers as f64;
    let words = shape.kept * (shape.levels * 8 * shape.features / 2) as f64;
    vec![
        need("scatter_packed", 1.0, words * APART, Bottleneck::Atomics),
        need("peak", 1.0, entries, Bottleneck::Memory),
        need("rescale", 1.0, shape.levels as f64, Bottleneck::Waits),
        need(
            "adam_table",
            1.0,
            // Every fourth step the averages follow: they are read and written, and so are all weights.
            entries + shape.rows_moved * (7.0 * row + 8.0) + 0.25 * 3.0 * entries,
            Bottleneck::Memory,
        ),
    ]
}

/// Returns the lines of a picture of `pixels` pixels: every line of all its rounds.
pub fn view(shape: &ViewShape, pixels: f64) -> Vec<Line> {
    let batches = (pixels / RAYS_AT_ONCE).ceil();
    let samples = pixels * SAMPLES_A_PIXEL;
    let operations = products(&shape.density) + products(&shape.color);
    // Features and latent are written and read once, colours written.
    let moved = 4 * (2 * (shape.density[0][0] + 16) + 3);
    let dispatches = 12.0;
    let rounds = ROUNDS * batches;
    let line = |kernel, seconds: f64, bound: String| Line {
        kernel,
        seconds,
        bound,
    };
    let steps = 2.0 * pixels * shape.steps_a_ray;
    let back = 20.0 * pixels;
    let mut lines: Vec<Line> = [
        need("march", 0.0, steps * STEP, Bottleneck::Arithmetic),
        need(
            "hash_encode",
            0.0,
            samples * (shape.levels * 8) as f64 * SECTOR,
            Bottleneck::Cache,
        ),
        need(
            "density, shade",
            0.0,
            samples * operations,
            Bottleneck::Arithmetic,
        ),
        need(
            "features, light, colour",
            0.0,
            samples * moved as f64,
            Bottleneck::Memory,
        ),
    ]
    .iter()
    .map(Need::line)
    .collect();
    lines.push(line(
        "gaps",
        rounds * dispatches * GAP_S,
        format!("{rounds:.0} rounds of {dispatches:.0} dispatches"),
    ));
    lines.push(line(
        "reads",
        batches * READS * READ_S + back / LINK,
        format!("{:.0} reads, {:.1} MB to the host", batches * READS, back * 1e-6),
    ));
    lines
}

/// Returns the shape of a step of the largest field of this benchmark midway through a training on photos:
/// ten samples a ray, all of which show.
pub fn middle(samples: f64) -> Shape {
    // 5 levels are dense. Of the others, the touched entries are those that one of 8 corners a sample falls
    // on.
    let (dense, hashed, entries) = (332_000.0, 11.0, f64::from(1 << 19));
    let touched = |entries: f64| entries * (1.0 - (-8.0 * samples / entries).exp());
    Shape {
        rays: samples / 10.0,
        visited: samples,
        kept: samples,
        steps_a_ray: 373.0,
        photos: 100,
        levels: 16,
        features: 2,
        table_numbers: 2 * (dense + hashed * entries) as usize,
        rows_moved: touched(dense) + hashed * touched(entries),
        density: vec![[32, 64], [64, 16]],
        color: vec![[32, 64], [64, 64], [64, 16]],
    }
}

/// Returns the shapes of pictures of both fields of this benchmark after four halvings of the steps along rays.
pub fn pictures() -> [ViewShape; 2] {
    [
        ViewShape {
            steps_a_ray: 1_480.0,
            levels: 8,
            density: vec![[32, 32], [32, 16]],
            color: vec![[32, 32], [32, 16]],
        },
        ViewShape {
            steps_a_ray: 1_480.0,
            levels: 16,
            density: vec![[32, 64], [64, 16]],
            color: vec![[32, 64], [64, 64], [64, 16]],
        },
    ]
}
