//! What this machine can do at most: multiply-adds, streams, and random rows of a table.

use std::hint::black_box;

use marf_field::bench::simd::{Block, Isa, Kernel, LANES, Level};
use rayon::prelude::*;

use crate::clock::{Threads, best};

/// 16 or 6 chains of fused multiply-adds: enough to hide 4 cycles on two pipes.
struct MultiplyAdds(usize);

impl Kernel for MultiplyAdds {
    type Output = f32;

    #[inline(always)]
    fn run<I: Isa>(self, isa: I) -> f32 {
        if I::WIDE {
            chains::<I, 16>(isa, self.0)
        } else {
            chains::<I, 6>(isa, self.0)
        }
    }
}

#[inline(always)]
fn chains<I: Isa, const N: usize>(isa: I, rounds: usize) -> f32 {
    let (factor, add) = (isa.splat(black_box(0.999)), isa.splat(black_box(0.001)));
    let mut sums = [isa.splat(1.0); N];
    for _ in 0..rounds {
        for sum in &mut sums {
            *sum = isa.mul_add(*sum, factor, add);
        }
    }
    let mut block = Block::default();
    let mut total = 0.0;
    for sum in sums {
        isa.store(sum, &mut block);
        total += block.0.iter().sum::<f32>();
    }
    total
}

/// Fused multiply-adds a second times 2, all threads, in 1e9.
pub fn gflops(level: Level, threads: &Threads) -> f64 {
    let plain = format!("{level:?}").starts_with("Plain");
    let rounds = if plain { 2_000 } else { 200_000 };
    let chains = if format!("{level:?}").starts_with("Avx512") {
        16
    } else {
        6
    };
    let time_s = threads.run(|count| {
        best(|| {
            (0..count).into_par_iter().for_each(|_| {
                black_box(level.run(MultiplyAdds(rounds)));
            })
        })
    });
    (threads.count * rounds * chains * LANES * 2) as f64 / time_s / 1e9
}

/// Bytes a second of a = b + 3 c over 3 x 64 MB, three streams counted, in 1e9.
pub fn triad(threads: &Threads) -> f64 {
    let n = 16 << 20;
    let (mut a, b, c) = (vec![0_f32; n], vec![1_f32; n], vec![2_f32; n]);
    let time_s = threads.run(|count| {
        let chunk = n / count;
        best(|| {
            let parts = a
                .par_chunks_mut(chunk)
                .zip(b.par_chunks(chunk))
                .zip(c.par_chunks(chunk));
            parts.for_each(|((a, b), c)| {
                for ((a, b), c) in a.iter_mut().zip(b).zip(c) {
                    *a = b + 3.0 * c;
                }
            });
        })
    });
    12.0 * n as f64 / time_s / 1e9
}

/// Random rows of F numbers a second, in 1e6: read, and added to. Each thread has its own table when it writes.
pub fn random<const F: usize>(rows: usize, threads: &Threads) -> [f64; 2] {
    let draws = 1 << 20;
    let mut state = 7_u64;
    let indices: Vec<u32> = (0..draws)
        .map(|_| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            ((state >> 33) % rows as u64) as u32
        })
        .collect();
    let table = vec![[1_f32; F]; rows];
    let read_s = threads.run(|count| {
        best(|| {
            (0..count).into_par_iter().for_each(|_| {
                let mut sum = [0.0_f32; F];
                for index in &indices {
                    let row = &table[*index as usize];
                    for f in 0..F {
                        sum[f] += row[f];
                    }
                }
                black_box(sum);
            })
        })
    });
    let mut tables = vec![table; threads.count];
    let write_s = threads.run(|_| {
        best(|| {
            tables.par_iter_mut().for_each(|table| {
                for index in &indices {
                    let row = &mut table[*index as usize];
                    for value in row {
                        *value += 1.0;
                    }
                }
            })
        })
    });
    [read_s, write_s].map(|time_s| (threads.count * draws) as f64 / time_s / 1e6)
}
