//! Numbers that decide quality, found on the pairs of benches/stereo.md.

/// Candidates of all pixels that are computed at once. Pictures are halved until all disparities fit.
pub(crate) const FULL_CELLS: usize = 64 << 20;

/// Candidates a pixel near the coarser disparity.
pub(crate) const FINE_CANDIDATES: usize = 32;

/// A change of the disparity by one pixel costs so many bits of the census code. From 8 to 16, the share
/// within a pixel rises from 0.839 to 0.846.
pub(crate) const STEP_PENALTY: u8 = 16;

/// A jump costs so many in even brightness.
pub(crate) const JUMP_PENALTY: u8 = 96;

/// A jump costs at least so many, at the strongest edges.
pub(crate) const EDGE_PENALTY: u8 = 24;

/// The change of brightness at which half of the difference is left.
pub(crate) const EDGE_BRIGHTNESS: u16 = 8;

/// How much more any other candidate has to cost, in quarters of a bit a path, twice.
pub(crate) const UNIQUE_MARGIN: u32 = 4;

/// Connected parts of fewer pixels go.
pub(crate) const ISLAND: usize = 100;

/// Rounds of the fit. More than three change nothing.
pub(crate) const ROUNDS: usize = 3;

/// The weight of the present disparity next to the squared slope of the brightness. From 2 to 10, the share that is off
/// by more than a pixel falls from 0.051 to 0.047.
pub(crate) const PRIOR: f32 = 25.0;

/// Half the width of the window in which a plane is fitted. With 4, the rms of the error is 0.003 px higher.
pub(crate) const RADIUS: usize = 3;

/// How far off the plane a pixel still has weight, in pixels: in the first round, which knows no slope yet.
pub(crate) const FIRST_REACH_PX: f32 = 2.0;

/// The same in the other rounds.
pub(crate) const REACH_PX: f32 = 1.0;

/// The standard deviation that is left where the fit is perfect: the truth is no better known on the pairs.
pub(crate) const SIGMA_LEAST_PX: f32 = 0.15;

/// How many times larger errors are than the fit alone says: neighbours share their errors.
pub(crate) const SIGMA_SCALE: f32 = 8.0;

/// Above this standard deviation there is no disparity. With 0.5, the share that is off by more than a
/// pixel falls from 0.032 to 0.019, and a ninth of the good ones is lost.
pub(crate) const SIGMA_MOST_PX: f32 = 1.0;

/// How much the fit may move a disparity, in pixels.
pub(crate) const DRIFT_PX: f32 = 1.5;
