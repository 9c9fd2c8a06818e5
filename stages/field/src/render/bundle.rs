//! What the rays of neighbouring pixels share: the steps at which one of them may meet matter.

use super::MIDDLE;
use crate::cpu::clearance::Clearance;
use crate::cpu::march::Steps;
use crate::cpu::simd::{Isa, Kernel, LANES};
use crate::frame::RayStart;

/// The middle of some rays that begin at one point, and how far they spread.
#[derive(Clone, Copy)]
pub struct Bundle {
    origin: [f32; 3],
    direction: [f32; 3],
    /// Greatest difference of a direction's coordinate from that of the middle.
    spread: f32,
}

impl Bundle {
    /// Returns the bundle of rays of one camera; none without a ray.
    pub fn new<'a>(rays: impl IntoIterator<Item = &'a RayStart>) -> Option<Self> {
        let (mut low, mut high, mut origin) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3], None);
        for ray in rays {
            origin = Some(ray.origin);
            for axis in 0..3 {
                low[axis] = low[axis].min(ray.direction[axis]);
                high[axis] = high[axis].max(ray.direction[axis]);
            }
        }
        let half = [0, 1, 2].map(|axis| 0.5 * (high[axis] - low[axis]));
        Some(Self {
            origin: origin?,
            direction: [0, 1, 2].map(|axis| 0.5 * (high[axis] + low[axis])),
            // The middle is rounded.
            spread: half[0].max(half[1]).max(half[2]) + f32::EPSILON,
        })
    }
}

/// Returns the steps at which a ray of a bundle may be in an occupied cell: a walk over them finds what a walk over all
/// steps finds.
pub struct NearMatter<'a> {
    pub steps: &'a Steps,
    pub clearance: &'a Clearance,
    pub bundle: Bundle,
}

impl Kernel for NearMatter<'_> {
    type Output = Steps;

    #[inline(always)]
    fn run<I: Isa>(self, _isa: I) -> Steps {
        let Self {
            steps,
            clearance,
            bundle,
        } = self;
        let (mut begin, mut length) = (Vec::new(), Vec::new());
        for step in 0..steps.count {
            let t = MIDDLE.mul_add(steps.length[step], steps.begin[step]);
            let at = [0, 1, 2].map(|axis: usize| bundle.direction[axis].mul_add(t, bundle.origin[axis]));
            if !clearance.is_free(at, bundle.spread * t) {
                begin.push(steps.begin[step]);
                length.push(steps.length[step]);
            }
        }
        let count = begin.len();
        let padded = count.next_multiple_of(LANES);
        begin.resize(padded, 0.0);
        length.resize(padded, 0.0);
        Steps { begin, length, count }
    }
}
