use marf_field::Render;
use marf_scene::{Image, Srgb};
use marf_stage::{Ctx, StageError};
use serde::{Deserialize, Serialize};

use super::intervals::{locally, widened};
use crate::depth_views::MIN_OPACITY;

/// Spread of the members at one viewpoint, all `[height * width]`, rows from the top.
///
/// Colours are sRGB in [0, 1]. Gray is (R + G + B) / 3 of a member's render.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct Maps {
    /// Pixels a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Mean colour.
    pub mean: Vec<[f32; 3]>,
    /// Mean gray.
    pub gray: Vec<f32>,
    /// Sample standard deviation of gray, divisor B - 1.
    pub std: Vec<f32>,
    /// The paper's: standard deviation of gray, divisor B.
    pub std_paper: Vec<f32>,
    /// Sample standard deviation of each channel.
    pub rgb_std: Vec<[f32; 3]>,
    /// (1 - c)², c the share of the pixel that photos have seen ([`Visibility::seen`]): 1 where no photo looked.
    pub unseen: Vec<f32>,
    /// Error that all members share: the error of gray of one member in the photos it was trained on that show what the pixel shows. It is
    /// the root mean square over these photos, and 0 without any.
    pub residual: Vec<f32>,
    /// √(divisor-B variance + `unseen` + `residual`²).
    pub total: Vec<f32>,
    /// Mean depth along the ray, world units, or -1 where the mean opacity is at most 0.5: sky, or nothing.
    pub depth: Vec<f32>,
    /// Sample standard deviation of the depth, world units, or -1 where there is no depth.
    pub depth_std: Vec<f32>,
    /// Photos that show what the pixel shows: the surface at its depth, or the sky.
    pub photos: Vec<f32>,
    /// Distance of the nearest of them to the surface, world units, or -1 without any and in the sky.
    pub photo_distance: Vec<f32>,
    /// Least angle between the surface's normal and the direction to one of them, degrees, or -1 where it is unknown.
    pub incidence_deg: Vec<f32>,
}

/// What photos saw of what one pixel shows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Visibility {
    /// How well the surface at the median depth was seen, in [0, 1].
    pub surface: f64,
    /// How well the sky behind it was seen, in [0, 1].
    pub sky: f64,
    /// As [`Maps::photos`].
    pub photos: f32,
    /// As [`Maps::photo_distance`].
    pub photo_distance: f32,
    /// As [`Maps::incidence_deg`].
    pub incidence_deg: f32,
    /// As [`Maps::residual`].
    pub residual: f32,
}

impl Visibility {
    /// Returns the share of a pixel of mean opacity `q` that was seen: q surface + (1 - q) sky.
    ///
    /// Where every surface was seen and no sky it is q, and `1 - q` squared is the opacity term of arXiv 2209.08718.
    fn seen(&self, opacity: f64) -> f64 {
        opacity * self.surface + (1.0 - opacity) * self.sky
    }
}

/// Mean, median and both standard deviations of a few numbers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Moments {
    pub mean: f64,
    /// Divisor B - 1.
    pub sample: f64,
    /// Divisor B.
    pub population: f64,
    /// The middle value, the lower one of two.
    pub median: f64,
}

/// Returns the moments of at least one value. Sorts first: the order of the members then changes no sum.
pub(crate) fn moments(values: &mut [f64]) -> Moments {
    values.sort_unstable_by(f64::total_cmp);
    let count = values.len() as f64;
    let mean = values.iter().sum::<f64>() / count;
    let squares: f64 = values.iter().map(|value| (value - mean) * (value - mean)).sum();
    Moments {
        mean,
        sample: (squares / (count - 1.0).max(1.0)).sqrt(),
        population: (squares / count).sqrt(),
        median: values[(values.len() - 1) / 2],
    }
}

/// Depths and opacities of the members, `[height * width]`.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Surfaces {
    /// The median, world units along the ray, whatever the opacity is. Where members disagree, their mean may be behind all surfaces.
    pub depth: Vec<f64>,
    /// The mean, in [0, 1].
    pub opacity: Vec<f32>,
}

/// Returns the spread of the members' renders of one viewpoint, which have one size. `visibilities` computes what photos saw of each pixel.
///
/// Extremes: one member has spread 0 everywhere, which says nothing. The stage refuses B = 1.
///
/// # Errors
/// A request to stop.
pub(crate) fn maps(
    ctx: &Ctx<'_>,
    renders: &[Render],
    visibilities: &dyn Fn(&Surfaces) -> Vec<Visibility>,
) -> Result<Maps, StageError> {
    let (width, height) = renders
        .first()
        .map_or((0, 0), |render| (render.width, render.height));
    let count = width as usize * height as usize;
    let mut values = vec![0.0; renders.len()];
    let mut over_members = |value: &dyn Fn(&Render) -> f64| {
        for (slot, render) in values.iter_mut().zip(renders) {
            *slot = value(render);
        }
        moments(&mut values)
    };
    let mut surfaces = Surfaces {
        depth: Vec::with_capacity(count),
        opacity: Vec::with_capacity(count),
    };
    for pixel in 0..count {
        surfaces
            .depth
            .push(over_members(&|render| f64::from(render.depth[pixel])).median);
        let opacity = over_members(&|render| f64::from(render.opacity[pixel])).mean;
        surfaces.opacity.push(opacity as f32);
    }
    ctx.check()?;
    let visibilities = visibilities(&surfaces);
    let mut maps = Maps {
        width,
        height,
        ..Maps::default()
    };
    for (pixel, visibility) in visibilities.iter().enumerate() {
        if pixel % width as usize == 0 {
            ctx.check()?;
        }
        let channels = [0, 1, 2].map(|channel| over_members(&|render| f64::from(render.rgb[pixel][channel])));
        let gray = over_members(&|render| gray(&render.rgb[pixel]));
        let depth = over_members(&|render| f64::from(render.depth[pixel]));
        maps.push(&channels, &gray, surfaces.opacity[pixel], &depth, visibility);
    }
    Ok(maps)
}

