//! Rocks: convex polyhedra in a bounding volume hierarchy.

use super::math::{Rng, V3, Vector, sin_cos, v3};

/// Planes that cut the corners of a shape, in addition to the six of its box.
const CUTS: usize = 18;
const PLANES: usize = CUTS + 6;
const SHAPES: usize = 48;
/// Margin of the boxes for rounding in single precision, metres.
const SLACK_M: f64 = 0.002;

/// A convex polyhedron in [-1, 1]³: normal · p <= reach for every plane.
struct Shape {
    nx: [f64; PLANES],
    ny: [f64; PLANES],
    nz: [f64; PLANES],
    reach: [f64; PLANES],
}

/// One rock: a scaled, rotated and placed shape.
#[derive(Debug, Clone)]
pub struct Rock {
    pub centre: V3,
    /// Rows of `rock_from_world`.
    rows: [V3; 3],
    /// Half extents along the rock's own axes, metres.
    pub half: V3,
    inverse_half: V3,
    shape: usize,
    /// Seed of its colour and texture.
    pub salt: u32,
    /// Height of the ground at its centre, metres.
    pub ground_z: f64,
}

/// Position, size and attitude of a rock.
pub struct Place {
    pub centre: V3,
    pub half: V3,
    pub yaw_rad: f64,
    /// Tilt as slopes along the rock's x and y.
    pub tilt: (f64, f64),
    pub ground_z: f64,
}

/// The first intersection of a ray with a rock.
#[derive(Debug, Clone, Copy)]
pub struct RockHit {
    pub t: f64,
    pub rock: usize,
    /// Outward normal, smoothed at edges.
    pub normal: V3,
}

pub struct Rocks {
    shapes: Vec<Shape>,
    pub all: Vec<Rock>,
    nodes: Vec<Node>,
}

/// A node of the hierarchy. Single precision halves the memory, and the exact test follows at the rock.
struct Node {
    low: [f32; 3],
    high: [f32; 3],
    /// Index of an inner node's second child (the first follows the node), or of a leaf's rock.
    next: u32,
    kind: Kind,
}

#[derive(Clone, Copy, PartialEq)]
enum Kind {
    Leaf,
    ForkAlongX,
    ForkAlongY,
}

/// A ray with the values that the box test needs.
#[derive(Clone, Copy)]
pub struct Ray {
    pub from: V3,
    pub along: V3,
    start: [f32; 3],
    inverse: [f32; 3],
}

impl Ray {
    pub fn new(from: V3, along: V3) -> Self {
        // A component of exactly zero would give 0 · inf. A tiny one gives a very large number instead.
        let inverse = |d: f64| (1.0 / if d.abs() < 1e-30 { 1e-30 } else { d }) as f32;
        Self {
            from,
            along,
            start: from.map(|number| number as f32).into(),
            inverse: along.map(inverse).into(),
        }
    }

    pub fn at(&self, t: f64) -> V3 {
        self.from + self.along * t
    }

    fn meets(&self, node: &Node, limit: f32) -> bool {
        let (mut enter, mut leave) = (0.0_f32, limit);
        for axis in 0..3 {
            let a = (node.low[axis] - self.start[axis]) * self.inverse[axis];
            let b = (node.high[axis] - self.start[axis]) * self.inverse[axis];
            let (near, far) = if a < b { (a, b) } else { (b, a) };
            enter = if near > enter { near } else { enter };
            leave = if far < leave { far } else { leave };
        }
        enter <= leave
    }
}

impl Rock {
    fn new(place: &Place, shape: usize, salt: u32) -> Self {
        let (sin, cos) = sin_cos(place.yaw_rad);
        let up = v3(place.tilt.0, place.tilt.1, 1.0).unit();
        let heading = v3(cos, sin, 0.0);
        let x = (heading - up * heading.dot(&up)).unit();
        Self {
            centre: place.centre,
            rows: [x, up.cross(&x), up],
            half: place.half,
            inverse_half: v3(1.0 / place.half.x, 1.0 / place.half.y, 1.0 / place.half.z),
            shape,
            salt,
            ground_z: place.ground_z,
        }
    }

    /// Returns a world vector in the rock's axes, metres.
    pub fn local(&self, p: V3) -> V3 {
        v3(self.rows[0].dot(&p), self.rows[1].dot(&p), self.rows[2].dot(&p))
    }

    pub fn world(&self, p: V3) -> V3 {
        self.rows[0] * p.x + self.rows[1] * p.y + self.rows[2] * p.z
    }

    /// Returns the half extents of its bounding box along the world's axes.
    fn reach(&self) -> V3 {
        let [x, y, z] = self.rows.map(|row| row.abs());
        x * self.half.x + y * self.half.y + z * self.half.z
    }
}

