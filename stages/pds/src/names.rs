//! Product names, for all missions: Mars 2020 (54 characters), MSL Mastcam, MAHLI and MARDI (30), and the
//! engineering cameras of MSL (36) and MER (27). No other module splits a name.

use crate::values;

/// Length of a Mars 2020 name without its version.
const UNVERSIONED: usize = 52;
/// Length of a Mars 2020 name with its version.
const VERSIONED: usize = 54;

/// The fields of a product name.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ProductName {
    /// The name as written, without the suffix of feeds (`_1200`).
    pub id: String,
    /// Naming scheme.
    pub scheme: Scheme,
    /// Instrument code (`ZL`, `NL`, `ML`, `NLA`, `1N`).
    pub instrument: String,
    /// Colour filter, if the name has it.
    pub filter: Option<String>,
    /// Sol, if the name has it.
    pub sol: Option<u32>,
    /// The product is a thumbnail.
    pub thumbnail: bool,
    /// Type of product (`RAD`, `ECM`, `DRCL`).
    pub product_type: String,
    /// Version. The highest supersedes the others. Empty if the name has none (feeds).
    pub version: String,
    /// Factor by which the detector's pixels were averaged. 1 if the name has none.
    pub downsampling: u32,
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

/// Product types of Mars 2020 and of the engineering cameras that are not photos: reference pixels, sums, histograms,
/// depth, coordinates, ranges, normals, disparity, reachability, roughness, slopes.
const NO_PICTURE: [&str; 21] = [
    "EDM", "ERP", "ERS", "ECS", "EHG", "ETH", "XYZ", "XYM", "XYR", "XYE", "RNG", "RNM", "RNR", "RNE", "UVW",
    "MXY", "DSP", "DSR", "ARM", "RUF", "SLP",
];

/// Product types of Mars 2020 that are frames of videos and of stacks of focus.
const SERIES: [&str; 6] = ["ECV", "EVD", "ECZ", "EZS", "ECR", "ERD"];

impl ProductName {
    /// Reads a file name without its extension. `None` if it follows no known scheme.
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

    /// Reads the name that a text begins with. After a Mars 2020 name anything may follow, as in the file name of a copy.
    pub fn read_start(text: &str) -> Option<Self> {
        Self::read(text).or_else(|| Self::read(text.get(..UNVERSIONED)?))
    }

    /// Whether the product is a frame of a video or of a stack of focus: one exposure, many products.
    pub fn is_of_series(&self) -> bool {
        SERIES.contains(&self.product_type.as_str())
    }

    /// Returns the key that all products of an exposure share: the name in upper case, without colour filter, type,
    /// producer and version.
    pub fn exposure_key(&self) -> String {
        let id = self.id.to_ascii_uppercase();
        match self.scheme {
            Scheme::M2020 => format!("{}{}{}", &id[..2], &id[3..23], &id[26..51]),
            Scheme::MslScience => id[..24].to_owned(),
            Scheme::MslEngineering => format!("{}{}", &id[..13], &id[16..35]),
            Scheme::Mer => id,
        }
    }

    /// Returns what all versions of an exposure share, those in another geometry included: the name in upper case, without
    /// type, geometry, producer and version.
    pub fn exposure(&self) -> String {
        let id = self.id.to_ascii_uppercase();
        match self.scheme {
            Scheme::M2020 => format!("{}{}", &id[..23], &id[27..48]),
            Scheme::MslScience => id[..24].to_owned(),
            Scheme::MslEngineering => format!("{}{}", &id[..13], &id[17..35]),
            Scheme::Mer => format!("{}{}", &id[..11], &id[14..25]),
        }
    }

    /// Returns what exposures share that were planned with one pointing: instrument, sol, site, drive, sequence and camera
    /// settings. Filter and clock may differ. `None` if names of the scheme do not say so.
    pub fn planned_pointing(&self) -> Option<String> {
        let id = self.id.to_ascii_uppercase();
        (self.scheme == Scheme::M2020).then(|| format!("{}{}{}", &id[..2], &id[4..8], &id[27..48]))
    }

    /// Returns the spacecraft clock, whole seconds, of a Mars 2020 name.
    pub fn clock_s(&self) -> Option<u64> {
        let digits = Some(&self.id[9..19]).filter(|_| self.scheme == Scheme::M2020);
        digits?.parse().ok()
    }

    /// Returns the camera with its eye and the clock. A photo shares them with everything that is computed from it, whatever its
    /// geometry, colour, tile and version.
    pub fn camera_and_clock(&self) -> String {
        let id = self.id.to_ascii_uppercase();
        match self.scheme {
            Scheme::M2020 => format!("{}{}", &id[..2], &id[3..23]),
            Scheme::MslScience => id[..24].to_owned(),
            Scheme::MslEngineering => id[..13].to_owned(),
            Scheme::Mer => format!("{}{}", &id[..11], &id[23..24]),
        }
    }

