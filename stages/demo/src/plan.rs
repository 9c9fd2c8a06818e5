//! The files of a sol: which view becomes which file, with which flaw.

use super::tour::{self, Eye, Pointing};

/// Sols that exist.
pub const SOLS: std::ops::RangeInclusive<u32> = 1..=999;
/// Sols that the rover spends at one site, each with a landscape and a frame of its own.
pub const SOLS_A_SITE: u32 = 100;
/// Factor by which thumbnails are reduced.
pub const THUMBNAIL_FACTOR: u32 = 4;
/// Spacecraft clock at the first sol, seconds, and seconds per sol.
const CLOCK_S: u32 = 667_000_000;
const SOL_S: u32 = 88_775;

/// Returns the site of a sol, from 1 on.
pub const fn site(sol: u32) -> u32 {
    1 + sol.saturating_sub(1) / SOLS_A_SITE
}

/// The flaw of a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FlawKind {
    /// The thumbnail of a good photo, named as one.
    Thumbnail,
    /// A good photo in one band.
    MonoCopy,
    /// One band, of a view that no other file shows.
    Mono,
    /// Three equal bands, of a view that no other file shows.
    EqualBands,
    /// A good photo's view through a narrow colour filter of this number.
    NarrowBand(u8),
    /// The bytes of a good photo under another name.
    ExactCopy,
    /// A good photo as a JPEG of quality 75.
    Reencoded,
    /// Out of focus.
    Defocus,
    /// Motion blur of a turning mast.
    Motion,
    /// Noise instead of a picture.
    Noise,
    /// Blocks of saturated colours instead of a picture.
    ColourBlocks,
    /// The rover's own deck fills the photo.
    Deck,
    /// A JPEG cut in half.
    Truncated,
    /// A dark frame: a whole picture in very few bytes.
    Dark,
}

impl FlawKind {
    /// Returns whether it is made from a photo of the landscape.
    pub(super) const fn shows_mars(self) -> bool {
        !matches!(self, Self::Noise | Self::ColourBlocks | Self::Deck | Self::Dark)
    }

    const fn extension(self) -> &'static str {
        match self {
            Self::Reencoded | Self::Truncated => "jpg",
            _ => "png",
        }
    }
}

/// One image file.
#[derive(Debug, Clone)]
pub struct Product {
    /// Product name, 54 characters.
    pub id: String,
    pub flaw: Option<FlawKind>,
    /// Digit of the colour filter.
    pub filter: u8,
    /// Spacecraft clock, seconds.
    pub clock_s: u32,
}

impl Product {
    pub fn file(&self) -> String {
        let extension = self.flaw.map_or("png", FlawKind::extension);
        format!("{}.{extension}", self.id)
    }
}

/// One exposure of one eye, and the files made from it.
#[derive(Debug, Clone)]
pub struct View {
    pub pointing: Pointing,
    pub eye: Eye,
    pub products: Vec<Product>,
}

impl View {
    /// Returns the good photo, if the view has one.
    pub fn good(&self) -> Option<&Product> {
        self.products.iter().find(|product| product.flaw.is_none())
    }
}

/// Returns the views of a sol in the order they were taken.
pub fn views(sol: u32, drives: &[u32]) -> Vec<View> {
    let mut slot = 0;
    let mut view = |pointing: Pointing, eye: Eye, flaws: &[Option<FlawKind>]| {
        let mut product = |flaw: &Option<FlawKind>| {
            slot += 1;
            product(sol, slot, drives[pointing.stop], eye, *flaw)
        };
        View {
            pointing,
            eye,
            products: flaws.iter().map(&mut product).collect(),
        }
    };
    let mut all = Vec::new();
    for (index, pointing) in tour::pairs().into_iter().enumerate() {
        for eye in [Eye::Left, Eye::Right] {
            all.push(view(pointing, eye, copies(index, eye)));
        }
    }
    let spare = [
        FlawKind::Mono,
        FlawKind::EqualBands,
        FlawKind::Defocus,
        FlawKind::Motion,
    ];
    for (pointing, flaw) in tour::spare().into_iter().zip(spare) {
        all.push(view(pointing, Eye::Left, &[Some(flaw)]));
    }
    let synthetic = [
        FlawKind::Noise,
        FlawKind::ColourBlocks,
        FlawKind::Deck,
        FlawKind::Dark,
    ];
    for flaw in synthetic {
        all.push(view(tour::DECK, Eye::Right, &[Some(flaw)]));
    }
    all
}

/// Returns the files of a good view: the photo, then the flawed ones made from it.
fn copies(pair: usize, eye: Eye) -> &'static [Option<FlawKind>] {
    match (pair, eye) {
        (0, Eye::Left) => &[
            None,
            Some(FlawKind::Thumbnail),
            Some(FlawKind::NarrowBand(1)),
            Some(FlawKind::NarrowBand(5)),
        ],
        (4, Eye::Left) => &[None, Some(FlawKind::MonoCopy), Some(FlawKind::ExactCopy)],
        (7, Eye::Right) => &[None, Some(FlawKind::Reencoded), Some(FlawKind::Truncated)],
        _ => &[None],
    }
}

fn product(sol: u32, slot: u32, drive: u32, eye: Eye, flaw: Option<FlawKind>) -> Product {
    let filter = match flaw {
        Some(FlawKind::NarrowBand(filter)) => filter,
        _ => 0,
    };
    let side = if eye == Eye::Left { 'L' } else { 'R' };
    let size = if flaw == Some(FlawKind::Thumbnail) {
        'T'
    } else {
        'N'
    };
    let clock_s = CLOCK_S + sol * SOL_S + slot * 61;
    let ms = slot * 37 % 1000;
    Product {
        id: format!(
            "Z{side}{filter}_{sol:04}_{clock_s:010}_{ms:03}EBY_{size}{site:03}{drive:04}ZCAM{slot:05}_0260LMJ01",
            site = site(sol)
        ),
        flaw,
        filter,
        clock_s,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The slices of the Mars 2020 file name, one by one.
    #[test]
    fn names_are_of_the_mars_2020_scheme() {
        for sol in [1, 2, 999] {
            for product in views(sol, &[20, 23, 9011]).iter().flat_map(|view| &view.products) {
                let id = &product.id;
                assert_eq!(id.len(), 54, "{id}");
                assert!(id.starts_with("ZL") || id.starts_with("ZR"), "{id}");
                let digits = |from: usize, to: usize| id[from..to].bytes().all(|byte| byte.is_ascii_digit());
                assert!(
                    digits(2, 3) && digits(9, 19) && digits(20, 23) && digits(31, 35) && digits(52, 54),
                    "{id}"
                );
                assert_eq!(id[4..8].parse::<u32>(), Ok(sol), "{id}");
                assert_eq!(
                    (&id[3..4], &id[8..9], &id[19..20], &id[26..27]),
                    ("_", "_", "_", "_")
                );
                assert_eq!(&id[23..26], "EBY");
                assert_eq!(
                    &id[27..28] == "T",
                    product.flaw == Some(FlawKind::Thumbnail),
                    "{id}"
                );
                assert_eq!((&id[35..39], &id[44..45], &id[48..52]), ("ZCAM", "_", "0LMJ"));
            }
        }
    }

    #[test]
    fn no_two_files_share_a_name() {
        let views = views(7, &[1, 2, 3]);
        let names: Vec<String> = views
            .iter()
            .flat_map(|view| &view.products)
            .map(Product::file)
            .collect();
        let distinct: std::collections::BTreeSet<&String> = names.iter().collect();
        assert_eq!(distinct.len(), names.len());
    }
}
