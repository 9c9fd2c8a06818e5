//! What the rays of neighbouring pixels share: the steps at which one of them may meet matter.

use crate::cpu::clearance::Clearance;
use crate::cpu::march::Steps;
use crate::cpu::simd::{Block, Isa, Kernel, LANES};
use crate::frame::RayStart;

/// Every sample is in the middle of its step.
pub const MIDDLE: f32 = 0.5;

/// The middle of some rays that begin at one point, and how far they spread.
#[derive(Clone, Copy)]
pub struct Bundle {
    origin: [f32; 3],
    direction: [f32; 3],
    /// Greatest difference of a direction's coordinate from that of the middle.
    spread: f32,
}

impl Bundle {
    /// Returns the bundle of rays of one camera, `None` without a ray.
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
    fn run<I: Isa>(self, isa: I) -> Steps {
        let Self {
            steps,
            clearance,
            bundle,
        } = self;
        let (mut begin, mut length) = (Vec::new(), Vec::new());
        let begins = steps.begin.as_chunks::<LANES>().0.iter();
        let lengths = steps.length.as_chunks::<LANES>().0.iter();
        for (begins, lengths) in begins.zip(lengths) {
            let (mut points, mut spread) = ([Block::ZERO; 3], Block::ZERO);
            for lane in 0..LANES {
                let t = MIDDLE.mul_add(lengths[lane], begins[lane]);
                spread.0[lane] = bundle.spread * t;
                for (axis, point) in points.iter_mut().enumerate() {
                    point.0[lane] = bundle.direction[axis].mul_add(t, bundle.origin[axis]);
                }
            }
            let near = clearance.near(isa, &points, &spread);
            for lane in (0..LANES).filter(|lane| near >> lane & 1 == 1 && lengths[*lane] > 0.0) {
                begin.push(begins[lane]);
                length.push(lengths[lane]);
            }
        }
        let count = begin.len();
        let padded = count.next_multiple_of(LANES);
        begin.resize(padded, 0.0);
        length.resize(padded, 0.0);
        Steps { begin, length, count }
    }
}
