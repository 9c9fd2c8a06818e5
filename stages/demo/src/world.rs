//! The landscape: ground and rocks, and what a ray sees of them.

use std::f64::consts::TAU;

use super::{
    ground::{self, FAR, Ground, OUTCROP},
    light::{self, TO_SUN},
    math::{Rng, V3, mix32, sin_cos, v3},
    rocks::{Place, Ray, Rocks},
};

/// Distance beyond which shadows are smaller than a pixel, metres.
const SHADOWS_M: f64 = 120.0;
/// Longest shadow, metres along the sunlight.
const SHADOW_M: f64 = 6.0;

/// Position of the stone that is there after the change, metres in the site.
const NEW_STONE: (f64, f64) = (7.25, 1.20);
/// Half extents of that stone, metres.
const NEW_HALF: V3 = v3(0.32, 0.25, 0.20);
/// The strip without dust after the change: its middle, the direction along it, half its length and width,
/// metres in the site.
const STRIP: ((f64, f64), (f64, f64), (f64, f64)) = ((5.35, 4.2), (0.0, 1.0), (0.7, 0.15));
/// Albedo without that dust, as a share: darker, and less red.
const BARED: V3 = v3(0.70, 0.78, 0.88);

/// The landscape of a seed at one time.
pub struct World {
    ground: Ground,
    rocks: Rocks,
    salt: u32,
    is_changed: bool,
}

/// A sample of a ray.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RaySample {
    /// Linear RGB.
    pub light: V3,
    /// Metres along the ray. Infinite for the sky.
    pub range_m: f64,
    /// The surface. There is an edge where neighbours differ in it or in its light.
    pub surface: Surface,
    /// Whether the surface is in a cast shadow.
    pub is_shaded: bool,
}

/// A kind of surface.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Surface {
    /// Sky or far hills.
    Sky,
    /// Sand, dust and small stones.
    Ground,
    /// A rock, by index.
    Rock(usize),
}

impl World {
    /// Returns the landscape, as it is after the change or before it.
    pub fn new(seed: u64, is_changed: bool) -> Self {
        let salt = mix32(seed as u32 ^ mix32((seed >> 32) as u32 ^ 0x6d61_7273));
        let mut places = places(seed, salt);
        places.extend(is_changed.then(|| new_stone(salt)));
        let rocks = Rocks::new(seed, &places);
        let ground = Ground::new(salt, &rocks.all);
        Self {
            ground,
            rocks,
            salt,
            is_changed,
        }
    }

    /// Returns the height of the ground, metres.
    pub fn height(&self, x: f64, y: f64) -> f64 {
        self.ground.height(x, y)
    }

    /// Returns the slopes of the large forms along x and y.
    pub fn slope(&self, x: f64, y: f64) -> (f64, f64) {
        let plain = |dx: f64, dy: f64| ground::plain(x + dx, y + dy, self.salt);
        (
            plain(0.9, 0.0) - plain(-0.9, 0.0),
            plain(0.0, 0.9) - plain(0.0, -0.9),
        )
    }

    /// Traces a ray. `pixel_rad` is the angle of a pixel, and finer detail is not drawn.
    pub fn trace(&self, from: V3, along: V3, pixel_rad: f64) -> RaySample {
        let ray = Ray::new(from, along);
        let ground_m = self.ground.first(&ray);
        if let Some(hit) = self.rocks.first(&ray, ground_m.unwrap_or(FAR)) {
            return self.rock(&ray, hit, pixel_rad);
        }
        match ground_m.filter(|&range| range < FAR) {
            Some(range_m) => self.sand(&ray, range_m, pixel_rad),
            None => RaySample {
                light: light::sky(along, self.salt),
                range_m: f64::INFINITY,
                surface: Surface::Sky,
                is_shaded: false,
            },
        }
    }

    /// Returns the range of a ray alone, metres. Infinite for the sky.
    pub fn range_m(&self, from: V3, along: V3) -> f64 {
        let ray = Ray::new(from, along);
        let ground = self.ground.first(&ray).filter(|&range| range < FAR);
        let rock = self.rocks.first(&ray, ground.unwrap_or(FAR));
        rock.map(|hit| hit.t).or(ground).unwrap_or(f64::INFINITY)
    }

    fn sand(&self, ray: &Ray, range_m: f64, pixel_rad: f64) -> RaySample {
        let p = ray.at(range_m);
        let point = self.ground.point(p.x, p.y);
        let facing = -ray.along.dot(&ground::normal_of(point.slope.0, point.slope.1));
        // A pixel's footprint is elongated: the geometric mean of its sides keeps detail without aliasing.
        let footprint_m = range_m * pixel_rad / facing.clamp(0.06, 1.0).sqrt();
        let mut material = light::ground_material(p.x, p.y, &point, footprint_m, self.salt);
        if self.is_changed && is_bared(p.x, p.y) {
            material.albedo = material.albedo.component_mul(&BARED);
        }
        // Only rocks cast shadows: the ground is less steep than the sun is high.
        let to_sun = Ray::new(p + v3(0.0, 0.0, 0.004), TO_SUN);
        let is_shaded = range_m < SHADOWS_M && self.rocks.shade_ground(&to_sun, SHADOW_M);
        let light = light::lit(&material, f64::from(!is_shaded), point.open);
        RaySample {
            light: light::hazed(light, range_m),
            range_m,
            surface: Surface::Ground,
            is_shaded,
        }
    }

