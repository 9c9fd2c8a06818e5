//! Look-up tables that turn 8-bit codes back into counts of the detector.
//!
//! The cameras store about the square root of the light in 8 bits. Pictures (browse files, feeds) are left as they
//! are: that root is close to a display's curve. Arrays of raw products are expanded, so that a product as received and
//! its expanded version become the same photo.

use crate::names::Scheme;

/// A look-up table of 256 counts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Table {
    /// Count of each code, never falling.
    pub counts: &'static [u16; 256],
    /// Count that is white: the largest.
    pub white: u16,
}

/// Returns the table of a name as labels write it (`MMM_LUT0`, `ilut/M20_LUT2_v2a.txt`). `None` for those that are
/// not public (the Mastcam-Z ones).
pub fn table(name: &str, scheme: Option<Scheme>) -> Option<Table> {
    let upper = name.to_ascii_uppercase();
    let file = upper.rsplit('/').next().unwrap_or_default();
    let counts = match file.strip_suffix(".TXT").unwrap_or(file) {
        "MMM_LUT0" => &MMM_LUT0,
        "LUT2" if scheme == Some(Scheme::M2020) => &M20_LUT2,
        plain if plain.starts_with("M20_LUT2") => &M20_LUT2,
        _ => return None,
    };
    Some(Table {
        counts,
        white: counts[255],
    })
}

/// Mastcam, MAHLI and MARDI of Curiosity: 8 to 11 bits.
#[rustfmt::skip]
static MMM_LUT0: [u16; 256] = [
    0, 2, 3, 3, 4, 5, 5, 6, 7, 8, 9, 10, 11, 12, 14, 15, 16, 18, 19, 20, 22, 24, 25, 27, 29, 31, 33, 35, 37,
    39, 41, 43, 46, 48, 50, 53, 55, 58, 61, 63, 66, 69, 72, 75, 78, 81, 84, 87, 90, 94, 97, 100, 104, 107,
    111, 115, 118, 122, 126, 130, 134, 138, 142, 146, 150, 154, 159, 163, 168, 172, 177, 181, 186, 191, 196,
    201, 206, 211, 216, 221, 226, 231, 236, 241, 247, 252, 258, 263, 269, 274, 280, 286, 292, 298, 304, 310,
    316, 322, 328, 334, 341, 347, 354, 360, 367, 373, 380, 387, 394, 401, 408, 415, 422, 429, 436, 443, 450,
    458, 465, 472, 480, 487, 495, 503, 510, 518, 526, 534, 542, 550, 558, 566, 575, 583, 591, 600, 608, 617,
    626, 634, 643, 652, 661, 670, 679, 688, 697, 706, 715, 724, 733, 743, 752, 761, 771, 781, 790, 800, 810,
    819, 829, 839, 849, 859, 869, 880, 890, 900, 911, 921, 932, 942, 953, 964, 974, 985, 996, 1007, 1018,
    1029, 1040, 1051, 1062, 1074, 1085, 1096, 1108, 1119, 1131, 1142, 1154, 1166, 1177, 1189, 1201, 1213,
    1225, 1237, 1249, 1262, 1274, 1286, 1299, 1311, 1324, 1336, 1349, 1362, 1374, 1387, 1400, 1413, 1426,
    1439, 1452, 1465, 1479, 1492, 1505, 1519, 1532, 1545, 1559, 1573, 1586, 1600, 1614, 1628, 1642, 1656,
    1670, 1684, 1698, 1712, 1727, 1741, 1755, 1770, 1784, 1799, 1814, 1828, 1843, 1858, 1873, 1888, 1903,
    1918, 1933, 1948, 1963, 1979, 1994, 2009, 2025, 2033,
];

