//! The pixels of a photo as training keeps them: all of them, or one of every run at a random place.

use marf_scene::{Image, Srgb};

use crate::rng::{Purpose, random_numbers};

/// The pixels of a photo that can be drawn in training.
///
/// The number of pixels of all photos together matters. Measured on the mock-up (80 photos of 360 x 480, 500
/// steps, one seed, three held-out views): all 13.8 million 20.33 dB, one in 8 20.36, one in 64 19.91, one in
/// 256 18.72. Below a million pixels a training sees the same ones too often. With one in 64, a thousand
/// photos of 2 megapixels still have 30 million.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Pixels {
    /// Pixels a row of the photo.
    pub width: u32,
    /// Rows of the photo.
    pub height: u32,
    /// Pixels of a run, counted along the rows and on in the next. One of each is kept.
    run: u32,
    /// 8-bit sRGB of the kept pixels.
    pub pixels: Vec<[u8; 3]>,
    /// Place of each kept pixel in its run, or [`HIDDEN`]. Empty where all are kept and none is hidden.
    offsets: Vec<u8>,
    /// Opacity of each kept pixel, whose colour is blended over black. Empty where the photo is opaque.
    alpha: Vec<u8>,
}

/// Replaces the place in the run: a mask hides the pixel, and nothing is learnt from it.
pub const HIDDEN: u8 = u8::MAX;

impl Pixels {
    /// Longest run: a place in it is one byte, and one value of that is [`HIDDEN`].
    pub const LONGEST_RUN: u32 = 255;

    /// Keeps one pixel of every `run`, at a place drawn from (seed, photo, run). Nothing is learnt from
    /// `hidden` pixels (`[height * width]`, `None`: no mask).
    ///
    /// The last run may be shorter. Its pixel is then drawn from fewer, as is that of a run with hidden
    /// pixels. `run` is clamped to 1 to 255. With 1 every pixel is kept and nothing is drawn.
    ///
    /// # Panics
    /// If there is not one of `hidden` for every pixel: a slip of the program.
    pub fn thinned(image: Image<Srgb>, hidden: Option<&[bool]>, run: u32, seed: u64, photo: u64) -> Self {
        let run = run.clamp(1, Self::LONGEST_RUN);
        if let Some(hidden) = hidden {
            assert_eq!(
                hidden.len(),
                image.pixels.len(),
                "a mask has the size of its photo"
            );
        }
        let Some(hidden) = hidden else {
            return match run {
                1 => image.into(),
                _ => Self::drawn(image, &[], run, seed, photo),
            };
        };
        if run > 1 {
            return Self::drawn(image, hidden, run, seed, photo);
        }
        let offsets = hidden.iter().map(|hidden| if *hidden { HIDDEN } else { 0 });
        Self {
            offsets: offsets.collect(),
            ..image.into()
        }
    }

    /// Draws one pixel of every run. `hidden` is empty or has one for every pixel.
    fn drawn(image: Image<Srgb>, hidden: &[bool], run: u32, seed: u64, photo: u64) -> Self {
        let mut rng = random_numbers(seed, Purpose::Thinning, 0, photo);
        let runs = image.pixels.chunks(run as usize).enumerate();
        let draw = |(index, pixels): (usize, &[[u8; 3]])| {
            let first = index * run as usize;
            let is_open = |place: &usize| !hidden.get(first + place).copied().unwrap_or(false);
            let open = (0..pixels.len()).filter(is_open);
            let count = open.clone().count();
            let drawn = rng.below(count.max(1) as u64) as usize;
            let mut open = open;
            match open.nth(drawn) {
                Some(place) => (pixels[place], place as u8),
                None => ([0; 3], HIDDEN),
            }
        };
        let (pixels, offsets) = runs.map(draw).unzip();
        Self {
            width: image.width,
            height: image.height,
            run,
            pixels,
            offsets,
            alpha: Vec::new(),
        }
    }

    /// Gives the kept pixels their opacities: those of all pixels of the photo, `[height * width]`, or empty
    /// where it is opaque.
    ///
    /// # Panics
    /// If there is not one for every pixel: a slip of the program.
    pub fn with_alpha(mut self, alpha: &[u8]) -> Self {
        if alpha.is_empty() {
            return self;
        }
        let all = self.width as usize * self.height as usize;
        assert_eq!(alpha.len(), all, "alpha has the size of its photo");
        self.alpha = (0..self.count()).map(|kept| alpha[self.place(kept)]).collect();
        self
    }

    /// Returns all pixels of the photo, `[height * width]`, masked ones too. `None` if some were left out.
    pub fn all(&self) -> Option<&[[u8; 3]]> {
        (self.run == 1).then_some(&self.pixels)
    }

    /// Returns whether some pixels of the photo show the space behind the scene, black here.
    pub fn is_transparent(&self) -> bool {
        !self.alpha.is_empty()
    }

    /// Returns the opacities of the kept pixels. Empty for an opaque photo.
    pub fn alpha(&self) -> &[u8] {
        &self.alpha
    }

