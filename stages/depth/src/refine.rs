//! Slanted planes: moves each disparity to where the two pictures agree best, to a fraction of a pixel.

use marf_numeric::InstructionSet;
use rayon::prelude::*;

use crate::kernel::{self, Kernel};
use crate::raster::{Picture, Raster};
use crate::tuning::{self, PRIOR, RADIUS};
use crate::winner::NONE;

/// The variance of rounding to a step of one.
const STEP_VARIANCE: f32 = 1.0 / 12.0;

/// Pixels that are computed together.
const LANES: usize = 8;

/// Disparities, and how they change from pixel to pixel.
pub(crate) struct Planes {
    pub disparity: Raster<f32>,
    /// Pixels of disparity a pixel to the right, and a pixel down.
    pub slope_x: Raster<f32>,
    pub slope_y: Raster<f32>,
    /// One standard deviation of the disparity, in pixels.
    pub sigma: Raster<f32>,
}

/// Fits planes to `disparity` and to the two pictures.
///
/// In each round, the right picture is resampled at the present disparities D (Catmull-Rom, after a binomial filter).
/// A pixel whose brightness is off by e, where the resampled picture has slope g, measures the disparity D - e / g with
/// the weight g^2 (Lucas and Kanade, IJCAI 1981). The plane through all measurements of a window is the result. Pixels
/// of another surface, more than a pixel off the plane, have no weight. Without texture, D itself is what is fitted.
pub(crate) fn refine(set: InstructionSet, pair: [&Picture; 2], disparity: Raster<f32>) -> Planes {
    let gain = gain(pair);
    let [left, mut right] = pair.map(|picture| smoothed(&picture.grey));
    right.values.iter_mut().for_each(|value| *value *= gain);
    let mut planes = Planes {
        slope_x: Raster::like(&disparity, 0.0),
        slope_y: Raster::like(&disparity, 0.0),
        sigma: Raster::like(&disparity, 0.0),
        disparity,
    };
    for round in 0..tuning::ROUNDS {
        let measured = Measured::new([&left, &right], &planes.disparity);
        planes = fit(
            set,
            &measured,
            planes,
            if round == 0 {
                tuning::FIRST_REACH_PX
            } else {
                tuning::REACH_PX
            },
        );
    }
    planes
}

/// Returns how much more contrast the left picture has: the ratio of the standard deviations of both, 1 without any.
fn gain(pair: [&Picture; 2]) -> f32 {
    let [left, right] = pair.map(|picture| {
        let values = picture.grey.values.iter().map(|value| u64::from(*value));
        let sum: u64 = values.clone().sum();
        let squares: u64 = values.clone().map(|value| value * value).sum();
        (values.len() as f64 * squares as f64 - sum as f64 * sum as f64).max(0.0)
    });
    if left > 0.0 && right > 0.0 {
        (left / right).sqrt() as f32
    } else {
        1.0
    }
}

/// Returns brightness after a binomial filter of 3 x 3 pixels.
fn smoothed(grey: &Raster<u8>) -> Raster<f32> {
    let padded = grey.padded(1);
    let mut out = Raster::like(grey, 0.0);
    out.values
        .par_chunks_mut(grey.width)
        .enumerate()
        .for_each(|(y, out)| {
            let rows: [_; 3] = std::array::from_fn(|i| padded.row(y + i));
            for (x, out) in out.iter_mut().enumerate() {
                let sum = |row: &[u8]| u32::from(row[x]) + 2 * u32::from(row[x + 1]) + u32::from(row[x + 2]);
                *out = (sum(rows[0]) + 2 * sum(rows[1]) + sum(rows[2])) as f32 / 16.0;
            }
        });
    out
}

/// What each pixel says about its disparity. All with a margin of [`RADIUS`] and more.
struct Measured {
    disparity: Raster<f32>,
    /// 1 where there is a disparity, 0 elsewhere.
    weight: Raster<f32>,
    /// g^2.
    texture: Raster<f32>,
    /// -g e.
    push: Raster<f32>,
    /// e^2.
    energy: Raster<f32>,
}

/// Half the width of the window of the mean brightness.
const MEAN_RADIUS: usize = 5;

