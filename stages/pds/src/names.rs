//! What file names of the three missions say: Mars 2020 (54 characters), MSL Mastcam / MAHLI / MARDI (30), and the
//! engineering cameras of MSL (36) and MER (27).

use crate::values;

/// What a product's name says of it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ProductName {
    /// The name without what a feed appends (`_1200`), as written.
    pub id: String,
    /// Which scheme it follows.
    pub scheme: Scheme,
    /// Instrument code (`ZL`, `NL`, `ML`, `NLA`, `1N`).
    pub instrument: String,
    /// Colour filter, if the name tells.
    pub filter: Option<String>,
    /// Sol, if the name tells.
    pub sol: Option<u32>,
    /// The name calls it a thumbnail.
    pub thumbnail: bool,
    /// Type of product (`RAD`, `ECM`, `DRCL`).
    pub product_type: String,
    /// Version; the highest supersedes the others. Empty where the name has none (feeds).
    pub version: String,
    /// Factor by which the detector's pixels were averaged, where the name tells.
    pub reduced: u32,
}

/// A naming scheme.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Scheme {
    /// Mars 2020: all cameras.
    M2020,
    /// MSL: Mastcam, MAHLI, MARDI.
    MslScience,
    /// MSL: Navcam, Hazcam.
    MslEngineering,
    /// Spirit and Opportunity.
    Mer,
}

/// Product types of Mars 2020 and of the engineering cameras that hold no picture: reference pixels, sums,
/// histograms, depth, coordinates, ranges, normals, disparity, reachability, roughness, slopes.
const NO_PICTURE: [&str; 21] = [
    "EDM", "ERP", "ERS", "ECS", "EHG", "ETH", "XYZ", "XYM", "XYR", "XYE", "RNG", "RNM", "RNR", "RNE", "UVW",
    "MXY", "DSP", "DSR", "ARM", "RUF", "SLP",
];

impl ProductName {
    /// Reads a file name without its extension; `None` if it follows no known scheme.
    pub fn read(stem: &str) -> Option<Self> {
        if !stem.is_ascii() {
            return None;
        }
        let upper = stem.to_ascii_uppercase();
        let mut name = mars2020(&upper)
            .or_else(|| msl_science(&upper))
            .or_else(|| msl_engineering(&upper))
            .or_else(|| mer(&upper))?;
        name.id = stem[..name.id.len()].to_owned();
        Some(name)
    }

    /// Returns why a file of this name is no photo, if so.
    pub fn no_photo(&self) -> Option<String> {
        (self.scheme != Scheme::MslScience && NO_PICTURE.contains(&self.product_type.as_str()))
            .then(|| format!("product type {} holds no photo", self.product_type))
    }

    /// Tells whether the pixels are as the camera sent them: such products may still be codes of a table.
    pub fn is_as_received(&self) -> bool {
        let kinds: &[&str] = match self.scheme {
            Scheme::M2020 => &["ECM", "ECV", "ECZ", "ECR"],
            Scheme::MslScience => &["XXXX", "DXXX"],
            Scheme::MslEngineering | Scheme::Mer => &[],
        };
        kinds.contains(&self.product_type.as_str())
    }

    /// Tells whether the name alone says that the pixels are still a colour mosaic if they have one band.
    pub fn says_mosaic(&self) -> bool {
        let raw =
            ["ECM", "EDR", "ECV", "EVD", "ECZ", "EZS", "ECR", "ERD"].contains(&self.product_type.as_str());
        let filter = self.filter.as_deref().unwrap_or_default();
        let mastcam = self.instrument.starts_with('Z');
        let whole = self.reduced == 1;
        self.scheme == Scheme::M2020 && raw && whole && (filter == "E" || (mastcam && filter == "0"))
    }
}

/// Returns what the files of one product share: the name in upper case, without version and what feeds append.
pub fn join_key(stem: &str) -> String {
    let upper = stem.to_ascii_uppercase();
    match ProductName::read(&upper) {
        Some(name) if name.scheme == Scheme::M2020 => upper[..52].to_owned(),
        Some(name) => name.id,
        None => upper,
    }
}

