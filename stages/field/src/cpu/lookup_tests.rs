//! Lookups and scatters against their definition, in f64.

use super::encode::{Lookup, Points, Scatter, Shape};
use super::simd::{Block, InstructionSet, LANES, Run, Stripe, flat};
use super::twins::{bits, blocks, numbers};

/// The contract of [`Lookup`] for one point, corner by corner.
fn mean_of_corners(shape: &Shape, table: &[f32], point: [f32; 3]) -> [f32; 4] {
    let side = shape.resolution + 1;
    let mut sums = [[0.0_f32; 4]; 2];
    let q = point.map(|x| x.clamp(0.0, 1.0) * shape.resolution as f32);
    let below = q.map(|q| (q as u32).min(shape.resolution - 1));
    let share = [0, 1, 2].map(|axis| q[axis] - below[axis] as f32);
    let pick = |axis: usize, above: usize| [1.0 - share[axis], share[axis]][above];
    for across in 0..4 {
        let weight = pick(1, across & 1) * pick(2, across >> 1);
        for dx in 0..2 {
            let [x, y, z] = [dx as u32, across as u32 & 1, across as u32 >> 1];
            let [x, y, z] = [below[0] + x, below[1] + y, below[2] + z];
            let entry = if shape.dense {
                x + side * (y + side * z)
            } else {
                let hash = x ^ y.wrapping_mul(2_654_435_761) ^ z.wrapping_mul(805_459_861);
                hash % shape.entries
            };
            for f in 0..4 {
                sums[dx][f] = weight.mul_add(table[entry as usize * 4 + f], sums[dx][f]);
            }
        }
    }
    [0, 1, 2, 3].map(|f| pick(0, 0).mul_add(sums[0][f], pick(0, 1) * sums[1][f]))
}

#[test]
fn a_lookup_in_a_table_of_any_size_is_the_mean_of_its_corners() {
    // 2^9 entries stay in the cache, 2^17 of 16 bytes are prefetched. Both dense and hashed. 16 points are
    // fewer than the prefetched blocks.
    for (resolution, log2_table) in [(6, 9), (70, 9), (50, 17), (600, 17)] {
        for count in [0, 16, 64, 160] {
            let axes = [1, 2, 3].map(|axis| numbers(count, axis));
            let axes = axes.map(|axis| axis.iter().map(|x| x * 0.6 + 0.5).collect::<Vec<f32>>());
            let shape = Shape::new(resolution, log2_table);
            let table = numbers(shape.entries as usize * 4, 7);
            for level in InstructionSet::all() {
                let mut rows = vec![Block::default(); count];
                level.run(Lookup::<4> {
                    shape,
                    table: &table,
                    points: Points {
                        x: &axes[0],
                        y: &axes[1],
                        z: &axes[2],
                    },
                    to: Stripe::cut(&mut rows, 1, 4).remove(2),
                });
                for (point, row) in rows.iter().enumerate() {
                    let at = [0, 1, 2].map(|axis| axes[axis][point]);
                    let found = [row.0[8], row.0[9], row.0[10], row.0[11]];
                    assert_eq!(
                        found,
                        mean_of_corners(&shape, &table, at),
                        "{level:?} {shape:?} {at:?}"
                    );
                }
            }
        }
    }
}

#[test]
fn points_outside_the_box_or_nan_look_up_its_border() {
    let shape = Shape::new(37, 9);
    let table = numbers(shape.entries as usize * 4, 7);
    let outside = [
        f32::NAN,
        -0.0,
        -1.0,
        f32::NEG_INFINITY,
        1.0,
        1.5,
        f32::INFINITY,
        1e30,
    ];
    let border = [0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0];
    let look = |level: InstructionSet, x: [f32; 8]| {
        let (mut rows, x) = (blocks(16, 8), [x, x].concat());
        let (y, z) = (&x.clone()[..], &[0.3; 16][..]);
        level.run(Lookup::<4> {
            shape,
            table: &table,
            points: Points { x: &x, y, z },
            to: Stripe::cut(&mut rows, 1, 4).remove(0),
        });
        bits(flat(&rows))
    };
    for level in InstructionSet::all() {
        assert_eq!(look(level, outside), look(level, border), "{level:?}");
    }
}

#[test]
fn a_scatter_in_a_large_table_is_the_transpose_of_its_lookup() {
    // <scatter(g), t> = <g, lookup(t)>, in f64. 2^17 entries of 16 bytes are prefetched.
    let shape = Shape::new(600, 17);
    let axes = [1, 2, 3].map(|axis| numbers(160, axis));
    let axes = axes.map(|axis| axis.iter().map(|x| x * 0.5 + 0.5).collect::<Vec<f32>>());
    let points = Points {
        x: &axes[0],
        y: &axes[1],
        z: &axes[2],
    };
    let (table, slopes) = (numbers(shape.entries as usize * 4, 7), blocks(160, 9));
    let mut found = Vec::new();
    for level in InstructionSet::all() {
        let (mut rows, mut gradient) = (vec![Block::default(); 160], vec![0.0; table.len()]);
        let (width, stride, first) = (1, LANES, 4);
        level.run(Lookup::<4> {
            shape,
            table: &table,
            points,
            to: Stripe::cut(&mut rows, width, 4).remove(1),
        });
        level.run(Scatter::<4> {
            shape,
            gradient: &mut gradient,
            points,
            rows: &slopes,
            stride,
            first,
        });
        let dot = |a: &[f32], b: &[f32]| -> f64 {
            a.iter().zip(b).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum()
        };
        let apart = dot(&gradient, &table) - dot(flat(&slopes), flat(&rows));
        assert!(apart.abs() < 1e-4, "{level:?}: {apart}");
        found.push(bits(&gradient));
    }
    assert!(found.iter().all(|gradient| *gradient == found[0]));
}
