//! One viewpoint: its figures, its errors against a photo and sparse points, and how far its maps reach.

use marf_scene::{Image, Point, Pose, Srgb, metrics::psnr, path::Viewpoint};
use marf_schema::bootstrap::{Coverage, PhotoReport, SparsificationCurves, ViewReport};
use nalgebra::Vector3;

use super::{
    intervals::{Errors, locally},
    maps::{Maps, gray},
    normality::{coverage, mean, nll},
    reach::Reach,
    sparsification::{Norm, Sparsification, hundredths, sparsify, spearman},
};
use crate::TrainError;

/// Photos that see a sparse point, at least, for it to be compared with: two may be a wrong match.
const LEAST_VIEWS: u32 = 3;
/// Side of the cells in which the nearest sparse point hides those behind it, pixels.
const CELL_PX: u32 = 16;
/// A sparse point is hidden if it is farther than this many times the nearest one around it.
const HIDDEN: f64 = 1.1;

/// Figures of a viewpoint that remain when its maps are dropped.
#[derive(Debug)]
pub(crate) struct ViewStudy {
    pub report: ViewReport,
    /// Pixels, and those with a depth: the weights of the means.
    pub pixels: f64,
    pub depth_pixels: f64,
    pub rgb_std: [f64; 3],
    pub reach: Reach,
    pub held_out: Option<HeldOutStudy>,
}

/// What a photo that was held out says.
#[derive(Debug)]
pub(crate) struct HeldOutStudy {
    pub curves: SparsificationCurves,
    pub coverage: Coverage,
    pub nll: f64,
    /// Of gray, sRGB in [0, 1].
    pub gray: Errors,
    /// Of the depth, as shares of it.
    pub depth: Errors,
}

/// A photo that was held out, with the number of the place it was taken at.
pub(crate) struct Truth<'a> {
    pub photo: &'a Image<Srgb>,
    /// Pixels that its mask hides. Empty without a mask.
    pub hidden: &'a [bool],
    pub place: usize,
}

/// Returns the figures of a viewpoint.
///
/// # Errors
/// A photo of another size than the maps.
pub(crate) fn study(
    place: &Viewpoint,
    maps: &Maps,
    truth: Option<&Truth<'_>>,
    points: &[Point],
) -> Result<ViewStudy, TrainError> {
    let error = truth
        .map(|truth| errors(maps, truth.photo, truth.hidden))
        .unwrap_or_default();
    let orders = truth.map(|_| Orders::new(maps, &error));
    let held_out = truth.zip(orders.as_ref()).map(|(truth, orders)| {
        let depths = depth_errors(place, maps, points);
        self::held_out(maps, truth.place, &error, orders, depths)
    });
    let report = ViewReport {
        place: truth.map(|truth| truth.place as u64),
        photo: truth
            .zip(orders.as_ref())
            .map(|(truth, orders)| photo_report(place, maps, truth, orders))
            .transpose()?,
        ..view_report(place, maps)
    };
    let channel = |channel: usize| mean(maps.rgb_std.iter().map(|rgb| rgb[channel]));
    Ok(ViewStudy {
        report,
        pixels: maps.std.len() as f64,
        depth_pixels: maps.depth_std.iter().filter(|std| **std >= 0.0).count() as f64,
        rgb_std: [0, 1, 2].map(channel),
        reach: Reach::new(maps, &error),
        held_out,
    })
}

/// Returns |mean gray - gray of the photo| of every pixel, -1 where its mask hides it.
pub(crate) fn errors(maps: &Maps, photo: &Image<Srgb>, hidden: &[bool]) -> Vec<f32> {
    let pixels = maps.gray.iter().zip(&photo.pixels);
    let errors = pixels.enumerate().map(|(pixel, (mean, rgb))| {
        let photo = gray(&rgb.map(|channel| f32::from(channel) / 255.0));
        let is_hidden = hidden.get(pixel).copied().unwrap_or(false);
        if is_hidden {
            -1.0
        } else {
            (f64::from(*mean) - photo).abs() as f32
        }
    });
    errors.collect()
}