/// Returns (R + G + B) / 3.
pub(crate) fn gray(rgb: &[f32; 3]) -> f64 {
    (f64::from(rgb[0]) + f64::from(rgb[1]) + f64::from(rgb[2])) / 3.0
}

impl Maps {
    /// Of [`Maps::unseen`]: more than half of the pixel was seen.
    const HALF_SEEN: f32 = 0.25;

    /// Returns the spread that intervals of gray are made of: √(v + `residual`²), v the variance averaged over 5 x 5 pixels.
    pub fn local_spread(&self) -> Vec<f32> {
        let local = locally(&self.std, self.width).into_iter();
        let both = local.zip(&self.residual);
        both.map(|(std, residual)| widened(std, f64::from(*residual)) as f32)
            .collect()
    }

    /// Returns the mean colour, rounded to 8 bits.
    pub fn mean_picture(&self) -> Image<Srgb> {
        let round = |value: f32| (value.clamp(0.0, 1.0) * 255.0 + 0.5) as u8;
        Image {
            width: self.width,
            height: self.height,
            pixels: self.mean.iter().map(|rgb| rgb.map(round)).collect(),
        }
    }

    /// Returns whether photos saw most of what a pixel shows.
    pub fn is_seen(&self, pixel: usize) -> bool {
        self.unseen[pixel] < Self::HALF_SEEN
    }

    /// Returns whether all maps are of a viewpoint of that width and height.
    pub fn are_whole(&self, width: u32, height: u32) -> bool {
        let colours = [&self.mean, &self.rgb_std].map(Vec::len);
        let values = [
            &self.gray,
            &self.std,
            &self.std_paper,
            &self.unseen,
            &self.residual,
            &self.total,
            &self.depth,
            &self.depth_std,
            &self.photos,
            &self.photo_distance,
            &self.incidence_deg,
        ];
        let mut pixels = values.map(Vec::len).into_iter().chain(colours);
        let count = width as usize * height as usize;
        (self.width, self.height) == (width, height) && pixels.all(|pixels| pixels == count)
    }

