//! The depths of all photos from above: a height map and an orthophoto with standard deviations.

use std::collections::BTreeMap;

use marf_surface::{ExportFrame, MapAxes, MapCell, MapGrid, SurfaceError, SurfaceMap, covered_pixels};
use nalgebra::{Vector2, Vector3};

use crate::surfels::Surfel;

/// Pixels along a side of a tile.
const SIDE: i32 = 32;
/// Most tiles, 64 KB each. With more, pixels get twice as wide.
const MOST_TILES: usize = 3000;
/// Most pixels of a map, 40 bytes each while it is written.
const MOST_PIXELS: i64 = 8_000_000;
/// Heights within this many standard deviations, or pixels, are one surface.
const SAME_SIGMAS: f32 = 3.0;
const SAME_PIXELS: f32 = 1.0;
/// Corners of a triangle are this many pixels apart at most: farther ones are of two surfaces, or far too coarse.
const WIDEST_PX: f64 = 8.0;
/// Two corners lie on one surface if each is this near to the plane of the other, as a share of their distance.
const BENT: f64 = 0.5;
/// A higher surface counts if it has this share of the weight of a lower one.
const LEAST_SHARE: f32 = 0.2;
/// What the spread of the map is.
const SIGMA_WORDS: &str = "standard deviation of the height";

/// A surface in a pixel: sums over the triangles of all photos.
#[derive(Debug, Clone, Copy, Default)]
struct Layer {
    /// Metres, times weight.
    height: f32,
    color: Vector3<f32>,
    /// 1 / m^2.
    weight: f32,
    /// Photos, the last of them counted from 1, and its weight.
    photos: u16,
    last: u16,
    last_weight: f32,
    confirmed: bool,
}

/// A sample of a triangle at the centre of a pixel.
#[derive(Clone, Copy)]
struct Sample {
    height: f32,
    color: Vector3<f32>,
    weight: f32,
    photo: u16,
    /// Photos that show it: 1, or those of a layer.
    photos: u16,
    confirmed: bool,
}

impl Layer {
    fn mean(&self) -> f32 {
        self.height / self.weight
    }

    /// Returns the variance of the mean, m^2. A pair gives its disparities to both of its photos, so their weights hold each pair twice.
    fn variance(&self) -> f32 {
        f32::from(self.photos.min(2)) / self.weight
    }

    fn holds(&self, sample: &Sample, pixel_m: f32) -> bool {
        let sigma = (self.variance() + f32::from(sample.photos.min(2)) / sample.weight).sqrt();
        (self.mean() - sample.height).abs() <= (SAME_SIGMAS * sigma).max(SAME_PIXELS * pixel_m)
    }

    /// Adds a sample. Several of one photo share their errors: only the largest weight counts.
    fn add(&mut self, sample: &Sample) {
        if self.last == sample.photo {
            self.photos = self.photos.max(sample.photos);
            if sample.weight <= self.last_weight {
                return;
            }
            let more = sample.weight - self.last_weight;
            self.sum(sample, more);
            self.last_weight = sample.weight;
            return;
        }
        self.sum(sample, sample.weight);
        self.photos = self.photos.saturating_add(1).max(sample.photos);
        (self.last, self.last_weight) = (sample.photo, sample.weight);
    }

    fn sum(&mut self, sample: &Sample, weight: f32) {
        self.height += sample.height * weight;
        self.color += sample.color * weight;
        self.weight += weight;
        self.confirmed |= sample.confirmed;
    }
}

/// The first and the last row and column of tiles.
struct Extent {
    first: [i32; 2],
    last: [i32; 2],
}

impl Extent {
    fn pixels(&self) -> i64 {
        let side = |i: usize| i64::from(self.last[i] - self.first[i] + 1) * i64::from(SIDE);
        side(0) * side(1)
    }
}

/// Two surfaces a pixel, an overhang and the ground below.
type Tile = Vec<[Layer; 2]>;

/// A map that grows photo by photo.
#[derive(Clone)]
pub(crate) struct Ground {
    pub pixel_m: f64,
    /// Whether pixels may get wider.
    fixed: bool,
    axes: MapAxes,
    metres: f64,
    origin_m: Vector3<f64>,
    /// By row and column of tiles, counted from the origin to the top and to the right.
    tiles: BTreeMap<[i32; 2], Tile>,
    photos: u16,
}

