use super::*;

#[test]
fn runs_of_sols_are_asked_for_together() {
    let sols = |list: &[u32]| runs(&list.iter().copied().collect());
    assert_eq!(sols(&[]), []);
    assert_eq!(sols(&[5, 6, 9]), [(5, 9)]);
    assert_eq!(sols(&[0, 19, 20, 100]), [(0, 19), (20, 20), (100, 100)]);
}

#[test]
fn an_id_that_could_be_a_path_is_none() {
    let id = |id: &str| id_of(&serde_json::json!({ "imageid": id }));
    assert_eq!(id("NLF_0050-a").as_deref(), Some("NLF_0050-a"));
    for bad in [
        "",
        "UNK",
        "../x",
        "a/b",
        "a\\b",
        "a.png",
        "a b",
        "é",
        "a\0b",
        &"a".repeat(81),
    ] {
        assert_eq!(id(bad), None, "{bad}");
    }
}

#[test]
fn latest_needs_a_feed_that_tells() {
    assert_eq!(wanted(&Sols::Latest, Some(7)).unwrap(), (0..=7).collect());
    assert_eq!(wanted(&Sols::Latest, Some(700)).unwrap(), (681..=700).collect());
    assert_eq!(
        wanted(&Sols::Ranges(vec![(5, 9)]), Some(6)).unwrap(),
        BTreeSet::from([5, 6])
    );
    assert!(wanted(&Sols::Latest, None).is_err());
}