impl Shape {
    fn new(rng: &mut Rng) -> Self {
        let mut shape = Self {
            nx: [0.0; PLANES],
            ny: [0.0; PLANES],
            nz: [0.0; PLANES],
            reach: [1.0; PLANES],
        };
        let axes = [&mut shape.nx, &mut shape.ny, &mut shape.nz];
        for (i, axis) in axes.into_iter().enumerate() {
            axis[2 * i] = 1.0;
            axis[2 * i + 1] = -1.0;
        }
        for i in 6..PLANES {
            let mut normal = rng.direction();
            // Fresh breaks are steep: flatten half of the cuts towards the horizon.
            if i % 2 == 0 {
                normal = v3(normal.x, normal.y, normal.z * 0.3).unit();
            }
            (shape.nx[i], shape.ny[i], shape.nz[i]) = (normal.x, normal.y, normal.z);
            shape.reach[i] = rng.within(0.62, 0.98);
        }
        shape
    }

    /// Returns the distance at which a ray enters, if below `limit`. 0 if it starts inside.
    fn enter(&self, from: V3, along: V3, limit: f64) -> Option<f64> {
        let (mut enter, mut leave) = (0.0_f64, limit);
        // Six planes at a time without a branch, which vectorises. The box's planes come first and reject
        // most rays.
        for first in (0..PLANES).step_by(6) {
            for i in first..first + 6 {
                let speed = self.nx[i] * along.x + self.ny[i] * along.y + self.nz[i] * along.z;
                let distance =
                    self.reach[i] - (self.nx[i] * from.x + self.ny[i] * from.y + self.nz[i] * from.z);
                // Parallel rays give ±inf, which is right inside and outside. On the plane itself NaN changes
                // nothing.
                let t = distance / speed;
                let (entry, exit) = if speed < 0.0 { (t, f64::INFINITY) } else { (0.0, t) };
                enter = if entry > enter { entry } else { enter };
                leave = if exit < leave { exit } else { leave };
            }
            if enter > leave {
                return None;
            }
        }
        (leave > 0.0).then_some(enter)
    }

    /// Returns the outward normal at a surface point, blended with planes close by: edges look worn.
    fn normal(&self, p: V3, wear: f64) -> V3 {
        let gap = |i: usize| self.reach[i] - (self.nx[i] * p.x + self.ny[i] * p.y + self.nz[i] * p.z);
        let least = (0..PLANES).map(gap).fold(f64::INFINITY, f64::min);
        (0..PLANES).fold(V3::zeros(), |sum, i| {
            let weight = (1.0 - (gap(i) - least) / wear).max(0.0);
            sum + v3(self.nx[i], self.ny[i], self.nz[i]) * (weight * weight)
        })
    }
}

impl Rocks {
    pub fn new(seed: u64, places: &[Place]) -> Self {
        let mut rng = Rng::new(seed, 0x726f_636b);
        let shapes = (0..SHAPES).map(|_| Shape::new(&mut rng)).collect();
        let mut all: Vec<Rock> = places
            .iter()
            .map(|place| {
                let bits = rng.bits();
                Rock::new(place, (bits >> 32) as usize % SHAPES, bits as u32)
            })
            .collect();
        let mut nodes = Vec::new();
        let count = all.len();
        grow(&mut nodes, &mut all, 0, count);
        Self { shapes, all, nodes }
    }

    /// Returns the first intersection of a ray with a rock, if before `limit`.
    pub fn first(&self, ray: &Ray, limit: f64) -> Option<RockHit> {
        let mut best: Option<(f64, usize)> = None;
        self.visit(ray, limit, |t, rock| {
            best = Some((t, rock));
            Some(t)
        });
        let (t, rock) = best?;
        Some(RockHit {
            t,
            rock,
            normal: self.normal(rock, ray.at(t)),
        })
    }

    /// Returns whether a ray that starts at or in the ground meets a rock, or starts inside one.
    pub fn shade_ground(&self, ray: &Ray, limit: f64) -> bool {
        self.blocks(ray, 0.0, limit)
    }

    /// Returns whether a ray that starts on a rock meets another rock.
    pub fn shade_rock(&self, ray: &Ray, limit: f64) -> bool {
        self.blocks(ray, f64::MIN_POSITIVE, limit)
    }

    fn blocks(&self, ray: &Ray, nearest: f64, limit: f64) -> bool {
        let mut blocked = false;
        self.visit(ray, limit, |t, _| {
            blocked |= t >= nearest;
            (!blocked).then_some(limit)
        });
        blocked
    }

    fn normal(&self, index: usize, point: V3) -> V3 {
        let rock = &self.all[index];
        let local = rock.local(point - rock.centre).component_mul(&rock.inverse_half);
        let normal = self.shapes[rock.shape].normal(local, 0.10);
        rock.world(normal.component_mul(&rock.inverse_half)).unit()
    }