    /// Returns how much a kept pixel shows of the space behind the scene, in [0, 1]. `None` for an opaque
    /// photo.
    pub fn share_behind(&self, kept: usize) -> Option<f32> {
        let alpha = self.alpha.get(kept)?;
        Some(f32::from(u8::MAX - alpha) / 255.0)
    }

    /// Returns whether a mask hides a kept pixel.
    pub fn is_hidden(&self, kept: usize) -> bool {
        self.offsets.get(kept) == Some(&HIDDEN)
    }

    /// Returns whether a mask hides all of the photo.
    pub fn is_all_hidden(&self) -> bool {
        !self.offsets.is_empty() && self.offsets.iter().all(|offset| *offset == HIDDEN)
    }

    /// Returns the bytes of an opaque photo with one pixel in `run` kept, with a mask or without. Alpha is
    /// one more a pixel.
    pub fn bytes(width: u32, height: u32, run: u32, masked: bool) -> u64 {
        let all = u64::from(width) * u64::from(height);
        match run {
            0 | 1 => {
                if masked {
                    4 * all
                } else {
                    3 * all
                }
            }
            _ => 4 * all.div_ceil(u64::from(run)),
        }
    }

    /// Returns how many pixels are kept.
    pub fn count(&self) -> usize {
        self.pixels.len()
    }

    /// Returns the pixels of a run. One of them is kept.
    pub fn run(&self) -> u32 {
        self.run
    }

    /// Returns whether the pixels fill the photo, and there is one.
    pub fn is_whole(&self) -> bool {
        let all = self.width as usize * self.height as usize;
        !self.pixels.is_empty() && self.pixels.len() == all.div_ceil(self.run as usize)
    }

    /// Returns the centre of a kept pixel in the photo, and its sRGB in [0, 1]. For a hidden one, the centre
    /// is the first of its run.
    pub fn at(&self, kept: usize) -> ([f64; 2], [f32; 3]) {
        let place = self.place(kept);
        let width = self.width as usize;
        let centre = [(place % width) as f64 + 0.5, (place / width) as f64 + 0.5];
        (
            centre,
            self.pixels[kept].map(|channel| f32::from(channel) / 255.0),
        )
    }

    /// Returns the index of a kept pixel among all of the photo. For a hidden one, the first of its run.
    fn place(&self, kept: usize) -> usize {
        let offset = self.offsets.get(kept).filter(|offset| **offset != HIDDEN);
        kept * self.run as usize + offset.map_or(0, |offset| usize::from(*offset))
    }

    /// Returns which of the kept pixels that of a column and row is, if it is kept and not hidden.
    pub fn kept(&self, column: u64, row: u64) -> Option<u64> {
        let place = row * u64::from(self.width) + column;
        let (kept, offset) = (place / u64::from(self.run), place % u64::from(self.run));
        let drawn = self.offsets.get(kept as usize).copied().unwrap_or(0);
        (u64::from(drawn) == offset).then_some(kept)
    }

    /// Returns every kept pixel as a number, to recognise the photo.
    pub fn words(&self) -> impl Iterator<Item = u64> {
        self.pixels.iter().enumerate().map(|(kept, [r, g, b])| {
            let offset = self.offsets.get(kept).copied().unwrap_or(0);
            u64::from(u32::from_le_bytes([*r, *g, *b, offset]))
        })
    }
}