/// Engineering cameras of Perseverance (`M20_LUT2_v2a`): 8 to 12 bits.
#[rustfmt::skip]
static M20_LUT2: [u16; 256] = [
    0, 1, 127, 131, 135, 140, 144, 149, 153, 158, 163, 168, 173, 178, 183, 188, 193, 199, 204, 210, 215,
    221, 227, 233, 239, 245, 251, 257, 263, 269, 276, 282, 289, 296, 302, 309, 316, 323, 330, 337, 345, 352,
    359, 367, 374, 382, 390, 398, 406, 414, 422, 430, 438, 447, 455, 464, 472, 481, 490, 499, 508, 517, 526,
    535, 544, 554, 563, 573, 582, 592, 602, 612, 622, 632, 642, 653, 663, 674, 684, 695, 705, 716, 727, 738,
    749, 761, 772, 783, 795, 806, 818, 830, 841, 853, 865, 877, 890, 902, 914, 927, 939, 952, 965, 978, 990,
    1004, 1017, 1030, 1043, 1057, 1070, 1084, 1097, 1111, 1125, 1139, 1153, 1167, 1181, 1196, 1210, 1225,
    1239, 1254, 1269, 1284, 1299, 1314, 1329, 1344, 1360, 1375, 1391, 1406, 1422, 1438, 1454, 1470, 1486,
    1502, 1519, 1535, 1552, 1568, 1585, 1602, 1619, 1636, 1653, 1670, 1687, 1705, 1722, 1740, 1758, 1775,
    1793, 1811, 1829, 1848, 1866, 1884, 1903, 1921, 1940, 1959, 1978, 1997, 2016, 2035, 2054, 2074, 2093,
    2113, 2132, 2152, 2172, 2192, 2212, 2232, 2252, 2273, 2293, 2314, 2335, 2355, 2376, 2397, 2418, 2439,
    2461, 2482, 2504, 2525, 2547, 2569, 2590, 2612, 2634, 2657, 2679, 2701, 2724, 2746, 2769, 2792, 2815,
    2838, 2861, 2884, 2907, 2931, 2954, 2978, 3002, 3025, 3049, 3073, 3098, 3122, 3146, 3171, 3195, 3220,
    3244, 3269, 3294, 3319, 3345, 3370, 3395, 3421, 3446, 3472, 3498, 3524, 3550, 3576, 3602, 3628, 3655,
    3681, 3708, 3734, 3761, 3788, 3815, 3842, 3870, 3897, 3924, 3952, 3980, 4007, 4035, 4095,
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tables_are_found_by_the_names_that_labels_write() {
        for name in ["MMM_LUT0", "mmm_lut0", "ilut/MMM_LUT0.txt"] {
            assert_eq!(table(name, None).map(|table| table.white), Some(2033), "{name}");
        }
        for name in ["ilut/M20_LUT2_v2a.txt", "M20_LUT2"] {
            assert_eq!(table(name, None).map(|table| table.white), Some(4095), "{name}");
        }
        assert!(table("LUT2", Some(Scheme::M2020)).is_some());
        assert_eq!(table("LUT2", Some(Scheme::MslEngineering)), None);
        for name in ["MCZ_LUT0", "ilut/M20_MCZ_LUT0.txt", "NONE", "", "/", ".TXT"] {
            assert_eq!(table(name, Some(Scheme::M2020)), None, "{name}");
        }
    }

    /// 0.029702 i² + 0.42091 i + 1.7742 fits codes 5 to 249 of the first within 0.72 counts (measured elsewhere).
    #[test]
    fn tables_rise_and_the_first_is_a_parabola() {
        for counts in [&MMM_LUT0, &M20_LUT2] {
            assert!(counts.windows(2).all(|pair| pair[0] <= pair[1]));
        }
        for code in 5..=249_u16 {
            let i = f64::from(code);
            let fit = 0.029_702 * i * i + 0.420_91 * i + 1.7742;
            let off = f64::from(MMM_LUT0[usize::from(code)]) - fit;
            assert!(off.abs() < 0.73, "{code}: {off}");
        }
    }
}
