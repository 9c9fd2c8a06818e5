//! How two photos are related by their product names and labels, before any pixel is compared.

use marf_cache::{Digest, manifest::Row};
use marf_pds::{ProductName, Scheme};
use marf_scene::{CameraPrior, PhotoFacts};
use serde::{Deserialize, Serialize};

use crate::facts::Facts;

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
    /// One camera on one sol through two colour filters, with unknown pointing.
    SameCamera,
    /// None of these.
    Unknown,
}

impl Relation {
    /// Returns the end of the sentence that says why a photo is a duplicate. Empty for [`Relation::Unknown`].
    pub(crate) fn reason_suffix(self) -> &'static str {
        match self {
            Self::SameExposure => ", another version of one exposure by name",
            Self::SamePointing => ", one pointing through another colour filter by name or label",
            Self::SameCamera => ", same camera through another colour filter",
            Self::Unknown => "",
        }
    }
}

/// What relates a photo to others.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Relative<'a> {
    /// Product id.
    pub(crate) id: &'a str,
    /// Instrument and eye as the archive names them.
    pub(crate) instrument: Option<&'a str>,
    /// Colour filter as the archive names it.
    pub(crate) filter: Option<&'a str>,
    /// Sol.
    pub(crate) sol: Option<u32>,
    /// Its row, whose facts may hold the camera of its label. `None` for a photo of an earlier sol.
    pub(crate) row: Option<&'a Row>,
}

impl<'a> Relative<'a> {
    /// Returns the facts that relate the photo of a row to others.
    pub(crate) fn from_row(row: &'a Row, facts: &Facts<'a>) -> Self {
        Self {
            id: &row.id,
            instrument: facts.instrument,
            filter: facts.filter,
            sol: facts.sol,
            row: Some(row),
        }
    }

    /// Returns the facts with the label's camera.
    fn labelled(&self) -> Option<PhotoFacts> {
        let facts = PhotoFacts::from_json(&self.row?.facts).ok()?;
        facts.prior.is_some().then_some(facts)
    }

    /// Returns the keys by which photos related to this one are found.
    pub(crate) fn keys(&self) -> RelationKeys {
        let exposure = ProductName::read_start(self.id).map(|name| match name.scheme {
            Scheme::M2020 => name.exposure().to_ascii_lowercase(),
            _ => name.exposure(),
        });
        let exposure = exposure.map(|fields| key_of("exposure", &[&fields]));
        let camera = self.instrument.zip(self.filter).map(|(instrument, filter)| {
            let sol = self.sol.map_or_else(String::new, |sol| sol.to_string());
            let camera = key_of("camera", &[instrument, &sol]);
            (camera, key_of("filter", &[filter]))
        });
        RelationKeys { exposure, camera }
    }
}

/// Keys to find related photos by. Equal keys may also belong to photos that are not related.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct RelationKeys {
    /// Equal for versions of one exposure. `None` without a product name.
    pub(crate) exposure: Option<u32>,
    /// Equal for photos of one camera on one sol, and a key of the filter: the photo is related to those with another one.
    pub(crate) camera: Option<(u32, u32)>,
}

/// Returns the key of some texts, the same on every machine.
fn key_of(kind: &str, texts: &[&str]) -> u32 {
    let joined = [&[kind], texts].concat().join("\0");
    let digest = Digest::from_content(joined.as_bytes());
    let [a, b, c, d, ..] = *digest.as_bytes();
    u32::from_le_bytes([a, b, c, d])
}

/// Returns how two photos are related.
pub(crate) fn relation_between(a: &Relative<'_>, b: &Relative<'_>) -> Relation {
    let names = ProductName::read_start(a.id).zip(ProductName::read_start(b.id));
    let same_exposure = |(a, b): &(ProductName, ProductName)| a.exposure() == b.exposure();
    if names.as_ref().is_some_and(same_exposure) && !a.id.eq_ignore_ascii_case(b.id) {
        return Relation::SameExposure;
    }
    if !differ_in_filter(a, b) {
        return Relation::Unknown;
    }
    let by_label = a
        .labelled()
        .zip(b.labelled())
        .and_then(|(a, b)| same_pointing(&a, &b));
    let by_name = names.and_then(|(a, b)| {
        let interval_s = a.clock_s()?.abs_diff(b.clock_s()?);
        Some(a.planned_pointing() == b.planned_pointing() && interval_s <= MAX_INTERVAL_S)
    });
    // A label holds the measured pointing, a name only the planned one.
    match by_label.or(by_name) {
        Some(true) => Relation::SamePointing,
        Some(false) => Relation::Unknown,
        None => Relation::SameCamera,
    }
}

/// Returns the rank of a product's processing level. Of two versions of one exposure, the lower rank is kept.
///
/// Calibrated radiance is first, so that the same kind of product is kept throughout the set.
pub(crate) fn processing_rank(id: &str) -> u8 {
    ProductName::read(id).map_or(u8::MAX, |name| name.processing_rank())
}

/// Whether one camera took both photos on one sol through different filters, by the archive's facts.
fn differ_in_filter(a: &Relative<'_>, b: &Relative<'_>) -> bool {
    let same = a.instrument.is_some() && a.instrument == b.instrument && a.sol == b.sol;
    same && a.filter.is_some() && b.filter.is_some() && a.filter != b.filter
}

/// Whether the labels of two photos give the same pointing. `None` if a label has no camera, or the labels are in
/// different frames.
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

    fn row(id: &str, facts: &PhotoFacts) -> Row {
        Row {
            id: id.to_owned(),
            blobs: Default::default(),
            facts: facts.to_json(),
        }
    }

    /// Returns how two photos are related. Asserts that related photos are found by their keys.
    fn relation_between(a: (&str, &PhotoFacts), b: (&str, &PhotoFacts)) -> Relation {
        let rows = (row(a.0, a.1), row(b.0, b.1));
        let (a, b) = (
            Relative::from_row(&rows.0, &Facts::from_row(&rows.0).unwrap()),
            Relative::from_row(&rows.1, &Facts::from_row(&rows.1).unwrap()),
        );
        let relation = super::relation_between(&a, &b);
        let (keys, others) = (a.keys(), b.keys());
        let same_exposure = keys.exposure.is_some() && keys.exposure == others.exposure;
        let same_camera = keys
            .camera
            .zip(others.camera)
            .is_some_and(|(a, b)| a.0 == b.0 && a.1 != b.1);
        assert!(
            relation == Relation::Unknown || same_exposure || same_camera,
            "{} {}: {relation:?}",
            a.id,
            b.id
        );
        relation
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
        let mer = ["1N491020834RADCNY9P0706L0M1", "1N491020834EFFCNY9P0706L0M1"];
        let mer = relation_between((mer[0], &PhotoFacts::default()), (mer[1], &PhotoFacts::default()));
        assert_eq!(mer, Relation::SameExposure);
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
        // 33 px of 1648 are 2 %, at 4600 px a radian.
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
        let ranks = [
            RAD,
            &RAD.replace("RAD", "RSL"),
            &RAD.replace("RAD", "EFF"),
            "rock.jpg",
        ]
        .map(processing_rank);
        assert!(ranks.is_sorted_by(|a, b| a < b), "{ranks:?}");
    }
}
