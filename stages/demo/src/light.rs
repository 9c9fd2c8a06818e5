//! Light and materials: sun, sky, sand, stones, rock.

use super::{
    ground::GroundPoint,
    math::{V3, Vector, cell_bits, mix32, noise2, noise3, smoothstep, split_floor, v3},
    rocks::Rock,
};

/// Irradiance of the sun on a surface that faces it, linear RGB.
pub const SUN: V3 = v3(1.32, 1.16, 0.98);
/// Irradiance of the open sky.
const SKY_LIGHT: V3 = v3(0.26, 0.205, 0.155);
/// Irradiance reflected by the sunlit ground.
const BOUNCE: V3 = v3(0.15, 0.085, 0.045);
const HORIZON: V3 = v3(0.66, 0.475, 0.315);
const ZENITH: V3 = v3(0.40, 0.285, 0.19);
const SAND: V3 = v3(0.295, 0.184, 0.107);
const DUST: V3 = v3(0.40, 0.252, 0.147);
const GRIT: V3 = v3(0.17, 0.118, 0.082);

/// Unit direction to the sun (site x, y, up): azimuth 128 degrees, elevation 37.
pub const TO_SUN: V3 = v3(-0.491_689, 0.629_334, 0.601_815);

/// Albedo and normal of a surface.
pub struct Material {
    pub albedo: V3,
    pub normal: V3,
}

/// Returns the light that a surface reflects.
pub fn lit(material: &Material, sun_share: f64, open: f64) -> V3 {
    let facing = material.normal.dot(&TO_SUN).max(0.0) * sun_share;
    let up = 0.5 + 0.5 * material.normal.z;
    let light = SUN * facing + SKY_LIGHT * (open * up) + BOUNCE * (open * (1.0 - up) + 0.04);
    material.albedo.component_mul(&light)
}

/// Returns the light of the sky, with hills on the horizon.
pub fn sky(along: V3, salt: u32) -> V3 {
    let level = (along.x * along.x + along.y * along.y).sqrt().max(1e-9);
    let (east, north) = (along.x / level, along.y / level);
    let rise = along.z / level;
    let high = smoothstep(-0.05, 0.9, rise);
    let near_sun = along.dot(&TO_SUN).max(0.0);
    let glow = near_sun * near_sun * near_sun * near_sun;
    let mut light = HORIZON.mix(ZENITH, high) + v3(0.16, 0.13, 0.10) * (glow * glow);
    light += v3(0.05, 0.035, 0.02) * smoothstep(0.12, 0.0, rise);
    for (ridge, tallness, haze) in [(0, 0.050, 0.80), (1, 0.028, 0.62)] {
        let outline =
            |scale: f64, k: u32| noise2(east * scale + 5.0, north * scale, salt ^ (71 + 8 * ridge + k)).0;
        let crest = tallness
            * (0.75
                + 0.55 * outline(1.6, 0)
                + 0.22 * outline(4.3, 1)
                + 0.07 * outline(13.0, 2)
                + 0.03 * outline(37.0, 3));
        let share = smoothstep(0.000_8, -0.000_8, rise - crest);
        if share > 0.0 {
            let folds = 0.5 + 0.5 * noise2(east * 30.0, north * 30.0 + rise * 160.0, salt ^ (77 + ridge)).0;
            let slope = v3(0.245, 0.150, 0.088).mix(v3(0.36, 0.225, 0.135), folds);
            light = light.mix(slope.mix(HORIZON, haze), share);
        }
    }
    light
}

/// Returns light after it passed dusty air over a distance.
pub fn hazed(light: V3, range_m: f64) -> V3 {
    let share = range_m / (range_m + 260.0);
    light.mix(HORIZON.mix(SAND, 0.25), share * share.sqrt())
}

/// Returns the contrast at which a pixel of this footprint resolves detail of a size: 1 from 1.7 footprints on.
fn held(size_m: f64, footprint_m: f64) -> f64 {
    smoothstep(0.7, 1.7, size_m / footprint_m)
}

/// Returns the material of the ground at a point: sand, dust and small stones.
pub fn ground_material(x: f64, y: f64, point: &GroundPoint, footprint_m: f64, salt: u32) -> Material {
    let mut albedo = SAND.mix(DUST, point.dusty);
    let (mut slope_x, mut slope_y) = point.slope;
    let (sand, mut tone) = (point.sand, point.tone);
    let rough = 1.0 - 0.62 * sand;
    let (mut px, mut py, mut size) = (x, y, 0.26);
    for octave in 0..7_u32 {
        let share = held(size, footprint_m);
        if share <= 0.0 {
            break;
        }
        // Each octave is rotated by the angle of a 3-4-5 triangle, which hides the lattice.
        (px, py) = (0.8 * px - 0.6 * py, 0.6 * px + 0.8 * py);
        let (value, dx, dy) = noise2(px / size, py / size, salt ^ (50 + octave));
        let strength = share * rough * 0.085;
        let turned = back(dx, dy, octave + 1);
        slope_x += strength * turned.0;
        slope_y += strength * turned.1;
        tone += share * (0.050 + 0.035 * rough) * value;
        size *= 0.52;
    }
    albedo *= 1.0 + tone;
    let mut material = Material {
        albedo,
        normal: super::ground::normal_of(slope_x, slope_y),
    };
    for (layer, (size, share)) in [(0.115, 0.34), (0.058, 0.42), (0.030, 0.5)]
        .into_iter()
        .enumerate()
    {
        let pebbles = PebbleLayer {
            size_m: size,
            share: share * (1.0 - 0.93 * sand),
            salt: salt ^ (90 + layer as u32),
        };
        pebbles.add(&mut material, x, y, footprint_m);
    }
    material
}