/// Returns the values of a map at the pixels that have an error.
fn compared(map: &[f32], error: &[f32]) -> Vec<f32> {
    let pixels = map.iter().zip(error).filter(|(_, error)| **error >= 0.0);
    pixels.map(|(value, _)| *value).collect()
}

/// Returns the figures of one viewpoint without a photo.
fn view_report(place: &Viewpoint, maps: &Maps) -> ViewReport {
    let share =
        |is: &dyn Fn(usize) -> bool| mean((0..maps.std.len()).map(|pixel| f64::from(u8::from(is(pixel)))));
    let with_depth = maps.depth_std.iter().copied().filter(|std| *std >= 0.0);
    let has_depth = with_depth.clone().next().is_some();
    ViewReport {
        name: place.name.clone(),
        std: mean(maps.std.iter().copied()),
        std_paper: mean(maps.std_paper.iter().copied()),
        unseen_term: mean(maps.unseen.iter().copied()),
        total_sd: mean(maps.total.iter().copied()),
        depth_std: has_depth.then(|| mean(with_depth)),
        unseen_share: share(&|pixel| !maps.is_seen(pixel)),
        sky_share: share(&|pixel| maps.is_seen(pixel) && maps.depth[pixel] < 0.0),
        place: None,
        photo: None,
    }
}

/// How well the spread ranks the errors.
struct Orders {
    std: Sparsification,
    std_rmse: Sparsification,
    total: Sparsification,
    spearman: f64,
}

impl Orders {
    fn new(maps: &Maps, error: &[f32]) -> Self {
        let (removed, errors) = (hundredths(), compared(error, error));
        let by = |map: &[f32], norm| sparsify(&compared(map, error), &errors, &removed, norm);
        Self {
            std: by(&maps.std, Norm::Mae),
            std_rmse: by(&maps.std, Norm::Rmse),
            total: by(&maps.total, Norm::Mae),
            spearman: spearman(&compared(&maps.std, error), &errors),
        }
    }

    /// Returns the errors that are left, at every twentieth.
    fn curves(&self) -> SparsificationCurves {
        let twentieths = |values: &[f64]| values.iter().copied().step_by(5).collect();
        SparsificationCurves {
            removed: twentieths(&hundredths()),
            by_std: twentieths(&self.std.curve),
            by_total: twentieths(&self.total.curve),
            best: twentieths(&self.std.best),
        }
    }
}

/// Returns how well the spread ranks the errors against a photo.
fn photo_report(
    place: &Viewpoint,
    maps: &Maps,
    truth: &Truth<'_>,
    orders: &Orders,
) -> Result<PhotoReport, TrainError> {
    let psnr =
        psnr(&maps.mean_picture(), truth.photo, truth.hidden).map_err(|cause| TrainError::Picture {
            name: place.name.clone(),
            cause: cause.to_string(),
        })?;
    Ok(PhotoReport {
        psnr,
        ause_mae: orders.std.ause,
        ause_mae_random: orders.std.ause_random,
        ause_rmse: orders.std_rmse.ause,
        ause_rmse_random: orders.std_rmse.ause_random,
        ause_mae_total: orders.total.ause,
        spearman: orders.spearman,
    })
}

/// Returns the study of a photo taken at the place `number`: `error` of every pixel, and spread and error of depths.
fn held_out(
    maps: &Maps,
    number: usize,
    error: &[f32],
    orders: &Orders,
    depths: Vec<(f32, f32)>,
) -> HeldOutStudy {
    let spreads = maps.local_spread();
    let seen = (0..error.len()).filter(|pixel| error[*pixel] >= 0.0 && maps.is_seen(*pixel));
    let gray: Vec<(f32, f32)> = seen.map(|pixel| (spreads[pixel], error[pixel])).collect();
    let (std, error) = (compared(&maps.std, error), compared(error, error));
    let unseen_share = 1.0 - gray.len() as f64 / error.len().max(1) as f64;
    let within = |widths: f64| coverage(&std, &error, widths);
    HeldOutStudy {
        curves: orders.curves(),
        coverage: Coverage {
            sd1: within(1.0),
            sd2: within(2.0),
            sd3: within(3.0),
        },
        nll: nll(&std, &error, 1.0),
        gray: Errors::new(number, gray, unseen_share),
        depth: Errors::new(number, depths, unseen_share),
    }
}