impl Measured {
    fn new(pair: [&Raster<f32>; 2], disparity: &Raster<f32>) -> Self {
        let [left, right] = pair;
        let (width, height) = (disparity.width, disparity.height);
        let mut slope = Raster::like(disparity, 0.0f32);
        let mut error = Raster::like(disparity, 0.0f32);
        let mut weight = Raster::like(disparity, 0.0f32);
        let rows = slope
            .values
            .par_chunks_mut(width)
            .zip(error.values.par_chunks_mut(width));
        rows.zip(weight.values.par_chunks_mut(width))
            .enumerate()
            .for_each(|(y, ((slope, error), weight))| {
                let (left, right) = (left.row(y), right.row(y));
                for (x, &d) in disparity.row(y).iter().enumerate() {
                    if d == NONE {
                        continue;
                    }
                    let at = x as f32 - d;
                    if at < 1.0 || at > (width as f32) - 3.0 {
                        continue;
                    }
                    let sample = catmull_rom(right, at);
                    slope[x] = sample.slope;
                    error[x] = left[x] - sample.value;
                    weight[x] = 1.0;
                }
            });
        let counts = box_sum(&weight);
        let means = box_sum(&error);
        let mut measured = Self {
            disparity: disparity.clone(),
            texture: Raster::filled(width, height, 0.0),
            push: Raster::filled(width, height, 0.0),
            energy: Raster::filled(width, height, 0.0),
            weight,
        };
        for i in 0..slope.values.len() {
            if measured.weight.values[i] > 0.0 {
                let e = error.values[i] - means.values[i] / counts.values[i];
                let g = slope.values[i];
                measured.texture.values[i] = g * g;
                measured.push.values[i] = -(g * e);
                measured.energy.values[i] = e * e;
            } else {
                measured.disparity.values[i] = if disparity.values[i] == NONE {
                    0.0
                } else {
                    disparity.values[i]
                };
                measured.weight.values[i] = if disparity.values[i] == NONE { 0.0 } else { 1.0 };
            }
        }
        measured.padded()
    }

    fn padded(self) -> Self {
        let margin = RADIUS + LANES;
        Self {
            weight: zero_padded(&self.weight, margin),
            disparity: self.disparity.padded(margin),
            texture: self.texture.padded(margin),
            push: self.push.padded(margin),
            energy: self.energy.padded(margin),
        }
    }
}

fn zero_padded(raster: &Raster<f32>, margin: usize) -> Raster<f32> {
    let mut out = Raster::filled(raster.width + 2 * margin, raster.height + 2 * margin, 0.0);
    for y in 0..raster.height {
        let start = (y + margin) * out.width + margin;
        out.values[start..start + raster.width].copy_from_slice(raster.row(y));
    }
    out
}

struct Sample {
    value: f32,
    slope: f32,
}

/// Returns the value and the slope of the Catmull-Rom spline through the four samples around `at`.
#[inline(always)]
fn catmull_rom(row: &[f32], at: f32) -> Sample {
    let whole = at as usize;
    let t = at - whole as f32;
    let p = [row[whole - 1], row[whole], row[whole + 1], row[whole + 2]];
    let b = 0.5 * (p[2] - p[0]);
    let c = p[0] - 2.5 * p[1] + 2.0 * p[2] - 0.5 * p[3];
    let d = 0.5 * (p[3] - p[0]) + 1.5 * (p[1] - p[2]);
    Sample {
        value: p[1] + t * (b + t * (c + t * d)),
        slope: b + t * (2.0 * c + t * 3.0 * d),
    }
}

/// Returns sums over windows, cut off at the borders.
fn box_sum(raster: &Raster<f32>) -> Raster<f32> {
    let padded = zero_padded(raster, MEAN_RADIUS);
    let mut columns = Raster::filled(padded.width, raster.height, 0.0f32);
    columns
        .values
        .par_chunks_mut(padded.width)
        .enumerate()
        .for_each(|(y, out)| {
            for row in y..=y + 2 * MEAN_RADIUS {
                for (out, value) in out.iter_mut().zip(padded.row(row)) {
                    *out += value;
                }
            }
        });
    let mut sums = Raster::like(raster, 0.0f32);
    sums.values
        .par_chunks_mut(raster.width)
        .enumerate()
        .for_each(|(y, out)| {
            for column in 0..=2 * MEAN_RADIUS {
                for (out, value) in out.iter_mut().zip(&columns.row(y)[column..]) {
                    *out += value;
                }
            }
        });
    sums
}

/// Fits a plane at each pixel.
fn fit(set: InstructionSet, measured: &Measured, planes: Planes, reach: f32) -> Planes {
    let width = planes.disparity.width;
    let mut out = Planes {
        disparity: Raster::like(&planes.disparity, NONE),
        slope_x: Raster::like(&planes.disparity, 0.0),
        slope_y: Raster::like(&planes.disparity, 0.0),
        sigma: Raster::like(&planes.disparity, 0.0),
    };
    let disparity = out.disparity.values.par_chunks_mut(width);
    let slopes = out
        .slope_x
        .values
        .par_chunks_mut(width)
        .zip(out.slope_y.values.par_chunks_mut(width));
    let rows = disparity.zip(slopes).zip(out.sigma.values.par_chunks_mut(width));
    rows.enumerate()
        .for_each(|(y, ((disparity, (slope_x, slope_y)), sigma))| {
            let out = RowOut {
                disparity,
                slope_x,
                slope_y,
                sigma,
            };
            kernel::run(
                set,
                FitRow {
                    measured,
                    planes: &planes,
                    reach,
                    y,
                    out,
                },
            );
        });
    out
}

struct RowOut<'a> {
    disparity: &'a mut [f32],
    slope_x: &'a mut [f32],
    slope_y: &'a mut [f32],
    sigma: &'a mut [f32],
}

struct FitRow<'a> {
    measured: &'a Measured,
    planes: &'a Planes,
    /// How far off the plane a pixel still has weight.
    reach: f32,
    y: usize,
    out: RowOut<'a>,
}