    /// Calls `hit` for intersections before the limit it last returned. `None` ends the traversal.
    fn visit(&self, ray: &Ray, mut limit: f64, mut hit: impl FnMut(f64, usize) -> Option<f64>) {
        let mut stack = [0_u32; 48];
        let mut depth = 1;
        while depth > 0 && !self.nodes.is_empty() {
            depth -= 1;
            let at = stack[depth] as usize;
            let node = &self.nodes[at];
            if !ray.meets(node, limit as f32 * 1.000_01) {
                continue;
            }
            if node.kind != Kind::Leaf {
                let ahead = match node.kind {
                    Kind::ForkAlongX => ray.along.x > 0.0,
                    _ => ray.along.y > 0.0,
                };
                let (first, second) = (at as u32 + 1, node.next);
                stack[depth] = if ahead { second } else { first };
                stack[depth + 1] = if ahead { first } else { second };
                depth += 2;
                continue;
            }
            let index = node.next as usize;
            if let Some(t) = self.enter(index, ray, limit) {
                match hit(t, index) {
                    Some(nearer) => limit = nearer,
                    None => return,
                }
            }
        }
    }

    fn enter(&self, index: usize, ray: &Ray, limit: f64) -> Option<f64> {
        let rock = &self.all[index];
        let from = rock
            .local(ray.from - rock.centre)
            .component_mul(&rock.inverse_half);
        let along = rock.local(ray.along).component_mul(&rock.inverse_half);
        self.shapes[rock.shape].enter(from, along, limit)
    }
}

fn bounds(rocks: &[Rock]) -> (V3, V3) {
    let (mut low, mut high) = (v3(1e9, 1e9, 1e9), v3(-1e9, -1e9, -1e9));
    for rock in rocks {
        let reach = rock.reach();
        let (a, b) = (rock.centre - reach, rock.centre + reach);
        low = v3(low.x.min(a.x), low.y.min(a.y), low.z.min(a.z));
        high = v3(high.x.max(b.x), high.y.max(b.y), high.z.max(b.z));
    }
    (low, high)
}

/// Builds the hierarchy over `all[from..to]`, sorting it in place. The longer axis is split at its median
/// rock.
fn grow(nodes: &mut Vec<Node>, all: &mut [Rock], from: usize, to: usize) {
    if from == to {
        return;
    }
    let slack = v3(SLACK_M, SLACK_M, SLACK_M);
    let (low, high) = bounds(&all[from..to]);
    let along_x = high.x - low.x > high.y - low.y;
    let at = nodes.len();
    nodes.push(Node {
        low: (low - slack).map(|number| number as f32).into(),
        high: (high + slack).map(|number| number as f32).into(),
        next: from as u32,
        kind: Kind::Leaf,
    });
    if to == from + 1 {
        return;
    }
    nodes[at].kind = if along_x {
        Kind::ForkAlongX
    } else {
        Kind::ForkAlongY
    };
    let key = |rock: &Rock| if along_x { rock.centre.x } else { rock.centre.y };
    all[from..to].sort_by(|a, b| key(a).total_cmp(&key(b)));
    let middle = from + (to - from) / 2;
    grow(nodes, all, from, middle);
    nodes[at].next = nodes.len() as u32;
    grow(nodes, all, middle, to);
}

#[cfg(test)]
mod tests {
    use super::*;

    fn field() -> Rocks {
        let mut rng = Rng::new(5, 5);
        let places: Vec<Place> = (0..400)
            .map(|_| Place {
                centre: v3(rng.within(-5.0, 5.0), rng.within(-5.0, 5.0), 0.0),
                half: v3(rng.within(0.05, 0.4), 0.2, 0.15),
                yaw_rad: rng.within(0.0, 6.0),
                tilt: (0.1, -0.2),
                ground_z: 0.0,
            })
            .collect();
        Rocks::new(5, &places)
    }

    /// The hierarchy finds what a test of every rock finds.
    #[test]
    fn the_tree_misses_no_rock() {
        let rocks = field();
        let mut rng = Rng::new(1, 2);
        let mut hits = 0;
        for _ in 0..500 {
            let from = v3(rng.within(-6.0, 6.0), rng.within(-6.0, 6.0), 1.0);
            let ray = Ray::new(from, (rng.direction() + v3(0.0, 0.0, -0.8)).unit());
            let every = (0..rocks.all.len()).filter_map(|index| rocks.enter(index, &ray, 1e9));
            let nearest = every.fold(f64::INFINITY, f64::min);
            let found = rocks.first(&ray, 1e9).map_or(f64::INFINITY, |hit| hit.t);
            assert_eq!(found.to_bits(), nearest.to_bits(), "{from:?}");
            assert_eq!(rocks.shade_ground(&ray, 1e9), found.is_finite());
            hits += usize::from(found.is_finite());
        }
        assert!(hits > 100, "only {hits} of 500 rays met a rock");
    }

    #[test]
    fn normals_face_the_viewer() {
        let rocks = field();
        let mut rng = Rng::new(3, 4);
        for _ in 0..500 {
            let from = v3(rng.within(-6.0, 6.0), rng.within(-6.0, 6.0), 2.0);
            let ray = Ray::new(from, v3(0.0, 0.6, -0.8));
            if let Some(hit) = rocks.first(&ray, 1e9) {
                assert!(hit.normal.dot(&ray.along) < 0.35, "{:?}", hit.normal);
                assert!((hit.normal.norm() - 1.0).abs() < 1e-12);
            }
        }
    }
}
