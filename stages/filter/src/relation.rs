//! How two photos are related by their product names and labels, before any pixel is compared.

use marf_pds::Mars2020Name;
use marf_scene::{CameraPrior, PhotoFacts};

/// Most seconds between two photos of one pointing through different filters: a wheel of eight positions takes
/// about two minutes.
const MAX_INTERVAL_S: u64 = 600;
/// Largest shift between two photos of one pointing by their labels, as a share of the width.
const MAX_SHIFT: f64 = 0.02;

/// How two photos are related by product name and label.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Relation {
    /// Versions of one exposure (EFF, RAD, RSL): the same pixels, processed in another way.
    SameExposure,
    /// One pointing through two colour filters.
    SamePointing,
    /// One camera on one sol through two colour filters; the pointing is unknown.
    SameCamera,
    /// None of these.
    Unknown,
}

impl Relation {
    /// Returns the end of the sentence that says why a photo is a duplicate; empty for [`Relation::Unknown`].
    pub(crate) fn reason_suffix(self) -> &'static str {
        match self {
            Self::SameExposure => ", another version of one exposure by name",
            Self::SamePointing => ", one pointing through another colour filter by name or label",
            Self::SameCamera => ", same camera through another colour filter",
            Self::Unknown => "",
        }
    }
}

/// Returns how two photos, each given by product id and facts, are related.
pub(crate) fn relation_between(a: (&str, &PhotoFacts), b: (&str, &PhotoFacts)) -> Relation {
    let names = Mars2020Name::read(a.0).zip(Mars2020Name::read(b.0));
    if names.is_some_and(|(a, b)| a.is_other_product_of_exposure(b)) {
        return Relation::SameExposure;
    }
    if !differ_in_filter(a.1, b.1) {
        return Relation::Unknown;
    }
    let by_label = same_pointing(a.1, b.1);
    let by_name = names
        .map(|(a, b)| a.is_same_planned_pointing(b) && a.clock_s().abs_diff(b.clock_s()) <= MAX_INTERVAL_S);
    // A label holds the measured pointing, a name only the planned one.
    match by_label.or(by_name) {
        Some(true) => Relation::SamePointing,
        Some(false) => Relation::Unknown,
        None => Relation::SameCamera,
    }
}

/// Returns the rank of a product's processing level; of two versions of one exposure the lower rank is kept.
///
/// Calibrated radiance is 0, so that the same kind of product is kept throughout the set.
pub(crate) fn processing_rank(id: &str) -> u8 {
    let product_type = Mars2020Name::read(id).map(|name| name.product_type().to_ascii_uppercase());
    match product_type.as_deref() {
        Some("RAD") => 0,
        Some(product) if product.starts_with('R') => 1,
        _ => 2,
    }
}

/// Returns whether one camera took both photos on one sol through different filters, by the archive's facts.
fn differ_in_filter(a: &PhotoFacts, b: &PhotoFacts) -> bool {
    let same = a.instrument.is_some() && a.instrument == b.instrument && a.sol == b.sol;
    same && a.filter.is_some() && b.filter.is_some() && a.filter != b.filter
}

/// Returns whether the labels of two photos give the same pointing; `None` where a label has no camera, or the labels
/// are in different frames.
fn same_pointing(a: &PhotoFacts, b: &PhotoFacts) -> Option<bool> {
    let (first, second) = (a.prior.as_ref()?, b.prior.as_ref()?);
    let rover_pose = |prior: &CameraPrior| prior.motion_counter.iter().copied().take(3).collect::<Vec<i64>>();
    if first.frame != second.frame || rover_pose(first) != rover_pose(second) {
        return None;
    }
    // Where the middle of one photo falls in the other, against its own middle.
    let ray = first.model.unproject(&middle_px(a).into())?;
    let Some(projected) = second.model.project_direction(&ray.direction) else {
        return Some(false);
    };
    let middle = middle_px(b);
    let (across, down) = (projected.x - middle[0], projected.y - middle[1]);
    let limit = MAX_SHIFT * f64::from(b.width);
    Some(across * across + down * down <= limit * limit)
}