/// Returns spread and error of the depth, as shares of it, where the view shows a sparse point that no other hides.
fn depth_errors(place: &Viewpoint, maps: &Maps, points: &[Point]) -> Vec<(f32, f32)> {
    let spread = locally(&maps.depth_std, maps.width);
    let compared = visible(place, points)
        .into_iter()
        .filter_map(|(pixel, distance)| {
            let depth = f64::from(maps.depth[pixel]);
            let usable = depth > 0.0 && maps.is_seen(pixel);
            let share = |length: f64| (length / depth) as f32;
            usable.then(|| (share(f64::from(spread[pixel])), share((depth - distance).abs())))
        });
    compared.collect()
}

/// Returns pixel and distance of sparse points that a view shows: in each cell of 16 pixels the nearest, if no nearer one around it hides
/// it. One a cell, since points are dense where texture makes depths good, and the interval is for all pixels.
fn visible(place: &Viewpoint, points: &[Point]) -> Vec<(usize, f64)> {
    let (camera, centre) = (&place.camera, place.cam_from_world.centre());
    let (across, down) = (camera.width.div_ceil(CELL_PX), camera.height.div_ceil(CELL_PX));
    let mut nearest: Vec<Option<(f64, usize)>> = vec![None; (across * down) as usize];
    for point in points.iter().filter(|point| point.views >= LEAST_VIEWS) {
        let point = Vector3::from(point.position);
        let Some((column, row)) = pixel_of(camera, &place.cam_from_world, &point) else {
            continue;
        };
        let distance = (point - centre).norm();
        let cell = &mut nearest[(row / CELL_PX * across + column / CELL_PX) as usize];
        if cell.is_none_or(|(least, _)| distance < least) {
            *cell = Some((distance, (row * camera.width + column) as usize));
        }
    }
    let nearest_around = |cell: u32| {
        let span = |place: u32, end: u32| place.saturating_sub(1)..(place + 2).min(end);
        let rows = span(cell / across, down);
        let cells = rows.flat_map(|row| span(cell % across, across).map(move |column| row * across + column));
        let distances = cells.filter_map(|cell| nearest[cell as usize].map(|(distance, _)| distance));
        distances.fold(f64::INFINITY, f64::min)
    };
    let shown = (0..across * down).filter_map(|cell| {
        let (distance, pixel) = nearest[cell as usize]?;
        (distance <= HIDDEN * nearest_around(cell)).then_some((pixel, distance))
    });
    shown.collect()
}

fn pixel_of(camera: &marf_scene::Camera, cam_from_world: &Pose, point: &Vector3<f64>) -> Option<(u32, u32)> {
    let pixel = camera.project_inside(&cam_from_world.point(point))?;
    Some((pixel.x as u32, pixel.y as u32))
}

#[cfg(test)]
mod tests {
    use super::super::maps::tests::{example, maps_of};
    use super::*;
    use marf_scene::Camera;

    fn place(width: u32, height: u32) -> Viewpoint {
        Viewpoint {
            name: "0001".to_owned(),
            camera: Camera::pinhole(width, height, 40.0),
            cam_from_world: Pose::identity(),
        }
    }

    fn point(x: f64, y: f64, z: f64, views: u32) -> Point {
        Point {
            position: [x, y, z],
            color: None,
            views,
        }
    }

    #[test]
    fn figures_of_the_worked_example_without_a_photo() {
        let study = study(&place(4, 1), &maps_of(&example()), None, &[]).unwrap();
        assert!((study.report.std_paper - 0.027_311).abs() < 6e-7, "{study:?}");
        assert!((study.report.std / study.report.std_paper - (4.0_f64 / 3.0).sqrt()).abs() < 1e-6);
        assert_eq!((study.report.unseen_share, study.report.sky_share), (0.25, 0.0));
        assert_eq!((study.pixels, study.depth_pixels), (4.0, 3.0));
        assert!(study.held_out.is_none() && study.report.photo.is_none());
    }

