//! `marf render` on a small real run: what it writes, what it finds again, what it refuses.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    reason = "a test that cannot go on should stop"
)]

mod common;

use std::path::Path;
use std::sync::LazyLock;

use common::{Ran, SMALL_DEMO, copy, marf};
use marf_scene::picture::png16::read_quantity;
use serde_json::{Value, json};

/// Runs the small demo up to a node, with two retrainings.
fn run_to(folder: &Path, node: &str) {
    let mut args = vec!["run", "--to", node];
    for set in SMALL_DEMO.iter().chain(&["bootstrap.b=2", "train.steps=80"]) {
        args.extend(["--set", set]);
    }
    marf(folder, &args).exits(0);
}

/// A folder with one run, up to the training.
fn trained() -> &'static Path {
    static RUN: LazyLock<tempfile::TempDir> = LazyLock::new(|| {
        let dir = tempfile::tempdir().unwrap();
        marf(dir.path(), &["init"]).exits(0);
        run_to(dir.path(), "train");
        dir
    });
    RUN.path()
}

/// A folder with a second run, up to the bootstrap.
fn bootstrapped() -> &'static Path {
    static RUN: LazyLock<tempfile::TempDir> = LazyLock::new(|| {
        let dir = tempfile::tempdir().unwrap();
        copy(trained(), dir.path());
        run_to(dir.path(), "bootstrap");
        dir
    });
    RUN.path()
}

fn render(folder: &Path, args: &[&str]) -> Ran {
    let words = ["render", "--json"].iter().chain(args).copied();
    marf(folder, &words.collect::<Vec<_>>())
}

/// What a call prints of its files.
fn told(ran: &Ran) -> Value {
    serde_json::from_str(&ran.stdout).unwrap()
}

#[test]
fn an_orbit_is_rendered_once_with_its_layers_and_known_by_its_content() {
    let dir = bootstrapped();
    let all = [
        "--path",
        "orbit",
        "--frames",
        "2",
        "--width",
        "65",
        "--output",
        "rgb,depth,uncertainty",
        "--out",
        "film",
    ];
    let first = render(dir, &all).exits(0);
    assert_eq!(first.done(), ["render-of-train", "video-of-train"]);
    let what = told(&first);
    assert_eq!(
        (&what["pictures"], &what["width"]),
        (&json!(2), &json!(65)),
        "{what}"
    );
    let file = |name: &str| std::fs::read(dir.join("film").join(name)).unwrap();
    for (folder, quantity) in [("depth", "depth"), ("uncertainty", "uncertainty")] {
        let (width, height, values) = read_quantity(&file(&format!("{folder}/0002.png")), quantity).unwrap();
        assert_eq!(
            (json!(width), json!(height)),
            (json!(65), what["height"].clone()),
            "{folder}"
        );
        assert!(values.iter().any(|value| *value > 0.0), "{folder} is empty");
        let preview = image::load_from_memory(&file(&format!("{folder}-preview/0002.png"))).unwrap();
        assert!(
            preview.height() > height,
            "{folder}: a preview has its scale below"
        );
    }
    assert_eq!(
        image::load_from_memory(&file("rgb/0001.png")).unwrap().width(),
        65
    );
    let film = file("video.mp4");
    assert_eq!(&film[4..8], b"ftyp");
    let poses: Value = serde_json::from_slice(&file("poses.json")).unwrap();
    assert_eq!(poses[1]["name"], "0002");

    let again = render(dir, &all).exits(0);
    assert_eq!(again.done(), Vec::<&str>::new(), "nothing changed");
    for name in ["film/rgb/0001.png", "film/depth/0001.png", "film/video.mp4"] {
        let made = marf(dir, &["audit", name]).exits(0);
        assert!(made.stdout.contains("-of-train"), "{name}: {}", made.stdout);
    }
    let status = marf(dir, &["status"]).exits(0);
    assert!(
        !status.stdout.contains("render-of"),
        "it is no run of the pipeline: {}",
        status.stdout
    );

    let other_rate = render(dir, &[&all[..], &["--fps", "12"]].concat()).exits(0);
    assert_eq!(
        other_rate.done(),
        ["video-of-train"],
        "another rate renders nothing"
    );
}

