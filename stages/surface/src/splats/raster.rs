//! Pictures of splats: their footprints on the image plane, blended from front to back.

use marf_scene::{Camera, Pose};
use nalgebra::Matrix2x3;
use rayon::prelude::*;

use super::{Splat, THIN};

/// Variance that is added to a footprint, pixels²: no footprint is narrower than a pixel (the reference code
/// of 3-D Gaussian splatting).
const LOW_PASS: f64 = 0.3;
/// Largest share of the light that one splat takes, and smallest that is drawn (the same).
const MOST_ALPHA: f32 = 0.99;
const LEAST_ALPHA: f32 = 1.0 / 255.0;
/// A pixel that less light than this passes is done (the same).
const DARK: f32 = 1e-4;
/// Standard deviations to the edge of a footprint: √(2 ln(255 · 0.99)) = 3.327, beyond which none has the least alpha.
const EDGE: f64 = 3.33;
/// The affine approximation is taken at most this share outside of the picture (the same).
const OUTSIDE: f64 = 1.3;
/// Standard deviations between a splat and the camera's plane: of nearer ones the affine approximation says nothing.
const NEAR: f64 = 3.0;
/// Side of a tile, pixels.
const TILE: usize = 16;

/// The footprint of a splat on the image plane.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Footprint {
    /// Centre, pixels.
    pub at: [f32; 2],
    /// Σ' = [[xx, xy], [xy, yy]], pixels².
    pub covariance: [f64; 3],
    /// Distance along the optical axis, world units.
    pub depth: f32,
    /// The splat.
    pub index: u32,
}

impl Footprint {
    /// Projects a splat: Σ' = J W Σ Wᵀ Jᵀ + 0.3 I, with the rotation W of the camera, the Jacobian J of the
    /// projection at the centre of the splat and Σ = σ² (I - n nᵀ) + t² n nᵀ. Sources: Zwicker et al., EWA
    /// Splatting, TVCG 2002, eq. 24 to 31. Kerbl et al., 3D Gaussian Splatting, SIGGRAPH 2023, eq. 5, and its
    /// reference code for 0.3. The distortion of the lens moves the centre but is left out of J.
    ///
    /// None behind the camera, or too near to it for the approximation.
    pub fn project(index: u32, splat: &Splat, camera: &Camera, cam_from_world: &Pose) -> Option<Self> {
        let centre = cam_from_world.point(&splat.position);
        if centre.z <= NEAR * splat.sigma {
            return None;
        }
        let at = camera.project(&centre)?;
        let within = |share: f64, side: u32, focal_px: f64| {
            let most = OUTSIDE * f64::from(side) / focal_px;
            share.clamp(-most, most)
        };
        let x = within(centre.x / centre.z, camera.width, camera.fx_px);
        let y = within(centre.y / centre.z, camera.height, camera.fy_px);
        let (fx, fy) = (camera.fx_px / centre.z, camera.fy_px / centre.z);
        let jacobian = Matrix2x3::new(fx, 0.0, -fx * x, 0.0, fy, -fy * y);
        let normal = jacobian * cam_from_world.direction(&splat.normal);
        let (wide, thin) = (
            splat.sigma * splat.sigma,
            (THIN * splat.sigma) * (THIN * splat.sigma),
        );
        let flat = jacobian * jacobian.transpose() * wide - normal * normal.transpose() * (wide - thin);
        Some(Self {
            at: [at.x as f32, at.y as f32],
            covariance: [flat[(0, 0)] + LOW_PASS, flat[(0, 1)], flat[(1, 1)] + LOW_PASS],
            depth: centre.z as f32,
            index,
        })
    }

