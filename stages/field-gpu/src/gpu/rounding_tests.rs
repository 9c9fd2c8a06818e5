//! How far drivers may be from the CPU: the formulas of kernels in every arithmetic that WGSL allows a driver.
//!
//! A driver may do a multiply-add as two operations, flush denormals to 0, and be off by 2.5 units in the
//! last place in a quotient. A root is the inverse of one that is off by 2 (WGSL, "Floating point accuracy").
//! The tolerances of the tests of kernels must hold all of that, before any card is seen.

use super::march_tests::CLOSE;
use super::rig::TOLERANCE;
use marf_field::cpu::math;

/// What a driver makes of f32.
#[derive(Clone, Copy, Debug)]
struct Driver {
    fuses: bool,
    flushes: bool,
    /// Units in the last place by which quotients are off, and half as many roots.
    off: i32,
}

/// The arithmetic of the CPU.
const EXACT: Driver = Driver {
    fuses: true,
    flushes: false,
    off: 0,
};

/// Every arithmetic that a driver may have, the CPU's among them.
fn drivers() -> impl Iterator<Item = Driver> {
    (0..2 * 2 * 5).map(|at| Driver {
        fuses: at % 2 == 0,
        flushes: at / 2 % 2 == 0,
        // 2.5 rounded up.
        off: [-3, -1, 0, 1, 3][at / 4],
    })
}

impl Driver {
    fn flushed(self, x: f32) -> f32 {
        if self.flushes && x.is_subnormal() { 0.0 } else { x }
    }

    /// A number that is off by `off` units in the last place, if it is in the range of a driver's promise.
    fn nudged(self, x: f32, off: i32) -> f32 {
        if !x.is_normal() {
            return self.flushed(x);
        }
        self.flushed(f32::from_bits(x.to_bits().wrapping_add_signed(off)))
    }

    fn times(self, a: f32, b: f32) -> f32 {
        self.flushed(self.flushed(a) * self.flushed(b))
    }

    fn plus(self, a: f32, b: f32) -> f32 {
        self.flushed(self.flushed(a) + self.flushed(b))
    }

    fn fma(self, a: f32, b: f32, c: f32) -> f32 {
        if !self.fuses {
            return self.plus(self.times(a, b), c);
        }
        self.flushed(self.flushed(a).mul_add(self.flushed(b), self.flushed(c)))
    }

    fn over(self, a: f32, b: f32) -> f32 {
        self.nudged(self.flushed(a) / self.flushed(b), self.off)
    }

    fn root(self, x: f32) -> f32 {
        self.nudged(self.flushed(x).sqrt(), self.off)
    }

    /// `exp_own` of shared/math.wgsl.
    fn exp(self, x: f32) -> f32 {
        let cut = x.clamp(-87.0, 88.0);
        let twos = self.fma(cut, std::f32::consts::LOG2_E, 12_582_912.0).to_bits() as i32 - 0x4b40_0000;
        let whole = self.times((twos * 22_713) as f32, 0.5_f32.powi(15));
        let r = self.fma(twos as f32, -1.428_606_8e-6, self.plus(cut, -whole));
        let mut p = self.fma(1.987_569_1e-4, r, 1.398_199_9e-3);
        for next in [8.333_452e-3, 4.166_579_6e-2, 1.666_666_5e-1, 0.5] {
            p = self.fma(p, r, next);
        }
        p = self.plus(self.fma(self.times(p, r), r, r), 1.0);
        self.times(p, f32::from_bits(((twos + 127) << 23) as u32))
    }

    /// `contracted` of march.wgsl along one axis, the largest: place in the box, and by how much a length shrinks.
    fn contracted(self, p: f32) -> [f32; 2] {
        if p.abs() <= 1.0 {
            return [self.fma(p, 0.25, 0.5), 1.0];
        }
        let shrink = self.over(1.0, p.abs());
        let scale = self.times(self.plus(2.0, -shrink), shrink);
        [self.fma(self.times(p, scale), 0.25, 0.5), shrink]
    }

    /// `advance` of adam_net.wgsl: weight, mean and square after a step.
    fn adam(self, [weight, mean, square]: [f32; 3], gradient: f32) -> [f32; 3] {
        let ([rate, beta1, beta2, epsilon], correction) = ([2e-2, 0.9, 0.99, 1e-12], [1.25, 2.5]);
        let slope = self.fma(1e-6, weight, gradient);
        let mean = self.fma(beta1, mean, self.times(1.0 - beta1, slope));
        let square = self.fma(beta2, square, self.times(1.0 - beta2, self.times(slope, slope)));
        let root = self.plus(self.root(self.times(square, correction[1])), epsilon);
        let step = self.over(self.times(rate, self.times(mean, correction[0])), root);
        [self.plus(weight, -step), mean, square]
    }
}