/// Returns the middle of a photo, pixel centres at integers.
fn middle_px(facts: &PhotoFacts) -> [f64; 2] {
    [facts.width, facts.height].map(|side| (f64::from(side) - 1.0) / 2.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    const RAD: &str = "ZL0_0709_0729888971_069RAD_N0332864ZCAM07114_0340LMA01";

    fn facts(id: &str) -> PhotoFacts {
        PhotoFacts {
            instrument: Some(id[..2].to_owned()),
            filter: Some(id[2..3].to_owned()),
            sol: Some(709),
            width: 1648,
            height: 1200,
            ..PhotoFacts::default()
        }
    }

    fn related(a: &str, b: &str) -> Relation {
        let (first, second) = (facts(a), facts(b));
        let found = relation_between((a, &first), (b, &second));
        assert_eq!(found, relation_between((b, &second), (a, &first)), "{a} {b}");
        found
    }

    #[test]
    fn versions_of_one_exposure_are_known_by_name() {
        for other in [
            "ZL0_0709_0729888971_069EFF_N0332864ZCAM07114_0340LMJ01",
            "zl0_0709_0729888971_069rsl_n0332864zcam07114_0340lma02",
            "ZL0_0709_0729888971_069RADLN0332864ZCAM07114_0340LMA01",
        ] {
            assert_eq!(related(RAD, other), Relation::SameExposure, "{other}");
        }
        for other in [
            RAD,
            "ZR0_0709_0729888971_069EFF_N0332864ZCAM07114_0340LMA01",
            "ZL0_0709_0729888972_069EFF_N0332864ZCAM07114_0340LMA01",
            "ZL0_0709_0729888971_070EFF_N0332864ZCAM07114_0340LMA01",
            "frame_00003",
            "",
        ] {
            let known = relation_between((RAD, &PhotoFacts::default()), (other, &PhotoFacts::default()));
            assert_eq!(known, Relation::Unknown, "{other}");
        }
    }

    /// Tiles of one Navcam frame share the clock but not the part of the frame.
    #[test]
    fn tiles_are_no_versions() {
        let tile = |number: &str| format!("NLF_0050_0671382174_448ECM_N0031950NCAM00500_{number}_195J");
        assert_eq!(related(&tile("01"), &tile("04")), Relation::Unknown);
        assert_eq!(
            related(&tile("01"), &format!("{}01", tile("01"))),
            Relation::SameExposure
        );
    }

    #[test]
    fn filters_of_one_pointing_are_known_by_name() {
        let through = |filter: &str, seconds: &str, sequence: &str| {
            format!("ZL{filter}_0709_{seconds}_069RAD_N0332864{sequence}_0340LMA01")
        };
        assert_eq!(
            related(RAD, &through("3", "0729889051", "ZCAM07114")),
            Relation::SamePointing
        );
        assert_eq!(
            related(RAD, &through("3", "0729889051", "ZCAM07115")),
            Relation::Unknown
        );
        assert_eq!(
            related(RAD, &through("3", "0729899051", "ZCAM07114")),
            Relation::Unknown
        );
        assert_eq!(
            related(RAD, &through("0", "0729889051", "ZCAM07114")),
            Relation::Unknown
        );
        let nameless = PhotoFacts {
            filter: Some("3".to_owned()),
            ..facts(RAD)
        };
        assert_eq!(
            relation_between(("a", &facts(RAD)), ("b", &nameless)),
            Relation::SameCamera
        );
    }

    #[test]
    fn a_label_has_the_last_word_on_the_pointing() {
        let camera = |turn: f64| CameraPrior {
            model: marf_scene::Cahvor {
                c: [0.0, 0.0, -2.0],
                a: [turn.cos(), turn.sin(), 0.0],
                h: [
                    823.5 * turn.cos() - 4600.0 * turn.sin(),
                    823.5 * turn.sin() + 4600.0 * turn.cos(),
                    0.0,
                ],
                v: [599.5 * turn.cos(), 599.5 * turn.sin(), 4600.0],
                o: None,
                r: None,
                e: None,
            },
            frame: "ROVER_NAV_FRAME".to_owned(),
            site_from_frame: None,
            motion_counter: vec![33, 2864, 12, 7],
        };
        let other_id = "ZL3_0709_0729889051_069RAD_N0332864ZCAM07115_0340LMA01";
        let at = |id: &str, turn: f64| PhotoFacts {
            prior: Some(camera(turn)),
            ..facts(id)
        };
        // 33 px of 1648 are 2 %; 4600 px a radian.
        for (turn, expected) in [
            (0.0, Relation::SamePointing),
            (0.006, Relation::SamePointing),
            (0.008, Relation::Unknown),
            (3.0, Relation::Unknown),
        ] {
            let found = relation_between((RAD, &at(RAD, 0.0)), (other_id, &at(other_id, turn)));
            assert_eq!(found, expected, "turned by {turn}");
        }
    }

    #[test]
    fn radiance_is_preferred() {
        assert_eq!(processing_rank(RAD), 0);
        assert_eq!(processing_rank(&RAD.replace("RAD", "RSL")), 1);
        assert_eq!(processing_rank(&RAD.replace("RAD", "EFF")), 2);
        assert_eq!(processing_rank("rock.jpg"), 2);
    }
}