fn digits(text: &str) -> bool {
    !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit())
}

fn letters_or_digits(text: &str) -> bool {
    text.bytes()
        .all(|byte| byte.is_ascii_alphanumeric() || byte == b'_')
}

/// 54 characters, or 52 in feeds, which may append `_1200` and the like.
fn mars2020(upper: &str) -> Option<ProductName> {
    let bytes = upper.as_bytes();
    let shape = upper.len() >= 52
        && letters_or_digits(upper)
        && digits(&upper[9..19])
        && bytes[19] == b'_'
        && digits(&upper[20..23])
        && matches!(bytes[27], b'T' | b'N')
        && bytes[48].is_ascii_digit()
        && bytes[8] == b'_'
        && bytes[0].is_ascii_alphabetic();
    let length = match upper.len() {
        52 => 52,
        _ if shape && matches!(bytes.get(52), Some(b'_')) => 52,
        54 => 54,
        _ if bytes.get(54) == Some(&b'_') => 54,
        _ => return None,
    };
    shape.then(|| ProductName {
        id: upper[..length].to_owned(),
        scheme: Scheme::M2020,
        instrument: upper[..2].to_owned(),
        filter: values::known(upper[2..3].trim_matches('_')),
        sol: values::sol(&upper[4..8]).filter(|_| digits(&upper[4..8])),
        thumbnail: bytes[27] == b'T',
        product_type: upper[23..26].to_owned(),
        version: upper[52..length].to_owned(),
        reduced: 1 << u32::from(bytes[48] - b'0'),
    })
}

/// `2264ML0121141200805116C00_DRCL`.
fn msl_science(upper: &str) -> Option<ProductName> {
    let bytes = upper.as_bytes();
    let shape = upper.len() == 30
        && letters_or_digits(upper)
        && digits(&upper[..4])
        && ["ML", "MR", "MH", "MD"].contains(&&upper[4..6])
        && digits(&upper[6..15])
        && bytes[22].is_ascii_alphabetic()
        && bytes[25] == b'_';
    shape.then(|| ProductName {
        id: upper.to_owned(),
        scheme: Scheme::MslScience,
        instrument: upper[4..6].to_owned(),
        filter: None,
        sol: values::sol(&upper[..4]),
        thumbnail: b"GHIOPQTU".contains(&bytes[22]),
        product_type: upper[26..].to_owned(),
        version: upper[24..25].to_owned(),
        reduced: 1,
    })
}

/// `NLB_586004185EDR_F0721234NCAM00295M1`.
fn msl_engineering(upper: &str) -> Option<ProductName> {
    let bytes = upper.as_bytes();
    let shape = upper.len() == 36
        && letters_or_digits(upper)
        && ["NL", "NR", "FL", "FR", "RL", "RR"].contains(&&upper[..2])
        && matches!(bytes[2], b'A' | b'B')
        && digits(&upper[4..13]);
    shape.then(|| ProductName {
        id: upper.to_owned(),
        scheme: Scheme::MslEngineering,
        instrument: upper[..3].to_owned(),
        filter: None,
        sol: None,
        thumbnail: bytes[17] == b'T',
        product_type: upper[13..16].to_owned(),
        version: upper[35..].to_owned(),
        reduced: 1,
    })
}