    /// Returns the pixels that it may touch, first and one past the last, of columns and of rows. `None`
    /// outside of the picture.
    fn pixels(&self, camera: &Camera) -> Option<[std::ops::Range<usize>; 2]> {
        let [xx, _, yy] = self.covariance;
        let along = |at: f32, variance: f64, side: u32| {
            let reach = EDGE * variance.sqrt();
            let first = (f64::from(at) - reach - 0.5).ceil().clamp(0.0, f64::from(side));
            let past = (f64::from(at) + reach + 0.5).floor().clamp(0.0, f64::from(side));
            (first < past).then_some(first as usize..past as usize)
        };
        Some([
            along(self.at[0], xx, camera.width)?,
            along(self.at[1], yy, camera.height)?,
        ])
    }

    /// Returns the inverse of Σ': what the power of the Gaussian is computed with.
    fn conic(&self) -> [f32; 3] {
        let [xx, xy, yy] = self.covariance;
        let determinant = xx * yy - xy * xy;
        [yy / determinant, -xy / determinant, xx / determinant].map(|value| value as f32)
    }
}

/// Contribution of a splat to a pixel.
#[derive(Debug, Clone, Copy)]
pub struct Share {
    /// The splat.
    pub index: u32,
    /// Pixel of the picture.
    pub pixel: u32,
    /// α T: its part of the light that reaches the pixel, in [0, 0.99].
    pub weight: f32,
}

/// Splats as a camera sees them, in tiles.
#[derive(Debug)]
pub struct Raster {
    camera: Camera,
    /// From near to far.
    footprints: Vec<Footprint>,
    /// Of each tile those that touch it, from near to far.
    tiles: Vec<Vec<u32>>,
}

impl Raster {
    /// Projects splats and sorts them by depth, equal ones by their place in the list.
    pub fn new(splats: &[Splat], camera: &Camera, cam_from_world: &Pose) -> Self {
        let all = splats.par_iter().enumerate();
        let seen = all.filter_map(|(index, splat)| {
            let footprint = Footprint::project(index as u32, splat, camera, cam_from_world)?;
            footprint.pixels(camera).map(|_| footprint)
        });
        let mut footprints: Vec<Footprint> = seen.collect();
        footprints.par_sort_by(|a, b| a.depth.total_cmp(&b.depth).then(a.index.cmp(&b.index)));
        let columns = (camera.width as usize).div_ceil(TILE);
        let mut tiles = vec![Vec::new(); columns * (camera.height as usize).div_ceil(TILE)];
        for (place, footprint) in (0_u32..).zip(&footprints) {
            let Some([across, down]) = footprint.pixels(camera) else {
                continue;
            };
            for row in down.start / TILE..down.end.div_ceil(TILE) {
                for column in across.start / TILE..across.end.div_ceil(TILE) {
                    tiles[row * columns + column].push(place);
                }
            }
        }
        Self {
            camera: *camera,
            footprints,
            tiles,
        }
    }

    /// Maps each tile with `of_tile`, in the order of the tiles. `of_tile` gets the contributions of splats
    /// to the tile's pixels, those of one pixel from front to back.
    pub fn map_tiles<T: Send>(&self, splats: &[Splat], of_tile: impl Fn(&[Share]) -> T + Sync) -> Vec<T> {
        let tiles = (0..self.tiles.len()).into_par_iter();
        tiles.map(|tile| of_tile(&self.shares(splats, tile))).collect()
    }

    /// Returns the picture before black, `[height * width]`, sRGB: C = Σᵢ cᵢ αᵢ Πⱼ (1 - αⱼ), j before i (3D Gaussian Splatting, eq. 3). Colours
    /// are blended as they are, in sRGB, as viewers do.
    pub fn picture(&self, splats: &[Splat]) -> Vec<[f32; 3]> {
        let tiles = self.map_tiles(splats, |shares| self.blended(splats, shares));
        let width = self.camera.width as usize;
        let columns = width.div_ceil(TILE);
        let pixels = 0..width * self.camera.height as usize;
        let of_pixel = |pixel: usize| {
            let (column, row) = (pixel % width, pixel / width);
            tiles[row / TILE * columns + column / TILE][self.slot(pixel as u32)]
        };
        pixels.map(of_pixel).collect()
    }

