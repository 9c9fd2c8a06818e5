//! Bad input gets one clear error that names the thing and the way out, and the right exit code.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    reason = "a test that cannot go on should stop"
)]

mod common;

use common::{marf, shared};

fn with_pipeline(text: &str) -> tempfile::TempDir {
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(dir.path().join("pipeline.toml"), text).unwrap();
    dir
}

const HEAD: &str = "[archive.demo]\nkind = \"demo\"\n[node.extract]\narchive = \"demo\"\n";

#[test]
fn an_unknown_key_is_refused_with_its_place_and_the_nearest_name() {
    let dir = with_pipeline(&format!("{HEAD}[node.size]\ninput = \"extract\"\nmin_byte = 3\n"));
    let ran = marf(dir.path(), &["plan"]).exits(2);
    assert!(
        ran.stderr.contains("pipeline.toml:7:1: unknown key `min_byte`"),
        "{}",
        ran.stderr
    );
    assert!(ran.stderr.contains("did you mean `min_bytes`?"), "{}", ran.stderr);
}

#[test]
fn an_unknown_stage_and_an_unknown_upstream_are_refused() {
    let dir = with_pipeline("[node.extrct]\n");
    assert!(
        marf(dir.path(), &["plan"])
            .exits(2)
            .stderr
            .contains("did you mean `extract`?")
    );
    let dir = with_pipeline(&format!("{HEAD}[node.size]\ninput = \"extrat\"\n"));
    assert!(
        marf(dir.path(), &["plan"])
            .exits(2)
            .stderr
            .contains("did you mean `extract`?")
    );
}

#[test]
fn what_the_training_of_a_bootstrap_decides_cannot_be_set_beside_it() {
    let nodes = "[node.calibrate]\ninput = \"extract\"\n[node.tune]\ninput = \"calibrate\"\n\
                 [node.train]\ninput = \"calibrate\"\n[node.bootstrap]\ninput = \"calibrate\"\ntraining = \"train\"\n";
    for (key, value) in [
        ("quality", "\"draft\""),
        ("steps", "5"),
        ("scale", "2"),
        ("field", "{ background = \"black\" }"),
        ("params", "\"tune\""),
    ] {
        let dir = with_pipeline(&format!("{HEAD}{nodes}{key} = {value}\n"));
        let ran = marf(dir.path(), &["plan"]).exits(2);
        let message = format!(
            "pipeline.toml:14:1: node.bootstrap.{key}: `training` sets it too, and only one of them may"
        );
        assert!(ran.stderr.contains(&message), "{}", ran.stderr);
        let hint = format!("hint: remove `{key}`, or `training`");
        assert!(ran.stderr.contains(&hint), "{}", ran.stderr);
    }
    let dir = with_pipeline(&format!("{HEAD}{nodes}b = 2\nmode = \"photos\"\nseed = 4\n"));
    marf(dir.path(), &["plan"]).exits(0);
}

#[test]
fn a_film_of_a_bootstrap_is_refused_with_the_render_that_makes_it() {
    let nodes = "[node.calibrate]\ninput = \"extract\"\n[node.bootstrap]\ninput = \"calibrate\"\n\
                 [node.video]\ninput = \"bootstrap\"\n";
    let dir = with_pipeline(&format!("{HEAD}{nodes}"));
    let ran = marf(dir.path(), &["plan"]).exits(2);
    let message = "`input` of `node.video` needs `film`, but `node.bootstrap` (stage `bootstrap`) gives";
    assert!(ran.stderr.contains(message), "{}", ran.stderr);
    assert!(
        ran.stderr.contains("hint: name a node of `render`") && ran.stderr.contains("members = "),
        "{}",
        ran.stderr
    );
}

#[test]
fn a_cycle_is_printed_in_full() {
    let text =
        "[node.size]\ninput = \"blur\"\n[node.shape]\ninput = \"size\"\n[node.blur]\ninput = \"shape\"\n";
    let ran = marf(with_pipeline(text).path(), &["run"]).exits(2);
    assert!(
        ran.stderr.contains("size -> shape -> blur -> size"),
        "{}",
        ran.stderr
    );
}

#[test]
fn a_value_of_the_wrong_type_is_named_at_its_place() {
    let dir = with_pipeline(&format!(
        "{HEAD}[node.size]\ninput = \"extract\"\nmin_bytes = \"many\"\n"
    ));
    let ran = marf(dir.path(), &["run"]).exits(2);
    assert!(
        ran.stderr.contains("pipeline.toml:7:13: node.size.min_bytes"),
        "{}",
        ran.stderr
    );
}

#[test]
fn no_pipeline_says_how_to_get_one() {
    let dir = tempfile::tempdir().unwrap();
    let ran = marf(dir.path(), &["run"]).exits(2);
    assert!(ran.stderr.contains("marf init"), "{}", ran.stderr);
}

#[test]
fn an_archive_on_a_server_names_its_missing_keys() {
    for (kind, missing) in [
        ("pds", "mission"),
        ("feed", "mission"),
        ("tape", "unknown kind of archive `tape`"),
    ] {
        let dir = with_pipeline(&format!(
            "[archive.a]\nkind = \"{kind}\"\n[node.extract]\narchive = \"a\"\n"
        ));
        let ran = marf(dir.path(), &["run"]).exits(2);
        assert!(ran.stderr.contains(missing), "{kind}: {}", ran.stderr);
    }
}