impl Ground {
    /// Returns an empty map. `fixed`: the width of a pixel in metres that the user asked for. Otherwise it is `cell`, units of the world.
    ///
    /// # Errors
    /// [`SurfaceError::Refused`] for a scene without scale or up.
    pub fn new(frame: &ExportFrame, fixed: Option<f64>, cell: f64) -> Result<Self, SurfaceError> {
        let (axes, metres) = frame.metric_map("the height map")?;
        Ok(Self {
            pixel_m: fixed.unwrap_or(cell * metres),
            fixed: fixed.is_some(),
            axes,
            metres,
            origin_m: frame.origin_m(),
            tiles: BTreeMap::new(),
            photos: 0,
        })
    }

    /// Adds the surface between the points of a photo, `[height * width]`.
    ///
    /// # Errors
    /// [`SurfaceError::Refused`] if pixels of the width that the user asked for are too many.
    pub fn add(&mut self, surfels: &[Option<Surfel>], width: usize) -> Result<(), SurfaceError> {
        self.photos += 1;
        for (index, pair) in surfels.windows(2).enumerate() {
            if (index + 1) % width == 0 || index + width + 1 >= surfels.len() {
                continue;
            }
            let below = &surfels[index + width..index + width + 2];
            for corners in [[pair[0], below[0], pair[1]], [pair[1], below[0], below[1]]] {
                if let [Some(a), Some(b), Some(c)] = corners {
                    self.draw([&a, &b, &c]);
                }
            }
            while self.tiles.len() > MOST_TILES {
                self.widen()?;
            }
        }
        Ok(())
    }

    /// Makes pixels twice as wide, unless the user asked for their width.
    fn widen(&mut self) -> Result<(), SurfaceError> {
        if self.fixed {
            return Err(SurfaceError::Refused {
                what: "the height map",
                why: format!("pixels of {} m are too many; widen `map_cell`", self.pixel_m),
            });
        }
        self.coarsen();
        Ok(())
    }

    /// Draws the triangle between three neighbours, if they are on one surface.
    fn draw(&mut self, corners: [&Surfel; 3]) {
        let at = corners.map(|corner| {
            let place = corner.position * self.metres + self.origin_m;
            self.axes.place(&place)
        });
        let low = at[0].inf(&at[1]).inf(&at[2]) / self.pixel_m;
        let high = at[0].sup(&at[1]).sup(&at[2]) / self.pixel_m;
        let (first, last) = (
            (low.xy().add_scalar(-0.5)).map(f64::ceil),
            (high.xy().add_scalar(-0.5)).map(f64::floor),
        );
        if first.x > last.x
            || first.y > last.y
            || (high.xy() - low.xy()).max() > WIDEST_PX
            || !is_smooth(corners)
        {
            return;
        }
        let size = last - first + Vector2::repeat(1.0);
        let (columns, rows) = (size.x as u32, size.y as u32);
        for pixel in covered_pixels(&at, self.pixel_m, &first, columns, rows) {
            let shares = pixel.shares;
            let mean = |value: &dyn Fn(usize) -> f64| (0..3).map(|i| shares[i] * value(i)).sum::<f64>();
            let sigma = mean(&|i| corners[i].height_sigma) * self.metres;
            let color = |channel: usize| mean(&|i| f64::from(corners[i].color[channel])) as f32;
            let sample = Sample {
                height: mean(&|i| at[i].z) as f32,
                color: Vector3::new(color(0), color(1), color(2)),
                weight: (1.0 / (sigma * sigma)) as f32,
                photo: self.photos,
                photos: 1,
                confirmed: corners.iter().all(|corner| corner.confirmed),
            };
            let column = first.x as i32 + pixel.column as i32;
            let row = first.y as i32 + (rows - 1 - pixel.row) as i32;
            self.put([row, column], &sample);
        }
    }

    /// Adds a sample to the layer of its height, or to an empty one, or in place of a lighter one.
    fn put(&mut self, place: [i32; 2], sample: &Sample) {
        let pixel_m = self.pixel_m as f32;
        let layers = self.layers(place);
        if let Some(layer) = layers
            .iter_mut()
            .find(|layer| layer.weight > 0.0 && layer.holds(sample, pixel_m))
        {
            layer.add(sample);
            return;
        }
        let [a, b] = layers;
        let lighter = if b.weight < a.weight { b } else { a };
        if lighter.weight < sample.weight && (sample.confirmed || !lighter.confirmed) {
            *lighter = Layer::default();
            lighter.add(sample);
        }
    }

    fn layers(&mut self, [row, column]: [i32; 2]) -> &mut [Layer; 2] {
        let tile = [row.div_euclid(SIDE), column.div_euclid(SIDE)];
        let inside = row.rem_euclid(SIDE) * SIDE + column.rem_euclid(SIDE);
        let empty = || vec![[Layer::default(); 2]; (SIDE * SIDE) as usize];
        &mut self.tiles.entry(tile).or_insert_with(empty)[inside as usize]
    }