    /// Returns the colours of a tile's pixels, at their [`slot`](Self::slot), of what splats add to them.
    pub fn blended(&self, splats: &[Splat], shares: &[Share]) -> Vec<[f32; 3]> {
        let mut colors = vec![[0.0; 3]; TILE * TILE];
        for share in shares {
            let more = splats[share.index as usize].color;
            let sum = &mut colors[self.slot(share.pixel)];
            *sum = [0, 1, 2].map(|channel| sum[channel] + share.weight * more[channel]);
        }
        colors
    }

    /// Returns the index of a pixel in its tile.
    pub fn slot(&self, pixel: u32) -> usize {
        let (column, row) = (pixel % self.camera.width, pixel / self.camera.width);
        row as usize % TILE * TILE + column as usize % TILE
    }

    /// Returns the contributions of splats to the pixels of a tile: α = min(0.99, o exp(-dᵀ Σ'⁻¹ d / 2)) at
    /// the centres of pixels. Those below 1/255 are left out.
    fn shares(&self, splats: &[Splat], tile: usize) -> Vec<Share> {
        let (width, height) = (self.camera.width as usize, self.camera.height as usize);
        let columns = width.div_ceil(TILE);
        let (left, top) = (tile % columns * TILE, tile / columns * TILE);
        let (right, bottom) = ((left + TILE).min(width), (top + TILE).min(height));
        let mut passes = [1.0_f32; TILE * TILE];
        let mut open = (right - left) * (bottom - top);
        let mut shares = Vec::new();
        for footprint in self.tiles[tile]
            .iter()
            .map(|place| &self.footprints[*place as usize])
        {
            if open == 0 {
                break;
            }
            let Some([across, down]) = footprint.pixels(&self.camera) else {
                continue;
            };
            let [xx, xy, yy] = footprint.conic();
            let opacity = splats[footprint.index as usize].opacity;
            for row in down.start.max(top)..down.end.min(bottom) {
                let y = row as f32 + 0.5 - footprint.at[1];
                for column in across.start.max(left)..across.end.min(right) {
                    let passing = &mut passes[(row - top) * TILE + column - left];
                    if *passing < DARK {
                        continue;
                    }
                    let x = column as f32 + 0.5 - footprint.at[0];
                    let power = -0.5 * (xx * x * x + yy * y * y) - xy * x * y;
                    let alpha = (opacity * libm::expf(power.min(0.0))).min(MOST_ALPHA);
                    if alpha < LEAST_ALPHA {
                        continue;
                    }
                    shares.push(Share {
                        index: footprint.index,
                        pixel: (row * width + column) as u32,
                        weight: alpha * *passing,
                    });
                    *passing *= 1.0 - alpha;
                    open -= usize::from(*passing < DARK);
                }
            }
        }
        shares
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;

    /// Nothing is rounded to less than this here: sums of a few f32.
    const CLOSE: f32 = 1e-5;

    fn camera() -> Camera {
        Camera::pinhole(65, 65, 100.0)
    }

    fn splat(z: f64, sigma: f64, gray: f32, opacity: f32) -> Splat {
        Splat {
            position: Vector3::new(0.0, 0.0, z),
            normal: -Vector3::z(),
            sigma,
            color: [gray; 3],
            opacity,
        }
    }

    fn picture(splats: &[Splat]) -> Vec<[f32; 3]> {
        Raster::new(splats, &camera(), &Pose::identity()).picture(splats)
    }

    fn at(picture: &[[f32; 3]], column: usize, row: usize) -> f32 {
        picture[row * 65 + column][0]
    }

    #[test]
    fn a_disc_that_faces_the_camera_has_the_variance_of_its_projection() {
        // 100 px * 0.05 / 2 = 2.5 px: 6.25 px².
        let found = Footprint::project(0, &splat(2.0, 0.05, 1.0, 0.9), &camera(), &Pose::identity()).unwrap();
        for (value, wanted) in found.covariance.into_iter().zip([6.55, 0.0, 6.55]) {
            assert!((value - wanted).abs() < 1e-12, "{:?}", found.covariance);
        }
        assert_eq!((found.at, found.depth), ([32.5, 32.5], 2.0));
    }

    #[test]
    fn a_disc_seen_at_60_degrees_is_half_as_wide() {
        let mut turned = splat(2.0, 0.05, 1.0, 0.9);
        turned.normal = Vector3::new(-(60_f64.to_radians().sin()), 0.0, -0.5);
        let found = Footprint::project(0, &turned, &camera(), &Pose::identity()).unwrap();
        // Half of 2.5 px squared. Its thickness of a tenth of σ adds 3/4 of a hundredth of 6.25.
        let wanted = [6.25 * (0.25 + 0.75 * THIN * THIN) + 0.3, 0.0, 6.55];
        for (value, wanted) in found.covariance.into_iter().zip(wanted) {
            assert!((value - wanted).abs() < 1e-9, "{:?}", found.covariance);
        }
    }

    #[test]
    fn a_splat_aside_is_sheared_by_perspective() {
        let aside = Splat {
            position: Vector3::new(0.4, 0.0, 2.0),
            normal: Vector3::x(),
            ..splat(2.0, 0.05, 1.0, 0.9)
        };
        let found = Footprint::project(0, &aside, &camera(), &Pose::identity()).unwrap();
        // Along its disc (y, z) only z moves the column: -f x / z² = -10 px a unit, 0.5 px for σ. Its
        // thickness moves it 50 px a unit, 0.25 px.
        assert!(
            (found.covariance[0] - (0.25 + 0.0625 + 0.3)).abs() < 1e-9,
            "{:?}",
            found.covariance
        );
    }

    #[test]
    fn one_splat_has_its_opacity_at_the_centre_and_falls_as_a_gaussian() {
        let picture = picture(&[splat(2.0, 0.05, 1.0, 0.9)]);
        assert!((at(&picture, 32, 32) - 0.9).abs() < CLOSE);
        let wanted = 0.9 * (-0.5_f32 * 9.0 / 6.55).exp();
        for (column, row) in [(35, 32), (29, 32), (32, 35), (32, 29)] {
            assert!((at(&picture, column, row) - wanted).abs() < CLOSE);
        }
        assert_eq!(at(&picture, 50, 32), 0.0, "below 1/255 nothing is drawn");
    }

    #[test]
    fn the_nearer_splat_hides_the_farther_whatever_their_order() {
        let (near, far) = (splat(2.0, 0.05, 1.0, 0.75), splat(3.0, 0.075, 0.4, 0.5));
        // 0.75 * 1 + 0.25 * 0.5 * 0.4.
        for splats in [[near, far], [far, near]] {
            let middle = at(&picture(&splats), 32, 32);
            assert!((middle - 0.8).abs() < CLOSE, "{middle}");
        }
    }

    #[test]
    fn energy_is_kept_and_no_splat_takes_all_light() {
        for opacity in [f32::MIN_POSITIVE, 0.003, 0.5, 0.99, 1.0] {
            let splats: Vec<Splat> = (0..40).map(|_| splat(2.0, 0.05, 1.0, opacity)).collect();
            let picture = picture(&splats);
            assert!(
                picture
                    .iter()
                    .flatten()
                    .all(|value| (0.0..=1.0 + CLOSE).contains(value)),
                "{opacity}"
            );
            let one = at(&super::tests::picture(&splats[..1]), 32, 32);
            let drawn = if opacity < LEAST_ALPHA {
                0.0
            } else {
                opacity.min(MOST_ALPHA)
            };
            assert!((one - drawn).abs() < CLOSE, "{opacity}: {one}");
        }
    }

    #[test]
    fn what_is_behind_the_camera_or_touches_it_is_not_drawn() {
        for z in [-2.0, 0.0, 0.1] {
            assert!(
                picture(&[splat(z, 0.05, 1.0, 0.9)])
                    .iter()
                    .flatten()
                    .all(|value| *value == 0.0),
                "{z}"
            );
        }
    }
}
