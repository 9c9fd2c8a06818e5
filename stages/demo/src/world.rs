//! The place itself: what lies where, and what a ray sees of it.

use super::{
    ground::{self, FAR, Ground, OUTCROP},
    light::{self, TO_SUN},
    math::{Dice, V3, mix32, sin_cos, v3},
    rocks::{Place, Ray, Rocks},
};

const TURN: f64 = 2.0 * std::f64::consts::PI;
/// Farther off, a shadow is smaller than a pixel, metres.
const SHADOWS_M: f64 = 120.0;
/// Longest shadow, metres along the light.
const SHADOW_M: f64 = 6.0;

/// A piece of Mars; the same for every sol of a seed.
pub struct World {
    ground: Ground,
    rocks: Rocks,
    salt: u32,
}

/// What a ray meets.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sight {
    /// Linear RGB.
    pub light: V3,
    /// Metres along the ray; infinite for the sky.
    pub range_m: f64,
    /// What it is; where neighbours differ, there is an edge.
    pub what: Thing,
}

/// What is seen, and whether the sun reaches it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Thing {
    /// Sky or far hills.
    Sky,
    /// Sunlit ground.
    Ground,
    /// Ground in a cast shadow.
    ShadedGround,
    /// A sunlit rock, by number.
    Rock(usize),
    /// A rock in a cast shadow.
    ShadedRock(usize),
}

impl World {
    pub fn new(seed: u64) -> Self {
        let salt = mix32(seed as u32 ^ mix32((seed >> 32) as u32 ^ 0x6d61_7273));
        let rocks = Rocks::new(seed, &places(seed, salt));
        let ground = Ground::new(salt, &rocks.all);
        Self { ground, rocks, salt }
    }

    /// Height of the ground, metres up.
    pub fn height(&self, x: f64, y: f64) -> f64 {
        self.ground.height(x, y)
    }

    /// Slopes of the large forms along x and y.
    pub fn lie(&self, x: f64, y: f64) -> (f64, f64) {
        let plain = |dx: f64, dy: f64| ground::plain(x + dx, y + dy, self.salt);
        (
            plain(0.9, 0.0) - plain(-0.9, 0.0),
            plain(0.0, 0.9) - plain(0.0, -0.9),
        )
    }

    /// Looks along a ray; `pixel_rad` is the angle of a pixel, below which no detail is drawn.
    pub fn look(&self, from: V3, along: V3, pixel_rad: f64) -> Sight {
        let ray = Ray::new(from, along);
        let ground_m = self.ground.first(&ray);
        if let Some(hit) = self.rocks.first(&ray, ground_m.unwrap_or(FAR)) {
            return self.rock(&ray, hit, pixel_rad);
        }
        match ground_m.filter(|&range| range < FAR) {
            Some(range_m) => self.sand(&ray, range_m, pixel_rad),
            None => Sight {
                light: light::sky(along, self.salt),
                range_m: f64::INFINITY,
                what: Thing::Sky,
            },
        }
    }

    /// Returns the range alone, metres; infinite for the sky.
    pub fn range_m(&self, from: V3, along: V3) -> f64 {
        let ray = Ray::new(from, along);
        let ground = self.ground.first(&ray).filter(|&range| range < FAR);
        let rock = self.rocks.first(&ray, ground.unwrap_or(FAR));
        rock.map(|hit| hit.t).or(ground).unwrap_or(f64::INFINITY)
    }

    fn sand(&self, ray: &Ray, range_m: f64, pixel_rad: f64) -> Sight {
        let p = ray.at(range_m);
        let lie = self.ground.lie(p.x, p.y);
        let facing = -ray.along.dot(ground::normal_of(lie.slope.0, lie.slope.1));
        // A pixel is long on the ground; half-way between its two sides keeps detail without shimmer.
        let footprint_m = range_m * pixel_rad / facing.clamp(0.06, 1.0).sqrt();
        let skin = light::ground_skin(p.x, p.y, &lie, footprint_m, self.salt);
        // Only rocks cast shadows: the ground is gentler than the sun is high.
        let to_sun = Ray::new(p + v3(0.0, 0.0, 0.004), TO_SUN);
        let shaded = range_m < SHADOWS_M && self.rocks.shade_ground(&to_sun, SHADOW_M);
        let light = light::lit(&skin, if shaded { 0.0 } else { 1.0 }, lie.open);
        Sight {
            light: light::hazed(light, range_m),
            range_m,
            what: if shaded {
                Thing::ShadedGround
            } else {
                Thing::Ground
            },
        }
    }