type Lanes = [f32; LANES];

/// Sums of the normal equations of a plane, for several pixels.
#[derive(Default)]
struct Sums {
    n: Lanes,
    x: Lanes,
    y: Lanes,
    xx: Lanes,
    xy: Lanes,
    yy: Lanes,
    z: Lanes,
    zx: Lanes,
    zy: Lanes,
    weight: Lanes,
    energy: Lanes,
}

impl Kernel for FitRow<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let width = self.planes.disparity.width;
        for start in (0..width).step_by(LANES) {
            let mut centre = [0.0; LANES];
            let mut slope_x = [0.0; LANES];
            let mut slope_y = [0.0; LANES];
            let mut any = false;
            for i in 0..LANES.min(width - start) {
                let d = self.planes.disparity.at(start + i, self.y);
                any |= d != NONE;
                centre[i] = if d == NONE { 0.0 } else { d };
                slope_x[i] = self.planes.slope_x.at(start + i, self.y);
                slope_y[i] = self.planes.slope_y.at(start + i, self.y);
            }
            if !any {
                continue;
            }
            let sums = self.sums(start, centre, [slope_x, slope_y]);
            for i in 0..LANES.min(width - start) {
                let x = start + i;
                let before = self.planes.disparity.at(x, self.y);
                if before == NONE {
                    continue;
                }
                // Few pixels decide no slope.
                let ridge = 0.05 * sums.n[i] + 1e-3;
                let (n, a, b) = (sums.n[i] + 1e-6, sums.x[i], sums.y[i]);
                let (xx, xy, yy) = (sums.xx[i] + ridge, sums.xy[i], sums.yy[i] + ridge);
                let (cxx, cxy, cyy) = (xx - a * a / n, xy - a * b / n, yy - b * b / n);
                let (px, py) = (sums.zx[i] - a * sums.z[i] / n, sums.zy[i] - b * sums.z[i] / n);
                let det = cxx * cyy - cxy * cxy;
                let sx = (px * cyy - py * cxy) / det;
                let sy = (py * cxx - px * cxy) / det;
                let shift = (sums.z[i] - a * sx - b * sy) / n;
                // Variance of the shift: the corner of the inverse of the normal matrix, times that of the brightness.
                let corner = 1.0 / n + (a * a * cyy - 2.0 * a * b * cxy + b * b * cxx) / (n * n * det);
                let noise = sums.energy[i] / (sums.weight[i] + 1e-6);
                // Brightness is known to a step of one: without texture, nothing is.
                let texture = (sums.n[i] - PRIOR * sums.weight[i]).max(1e-6);
                let fit =
                    (noise * corner + STEP_VARIANCE / texture) * tuning::SIGMA_SCALE * tuning::SIGMA_SCALE;
                let least = tuning::SIGMA_LEAST_PX * tuning::SIGMA_LEAST_PX;
                self.out.sigma[x] = (least + fit.max(0.0)).sqrt();
                self.out.disparity[x] = before + shift.clamp(-1.0, 1.0);
                self.out.slope_x[x] = sx.clamp(-2.0, 2.0);
                self.out.slope_y[x] = sy.clamp(-2.0, 2.0);
            }
        }
    }
}

impl FitRow<'_> {
    #[inline(always)]
    fn sums(&self, start: usize, centre: Lanes, slopes: [Lanes; 2]) -> Sums {
        let mut sums = Sums::default();
        let margin = RADIUS + LANES;
        let inverse = 1.0 / (self.reach * self.reach);
        for v in 0..=2 * RADIUS {
            let row = (self.y + margin - RADIUS + v) * self.measured.disparity.width;
            let dy = v as f32 - RADIUS as f32;
            for u in 0..=2 * RADIUS {
                let dx = u as f32 - RADIUS as f32;
                let at = row + start + margin - RADIUS + u;
                let load = |raster: &Raster<f32>| -> Lanes {
                    let mut lanes = [0.0; LANES];
                    lanes.copy_from_slice(&raster.values[at..at + LANES]);
                    lanes
                };
                let disparity = load(&self.measured.disparity);
                let weight = load(&self.measured.weight);
                let texture = load(&self.measured.texture);
                let push = load(&self.measured.push);
                let energy = load(&self.measured.energy);
                for i in 0..LANES {
                    let rise = disparity[i] - centre[i];
                    let off = rise - slopes[0][i] * dx - slopes[1][i] * dy;
                    let near = (1.0 - off * off * inverse).max(0.0);
                    let w = weight[i] * near;
                    let g = w * (texture[i] + PRIOR);
                    let z = g * rise + w * push[i];
                    sums.n[i] += g;
                    sums.x[i] += g * dx;
                    sums.y[i] += g * dy;
                    sums.xx[i] += g * (dx * dx);
                    sums.xy[i] += g * (dx * dy);
                    sums.yy[i] += g * (dy * dy);
                    sums.z[i] += z;
                    sums.zx[i] += z * dx;
                    sums.zy[i] += z * dy;
                    sums.weight[i] += w;
                    sums.energy[i] += w * energy[i];
                }
            }
        }
        sums
    }
}
