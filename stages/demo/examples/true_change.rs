//! Tells what changes on the built-in Mars, as a comparison of two times should find it:
//! `cargo run --release -p marf-demo --example true_change -- 1 8`.

use std::error::Error;
use std::io::Write;

use marf_demo::{Demo, DemoOptions};

/// Distance between the places that are looked at, metres.
const STEP_M: f64 = 0.01;
/// Half the side of the square around the change, metres.
const REACH_M: f64 = 3.0;
/// What is looked at, metres in the site.
const MIDDLE_M: (f64, f64) = (6.0, 2.5);
/// Least change of height, metres: what rises by less is sand that leans on the stone.
const LEAST_M: f64 = 0.03;
/// Least change of red over green, as a factor: shade on the sand around the stone changes less.
const LEAST_FACTOR: f64 = 1.03;

/// Tells whether two lights have different colours.
fn is_other(old: [f64; 3], new: [f64; 3]) -> bool {
    let factor = (new[0] / new[1]) / (old[0] / old[1]);
    !(1.0 / LEAST_FACTOR..LEAST_FACTOR).contains(&factor)
}

fn main() -> Result<(), Box<dyn Error>> {
    let sols: Vec<u32> = std::env::args()
        .skip(1)
        .map(|sol| sol.parse())
        .collect::<Result<_, _>>()?;
    let [before, after] = sols.as_slice() else {
        return Err("name a sol before the change and the first after it".into());
    };
    let demo = Demo::new(DemoOptions::default())?.with_change(*after)?;
    let steps = (REACH_M / STEP_M) as i32;
    // Cells, and the sums of x, y and the change of height.
    let mut found = [(0_u32, [0.0; 3]); 3];
    for (row, column) in (-steps..steps).flat_map(|row| (-steps..steps).map(move |column| (row, column))) {
        let (x, y) = (
            MIDDLE_M.0 + f64::from(row) * STEP_M,
            MIDDLE_M.1 + f64::from(column) * STEP_M,
        );
        let (old, new) = (demo.from_above(*before, x, y)?, demo.from_above(*after, x, y)?);
        let rise = new.height_m - old.height_m;
        let kind = match old.is_shaded == new.is_shaded {
            _ if rise.abs() > LEAST_M => 0,
            true if is_other(old.light, new.light) => 1,
            false => 2,
            true => continue,
        };
        let (count, sums) = &mut found[kind];
        *count += 1;
        sums.iter_mut()
            .zip([x, y, rise])
            .for_each(|(sum, value)| *sum += value);
    }
    for (name, (count, sums)) in ["higher", "colour", "shadow"].iter().zip(found) {
        let mean = sums.map(|sum| sum / f64::from(count));
        writeln!(
            std::io::stdout(),
            "{name}: {:.3} m2 at x {:.2}, y {:.2}, by {:.3} m",
            f64::from(count) * STEP_M * STEP_M,
            mean[0],
            mean[1],
            mean[2]
        )?;
    }
    Ok(())
}