/// Numbers from 2^-140, a denormal, to 2^20, both signs. All are unround.
fn all_sizes() -> impl Iterator<Item = f32> {
    let sizes = (-1400..200).map(|tenth| 2.0_f64.powf(f64::from(tenth) / 10.0) as f32);
    sizes.flat_map(|x| [x, -x])
}

/// Returns the largest error of any driver over the numbers, each error by the size that a number is given.
fn worst(numbers: &[f32], of: impl Fn(Driver, f32) -> f32, size: impl Fn(f32) -> f32) -> f32 {
    let errors = drivers().flat_map(|driver| {
        let of = &of;
        let size = &size;
        numbers.iter().map(move |x| {
            let (found, expected) = (of(driver, *x), of(EXACT, *x));
            let error = (found - expected).abs() / size(expected);
            assert!(!error.is_nan(), "{driver:?}, {x}: {found} against {expected}");
            error
        })
    });
    errors.fold(0.0, f32::max)
}

#[test]
fn the_exact_arithmetic_is_that_of_the_cpu() {
    for x in (-9000..9000).map(|x| x as f32 / 100.3) {
        assert_eq!(EXACT.exp(x).to_bits(), math::exp(x).to_bits(), "{x}");
    }
}

#[test]
fn every_driver_has_exponentials_within_the_tolerance_of_light() {
    let numbers: Vec<f32> = (-8600..=1100).map(|x| x as f32 / 100.3).collect();
    let error = worst(&numbers, Driver::exp, |x| x.max(1e-30));
    println!("exponential: {error:.1e} of {TOLERANCE:.1e}");
    assert!(error > 0.0 && error < TOLERANCE, "{error}");
}

/// Optical depths add up in the order of a ray's samples, whatever the driver: their own errors are all there is.
#[test]
fn every_driver_has_transmittances_within_the_tolerance_of_light() {
    let raws: Vec<f32> = (0..400).map(|x| x as f32 / 37.3 - 6.0).collect();
    let behind = |driver: Driver, raw: f32| {
        let tau = driver.times(driver.exp(raw), 3e-3);
        let depth = (0..1101).fold(0.0, |depth, _| driver.plus(depth, tau));
        driver.exp(-depth)
    };
    let error = worst(&raws, behind, |_| 1.0);
    println!("transmittance: {error:.1e} of {TOLERANCE:.1e}");
    assert!(error > 0.0 && error < TOLERANCE, "{error}");
}

#[test]
fn every_driver_has_samples_within_the_tolerance_of_the_march() {
    let numbers: Vec<f32> = all_sizes().collect();
    for (what, column) in [("place", 0), ("shrinking", 1)] {
        let error = worst(&numbers, |driver, x| driver.contracted(x)[column], |_| 1.0);
        println!("march, {what}: {error:.1e} of {CLOSE:.1e}");
        assert!(error < CLOSE, "{what}: {error}");
    }
    // A point along a ray, in front of the contraction.
    let error = worst(
        &numbers,
        |driver, t| driver.fma(0.577, t, 1.3),
        |x| x.abs().max(1.0),
    );
    assert!(error < CLOSE, "{error}");
}

/// Denormals aside, whose squares no driver keeps: a gradient of 1e-15 is the smallest that is known to move a weight.
#[test]
fn every_driver_has_steps_of_adam_within_their_tolerance() {
    let gradients: Vec<f32> = all_sizes().filter(|x| (1e-15..1e5).contains(&x.abs())).collect();
    for (what, row) in [("weight", 0), ("mean", 1), ("square", 2)] {
        let of = |driver: Driver, gradient: f32| {
            let start = [0.01, 0.0, 0.0];
            let steps = [1.0, -0.3, 0.7].iter();
            let numbers = steps.fold(start, |all, share| driver.adam(all, share * gradient));
            // Of the largest number that goes in: gradients, and the pull of 1e-8 to zero.
            let largest = gradient.abs().max(1e-8);
            numbers[row] / [0.01, largest, largest * largest][row]
        };
        let error = worst(&gradients, of, |_| 1.0);
        println!("adam, {what}: {error:.1e} of {TOLERANCE:.1e}");
        assert!(error > 0.0 && error < TOLERANCE, "{what}: {error}");
    }
}

/// What a view number that travelled as a float would come to, and what a flushed moment costs: nothing but itself.
#[test]
fn a_driver_that_flushes_loses_small_integers_that_travel_as_floats() {
    let flushing = Driver {
        flushes: true,
        ..EXACT
    };
    for view in [1_u32, 7, 1000] {
        assert_eq!(flushing.flushed(f32::from_bits(view)), 0.0);
        assert_eq!(EXACT.flushed(f32::from_bits(view)).to_bits(), view);
    }
}
