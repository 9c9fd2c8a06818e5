//! EXIF orientation: how stored pixels are turned to be upright.
//!
//! Decoding turns a photo upright. COLMAP, nerfstudio and instant-ngp open the stored pixels, and their cameras are for these.

use marf_scene::{Image, Srgb};

/// Beginning of the note of a photo that was turned. The number of the orientation follows.
const NOTE: &str = "turned upright from EXIF orientation ";

/// An EXIF orientation, 1 to 8.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Orientation(u8);

impl Orientation {
    /// Stored as it is seen.
    pub const UPRIGHT: Self = Self(1);

    /// Returns the orientation from which a photo was turned, read from the notes of its decoding.
    pub fn from_notes(notes: &[String]) -> Self {
        let number = notes
            .iter()
            .find_map(|note| note.strip_prefix(NOTE)?.parse().ok());
        number
            .filter(|number| (1..=8).contains(number))
            .map_or(Self::UPRIGHT, Self)
    }

    /// Returns the size of the stored pixels of an upright size, and the other way round.
    pub fn other_size(self, [width, height]: [u32; 2]) -> [u32; 2] {
        if self.0 >= 5 {
            [height, width]
        } else {
            [width, height]
        }
    }

    /// Returns the stored pixels of an upright image.
    pub fn stored(self, upright: &Image<Srgb>) -> Image<Srgb> {
        let [width, height] = self.other_size([upright.width, upright.height]);
        let (right, bottom) = (width.saturating_sub(1), height.saturating_sub(1));
        Image::from_fn(width, height, |x, y| {
            let (column, row) = match self.0 {
                2 => (right - x, y),
                3 => (right - x, bottom - y),
                4 => (x, bottom - y),
                5 => (y, x),
                6 => (bottom - y, x),
                7 => (bottom - y, right - x),
                8 => (y, right - x),
                _ => (x, y),
            };
            upright.at(column, row)
        })
    }

    /// Returns stored pixels upright.
    pub fn upright(self, stored: &Image<Srgb>) -> Image<Srgb> {
        // The quarter turns undo each other, every other orientation itself.
        let inverse = match self.0 {
            6 => 8,
            8 => 6,
            number => number,
        };
        Self(inverse).stored(stored)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 3 x 2 pixels, a to f by rows.
    fn letters() -> Image<Srgb> {
        Image::from_fn(3, 2, |x, y| [b'a' + (x + 3 * y) as u8; 3])
    }

    fn text(image: &Image<Srgb>) -> String {
        let rows = image.pixels.chunks(image.width as usize);
        let rows: Vec<String> = rows
            .map(|row| row.iter().map(|pixel| char::from(pixel[0])).collect())
            .collect();
        rows.join("/")
    }

    #[test]
    fn each_orientation_is_turned_upright_as_exif_says_and_back() {
        // Exif 2.32, table 6: where row 0 and column 0 of the stored pixels are seen.
        let upright = [
            "abc/def", "cba/fed", "fed/cba", "def/abc", "ad/be/cf", "da/eb/fc", "fc/eb/da", "cf/be/ad",
        ];
        for (number, expected) in (1..).zip(upright) {
            let note = format!("{NOTE}{number}");
            let orientation = Orientation::from_notes(&["other".to_owned(), note]);
            let seen = orientation.upright(&letters());
            assert_eq!(text(&seen), expected, "{number}");
            assert_eq!(orientation.stored(&seen), letters(), "{number}");
            assert_eq!(orientation.other_size([3, 2]), [seen.width, seen.height]);
        }
        for note in ["turned upright from EXIF orientation 9", "16 bits reduced to 8"] {
            assert_eq!(Orientation::from_notes(&[note.to_owned()]), Orientation::UPRIGHT);
        }
    }
}