    fn push(
        &mut self,
        channels: &[Moments; 3],
        gray: &Moments,
        opacity: f32,
        depth: &Moments,
        visibility: &Visibility,
    ) {
        let unseen = 1.0 - visibility.seen(f64::from(opacity));
        let unseen = unseen * unseen;
        let residual = f64::from(visibility.residual);
        let total = (gray.population * gray.population + unseen + residual * residual).sqrt();
        self.mean.push(channels.map(|channel| channel.mean as f32));
        self.gray.push(gray.mean as f32);
        self.std.push(gray.sample as f32);
        self.std_paper.push(gray.population as f32);
        self.rgb_std.push(channels.map(|channel| channel.sample as f32));
        self.unseen.push(unseen as f32);
        self.residual.push(visibility.residual);
        self.total.push(total as f32);
        let matter_only = |value: f64| if opacity > MIN_OPACITY { value as f32 } else { -1.0 };
        self.depth.push(matter_only(depth.mean));
        self.depth_std.push(matter_only(depth.sample));
        self.photos.push(visibility.photos);
        self.photo_distance.push(visibility.photo_distance);
        self.incidence_deg.push(visibility.incidence_deg);
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// The worked example: 4 pixels, 4 members, gray colours.
    pub(crate) fn example() -> Vec<Render> {
        let rows = [
            [0.50, 0.20, 0.80, 0.40],
            [0.52, 0.26, 0.75, 0.40],
            [0.48, 0.14, 0.85, 0.40],
            [0.50, 0.20, 0.80, 0.44],
        ];
        let opacity = [
            [1.0, 1.0, 1.0, 0.1],
            [1.0, 1.0, 0.9, 0.2],
            [1.0, 1.0, 1.0, 0.1],
            [1.0, 0.98, 1.0, 0.2],
        ];
        let render = |member: usize| Render {
            width: 4,
            height: 1,
            rgb: rows[member].map(|gray| [gray; 3]).to_vec(),
            opacity: opacity[member].to_vec(),
            depth: vec![2.0 + member as f32; 4],
        };
        (0..4).map(render).collect()
    }

    /// Photos saw all matter and no sky.
    fn matter_seen(surfaces: &Surfaces) -> Vec<Visibility> {
        let visibility = Visibility {
            surface: 1.0,
            sky: 0.0,
            photos: 3.0,
            photo_distance: 2.0,
            incidence_deg: 30.0,
            residual: 0.0,
        };
        vec![visibility; surfaces.depth.len()]
    }

    pub(crate) fn maps_of(renders: &[Render]) -> Maps {
        maps(
            &marf_stage::harness::Harness::default().ctx(),
            renders,
            &matter_seen,
        )
        .unwrap()
    }

    #[test]
    fn a_sky_that_photos_saw_is_certain_and_a_surface_that_none_saw_is_not() {
        let visibility = |surface: f64, sky: f64| Visibility {
            surface,
            sky,
            ..matter_seen(&Surfaces {
                depth: vec![0.0],
                opacity: vec![0.0],
            })[0]
        };
        let rows = [
            visibility(1.0, 0.0),
            visibility(0.0, 1.0),
            visibility(0.0, 0.0),
            visibility(1.0, 1.0),
        ];
        let harness = marf_stage::harness::Harness::default();
        let maps = maps(&harness.ctx(), &example(), &|_| rows.to_vec()).unwrap();
        for (pixel, expected) in [0.0, 0.995 * 0.995, 1.0, 0.0].into_iter().enumerate() {
            close(maps.unseen[pixel], expected, &format!("p{}", pixel + 1));
        }
        assert_eq!(
            [0, 1, 2, 3].map(|pixel| maps.is_seen(pixel)),
            [true, false, false, true]
        );
        close(maps.total[3], 0.017321, "the spread alone");
    }

    #[test]
    fn maps_come_back_to_the_bit_and_those_of_another_size_are_not_whole() {
        let mut maps = maps_of(&example());
        maps.depth[0] = f32::MIN_POSITIVE / 2.0;
        maps.gray[1] = -0.0;
        let bytes = postcard::to_allocvec(&maps).unwrap();
        let mut read: Maps = postcard::from_bytes(&bytes).unwrap();
        assert_eq!(postcard::to_allocvec(&read).unwrap(), bytes);
        assert!(read == maps && read.are_whole(4, 1));
        assert!(!read.are_whole(5, 1) && !read.are_whole(2, 2));
        read.incidence_deg.pop();
        assert!(!read.are_whole(4, 1));
    }

    /// Asserts six decimals, as the example is printed. f32 renders leave 1e-7.
    pub(crate) fn close(found: impl Into<f64>, expected: f64, what: &str) {
        let found = found.into();
        assert!((found - expected).abs() < 6e-7, "{what}: {found}, not {expected}");
    }

    #[test]
    fn the_worked_example_comes_out_digit_for_digit() {
        let maps = maps_of(&example());
        let rows: [(&str, &[f32], [f64; 4]); 5] = [
            ("mean", &maps.gray, [0.50, 0.20, 0.80, 0.41]),
            (
                "divisor B",
                &maps.std_paper,
                [0.014142, 0.042426, 0.035355, 0.017321],
            ),
            (
                "divisor B - 1",
                &maps.std,
                [0.016330, 0.048990, 0.040825, 0.020000],
            ),
            ("opacity term", &maps.unseen, [0.0, 0.000025, 0.000625, 0.7225]),
            ("total", &maps.total, [0.014142, 0.042720, 0.043301, 0.850176]),
        ];
        for (what, found, expected) in rows {
            for (pixel, (found, expected)) in found.iter().zip(expected).enumerate() {
                close(*found, expected, &format!("{what}, p{}", pixel + 1));
            }
        }
        let mean = maps.std_paper.iter().map(|std| f64::from(*std)).sum::<f64>() / 4.0;
        close(mean, 0.027311, "scene mean");
    }

    #[test]
    fn what_is_mostly_empty_has_no_depth_and_each_channel_its_own_spread() {
        let mut renders = example();
        for render in &mut renders {
            render.rgb[0][2] = 0.7;
        }
        let maps = maps_of(&renders);
        close(maps.depth[0], 3.5, "depth 2 3 4 5");
        close(maps.depth_std[0], (5.0_f64 / 3.0).sqrt(), "depth 2 3 4 5");
        assert_eq!((maps.depth[3], maps.depth_std[3]), (-1.0, -1.0));
        assert_eq!(maps.rgb_std[0][2], 0.0);
        close(maps.rgb_std[0][0], 0.016330, "red");
    }

    #[test]
    fn the_order_of_the_members_does_not_matter_to_the_last_bit() {
        let mut renders = example();
        renders[1].rgb[2] = [0.1, 0.7, 0.3];
        let before = maps_of(&renders);
        renders.rotate_left(1);
        renders.swap(0, 2);
        assert_eq!(maps_of(&renders), before);
    }

    #[test]
    fn equal_members_have_no_spread() {
        let renders = vec![example().remove(0); 3];
        let maps = maps_of(&renders);
        for (map, pixel) in [&maps.std, &maps.std_paper, &maps.depth_std].iter().zip(0..) {
            assert!(map[..3].iter().all(|std| *std < 1e-7), "{pixel}: {map:?}");
        }
    }
}