/// Rotates a slope back by `times` 3-4-5 angles.
fn back(mut dx: f64, mut dy: f64, times: u32) -> (f64, f64) {
    for _ in 0..times {
        (dx, dy) = (0.8 * dx + 0.6 * dy, -0.6 * dx + 0.8 * dy);
    }
    (dx, dy)
}

/// A layer of pebbles, at most one per cell.
struct PebbleLayer {
    /// Side of a cell, metres.
    size_m: f64,
    /// Share of the cells that hold one.
    share: f64,
    salt: u32,
}

impl PebbleLayer {
    /// Adds the layer to the ground at a point: each pebble is a dome with its shadow.
    fn add(&self, material: &mut Material, x: f64, y: f64, footprint_m: f64) {
        let Self { size_m, share, salt } = *self;
        let (u, v) = (x / size_m, y / size_m);
        let ((i, u), (j, v)) = (split_floor(u), split_floor(v));
        let bits = cell_bits(i, j, salt);
        let visible = held(size_m * 0.35, footprint_m);
        if f64::from(bits & 0xffff) / 65_536.0 > share || visible <= 0.0 {
            return;
        }
        let number = |k: u32| f64::from(mix32(bits ^ k) >> 8) / 16_777_216.0;
        let radius = 0.11 + 0.13 * number(1);
        let middle = (0.36 + 0.28 * number(2), 0.36 + 0.28 * number(3));
        let stretch = 0.75 + 0.6 * number(4);
        let (dx, dy) = (u - middle.0, v - middle.1);
        let (shear, soft) = (number(5) - 0.5, (footprint_m / size_m / radius).clamp(0.08, 0.6));
        let outline = |dx: f64, dy: f64| {
            let (a, b) = ((dx + shear * dy) * stretch / radius, dy / stretch / radius);
            (a, b, a * a + b * b)
        };
        let (_, _, shadow) = outline(dx + TO_SUN.x * radius * 0.8, dy + TO_SUN.y * radius * 0.8);
        let dark = visible * smoothstep(1.0 + soft, 1.0 - soft, shadow) * 0.55;
        let (a, b, r2) = outline(dx, dy);
        let stone = visible * smoothstep(1.0 + soft, 1.0 - soft, r2);
        let colour = GRIT.mix(DUST, 0.75 * number(6) * number(6)) * (0.75 + 0.6 * number(7));
        material.albedo = (material.albedo * (1.0 - dark)).mix(colour, stone);
        let dome = v3(a * 0.75, b * 0.75, 0.55).unit();
        material.normal = material.normal.mix(dome, stone * 0.85).unit();
    }
}

/// Returns the material of rock: bedding, grain, pits, and dust on upward faces.
pub fn rock_material(rock: &Rock, point: V3, normal: V3, footprint_m: f64, salt: u32) -> Material {
    let number = |k: u32| f64::from(mix32(rock.salt ^ k) >> 8) / 16_777_216.0;
    let local = rock.local(point - rock.centre) + v3(number(1), number(2), number(3)) * 50.0;
    let fresh = v3(0.150, 0.122, 0.100).mix(v3(0.265, 0.190, 0.125), number(4));
    let (mut tone, mut bump, mut size) = (0.0, V3::zeros(), 0.21);
    for octave in 0..6_u32 {
        let share = held(size, footprint_m);
        if share <= 0.0 || (octave < 2 && rock.half.x < size * 0.4) {
            size *= 0.5;
            continue;
        }
        // Bedding: detail is finer across the layers than along them.
        let p = v3(local.x / size, local.y / size, local.z * 1.7 / size);
        let (value, slope) = noise3(p, salt ^ (120 + octave));
        tone += share * 0.13 * value;
        bump += slope * (share * 0.17);
        size *= 0.5;
    }
    let pit = smoothstep(0.26, 0.42, -tone);
    let tilt = rock.world(bump);
    let normal = (normal - (tilt - normal * tilt.dot(&normal))).unit();
    let coat = smoothstep(0.35, 0.95, normal.z + 1.1 * tone) * (0.35 + 0.5 * number(5));
    let stain = smoothstep(0.22, 0.0, point.z - rock.ground_z) * 0.45;
    let albedo = fresh.mix(DUST, coat.max(stain)) * ((1.0 + tone) * (1.0 - 0.4 * pit));
    Material { albedo, normal }
}

/// Returns the share of the sky visible from a point of a rock: less near the ground.
pub fn rock_openness(rock: &Rock, point: V3) -> f64 {
    let height = (point.z - rock.ground_z) / (rock.half.z + 0.01);
    0.5 + 0.5 * smoothstep(-0.1, 0.9, height)
}