/// `1N491020834ILFCNY9P0706L0M1`.
fn mer(upper: &str) -> Option<ProductName> {
    let bytes = upper.as_bytes();
    let shape = upper.len() == 27
        && letters_or_digits(upper)
        && matches!(bytes[0], b'1' | b'2')
        && b"NPFRME".contains(&bytes[1])
        && digits(&upper[2..11])
        && bytes[18].is_ascii_alphabetic()
        && matches!(bytes[23], b'L' | b'R' | b'M' | b'N' | b'B');
    shape.then(|| ProductName {
        id: upper.to_owned(),
        scheme: Scheme::Mer,
        instrument: format!("{}{}", &upper[..2], &upper[23..24]),
        filter: values::known(&upper[24..25]),
        sol: None,
        thumbnail: &upper[12..14] == "TH",
        product_type: upper[11..14].to_owned(),
        version: upper[26..].to_owned(),
        reduced: 1,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(stem: &str) -> ProductName {
        ProductName::read(stem).unwrap_or_else(|| panic!("{stem} is not read"))
    }

    #[test]
    fn a_mars_2020_name_is_read_by_position() {
        let name = read("ZL0_0709_0729888971_069RAD_N0332864ZCAM07114_0340LMA01");
        assert_eq!((name.instrument.as_str(), name.sol), ("ZL", Some(709)));
        assert_eq!((name.filter.as_deref(), name.thumbnail), (Some("0"), false));
        assert_eq!((name.product_type.as_str(), name.version.as_str()), ("RAD", "01"));
        let thumbnail = read("HSF_0649_0724570000_955ECM_T0370001HELI00002_000085J01");
        assert!(thumbnail.thumbnail && thumbnail.instrument == "HS");
        assert!(thumbnail.is_as_received() && !name.is_as_received());
    }

    #[test]
    fn a_feed_name_and_its_archive_name_join() {
        let feed = "NLF_0050_0671382174_448ECM_N0031950NCAM00500_01_295J";
        for other in [
            format!("{feed}01"),
            format!("{feed}02_1200"),
            format!("{feed}01_800"),
            format!("{feed}_320"),
        ] {
            assert_eq!(join_key(&other), join_key(feed), "{other}");
        }
        assert_eq!(read(feed).reduced, 4);
        assert_eq!(read(&format!("{feed}01_800")).id, format!("{feed}01"));
        assert_ne!(join_key(feed), join_key(&feed.replace("295J", "195J")));
    }

    #[test]
    fn names_of_msl_and_mer_are_read() {
        let name = read("3778ML1037770010808163I01_DXXX");
        assert!(name.thumbnail && name.sol == Some(3778) && name.product_type == "DXXX");
        assert!(!read("2264ML0121141200805116C00_DRCL").thumbnail);
        assert_eq!(
            join_key("3778ml1037770010808163i01_dxxx"),
            "3778ML1037770010808163I01_DXXX"
        );
        let navcam = read("NLA_399621413EDR_F0030308NCAM00405M1");
        assert_eq!((navcam.instrument.as_str(), navcam.sol), ("NLA", None));
        assert!(read("NLA_399620372ARMLD0030266TRAV00004M1").no_photo().is_some());
        let opportunity = read("1N491020834ILFCNY9P0706L0M1");
        assert_eq!(
            (opportunity.instrument.as_str(), opportunity.filter.as_deref()),
            ("1NL", Some("0"))
        );
    }

    #[test]
    fn only_raw_broad_band_names_say_mosaic() {
        assert!(read("NRE_0060_0672265209_237ECM_N0032046NCAM00410_00_0LLJ").says_mosaic());
        assert!(!read("NLF_0060_0672265209_237EBY_N0032046NCAM00410_00_0LLJ").says_mosaic());
        assert!(!read("NRE_0060_0672265209_237ECM_N0032046NCAM00410_00_1LLJ").says_mosaic());
        assert!(read("ZL0_0001_0667035659_559ECM_N0010052AUT_04096_0260LMJ01").says_mosaic());
        assert!(!read("ZL1_0001_0667035659_559ECM_N0010052AUT_04096_0260LMJ01").says_mosaic());
    }

    #[test]
    fn other_names_follow_no_scheme() {
        let long = "_".repeat(60);
        for other in [
            "",
            "frame_00003",
            "ukbench00120",
            &long,
            "é".repeat(30).as_str(),
            &"9".repeat(54),
        ] {
            assert_eq!(ProductName::read(other), None, "{other}");
        }
    }
}