    fn rock(&self, ray: &Ray, hit: super::rocks::RockHit, pixel_rad: f64) -> RaySample {
        let rock = &self.rocks.all[hit.rock];
        let p = ray.at(hit.t);
        let material = light::rock_material(rock, p, hit.normal, hit.t * pixel_rad, self.salt);
        let turned_away = hit.normal.dot(&TO_SUN) <= 0.0;
        let to_sun = Ray::new(p + hit.normal * 0.003, TO_SUN);
        let is_shaded = !turned_away && hit.t < SHADOWS_M && self.rocks.shade_rock(&to_sun, SHADOW_M);
        let light = light::lit(&material, f64::from(!is_shaded), light::rock_openness(rock, p));
        RaySample {
            light: light::hazed(light, hit.t),
            range_m: hit.t,
            surface: Surface::Rock(hit.rock),
            is_shaded,
        }
    }
}

/// Returns whether a place is on the strip from which dust is gone after the change.
fn is_bared(x: f64, y: f64) -> bool {
    let (middle, along, half) = STRIP;
    let (dx, dy) = (x - middle.0, y - middle.1);
    (dx * along.0 + dy * along.1).abs() < half.0 && (dy * along.0 - dx * along.1).abs() < half.1
}

/// Returns the stone that is there after the change.
fn new_stone(salt: u32) -> Place {
    let ground_z = ground::plain(NEW_STONE.0, NEW_STONE.1, salt);
    Place {
        centre: v3(NEW_STONE.0, NEW_STONE.1, ground_z + 0.6 * NEW_HALF.z),
        half: NEW_HALF,
        yaw_rad: 0.7,
        tilt: (0.08, -0.05),
        ground_z,
    }
}

/// Returns random positions of rocks: the outcrop, its debris, the stones of the plain, distant boulders.
fn places(seed: u64, salt: u32) -> Vec<Place> {
    let mut rng = Rng::new(seed, 0x706c_6163);
    let mut all = outcrop(&mut rng, salt);
    for _ in 0..1500 {
        let (x, y) = (rng.normal() * 2.3, rng.normal() * 2.3);
        let size = power_law(&mut rng, 0.018, 0.20);
        all.extend(stone(&mut rng, [OUTCROP[0] + x, OUTCROP[1] + y], size, salt));
    }
    for _ in 0..7000 {
        let at = disc(&mut rng, 0.0, 17.0);
        let size = power_law(&mut rng, 0.018, 0.30);
        all.extend(stone(&mut rng, at, size, salt));
    }
    for _ in 0..1600 {
        let at = disc(&mut rng, 16.0, 80.0);
        let size = power_law(&mut rng, 0.07, 0.7);
        all.extend(stone(&mut rng, at, size, salt));
    }
    all
}

/// Returns a random size. The number of rocks larger than r falls as r^-2, as on Mars.
fn power_law(rng: &mut Rng, least_m: f64, most_m: f64) -> f64 {
    (least_m / rng.within(0.0, 1.0).max(1e-9).sqrt()).min(most_m)
}

fn disc(rng: &mut Rng, from_m: f64, to_m: f64) -> [f64; 2] {
    let radius = rng.within(from_m * from_m, to_m * to_m).sqrt();
    let (sin, cos) = sin_cos(rng.within(0.0, TAU));
    [OUTCROP[0] + radius * cos, OUTCROP[1] + radius * sin]
}

/// Returns the outcrop: broken, tilted slabs and blocks.
fn outcrop(rng: &mut Rng, salt: u32) -> Vec<Place> {
    let mut all = Vec::new();
    for index in 0..26 {
        let spread = if index < 12 { 0.75 } else { 1.5 };
        let (x, y) = (rng.normal() * spread, rng.normal() * spread);
        let at = [OUTCROP[0] + x, OUTCROP[1] + y];
        let wide = rng.within(0.22, 0.58) * if index < 12 { 1.0 } else { 0.75 };
        let slab = index % 3 != 0;
        let flat = if slab {
            rng.within(0.26, 0.42)
        } else {
            rng.within(0.55, 0.85)
        };
        let half = v3(wide, wide * rng.within(0.55, 0.9), wide * flat);
        let tilt = (rng.within(-0.35, 0.35), rng.within(-0.35, 0.35));
        let bury = [0.12, 0.3, 0.45, 0.2][index % 4];
        all.push(Place {
            tilt,
            ..place(rng, at, half, bury, salt)
        });
    }
    all
}

/// Returns a stone of the plain. `None` in drifted sand, unless it is large.
fn stone(rng: &mut Rng, at: [f64; 2], size: f64, salt: u32) -> Option<Place> {
    let half = v3(size, size * rng.within(0.6, 0.95), size * rng.within(0.4, 0.8));
    let tilt = (rng.within(-0.25, 0.25), rng.within(-0.25, 0.25));
    let bury = rng.within(0.1, 0.6);
    let buried_by_sand = rng.within(0.0, 1.0) < ground::sandiness(at[0], at[1], salt) * 0.94 && size < 0.11;
    let stone = Place {
        tilt,
        ..place(rng, at, half, bury, salt)
    };
    (!buried_by_sand).then_some(stone)
}

/// Returns an upright rock that is turned at random and buried by a share of its height.
fn place(rng: &mut Rng, at: [f64; 2], half: V3, bury: f64, salt: u32) -> Place {
    let ground_z = ground::plain(at[0], at[1], salt);
    Place {
        centre: v3(at[0], at[1], ground_z + half.z * (1.0 - 2.0 * bury)),
        half,
        yaw_rad: rng.within(0.0, TAU),
        tilt: (0.0, 0.0),
        ground_z,
    }
}
