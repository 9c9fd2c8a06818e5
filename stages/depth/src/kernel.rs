//! Loops that are compiled once for each instruction set.

use marf_numeric::InstructionSet;

/// A computation that is compiled once for each instruction set.
///
/// `run` and all it calls should be `#[inline(always)]`, so that its loops over independent lanes are compiled with
/// the instructions of the set. Code that is not inlined is slower, never different.
pub(crate) trait Kernel {
    /// What the computation returns.
    type Output;
    /// Computes.
    fn run(self) -> Self::Output;
}

/// Runs a kernel on an instruction set.
pub(crate) fn run<K: Kernel>(set: InstructionSet, kernel: K) -> K::Output {
    set.dispatch(Dispatched(kernel))
}

marf_numeric::dispatch_kernels!(Kernel, |kernel, _| kernel.run());