    /// Returns [`ProductName::camera_and_clock`] of a photo that the other eye takes at the same time, if names say so.
    pub fn twin_camera_and_clock(&self) -> Option<String> {
        let mut twin = self.camera_and_clock();
        let eye = match self.scheme {
            Scheme::M2020 | Scheme::MslEngineering => 1,
            Scheme::Mer => 11,
            Scheme::MslScience => return None,
        };
        let other = match &twin[eye..=eye] {
            "L" => "R",
            "R" => "L",
            _ => return None,
        };
        twin.replace_range(eye..=eye, other);
        Some(twin)
    }

    /// Returns the rank of the product among the versions of its exposure, the best first: radiance or I/F of 16 bits, then
    /// other calibrated products, then counts and codes.
    pub fn processing_rank(&self) -> u8 {
        match self.product_type.as_str() {
            "RAD" | "DRXX" => 0,
            "IOF" => 1,
            kind if kind.starts_with("DR") || kind.starts_with('R') || kind.starts_with("IO") => 2,
            "DXXX" => 3,
            _ => 4,
        }
    }

    /// Returns the reason if a file of this name is not a photo.
    pub fn no_photo(&self) -> Option<String> {
        (self.scheme != Scheme::MslScience && NO_PICTURE.contains(&self.product_type.as_str()))
            .then(|| format!("product type {} holds no photo", self.product_type))
    }

    /// Whether the pixels are as the camera sent them. Such pixels may still be codes of a look-up table.
    pub fn is_as_received(&self) -> bool {
        let kinds: &[&str] = match self.scheme {
            Scheme::M2020 => &["ECM", "ECV", "ECZ", "ECR"],
            Scheme::MslScience => &["XXXX", "DXXX"],
            Scheme::MslEngineering | Scheme::Mer => &[],
        };
        kinds.contains(&self.product_type.as_str())
    }

    /// Whether, by the name, pixels in one band are a colour mosaic that is not interpolated yet. `filter` is the colour
    /// filter by the label, for names without one.
    pub fn is_mosaic(&self, filter: Option<&str>) -> bool {
        let raw =
            ["ECM", "EDR", "ECV", "EVD", "ECZ", "EZS", "ECR", "ERD"].contains(&self.product_type.as_str());
        let filter = self.filter.as_deref().or(filter).unwrap_or("0");
        let mastcam = self.instrument.starts_with('Z');
        let whole = self.downsampling == 1;
        match self.scheme {
            Scheme::M2020 => raw && whole && (filter == "E" || (mastcam && filter == "0")),
            // A, B and C are arrays of raw pixels, with a table or lossless compression.
            Scheme::MslScience => {
                self.is_as_received() && filter == "0" && b"ABCabc".contains(&self.id.as_bytes()[22])
            }
            Scheme::MslEngineering | Scheme::Mer => false,
        }
    }
}

/// Returns the key that all files of a product share: the name in upper case, without version and suffix of feeds.
pub fn join_key(stem: &str) -> String {
    let upper = stem.to_ascii_uppercase();
    match ProductName::read(&upper) {
        Some(name) if name.scheme == Scheme::M2020 => upper[..UNVERSIONED].to_owned(),
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

/// Reads a name of 54 characters, or of 52 in feeds, which may append `_1200` and the like. Every field is at a fixed position
/// (Mars 2020 Camera SIS, "File naming").
fn mars2020(upper: &str) -> Option<ProductName> {
    let bytes = upper.as_bytes();
    let shape = bytes.len() >= UNVERSIONED
        && letters_or_digits(upper)
        && bytes[0].is_ascii_alphabetic()
        && bytes[8] == b'_'
        && digits(&upper[9..19])
        && bytes[19] == b'_'
        && digits(&upper[20..23])
        && matches!(bytes[27], b'T' | b'N')
        && bytes[48].is_ascii_digit();
    if !shape {
        return None;
    }
    let length = match upper.len() {
        UNVERSIONED => UNVERSIONED,
        _ if bytes[UNVERSIONED] == b'_' => UNVERSIONED,
        VERSIONED => VERSIONED,
        _ if bytes.get(VERSIONED) == Some(&b'_') => VERSIONED,
        _ => return None,
    };
    // Letters in the four characters of the sol denote days on Earth.
    let sol = &upper[4..8];
    Some(ProductName {
        id: upper[..length].to_owned(),
        scheme: Scheme::M2020,
        instrument: upper[..2].to_owned(),
        filter: values::known(upper[2..3].trim_matches('_')),
        sol: values::sol(sol).filter(|_| digits(sol)),
        thumbnail: bytes[27] == b'T',
        product_type: upper[23..26].to_owned(),
        version: upper[UNVERSIONED..length].to_owned(),
        downsampling: 1 << u32::from(bytes[48] - b'0'),
    })
}

/// Reads a name like `2264ML0121141200805116C00_DRCL`.
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
        downsampling: 1,
    })
}

/// Reads a name like `NLB_586004185EDR_F0721234NCAM00295M1`.
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
        downsampling: 1,
    })
}

/// Reads a name like `1N491020834ILFCNY9P0706L0M1`.
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
        downsampling: 1,
    })
}

#[cfg(test)]
mod tests;
