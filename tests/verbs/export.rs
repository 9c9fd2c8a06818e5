//! `export` and `verify`, as users meet them: what holds, and the answer to each kind of bad input.

use std::path::Path;

use crate::common::{Ran, marf};

/// Test 1 of RFC 8032, section 7.1.
const PRIVATE_PEM: &str = "-----BEGIN PRIVATE KEY-----\n\
    MC4CAQAwBQYDK2VwBCIEIJ1hsZ3v/VpguoRK9JLsLMREScVpezJpGXA7rAMcrn9g\n\
    -----END PRIVATE KEY-----\n";
const PUBLIC_PEM: &str = "-----BEGIN PUBLIC KEY-----\n\
    MCowBQYDK2VwAyEA11qYAYKxCrfVS/7TyWQHOg7hcvPapiMlrwIaaPcHURo=\n\
    -----END PUBLIC KEY-----\n";
/// Test 2 of the same section.
const OTHER_PUBLIC_PEM: &str = "-----BEGIN PUBLIC KEY-----\n\
    MCowBQYDK2VwAyEAPUAXw+hDiVqStwqnTRt+vJyYLM8uxJaMwM1V8Sr0Zgw=\n\
    -----END PUBLIC KEY-----\n";

/// Returns a folder with a run and keys.
fn with_keys() -> tempfile::TempDir {
    let dir = crate::after_a_run();
    let locked = "-----BEGIN ENCRYPTED PRIVATE KEY-----\nAAAA\n-----END ENCRYPTED PRIVATE KEY-----\n";
    for (name, text) in [
        ("key.pem", PRIVATE_PEM),
        ("pub.pem", PUBLIC_PEM),
        ("other.pem", OTHER_PUBLIC_PEM),
        ("locked.pem", locked),
    ] {
        std::fs::write(dir.path().join(name), text).unwrap();
    }
    dir
}

#[track_caller]
fn says(ran: &Ran, words: &[&str]) {
    let text = format!("{}{}", ran.stdout, ran.stderr);
    for word in words {
        assert!(text.contains(word), "{word}: {text}");
    }
}

fn run(folder: &Path, line: &str) -> Ran {
    marf(folder, &line.split(' ').collect::<Vec<_>>())
}

#[test]
fn a_run_is_handed_over_and_checked_without_its_store() {
    let dir = with_keys();
    let written = run(dir.path(), "export crate crate --key key.pem --license CC-BY-4.0").exits(0);
    says(
        &written,
        &["wrote crate: run ", " of small, ", "manifest SHA-256 "],
    );
    let elsewhere = tempfile::tempdir().unwrap();
    crate::common::copy(&dir.path().join("crate"), &elsewhere.path().join("crate"));
    std::fs::write(elsewhere.path().join("pub.pem"), PUBLIC_PEM).unwrap();
    drop(dir);
    let held = run(elsewhere.path(), "verify crate --key pub.pem").exits(0);
    says(
        &held,
        &[
            "3 actions checked against their keys",
            "It is signed with the given key.",
        ],
    );
    let json: serde_json::Value =
        serde_json::from_str(&run(elsewhere.path(), "verify crate --json").exits(0).stdout).unwrap();
    assert_eq!(json["signature"], "not_checked");
    assert_eq!(json["faults"], serde_json::json!([]));

    let verdicts = elsewhere.path().join("crate/data/pipeline.toml");
    let mut bytes = std::fs::read(&verdicts).unwrap();
    bytes[0] ^= 1;
    std::fs::write(&verdicts, bytes).unwrap();
    let altered = run(elsewhere.path(), "verify crate").exits(4);
    says(
        &altered,
        &[
            "fault: `data/pipeline.toml` was altered: SHA-256 ",
            "crate is not intact (faults: 2)",
        ],
    );
    assert_eq!(altered.stdout.matches("fault: ").count(), 2);
    let metadata = elsewhere.path().join("crate/data/ro-crate-metadata.json");
    let text = std::fs::read_to_string(&metadata).unwrap();
    std::fs::write(
        &metadata,
        text.replace("urn:x-marf:crate:1", "urn:x-marf:crate:7"),
    )
    .unwrap();
    let newer = run(elsewhere.path(), "verify crate").exits(8);
    says(&newer, &["is a crate of version 7: this program reads up to 1"]);
}

