//! Product names of Mars 2020: 54 characters, every field at a fixed position (Mars 2020 Camera SIS, "File naming").

/// Length of a name without its version.
pub(super) const UNVERSIONED: usize = 52;
/// Length of a name with its version.
pub(super) const VERSIONED: usize = 54;

/// A text that begins with a Mars 2020 product name, in letters of either case.
///
/// Weaker than [`super::ProductName::read`]: only the separators, the clock and the mark of thumbnails are checked, and
/// anything may follow after 52 characters.
#[derive(Debug, Clone, Copy)]
pub struct Mars2020Name<'a>(&'a str);

impl<'a> Mars2020Name<'a> {
    /// Reads the name that a text begins with. `None` if there is none, or the text is not ASCII.
    pub fn read(text: &'a str) -> Option<Self> {
        let bytes = text.as_bytes();
        let digits = |from: usize, to: usize| bytes[from..to].iter().all(u8::is_ascii_digit);
        let fits = text.is_ascii()
            && bytes.len() >= UNVERSIONED
            && bytes[8] == b'_'
            && digits(9, 19)
            && bytes[19] == b'_'
            && digits(20, 23)
            && matches!(bytes[27], b'T' | b'N' | b't' | b'n');
        fits.then_some(Self(text))
    }

    /// Returns the code of the instrument (`ZL`, `NR`), as written.
    pub fn instrument(self) -> &'a str {
        &self.0[..2]
    }

    /// Returns the code of the colour filter, as written.
    pub fn filter(self) -> &'a str {
        &self.0[2..3]
    }

    /// Returns the four characters of the sol. Letters denote days on Earth.
    pub fn sol(self) -> &'a str {
        &self.0[4..8]
    }

    /// Returns the spacecraft clock, whole seconds.
    pub fn clock_s(self) -> u64 {
        self.0[9..19].parse().unwrap_or(0) // ten digits, as `read` has checked
    }

    /// Returns the type of product (`RAD`, `ECM`), as written.
    pub fn product_type(self) -> &'a str {
        &self.0[23..26]
    }

    /// Whether the name is a thumbnail's.
    pub fn is_thumbnail(self) -> bool {
        self.0.as_bytes()[27].eq_ignore_ascii_case(&b'T')
    }

    /// Returns the digit that counts how often the pixels were halved, as written.
    pub(super) fn downsampling(self) -> u8 {
        self.0.as_bytes()[48]
    }

    /// Whether two different products show one exposure: equal in instrument, filter, clock to the millisecond, site,
    /// drive, sequence and camera settings. Type, geometry, compression and version may differ.
    pub fn is_other_product_of_exposure(self, other: Mars2020Name<'_>) -> bool {
        self.same_at(other, [0..23, 27..48])
            && !(self.0[23..27].eq_ignore_ascii_case(&other.0[23..27])
                && self.0[48..].eq_ignore_ascii_case(&other.0[48..]))
    }

    /// Whether two exposures were planned with one pointing: equal in instrument, sol, site, drive, sequence and
    /// camera settings. Filter and clock may differ.
    pub fn is_same_planned_pointing(self, other: Mars2020Name<'_>) -> bool {
        self.same_at(other, [0..2, 4..8, 27..48])
    }

    fn same_at<const N: usize>(self, other: Mars2020Name<'_>, ranges: [std::ops::Range<usize>; N]) -> bool {
        ranges
            .into_iter()
            .all(|range| self.0[range.clone()].eq_ignore_ascii_case(&other.0[range]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_text_may_go_on_after_the_name() {
        let name = "zl0_0709_0729888971_069RAD_N0332864ZCAM07114_0340LMA01";
        let read = |text| Mars2020Name::read(text).unwrap();
        let copy = format!("{name} (1).png");
        assert!(read(name).is_other_product_of_exposure(read(&copy)));
        assert_eq!(
            (read(&copy).clock_s(), read(&copy).product_type()),
            (729_888_971, "RAD")
        );
        for bad in [
            "",
            "ZL0",
            &copy[1..],
            &format!("{name} é"),
            &copy.replacen("_N", "_X", 1),
        ] {
            assert!(Mars2020Name::read(bad).is_none(), "{bad}");
        }
    }
}
