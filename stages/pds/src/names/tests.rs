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
fn a_text_may_go_on_after_the_name() {
    let name = "zl0_0709_0729888971_069RAD_N0332864ZCAM07114_0340LMA01";
    let copy = format!("{name} (1).png");
    let found = ProductName::read_start(&copy).unwrap();
    assert_eq!(found.exposure(), read(name).exposure());
    assert_eq!(
        (found.clock_s(), found.product_type.as_str()),
        (Some(729_888_971), "RAD")
    );
    for bad in [
        "",
        "ZL0",
        &copy[1..],
        &format!("é {name}"),
        &copy.replacen("_N", "_X", 1),
    ] {
        assert!(ProductName::read_start(bad).is_none(), "{bad}");
    }
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
    assert_eq!(read(feed).downsampling, 4);
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
    assert!(read("NRE_0060_0672265209_237ECM_N0032046NCAM00410_00_0LLJ").is_mosaic(None));
    assert!(!read("NLF_0060_0672265209_237EBY_N0032046NCAM00410_00_0LLJ").is_mosaic(None));
    assert!(!read("NRE_0060_0672265209_237ECM_N0032046NCAM00410_00_1LLJ").is_mosaic(None));
    assert!(read("ZL0_0001_0667035659_559ECM_N0010052AUT_04096_0260LMJ01").is_mosaic(None));
    assert!(!read("ZL1_0001_0667035659_559ECM_N0010052AUT_04096_0260LMJ01").is_mosaic(None));
    let mastcam = |kind: &str| read(&format!("2264ML0121141200805116{kind}00_DXXX"));
    assert!(mastcam("C").is_mosaic(None) && !mastcam("C").is_mosaic(Some("3")));
    assert!(!mastcam("E").is_mosaic(None));
}

#[test]
fn renditions_of_one_exposure_share_their_key() {
    let key = |stem: &str| read(stem).exposure_key();
    let raw = key("ZL0_0012_0668000000_100ECM_N0030000ZCAM00001_0340LMJ01");
    assert_eq!(raw, key("ZLF_0012_0668000000_100EBY_N0030000ZCAM00001_0340LMA02"));
    assert_ne!(raw, key("ZR0_0012_0668000000_100ECM_N0030000ZCAM00001_0340LMJ01"));
    assert_ne!(raw, key("ZL0_0012_0668000000_101ECM_N0030000ZCAM00001_0340LMJ01"));
    assert_eq!(
        key("2264ML0121141200805116C00_DRCL"),
        key("2264ML0121141200805116C01_DRCX")
    );
}

#[test]
fn versions_of_one_exposure_are_known_in_every_scheme() {
    for (best, others) in [
        (
            "1N491020834RADCNY9P0706L0M1",
            &[
                "1N491020834EFFCNY9P0706L0M1",
                "1N491020834RSLCNY9P0706L0M1",
                "1n491020834ilfcny9p0706l0m2",
            ][..],
        ),
        (
            "NLA_399621413RAD_F0030308NCAM00405M1",
            &[
                "NLA_399621413EDR_F0030308NCAM00405M1",
                "NLA_399621413RASLF0030308NCAM00405M1",
            ],
        ),
        (
            "2264ML0121141200805116C00_DRXX",
            &[
                "2264ML0121141200805116C00_DRCL",
                "2264ML0121141200805116C00_XXXX",
                "2264ML0121141200805116C01_DXXX",
            ],
        ),
        (
            "ZL0_0709_0729888971_069RAD_N0332864ZCAM07114_0340LMA01",
            &["ZL0_0709_0729888971_069RSL_N0332864ZCAM07114_0340LMA02"],
        ),
    ] {
        let first = read(best);
        for other in others.iter().map(|other| read(other)) {
            assert_eq!(first.exposure(), other.exposure(), "{}", other.id);
            assert!(first.processing_rank() < other.processing_rank(), "{}", other.id);
        }
    }
    let key = |stem: &str| read(stem).exposure();
    assert_ne!(
        key("1N491020834RADCNY9P0706L0M1"),
        key("1N491020835RADCNY9P0706L0M1")
    );
    assert_ne!(
        key("1N491020834RADCNY9P0706L0M1"),
        key("1N491020834RADCNY9P0706R0M1")
    );
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
