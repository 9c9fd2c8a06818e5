//! Versions of one exposure, and filters of one pointing.

use super::*;

/// Names of one exposure and of one pointing through filters, as Mastcam-Z has them.
fn product(filter: &str, seconds: &str, kind: &str) -> String {
    format!("ZL{filter}_0709_{seconds}_069{kind}_N0332864ZCAM07114_0340LMA01")
}

fn exposure(photos: &mut Photos, id: &str, image: &Image<Srgb>) {
    photos.add_with(id, &png(image), |facts| {
        facts.instrument = Some("ZL".to_owned());
        facts.filter = Some(id[2..3].to_owned());
        facts.sol = Some(709);
    });
}

#[test]
fn of_the_versions_of_one_exposure_the_radiance_stays() {
    let (rad, eff, rsl) = (
        product("0", "0729888971", "RAD"),
        product("0", "0729888971", "EFF"),
        product("0", "0729888971", "RSL"),
    );
    let place = ground(70);
    // Another tone curve: a square root, and one that is dark.
    let bright = recoloured(&place, |pixel| {
        pixel.map(|value| (f64::from(value) * 255.0).sqrt() as u8)
    });
    let dark = recoloured(&place, |pixel| {
        pixel.map(|value| (u32::from(value) * u32::from(value) / 255) as u8)
    });
    let mut photos = Photos::default();
    exposure(&mut photos, &eff, &bright);
    exposure(&mut photos, &rad, &place);
    exposure(&mut photos, &rsl, &dark);
    let verdicts = photos.judge("duplicate", defaults());
    assert!(verdicts[&rad].keeps(), "{verdicts:?}");
    for gone in [&eff, &rsl] {
        assert_eq!(verdicts[gone].twin.as_ref(), Some(&rad), "{:?}", verdicts[gone]);
        assert!(
            verdicts[gone].reason.contains("another version of one exposure"),
            "{:?}",
            verdicts[gone]
        );
    }
}

#[test]
fn a_name_alone_does_not_make_a_version() {
    let (rad, eff) = (
        product("0", "0729888971", "RAD"),
        product("0", "0729888971", "EFF"),
    );
    let mut photos = Photos::default();
    exposure(&mut photos, &rad, &ground(71));
    exposure(&mut photos, &eff, &ground(72));
    let verdicts = photos.judge("duplicate", defaults());
    assert!(verdicts.values().all(marf_stage::Verdict::keeps), "{verdicts:?}");
}

/// Rocks that are bright in one filter and dark in the next: too far apart for pixels alone.
#[test]
fn filters_of_one_pointing_are_one_view_and_the_broad_band_stays() {
    let (place, ore) = (ground(73), ground(74));
    let through = |ore_share: f64| {
        Image::from_fn(320, 240, |x, y| {
            let value =
                f64::from(place.at(x, y)[0]) * (1.0 - ore_share) + f64::from(ore.at(x, y)[0]) * ore_share;
            [value as u8; 3]
        })
    };
    let (broad, narrow) = (
        product("0", "0729888971", "RAD"),
        product("5", "0729889030", "RAD"),
    );
    let mut photos = Photos::default();
    exposure(&mut photos, &narrow, &through(0.25));
    exposure(&mut photos, &broad, &place);
    let verdicts = photos.judge("duplicate", defaults());
    assert!(verdicts[&broad].keeps(), "{verdicts:?}");
    let gone = &verdicts[&narrow];
    assert!(
        !gone.keeps() && gone.reason.contains("one pointing through another colour filter"),
        "{gone:?}"
    );
    let score = gone.score.unwrap();
    assert!(
        (0.8..0.975).contains(&score),
        "pixels alone would say it too: {score}"
    );
    // Another sequence, hence another pointing as far as is known.
    let elsewhere = narrow.replace("ZCAM07114", "ZCAM07115");
    let mut photos = Photos::default();
    exposure(&mut photos, &elsewhere, &through(0.25));
    exposure(&mut photos, &broad, &place);
    assert!(photos.judge("duplicate", defaults())[&elsewhere].keeps());
}