#[test]
fn a_statement_is_signed_and_checked() {
    let dir = with_keys();
    run(dir.path(), "export attest --key key.pem --out size.json size").exits(0);
    let held = run(dir.path(), "verify size.json --key pub.pem").exits(0);
    says(
        &held,
        &["This statement is signed with the given key and covers 2 files."],
    );
    let other = run(dir.path(), "verify size.json --key other.pem").exits(13);
    says(&other, &["size.json is not signed with other.pem"]);
    let nobody = run(dir.path(), "verify size.json").exits(2);
    says(&nobody, &["name a public key with --key"]);
    let about = run(
        dir.path(),
        "verify size.json --key pub.pem --subject pipeline.toml",
    )
    .exits(4);
    says(&about, &["it is not about pipeline.toml"]);
    let absent = run(dir.path(), "verify size.json --key pub.pem --subject nowhere").exits(2);
    says(&absent, &["nowhere cannot be read: "]);
    let stdout = run(dir.path(), "export attest --key key.pem").exits(0).stdout;
    assert_eq!(stdout.lines().count(), 1, "one line of JSON");
    std::fs::write(dir.path().join("run.json"), stdout).unwrap();
    let envelope = std::fs::read(dir.path().join("run.json")).unwrap();
    let envelope: serde_json::Value = serde_json::from_slice(&envelope).unwrap();
    let payload = base64::Engine::decode(
        &base64::engine::general_purpose::STANDARD,
        envelope["payload"].as_str().unwrap(),
    );
    let statement: serde_json::Value = serde_json::from_slice(&payload.unwrap()).unwrap();
    let builder = &statement["predicate"]["runDetails"]["builder"]["builderDependencies"][0]["name"];
    let here = format!("marf for {} on {}", std::env::consts::OS, std::env::consts::ARCH);
    assert_eq!(builder.as_str(), Some(here.as_str()), "{statement}");
    let held = run(dir.path(), "verify run.json --key pub.pem").exits(0);
    says(&held, &["covers 7 files."]);
}

#[test]
fn bad_input_has_one_clear_answer() {
    let dir = with_keys();
    run(dir.path(), "export crate crate").exits(0);
    for (line, code, words) in [
        (
            "export crate other --key locked.pem",
            2,
            &[
                "the key locked.pem cannot be used",
                "locked with a passphrase",
                "openssl pkey -in KEY.pem",
            ][..],
        ),
        (
            "export crate other --key none.pem",
            2,
            &["the key none.pem cannot be read"],
        ),
        (
            "export crate other --key pub.pem",
            2,
            &["it has no `PRIVATE KEY` section"],
        ),
        (
            "export crate crate",
            2,
            &["crate is there already", "name another folder"],
        ),
        (
            "export crate other --items nobody",
            2,
            &[
                "the run has no photo `nobody`",
                "`marf photos` lists the names of all photos",
            ],
        ),
        ("export crate other --run 9", 1, &["9"]),
        (
            "export attest --key key.pem nobody",
            2,
            &["`nobody` is no node of the run, and no file"],
        ),
        (
            "export attest --key key.pem key.pem",
            1,
            &[
                "key.pem holds no result of run",
                "name another run with --run. `marf log` lists all",
            ],
        ),
        ("verify nowhere", 2, &["there is no folder nowhere"]),
        ("verify out", 2, &["out is not a crate"]),
        (
            "verify crate --key key.pem",
            2,
            &["it has no `PUBLIC KEY` section", "-pubout"],
        ),
        (
            "verify crate --key pub.pem",
            13,
            &["crate is not signed with this key"],
        ),
        (
            "verify pub.pem --key pub.pem",
            2,
            &["pub.pem is neither the folder of a crate nor a signed statement"],
        ),
    ] {
        let ran = run(dir.path(), line).exits(code);
        says(&ran, words);
    }
    assert!(
        !dir.path().join("other").exists(),
        "nothing is left of what failed"
    );
}

/// What a crate names without its bytes is counted when it is written and when it is checked.
#[test]
fn photos_that_are_left_out_are_counted() {
    let dir = with_keys();
    let table = marf(dir.path(), &["photos", "--json"]).exits(0).stdout;
    let table: serde_json::Value = serde_json::from_str(&table).unwrap();
    let chosen = table["photos"][0]["product"].as_str().unwrap();
    for (folder, option) in [
        ("some", format!("--items {chosen}")),
        ("none", "--without-data".to_owned()),
    ] {
        let written = run(dir.path(), &format!("export crate {folder} {option} --json"))
            .exits(0)
            .stdout;
        let written: serde_json::Value = serde_json::from_str(&written).unwrap();
        let checked = run(dir.path(), &format!("verify {folder} --json"))
            .exits(0)
            .stdout;
        let checked: serde_json::Value = serde_json::from_str(&checked).unwrap();
        assert!(written["named"].as_u64().unwrap() > 30, "{written}");
        assert_eq!(written["named"], checked["named"], "{folder}");
    }
}