    #[test]
    fn figures_of_the_worked_example_with_its_photo() {
        let maps = maps_of(&example());
        let photo = Image {
            width: 4,
            height: 1,
            pixels: vec![[128; 3], [77; 3], [184; 3], [153; 3]],
        };
        let truth = Truth {
            photo: &photo,
            hidden: &[],
            place: 7,
        };
        let study = study(&place(4, 1), &maps, Some(&truth), &[]).unwrap();
        let report = study.report.photo.unwrap();
        assert!((report.spearman - 0.4).abs() < 1e-12);
        assert!(
            report.ause_mae_total < report.ause_mae,
            "what no photo saw comes last"
        );
        let held_out = study.held_out.unwrap();
        assert_eq!(
            [
                held_out.coverage.sd1,
                held_out.coverage.sd2,
                held_out.coverage.sd3
            ],
            [0.25, 0.5, 0.75]
        );
        assert_eq!(
            (
                held_out.gray.place,
                held_out.gray.pairs.len(),
                held_out.gray.unseen_share
            ),
            (7, 3, 0.25)
        );
        let small = Image {
            width: 1,
            height: 1,
            pixels: vec![[0; 3]],
        };
        let wrong = super::study(
            &place(4, 1),
            &maps,
            Some(&Truth {
                photo: &small,
                hidden: &[],
                place: 0,
            }),
            &[],
        );
        assert!(wrong.unwrap_err().to_string().contains("0001"));
    }

    #[test]
    fn what_a_mask_hides_is_compared_with_nothing() {
        let maps = maps_of(&example());
        let photo = |last: u8| Image {
            width: 4,
            height: 1,
            pixels: vec![[128; 3], [77; 3], [184; 3], [last; 3]],
        };
        let study_of = |photo: &Image<Srgb>, hidden: &[bool]| {
            study(
                &place(4, 1),
                &maps,
                Some(&Truth {
                    photo,
                    hidden,
                    place: 0,
                }),
                &[],
            )
            .unwrap()
        };
        let hidden = [false, false, false, true];
        let (one, other) = (study_of(&photo(0), &hidden), study_of(&photo(255), &hidden));
        assert_eq!(one.report, other.report);
        assert_eq!(one.held_out.unwrap().gray, other.held_out.unwrap().gray);
        assert_ne!(study_of(&photo(0), &[]).report, study_of(&photo(255), &[]).report);
        assert_eq!(errors(&maps, &photo(0), &hidden)[3], -1.0);
    }

    #[test]
    fn sparse_points_count_where_no_other_hides_them() {
        let points = [
            point(0.0, 0.0, 2.0, 3),
            point(0.02, 0.0, 4.0, 5), // behind it, in the same cell
            point(0.0, 0.0, 1.0, 2),  // seen by too few photos to hide or to count
            point(-2.6, 0.0, 2.0, 9), // beyond the left edge
            point(0.0, 0.0, -2.0, 9), // behind the camera
            point(3.2, 0.0, 4.0, 3),  // alone in its corner
        ];
        let found = visible(&place(96, 40), &points);
        assert_eq!(found.len(), 2, "{found:?}");
        assert_eq!(found[0], (20 * 96 + 48, 2.0));
        assert_eq!(found[1].0, 20 * 96 + 80);
    }

    #[test]
    fn depths_are_compared_as_shares() {
        let maps = maps_of(&example());
        // Depths 2, 3, 4, 5: 3.5 in the mean, in all pixels with matter.
        let found = depth_errors(&place(4, 1), &maps, &[point(0.0, 0.0, 4.2, 3)]);
        assert_eq!(found.len(), 1);
        assert!((found[0].1 - 0.2).abs() < 1e-6, "{found:?}");
        assert!(
            (f64::from(found[0].0) - (5.0_f64 / 3.0).sqrt() / 3.5).abs() < 1e-6,
            "{found:?}"
        );
    }
}