    /// Returns the rows and columns of tiles.
    fn extent(&self) -> Option<Extent> {
        let one = |tile: &[i32; 2]| Extent {
            first: *tile,
            last: *tile,
        };
        self.tiles.keys().map(one).reduce(|a, b| Extent {
            first: [0, 1].map(|i| a.first[i].min(b.first[i])),
            last: [0, 1].map(|i| a.last[i].max(b.last[i])),
        })
    }

    fn coarsen(&mut self) {
        self.pixel_m *= 2.0;
        let fine = std::mem::take(&mut self.tiles);
        for ([tile_row, tile_column], tile) in fine {
            for (inside, layers) in (0_i32..).zip(tile) {
                let place = [
                    tile_row * SIDE + inside / SIDE,
                    tile_column * SIDE + inside % SIDE,
                ];
                for layer in layers.iter().filter(|layer| layer.weight > 0.0) {
                    let sample = Sample {
                        height: layer.mean(),
                        color: layer.color / layer.weight,
                        weight: layer.weight,
                        photo: layer.last,
                        photos: layer.photos,
                        confirmed: layer.confirmed,
                    };
                    self.put(place.map(|x| x.div_euclid(2)), &sample);
                }
            }
        }
    }

    /// Returns the map: in each pixel the higher surface, unless it has hardly any weight. If anything is confirmed, surfaces that only
    /// one pair shows are left out.
    ///
    /// # Errors
    /// [`SurfaceError::Refused`] without any surface, and if pixels of the width that the user asked for are too many.
    pub fn map(mut self, frame: &ExportFrame) -> Result<SurfaceMap, SurfaceError> {
        let extent = loop {
            let extent = self.extent().ok_or_else(|| SurfaceError::Refused {
                what: "the height map",
                why: "no photo shows a surface near enough".to_owned(),
            })?;
            if extent.pixels() <= MOST_PIXELS {
                break extent;
            }
            self.widen()?;
        };
        let Extent { first, last } = extent;
        let ([bottom, left], [top, right]) = (first, last);
        let layers = || self.tiles.values().flatten().flatten();
        let has_confirmed = layers().any(is_firm);
        let (columns, rows) = ((right - left + 1) * SIDE, (top - bottom + 1) * SIDE);
        let mut cells = vec![None; columns as usize * rows as usize];
        for (tile, values) in &self.tiles {
            for (inside, layers) in (0_i32..).zip(values) {
                let row = rows - 1 - ((tile[0] - bottom) * SIDE + inside / SIDE);
                let column = (tile[1] - left) * SIDE + inside % SIDE;
                cells[(row * columns + column) as usize] = shown(layers, has_confirmed);
            }
        }
        let grid = MapGrid {
            pixel_m: self.pixel_m,
            first: Vector2::new(f64::from(left * SIDE), f64::from(bottom * SIDE)),
            columns: columns as u32,
            rows: rows as u32,
        };
        SurfaceMap::from_cells(frame, grid, cells, SIGMA_WORDS)
    }
}

fn is_firm(layer: &Layer) -> bool {
    layer.confirmed || layer.photos > 1
}

/// Returns the surface of a pixel that the map shows.
fn shown(layers: &[Layer; 2], has_confirmed: bool) -> Option<MapCell> {
    let known = || {
        let known = layers.iter().filter(|layer| layer.weight > 0.0);
        known.filter(|layer| !has_confirmed || is_firm(layer))
    };
    let most = known().map(|layer| layer.weight).fold(0.0, f32::max);
    let heavy = known().filter(|layer| layer.weight >= LEAST_SHARE * most);
    let layer = heavy.max_by(|a, b| a.mean().total_cmp(&b.mean()))?;
    Some(MapCell {
        height_m: f64::from(layer.mean()),
        color: (layer.color / (layer.weight * 255.0)).into(),
        spread_m: f64::from(layer.variance().sqrt()),
    })
}

/// Returns whether neighbours lie near the planes of each other.
fn is_smooth(corners: [&Surfel; 3]) -> bool {
    let near = |a: &Surfel, b: &Surfel| {
        let between = b.position - a.position;
        a.normal.dot(&between).abs() <= BENT * between.norm()
    };
    let [a, b, c] = corners;
    [(a, b), (b, c), (c, a)]
        .iter()
        .all(|(a, b)| near(a, b) || near(b, a))
}

#[cfg(test)]
mod tests;
