//! What this machine can do at most: multiply-adds, streams, and random rows of a table.

use std::hint::black_box;

use marf_field::cpu::simd::{Block, InstructionSet, Isa, Kernel, LANES, Run};

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
pub fn gflops(level: InstructionSet, threads: &Threads) -> f64 {
    let (rounds, chains) = match level {
        InstructionSet::Plain(_) => (200, 6),
        _ if format!("{level:?}").starts_with("Avx512") => (20_000, 16),
        _ => (20_000, 6),
    };
    let rate = threads.rate(|_| {
        best(|| {
            black_box(level.run(MultiplyAdds(rounds)));
        })
    });
    rate * (rounds * chains * LANES * 2) as f64 / 1e9
}

/// Bytes a second of a = b + 3 c, three streams of 16 MB a thread counted, in 1e9.
pub fn triad(threads: &Threads) -> f64 {
    let n = 4 << 20;
    let rate = threads.rate(|_| {
        let (mut a, b, c) = (vec![0_f32; n], vec![1_f32; n], vec![2_f32; n]);
        best(|| {
            for ((a, b), c) in a.iter_mut().zip(&b).zip(&c) {
                *a = b + 3.0 * c;
            }
            black_box(&mut a);
        })
    });
    rate * 12.0 * n as f64 / 1e9
}

/// Random rows of F numbers a second, in 1e6: read, and added to. Each thread has its own table.
pub fn random<const F: usize>(rows: usize, threads: &Threads) -> [f64; 2] {
    let draws = 1 << 17;
    let mut state = 7_u64;
    let indices: Vec<u32> = (0..draws)
        .map(|_| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            ((state >> 33) % rows as u64) as u32
        })
        .collect();
    let read = threads.rate(|_| {
        let table = vec![[1_f32; F]; rows];
        best(|| {
            // Eight sums: one would wait for itself.
            let mut sums = [[0_f32; F]; 8];
            for eight in indices.as_chunks::<8>().0 {
                for (index, sum) in eight.iter().zip(&mut sums) {
                    let row = &table[*index as usize];
                    for f in 0..F {
                        sum[f] += row[f];
                    }
                }
            }
            black_box(sums);
        })
    });
    let added = threads.rate(|_| {
        let mut table = vec![[1_f32; F]; rows];
        best(|| {
            for index in &indices {
                for value in &mut table[*index as usize] {
                    *value += 1.0;
                }
            }
            black_box(&mut table);
        })
    });
    [read, added].map(|rate| rate * draws as f64 / 1e6)
}
