//! Detection of instruction sets, and code compiled once for each of them.
//!
//! A token ([`Avx2`], [`Avx512`]) proves that this machine has the instructions: only detection makes one, so functions
//! that take a token are safe to call. Rust never fuses or reorders float operations by itself, so the same loops round
//! alike on every set.
#![allow(unsafe_code)]

/// Proof of nothing beyond the baseline of the target.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Plain;

/// Proof of AVX2, FMA and BMI2.
#[cfg(target_arch = "x86_64")]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Avx2(());

/// Proof of AVX-512 F, BW, DQ, VL and VNNI beside what [`Avx2`] proves.
#[cfg(target_arch = "x86_64")]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Avx512(());

/// An instruction set of this machine.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum InstructionSet {
    /// The baseline of the target; fused multiply-add may be a library call there.
    Plain(Plain),
    /// 8 lanes of f32.
    #[cfg(target_arch = "x86_64")]
    Avx2(Avx2),
    /// 16 lanes of f32.
    #[cfg(target_arch = "x86_64")]
    Avx512(Avx512),
}

/// Work with one body for each instruction set.
///
/// The methods, and all that they call, should be `#[inline(always)]`: only what is inlined is compiled with the
/// instructions of the set. What is not is slower, never different.
pub trait Dispatch {
    /// What the work returns.
    type Output;
    /// Runs on the baseline of the target.
    fn plain(self, token: Plain) -> Self::Output;
    /// Runs with AVX2.
    #[cfg(target_arch = "x86_64")]
    fn avx2(self, token: Avx2) -> Self::Output;
    /// Runs with AVX-512.
    #[cfg(target_arch = "x86_64")]
    fn avx512(self, token: Avx512) -> Self::Output;
}

/// Declares `Dispatched(kernel)`, a [`Dispatch`] that runs a kernel of a trait on every instruction set in the same way.
///
/// The trait has an associated type `Output`. `dispatch_kernels!(Kernel, |kernel, token| kernel.run(token))` calls a
/// method with the token of the set.
#[macro_export]
macro_rules! dispatch_kernels {
    ($kernel:ident, |$work:ident, $token:tt| $run:expr) => {
        /// A kernel on the set whose token it gets.
        struct Dispatched<K>(K);

        impl<K: $kernel> $crate::Dispatch for Dispatched<K> {
            type Output = K::Output;

            #[inline(always)]
            fn plain(self, $token: $crate::Plain) -> K::Output {
                let Self($work) = self;
                $run
            }

            #[cfg(target_arch = "x86_64")]
            #[inline(always)]
            fn avx2(self, $token: $crate::Avx2) -> K::Output {
                let Self($work) = self;
                $run
            }

            #[cfg(target_arch = "x86_64")]
            #[inline(always)]
            fn avx512(self, $token: $crate::Avx512) -> K::Output {
                let Self($work) = self;
                $run
            }
        }
    };
}

impl InstructionSet {
    /// Returns every set of this machine, the slowest first.
    pub fn all() -> Vec<Self> {
        let mut sets = vec![Self::Plain(Plain)];
        #[cfg(target_arch = "x86_64")]
        if has_avx2() {
            sets.push(Self::Avx2(Avx2(())));
            if has_avx512() {
                sets.push(Self::Avx512(Avx512(())));
            }
        }
        sets
    }

    /// Returns the fastest set of this machine.
    pub fn best() -> Self {
        Self::all().pop().unwrap_or(Self::Plain(Plain))
    }

    /// Runs work on this set.
    pub fn dispatch<D: Dispatch>(self, work: D) -> D::Output {
        match self {
            Self::Plain(token) => work.plain(token),
            #[cfg(target_arch = "x86_64")]
            // SAFETY: the token was made by detection.
            Self::Avx2(token) => unsafe { on_avx2(work, token) },
            #[cfg(target_arch = "x86_64")]
            // SAFETY: the token was made by detection.
            Self::Avx512(token) => unsafe { on_avx512(work, token) },
        }
    }
}

#[cfg(target_arch = "x86_64")]
fn has_avx2() -> bool {
    is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") && is_x86_feature_detected!("bmi2")
}

#[cfg(target_arch = "x86_64")]
fn has_avx512() -> bool {
    is_x86_feature_detected!("avx512f")
        && is_x86_feature_detected!("avx512bw")
        && is_x86_feature_detected!("avx512dq")
        && is_x86_feature_detected!("avx512vl")
        && is_x86_feature_detected!("avx512vnni")
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma,bmi2")]
fn on_avx2<D: Dispatch>(work: D, token: Avx2) -> D::Output {
    work.avx2(token)
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl,avx512vnni,avx2,fma,bmi2")]
fn on_avx512<D: Dispatch>(work: D, token: Avx512) -> D::Output {
    work.avx512(token)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A product and a sum that a fused multiply-add would round differently.
    struct Unfused([f32; 3]);

    impl Unfused {
        #[inline(always)]
        fn body(self) -> (u32, u32) {
            let [a, b, c] = self.0;
            ((a * b + c).to_bits(), a.mul_add(b, c).to_bits())
        }
    }

    impl Dispatch for Unfused {
        type Output = (u32, u32);
        #[inline(always)]
        fn plain(self, _: Plain) -> Self::Output {
            self.body()
        }
        #[cfg(target_arch = "x86_64")]
        #[inline(always)]
        fn avx2(self, _: Avx2) -> Self::Output {
            self.body()
        }
        #[cfg(target_arch = "x86_64")]
        #[inline(always)]
        fn avx512(self, _: Avx512) -> Self::Output {
            self.body()
        }
    }

    #[test]
    fn every_set_rounds_products_and_fused_products_alike() {
        let numbers = [1.0 + f32::EPSILON, 1.0 - f32::EPSILON, -1.0];
        let (product, fused) = InstructionSet::Plain(Plain).dispatch(Unfused(numbers));
        assert_ne!(product, fused, "the numbers do not tell the two apart");
        for set in InstructionSet::all() {
            let found = set.dispatch(Unfused(std::hint::black_box(numbers)));
            assert_eq!(found, (product, fused), "{set:?}");
        }
    }

    #[test]
    fn the_best_set_is_the_last_of_all() {
        assert_eq!(InstructionSet::all().last(), Some(&InstructionSet::best()));
        assert_eq!(InstructionSet::all()[0], InstructionSet::Plain(Plain));
    }
}
