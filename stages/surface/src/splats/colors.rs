//! The colours with which pictures of splats are those of a field.

use super::raster::{Raster, Share};
use super::{Picture, Splat};

/// Sums of a splat over pixels: weight times what the picture lacks, by channel, and weight.
type Sums = [f64; 4];

/// Moves the colours of splats towards those with which their pictures are the field's, by `sweeps` steps.
///
/// A picture is linear in the colours: p = W c with the weights of [`Raster`], whose rows sum to at most 1. A
/// step is c ← c + D Wᵀ (p* - W c) with D = 1 / column sums, over all pixels of all views that show a
/// surface. This is the simultaneous iterative reconstruction technique (Gilbert 1972, convergence: Gregor
/// and Benson, IEEE TMI 2008). Colours are held within [0, 1]. Splats that no pixel shows keep theirs. Sums
/// run in the order of views and tiles: the same for any number of threads.
///
/// # Errors
/// Those of `before_view`, which is called with step and view before each, to report progress and to stop.
pub fn adjust_colors<E>(
    splats: &mut [Splat],
    pictures: &[Picture<'_>],
    sweeps: u32,
    mut before_view: impl FnMut(u32, usize) -> Result<(), E>,
) -> Result<(), E> {
    for sweep in 0..sweeps {
        let mut sums: Vec<Sums> = vec![[0.0; 4]; splats.len()];
        for (view, picture) in pictures.iter().enumerate() {
            before_view(sweep, view)?;
            add_lacking(splats, picture, &mut sums);
        }
        for (splat, sums) in splats.iter_mut().zip(&sums) {
            if sums[3] <= 0.0 {
                continue;
            }
            for (channel, color) in splat.color.iter_mut().enumerate() {
                *color = (*color + (sums[channel] / sums[3]) as f32).clamp(0.0, 1.0);
            }
        }
    }
    Ok(())
}

/// Adds what a picture lacks to the sums of the splats that it shows.
fn add_lacking(splats: &[Splat], picture: &Picture<'_>, sums: &mut [Sums]) {
    let raster = Raster::new(splats, picture.camera, picture.cam_from_world);
    let tiles = raster.map_tiles(splats, |shares| {
        let drawn = raster.blended(splats, shares);
        // Those of one splat follow each other.
        let runs = shares.chunk_by(|a, b| a.index == b.index).map(|run| {
            let mut sum = [0.0; 4];
            let compared = |share: &&Share| picture.opacity[share.pixel as usize] > 0.0;
            for share in run.iter().filter(compared) {
                let (target, is) = (picture.rgb[share.pixel as usize], drawn[raster.slot(share.pixel)]);
                let weight = f64::from(share.weight);
                for channel in 0..3 {
                    sum[channel] += weight * f64::from(target[channel] - is[channel]);
                }
                sum[3] += weight;
            }
            (run[0].index, sum)
        });
        runs.collect::<Vec<(u32, Sums)>>()
    });
    for (index, more) in tiles.into_iter().flatten() {
        let sum = &mut sums[index as usize];
        *sum = [0, 1, 2, 3].map(|part| sum[part] + more[part]);
    }
}

#[cfg(test)]
mod tests {
    use marf_scene::{Camera, Pose};
    use nalgebra::Vector3;

    use super::*;

    /// A wall of discs a quarter of a unit apart at z = 2, all gray, and its camera.
    fn wall() -> (Vec<Splat>, Camera) {
        let at = |index: i32| f64::from(index) * 0.25;
        let places = (-4..=4).flat_map(|y| (-4..=4).map(move |x| Vector3::new(at(x), at(y), 2.0)));
        let splats = places.map(|position| Splat {
            position,
            normal: -Vector3::z(),
            sigma: 0.15,
            color: [0.5; 3],
            opacity: 0.9,
        });
        (splats.collect(), Camera::pinhole(40, 40, 40.0))
    }

    fn adjusted(threads: usize, sweeps: u32) -> (Vec<Splat>, Vec<Splat>, f64) {
        let (start, camera) = wall();
        let mut truth = start.clone();
        for (index, splat) in truth.iter_mut().enumerate() {
            splat.color = [0.2, 0.5, 0.3 + 0.05 * (index % 9) as f32];
        }
        let pose = Pose::identity();
        let rgb = Raster::new(&truth, &camera, &pose).picture(&truth);
        let picture = Picture {
            camera: &camera,
            cam_from_world: &pose,
            rgb: &rgb,
            opacity: &vec![1.0; rgb.len()],
        };
        let mut splats = start;
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        let never = |_, _| Ok::<_, std::convert::Infallible>(());
        pool.install(|| adjust_colors(&mut splats, &[picture], sweeps, never))
            .unwrap();
        let psnr_db = super::super::judge(&splats, &picture).unwrap().psnr_db;
        (splats, truth, psnr_db)
    }

    #[test]
    fn the_colours_that_a_picture_was_made_with_come_back() {
        let psnr_db = [0, 1, 4, 60].map(|sweeps| adjusted(2, sweeps).2);
        assert!(
            psnr_db.is_sorted() && psnr_db[3] > psnr_db[0] + 20.0,
            "{psnr_db:?}"
        );
        let (splats, truth, _) = adjusted(2, 60);
        // The middle ones, which are seen whole.
        for index in [30, 40, 50] {
            for (found, wanted) in splats[index].color.iter().zip(truth[index].color) {
                assert!((found - wanted).abs() < 0.02, "{:?}", splats[index]);
            }
        }
    }

    #[test]
    fn the_same_colours_for_one_thread_and_three() {
        assert_eq!(adjusted(1, 3).0, adjusted(3, 3).0);
    }

    #[test]
    fn pixels_without_a_surface_ask_nothing_and_a_wish_to_stop_is_heard() {
        let (mut splats, camera) = wall();
        let pose = Pose::identity();
        let picture = Picture {
            camera: &camera,
            cam_from_world: &pose,
            rgb: &vec![[1.0; 3]; 1600],
            opacity: &vec![0.0; 1600],
        };
        adjust_colors(&mut splats, &[picture], 2, |_, _| Ok::<_, String>(())).unwrap();
        assert_eq!(splats, wall().0);
        assert_eq!(super::super::judge(&splats, &picture), None);
        let stopped = adjust_colors(&mut splats, &[picture], 2, |step, view| {
            if step == 1 {
                Err(format!("step {step}, view {view}"))
            } else {
                Ok(())
            }
        });
        assert_eq!(stopped.unwrap_err(), "step 1, view 0");
    }
}
