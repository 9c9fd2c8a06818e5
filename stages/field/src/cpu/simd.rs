//! 16 lanes of f32 on AVX-512, AVX2 and plain Rust: with `stages/numeric` the only place with `unsafe`.
//!
//! A token of `marf-numeric` proves that this machine has the instructions, hence the methods that need them
//! are safe. A [`Kernel`] is compiled once a set. All its functions are `#[inline(always)]`, so that its
//! plain loops are compiled with the set's instructions too. Every set rounds every lane alike (IEEE 754
//! fused multiply-add), so the bits are the same.
#![allow(unsafe_code)]

mod isa;
mod plain;
mod sums;
mod table;
#[cfg(target_arch = "x86_64")]
mod x86;

pub use isa::{Block, Isa, Kernel, LANES, Run, Stripe, flat, flat_mut};
pub use marf_numeric::{InstructionSet, Plain};
pub use sums::{Strided, add_products};
pub use table::{Checked, CheckedMut, Indices, Table, TableMut, prefetch_all};