    fn rock(&self, ray: &Ray, hit: super::rocks::RockHit, pixel_rad: f64) -> Sight {
        let rock = &self.rocks.all[hit.rock];
        let p = ray.at(hit.t);
        let skin = light::rock_skin(rock, p, hit.normal, hit.t * pixel_rad, self.salt);
        let turned_away = hit.normal.dot(TO_SUN) <= 0.0;
        let to_sun = Ray::new(p + hit.normal * 0.003, TO_SUN);
        let shaded = !turned_away && hit.t < SHADOWS_M && self.rocks.shade_rock(&to_sun, SHADOW_M);
        let light = light::lit(
            &skin,
            if shaded { 0.0 } else { 1.0 },
            light::rock_openness(rock, p),
        );
        Sight {
            light: light::hazed(light, hit.t),
            range_m: hit.t,
            what: if shaded {
                Thing::ShadedRock(hit.rock)
            } else {
                Thing::Rock(hit.rock)
            },
        }
    }
}

/// Draws where rocks lie: the outcrop, its debris, the stones of the plain, boulders far off.
fn places(seed: u64, salt: u32) -> Vec<Place> {
    let mut dice = Dice::new(seed, 0x706c_6163);
    let mut all = outcrop(&mut dice, salt);
    for _ in 0..1500 {
        let (x, y) = (dice.normal() * 2.3, dice.normal() * 2.3);
        let size = power_law(&mut dice, 0.018, 0.20);
        all.extend(stone(&mut dice, (OUTCROP.0 + x, OUTCROP.1 + y), size, salt));
    }
    for _ in 0..7000 {
        let at = disc(&mut dice, 0.0, 17.0);
        let size = power_law(&mut dice, 0.018, 0.30);
        all.extend(stone(&mut dice, at, size, salt));
    }
    for _ in 0..1600 {
        let at = disc(&mut dice, 16.0, 80.0);
        let size = power_law(&mut dice, 0.07, 0.7);
        all.extend(stone(&mut dice, at, size, salt));
    }
    all
}

/// How many are larger than r falls as r^-2, as counts on Mars roughly do.
fn power_law(dice: &mut Dice, least_m: f64, most_m: f64) -> f64 {
    (least_m / dice.within(0.0, 1.0).max(1e-9).sqrt()).min(most_m)
}

fn disc(dice: &mut Dice, from_m: f64, to_m: f64) -> (f64, f64) {
    let radius = dice.within(from_m * from_m, to_m * to_m).sqrt();
    let (sin, cos) = sin_cos(dice.within(0.0, TURN));
    (OUTCROP.0 + radius * cos, OUTCROP.1 + radius * sin)
}

/// Broken, tilted slabs and blocks that lean on each other.
fn outcrop(dice: &mut Dice, salt: u32) -> Vec<Place> {
    let mut all = Vec::new();
    for index in 0..26 {
        let spread = if index < 12 { 0.75 } else { 1.5 };
        let (x, y) = (dice.normal() * spread, dice.normal() * spread);
        let at = (OUTCROP.0 + x, OUTCROP.1 + y);
        let wide = dice.within(0.22, 0.58) * if index < 12 { 1.0 } else { 0.75 };
        let slab = index % 3 != 0;
        let flat = if slab {
            dice.within(0.26, 0.42)
        } else {
            dice.within(0.55, 0.85)
        };
        let half = v3(wide, wide * dice.within(0.55, 0.9), wide * flat);
        let tilt = (dice.within(-0.35, 0.35), dice.within(-0.35, 0.35));
        all.push(place(dice, at, half, tilt, dice_bury(index), salt));
    }
    all
}

fn dice_bury(index: usize) -> f64 {
    [0.12, 0.3, 0.45, 0.2][index % 4]
}

/// A stone of the plain; none where sand has drifted, unless it is large.
fn stone(dice: &mut Dice, at: (f64, f64), size: f64, salt: u32) -> Option<Place> {
    let half = v3(size, size * dice.within(0.6, 0.95), size * dice.within(0.4, 0.8));
    let tilt = (dice.within(-0.25, 0.25), dice.within(-0.25, 0.25));
    let bury = dice.within(0.1, 0.6);
    let buried_by_sand = dice.within(0.0, 1.0) < ground::sandiness(at.0, at.1, salt) * 0.94 && size < 0.11;
    let stone = place(dice, at, half, tilt, bury, salt);
    (!buried_by_sand).then_some(stone)
}

fn place(dice: &mut Dice, at: (f64, f64), half: V3, tilt: (f64, f64), bury: f64, salt: u32) -> Place {
    let ground_z = ground::plain(at.0, at.1, salt);
    Place {
        centre: v3(at.0, at.1, ground_z + half.z * (1.0 - 2.0 * bury)),
        half,
        yaw_rad: dice.within(0.0, TURN),
        tilt,
        ground_z,
    }
}
