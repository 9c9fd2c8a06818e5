//! Loops that are compiled once for each instruction set.

#[cfg(target_arch = "x86_64")]
use marf_numeric::{Avx2, Avx512};
use marf_numeric::{Dispatch, InstructionSet, Plain};

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
    set.dispatch(Compiled(kernel))
}

struct Compiled<K>(K);

impl<K: Kernel> Dispatch for Compiled<K> {
    type Output = K::Output;

    #[inline(always)]
    fn plain(self, _: Plain) -> K::Output {
        self.0.run()
    }

    #[cfg(target_arch = "x86_64")]
    #[inline(always)]
    fn avx2(self, _: Avx2) -> K::Output {
        self.0.run()
    }

    #[cfg(target_arch = "x86_64")]
    #[inline(always)]
    fn avx512(self, _: Avx512) -> K::Output {
        self.0.run()
    }
}