impl From<Image<Srgb>> for Pixels {
    fn from(image: Image<Srgb>) -> Self {
        Self {
            width: image.width,
            height: image.height,
            run: 1,
            pixels: image.pixels,
            offsets: Vec::new(),
            alpha: Vec::new(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The colour of every pixel is its place.
    fn numbered(width: u32, height: u32) -> Image<Srgb> {
        Image::from_fn(width, height, |column, row| {
            let place = row * width + column;
            [place as u8, (place >> 8) as u8, (place >> 16) as u8]
        })
    }

    fn place(pixels: &Pixels, kept: usize) -> usize {
        let (centre, rgb) = pixels.at(kept);
        let place = (centre[1] - 0.5) as usize * pixels.width as usize + (centre[0] - 0.5) as usize;
        let bytes = rgb.map(|channel| (channel * 255.0 + 0.5) as usize);
        assert_eq!(bytes[0] | bytes[1] << 8 | bytes[2] << 16, place, "{centre:?}");
        place
    }

    #[test]
    fn one_pixel_of_every_run_is_kept_with_its_place() {
        for (width, height) in [(1, 1), (7, 5), (64, 48), (301, 17)] {
            for run in [1, 2, 8, 64, 255] {
                let pixels = Pixels::thinned(numbered(width, height), None, run, 3, 4);
                let all = (width * height) as usize;
                assert_eq!(
                    pixels.count(),
                    all.div_ceil(run as usize),
                    "{width} x {height} by {run}"
                );
                assert!(pixels.is_whole());
                for kept in 0..pixels.count() {
                    let place = place(&pixels, kept);
                    assert_eq!(place / run as usize, kept, "{width} x {height} by {run}");
                    assert!(place < all);
                    let (column, row) = (place as u64 % u64::from(width), place as u64 / u64::from(width));
                    assert_eq!(pixels.kept(column, row), Some(kept as u64));
                }
                let bytes = 3 * pixels.pixels.len() + pixels.offsets.len();
                assert_eq!(Pixels::bytes(width, height, run, false), bytes as u64, "{run}");
            }
        }
    }

    #[test]
    fn every_place_of_a_run_is_as_likely_as_any_other() {
        let mut times = [0_u32; 8];
        for photo in 0..50 {
            let pixels = Pixels::thinned(numbered(64, 64), None, 8, u64::MAX, photo);
            pixels
                .offsets
                .iter()
                .for_each(|offset| times[usize::from(*offset)] += 1);
        }
        // 25,600 draws: 3,200 a place, with a standard deviation of 53.
        assert!(
            times.iter().all(|times| (2_950..3_450).contains(times)),
            "{times:?}"
        );
    }

    #[test]
    fn all_bits_of_the_seed_and_the_photo_decide_what_is_kept() {
        let kept = |seed, photo| Pixels::thinned(numbered(64, 16), None, 16, seed, photo);
        assert_eq!(kept(1, 2), kept(1, 2));
        for (seed, photo) in [(1, 3), (1 + (1 << 40), 2), (1 << 63 | 1, 2)] {
            assert_ne!(kept(1, 2).offsets, kept(seed, photo).offsets, "{seed} {photo}");
        }
    }

    #[test]
    fn a_run_out_of_range_is_taken_into_it() {
        assert_eq!(
            Pixels::thinned(numbered(20, 20), None, 0, 1, 1),
            numbered(20, 20).into()
        );
        let most = Pixels::thinned(numbered(20, 20), None, u32::MAX, 1, 1);
        assert_eq!((most.run, most.count()), (255, 2));
    }

    #[test]
    fn an_image_without_pixels_or_with_too_few_is_not_whole() {
        let cut = Image {
            pixels: vec![[0; 3]; 5],
            ..numbered(2, 3)
        };
        assert!(!Pixels::from(cut).is_whole());
        assert!(!Pixels::thinned(numbered(0, 0), None, 4, 0, 0).is_whole());
    }

    #[test]
    fn what_a_mask_hides_is_never_drawn_and_its_run_is_drawn_from_the_rest() {
        let hidden = |place: usize| place % 7 < 3 || (64..128).contains(&place);
        let mask: Vec<bool> = (0..20 * 16).map(hidden).collect();
        for run in [1, 2, 8, 32, 255] {
            let pixels = Pixels::thinned(numbered(20, 16), Some(&mask), run, 3, 4);
            assert!(pixels.is_whole() && !pixels.is_all_hidden());
            for kept in 0..pixels.count() {
                let of_run = kept * run as usize..((kept + 1) * run as usize).min(mask.len());
                assert_eq!(
                    pixels.is_hidden(kept),
                    of_run.clone().all(hidden),
                    "{kept} by {run}"
                );
                if !pixels.is_hidden(kept) {
                    let place = place(&pixels, kept);
                    assert!(of_run.contains(&place) && !hidden(place), "{place} by {run}");
                    let (column, row) = ((place % 20) as u64, (place / 20) as u64);
                    assert_eq!(pixels.kept(column, row), Some(kept as u64));
                }
            }
            assert_eq!(pixels.kept(1, 0), None, "hidden");
            let bytes = 3 * pixels.pixels.len() + pixels.offsets.len();
            assert_eq!(Pixels::bytes(20, 16, run, true), bytes as u64, "{run}");
        }
        let all = Pixels::thinned(numbered(20, 16), Some(&[true; 320]), 4, 3, 4);
        assert!(all.is_whole() && all.is_all_hidden());
    }

    #[test]
    fn a_kept_pixel_has_the_opacity_of_its_place() {
        let alpha: Vec<u8> = (0..20 * 16).map(|place| (place * 7) as u8).collect();
        let mask: Vec<bool> = (0..20 * 16).map(|place| place % 3 == 0).collect();
        for (hidden, run) in [(None, 1), (None, 8), (Some(&*mask), 1), (Some(&*mask), 8)] {
            let pixels = Pixels::thinned(numbered(20, 16), hidden, run, 3, 4).with_alpha(&alpha);
            assert!(pixels.is_transparent());
            for kept in (0..pixels.count()).filter(|kept| !pixels.is_hidden(*kept)) {
                let share = pixels.share_behind(kept).unwrap();
                assert_eq!(share, f32::from(255 - alpha[place(&pixels, kept)]) / 255.0);
            }
        }
        let opaque = Pixels::from(numbered(20, 16)).with_alpha(&[]);
        assert!(!opaque.is_transparent() && opaque.share_behind(0).is_none());
    }

    #[test]
    fn a_mask_that_hides_nothing_changes_nothing_that_is_drawn() {
        for run in [1, 8] {
            let plain = Pixels::thinned(numbered(20, 16), None, run, 3, 4);
            let masked = Pixels::thinned(numbered(20, 16), Some(&[false; 320]), run, 3, 4);
            assert!(plain.words().eq(masked.words()), "{run}");
        }
    }
}
