//! Which cameras see colour.

use marf_scene::Sensor;

use crate::names::{ProductName, Scheme};

/// Starts of names of instruments, by the code of their spacecraft in labels. The first that fits counts.
const INSTRUMENTS: [(&str, &str, Sensor); 20] = [
    ("MER1", "", Sensor::Monochrome),
    ("MER2", "", Sensor::Monochrome),
    ("MSL", "NAV_", Sensor::Monochrome),
    ("MSL", "FHAZ_", Sensor::Monochrome),
    ("MSL", "RHAZ_", Sensor::Monochrome),
    ("MSL", "CHEMCAM", Sensor::Monochrome),
    ("MSL", "MAST", Sensor::Color),
    ("MSL", "MAHLI", Sensor::Color),
    ("MSL", "MARDI", Sensor::Color),
    ("NSYT", "IDC", Sensor::Color),
    ("NSYT", "ICC", Sensor::Color),
    ("M20", "MCZ_", Sensor::Color),
    ("M20", "NAVCAM_", Sensor::Color),
    ("M20", "FRONT_HAZCAM", Sensor::Color),
    ("M20", "REAR_HAZCAM", Sensor::Color),
    ("M20", "HELI_RTE", Sensor::Color),
    ("M20", "HELI_NAV", Sensor::Monochrome),
    ("M20", "LCAM", Sensor::Monochrome),
    ("M20", "SKYCAM", Sensor::Monochrome),
    ("M20", "PIXL_MCC", Sensor::Monochrome),
];

/// Returns the sensor of an instrument as labels name it. `None` if it is not known.
pub(crate) fn of_instrument(host: &str, instrument: &str) -> Option<Sensor> {
    let fits = |(own, start, _): &&(&str, &str, Sensor)| *own == host && instrument.starts_with(start);
    INSTRUMENTS.iter().find(fits).map(|(.., sensor)| *sensor)
}

impl ProductName {
    /// Returns whether the product's camera sees colour, by the name alone. `None` if it does not say.
    pub fn sensor(&self) -> Option<Sensor> {
        match self.scheme {
            Scheme::Mer | Scheme::MslEngineering => Some(Sensor::Monochrome),
            Scheme::MslScience => Some(Sensor::Color),
            Scheme::M2020 if self.filter.as_deref() == Some("M") => Some(Sensor::Monochrome),
            Scheme::M2020 => match self.instrument.as_str() {
                "ZL" | "ZR" | "NL" | "NR" | "FL" | "FR" | "BL" | "BR" | "RL" | "RR" | "HS" => {
                    Some(Sensor::Color)
                }
                "HN" | "EL" | "WS" | "PC" => Some(Sensor::Monochrome),
                _ => None,
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_says_whether_its_camera_sees_colour() {
        for (stem, sensor) in [
            ("NLA_399621413EDR_F0030308NCAM00405M1", Some(Sensor::Monochrome)),
            ("1N491020834ILFCNY9P0706L0M1", Some(Sensor::Monochrome)),
            ("2264ML0121141200805116C00_DRCL", Some(Sensor::Color)),
            (
                "NRE_0060_0672265209_237ECM_N0032046NCAM00410_00_0LLJ",
                Some(Sensor::Color),
            ),
            (
                "NLM_0060_0672265209_237ECM_N0032046NCAM00410_00_0LLJ",
                Some(Sensor::Monochrome),
            ),
            (
                "HNM_0649_0724570000_955ECM_N0370001HELI00002_000085J01",
                Some(Sensor::Monochrome),
            ),
            (
                "HSF_0649_0724570000_955ECM_N0370001HELI00002_000085J01",
                Some(Sensor::Color),
            ),
            (
                "ELM_0000_0666952977_600ECM_N0030000EDLC00011_0000LUJ01",
                Some(Sensor::Monochrome),
            ),
            ("LRF_0649_0724570000_955ECM_N0370001SCAM00002_000085J01", None),
        ] {
            let name = ProductName::read(stem).unwrap_or_else(|| panic!("{stem} is not read"));
            assert_eq!(name.sensor(), sensor, "{stem}");
        }
    }

    /// Two missions have a NAVCAM_LEFT: that of MER is monochrome, that of Mars 2020 is not.
    #[test]
    fn an_instrument_is_known_by_its_spacecraft() {
        assert_eq!(of_instrument("MER1", "NAVCAM_LEFT"), Some(Sensor::Monochrome));
        assert_eq!(of_instrument("M20", "NAVCAM_LEFT"), Some(Sensor::Color));
        assert_eq!(of_instrument("MSL", "NAV_LEFT_B"), Some(Sensor::Monochrome));
        assert_eq!(of_instrument("", "NAVCAM_LEFT"), None);
    }
}