#[test]
fn a_missing_and_an_empty_folder_are_one_error_each() {
    let dir = tempfile::tempdir().unwrap();
    let ran = marf(dir.path(), &["filter", "nowhere"]).exits(1);
    assert!(ran.stderr.contains("nowhere"), "{}", ran.stderr);
    std::fs::create_dir(dir.path().join("empty")).unwrap();
    let ran = marf(dir.path(), &["filter", "empty"]).exits(1);
    assert!(ran.stderr.contains("empty"), "{}", ran.stderr);
}

#[test]
fn photos_that_share_nothing_are_not_calibrated_and_the_hint_says_what_to_do() {
    let Some(data) = shared("m2020_navcam_feed") else {
        return;
    };
    let dir = tempfile::tempdir().unwrap();
    let ran = marf(dir.path(), &["calibrate", &data.to_string_lossy()]).exits(1);
    for words in ["photos were placed", "cause: ", "hint: "] {
        assert!(ran.stderr.contains(words), "{words}: {}", ran.stderr);
    }
    assert!(!dir.path().join("transforms.json").exists());
}

#[test]
fn init_writes_once_and_every_template_is_a_valid_pipeline() {
    for mission in [
        "demo",
        "mission",
        "folder",
        "perseverance",
        "curiosity",
        "ingenuity",
    ] {
        let dir = tempfile::tempdir().unwrap();
        marf(dir.path(), &["init", "--mission", mission]).exits(0);
        marf(dir.path(), &["init", "--mission", mission]).exits(2);
        let plan = marf(dir.path(), &["plan", "--offline"]);
        // Folders and archives do not exist here, but the pipeline itself is well-formed.
        assert!(plan.code != 2, "{mission}: {}", plan.stderr);
    }
}

#[test]
fn hostile_toml_is_refused_without_a_crash() {
    let Some(own) = shared("bad-inputs/own") else {
        return;
    };
    for name in ["deep.toml", "dup_key.toml", "nan.toml"] {
        let dir = tempfile::tempdir().unwrap();
        std::fs::copy(own.join(name), dir.path().join("pipeline.toml")).unwrap();
        let ran = marf(dir.path(), &["plan"]);
        assert_eq!(ran.code, 2, "{name}: {}", ran.stderr);
    }
}

/// Names of files cannot drive a terminal or write lines that look like those of marf.
#[cfg(unix)]
#[test]
fn names_of_files_are_escaped_wherever_they_are_printed() {
    let dir = tempfile::tempdir().unwrap();
    let photos = dir.path().join("photos");
    std::fs::create_dir(&photos).unwrap();
    let hostile = [
        "a\u{1b}]0;title\u{7}.png",
        "b\nholds\n.png",
        "c\u{202e}gnp.exe",
        "d\u{9b}2J.txt",
    ];
    for (index, name) in hostile.iter().enumerate() {
        let picture = image::RgbImage::from_fn(64, 48, |x, y| {
            image::Rgb([x, y, (x * y + index as u32) % 251].map(|value| value as u8))
        });
        let mut bytes = std::io::Cursor::new(Vec::new());
        picture.write_to(&mut bytes, image::ImageFormat::Png).unwrap();
        std::fs::write(photos.join(name), bytes.into_inner()).unwrap();
    }
    std::fs::write(photos.join("e\u{1b}[2J\n.txt"), b"text").unwrap();
    let pipeline = "[archive.mine]\nkind = \"folder\"\npath = \"photos\"\n[node.extract]\narchive = \"mine\"\n\
        [node.size]\ninput = \"extract\"\nmin_bytes = 10\n[keep]\nids = [\"x\\u001b\\n\"]\n";
    std::fs::write(dir.path().join("pipeline.toml"), pipeline).unwrap();
    let acts = |char: char| (char.is_control() && char != '\n') || ('\u{202a}'..='\u{202e}').contains(&char);
    let bad = "photos/no\u{1b}such\nholds\u{202e}";
    let verbs: [&[&str]; 12] = [
        &["run"],
        &["photos"],
        &["photos", "--json"],
        &["photos", "photos"],
        &["filter", "photos"],
        &["filter", bad],
        &["verify", bad],
        &["audit", bad],
        &["render", "--path", bad, "--out", "x"],
        &[bad],
        &["run", "--threads", "1\u{1b}\nholds"],
        &["verify", "--json=1\nholds", bad],
    ];
    for args in verbs {
        let ran = marf(dir.path(), args);
        for text in [&ran.stdout, &ran.stderr] {
            assert!(!text.contains(acts), "{args:?}: {text:?}");
            assert!(
                !text.lines().any(|line| line.starts_with("holds")),
                "{args:?}: {text:?}"
            );
        }
    }
    let table = marf(dir.path(), &["photos"]).exits(0).stdout;
    assert!(
        table.contains("b\\nholds\\n.png") && table.contains("c\\u{202e}gnp.exe"),
        "{table}"
    );
    let json = marf(dir.path(), &["photos", "--json"]).exits(0).stdout;
    let read: serde_json::Value = serde_json::from_str(&json).unwrap();
    assert!(read.to_string().contains("\u{202e}gnp.exe"), "{json}");
    let report = std::fs::read_to_string(dir.path().join("out/report.html")).unwrap();
    assert!(
        !report.contains(|char| acts(char) && char != '\t'),
        "a name acts in the report"
    );
    assert!(report.contains("c\\u{202e}gnp.exe"));
}