#[test]
fn the_poses_of_one_render_are_the_bookmarks_of_the_next() {
    let dir = bootstrapped();
    render(
        dir,
        &["--path", "train", "--frames", "3", "--width", "40", "--out", "a"],
    )
    .exits(0);
    assert!(dir.join("a/video.mp4").exists());
    let stills = render(dir, &["--path", "a/poses.json", "--out", "a"]).exits(0);
    assert_eq!(
        (&told(&stills)["pictures"], &told(&stills)["width"]),
        (&json!(3), &json!(40))
    );
    assert!(
        !dir.join("a/video.mp4").exists(),
        "the film of another path would be taken for that of the stills"
    );
    let through = [
        "--path",
        "a/poses.json",
        "--frames",
        "4",
        "--height",
        "20",
        "--out",
        "b",
    ];
    let film = render(dir, &through).exits(0);
    assert_eq!(
        (&told(&film)["pictures"], &told(&film)["height"]),
        (&json!(4), &json!(20))
    );
    assert!(dir.join("b/video.mp4").exists());
    let copied = ["--path", "a/poses.json", "--out", "c"];
    let same = render(dir, &copied).exits(0);
    assert_eq!(
        same.done(),
        Vec::<&str>::new(),
        "another folder gets the same pictures"
    );
    // The last run has rendered colours alone. An earlier one has the bootstrap of this field.
    let more = ["--output", "uncertainty", "--width", "16"];
    render(dir, &[&copied[..], &more].concat()).exits(0);
    assert!(dir.join("c/uncertainty/0003.png").exists() && !dir.join("c/rgb/0003.png").exists());
}

#[test]
fn what_cannot_be_rendered_is_one_error_with_the_way_out() {
    let dir = bootstrapped();
    std::fs::write(dir.join("empty.json"), "[]").unwrap();
    let refused = |args: &[&str], word: &str| {
        let ran = marf(dir, &[&["render", "--out", "refused"], args].concat()).exits(2);
        assert!(ran.stderr.contains(word), "{args:?}: {}", ran.stderr);
    };
    refused(&["--path", "orbti"], "did you mean `orbit`?");
    refused(&["--path", "empty.json"], "it holds no bookmark");
    refused(&["--output", "normals"], "`rgb`, `depth`, `uncertainty`");
    refused(&["--width", "0"], "0 is not within 1 to 4096");
    refused(&["--scale", "0"], "Take a factor above 0");
    refused(&["--quantizer", "60"], "12 to 51");
    refused(&["blur"], "`blur` of run 2 gives no trained field");
    refused(
        &["--path", "nowhere.json"],
        "take one of train, heldout, flythrough, orbit, or a file of bookmarks",
    );
    refused(&["--width", "8", "--scale", "2"], "cannot be used with");
    let wide = ["render", "--out", "refused", "--width", "4000"];
    let ran = marf(dir, &wide).exits(1);
    assert!(ran.stderr.contains("lower `width`"), "{}", ran.stderr);
    assert!(!dir.join("refused").exists());
}

#[test]
fn uncertainty_without_a_bootstrap_names_what_to_add() {
    let ran = render(trained(), &["--output", "uncertainty", "--out", "x"]).exits(2);
    assert!(
        ran.stderr.contains(
            "run 1 has no bootstrap of `train`, and the uncertainty is how far its retrainings differ"
        ),
        "{}",
        ran.stderr
    );
    assert!(
        ran.stderr.contains("[node.bootstrap]") && ran.stderr.contains("training = \"train\""),
        "{}",
        ran.stderr
    );
}
