//! A shared store as its users meet it: runs that travel, and objects that are not what they should be.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on should stop")]

mod common;

use std::path::{Path, PathBuf};

use common::{Ran, marf};

/// Filters and cameras of the built-in Mars, in a second.
const PIPELINE: &str = concat!(
    "name = \"shared\"\n[archive.photos]\nkind = \"demo\"\nsols = \"1\"\nwidth = 160\n",
    include_str!("../labs/five_nodes.toml"),
    "[node.calibrate]\ninput = \"blur\"\nmethod = \"labels\"\n",
);

/// Folders with the same pipeline and stores of their own, and a folder that is shared.
struct World {
    dir: tempfile::TempDir,
}

impl World {
    fn new() -> Self {
        let dir = tempfile::tempdir().unwrap();
        Self { dir }
    }

    fn url(&self) -> String {
        format!("file://{}/shared", self.dir.path().display())
    }

    /// Returns a folder with the pipeline.
    fn machine(&self, name: &str) -> PathBuf {
        let folder = self.dir.path().join(name);
        std::fs::create_dir_all(&folder).unwrap();
        std::fs::write(folder.join("pipeline.toml"), PIPELINE).unwrap();
        folder
    }

    /// Returns a folder with the pipeline, which names the shared store: runs fetch and send.
    fn sharing_machine(&self, name: &str) -> PathBuf {
        let folder = self.machine(name);
        let store = format!("[store]\nremote = \"{}\"\n", self.url());
        std::fs::write(folder.join("pipeline.toml"), format!("{PIPELINE}{store}")).unwrap();
        folder
    }

    /// Runs `marf cache ARGS` with the address of the shared store.
    fn cache(&self, folder: &Path, args: &[&str]) -> Ran {
        let url = self.url();
        marf(folder, &[&["cache"], args, &["--remote", &url]].concat())
    }

    /// Returns a file of the shared store below a folder with this ending.
    fn file(&self, folder: &str, ending: &str) -> PathBuf {
        let mut found = Vec::new();
        collect(&self.dir.path().join("shared").join(folder), &mut found);
        found.sort();
        found
            .into_iter()
            .find(|path| path.to_string_lossy().ends_with(ending))
            .unwrap()
    }
}

fn collect(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        match path.is_dir() {
            true => collect(&path, found),
            false => found.push(path),
        }
    }
}

fn json(ran: &Ran) -> serde_json::Value {
    serde_json::from_str(&ran.stdout).unwrap()
}

#[test]
fn a_fresh_machine_that_pulls_runs_no_node() {
    let world = World::new();
    let (here, there) = (world.machine("here"), world.machine("there"));
    marf(&here, &["run"]).exits(0);
    let pushed = json(&world.cache(&here, &["push", "--json"]).exits(0));
    assert_eq!(pushed["known_results"], 0);
    assert_eq!(pushed["conflicts"], 0);
    let pulled = json(&world.cache(&there, &["pull", "--json"]).exits(0));
    assert_eq!(pulled["results"], pushed["results"]);
    assert_eq!(pulled["blob_bytes"], pushed["blob_bytes"]);
    assert_eq!(pulled["run"], pushed["run"]);
    marf(&there, &["cache", "fsck", "--read-data"]).exits(0);
    let ran = marf(&there, &["run", "--json"]).exits(0);
    assert_eq!(ran.nodes("finished"), Vec::<String>::new());
    let scene = |folder: &Path| std::fs::read(folder.join("out/calibrate/scene.json")).unwrap();
    assert_eq!(scene(&here), scene(&there));
}

#[test]
fn a_second_push_and_a_second_pull_find_everything_there() {
    let world = World::new();
    let (here, there) = (world.machine("here"), world.machine("there"));
    marf(&here, &["run"]).exits(0);
    world.cache(&here, &["push"]).exits(0);
    let again = json(&world.cache(&here, &["push", "--json"]).exits(0));
    assert_eq!((&again["results"], &again["blobs"]), (&0.into(), &0.into()));
    world.cache(&there, &["pull"]).exits(0);
    let again = json(&world.cache(&there, &["pull", "--json"]).exits(0));
    assert_eq!((&again["results"], &again["blobs"]), (&0.into(), &0.into()));
    assert_eq!(again["number"], 1, "a run that is there is not added twice");
}

#[test]
fn a_poisoned_object_is_named_and_a_run_makes_its_own() {
    let world = World::new();
    let (here, there) = (world.machine("here"), world.sharing_machine("there"));
    marf(&here, &["run"]).exits(0);
    world.cache(&here, &["push"]).exits(0);
    for (folder, ending) in [("packs", ".pack"), ("packs", ".idx"), ("records", "")] {
        let path = world.file(folder, ending);
        let whole = std::fs::read(&path).unwrap();
        let mut bytes = whole.clone();
        bytes[whole.len() / 2] ^= 1;
        std::fs::write(&path, bytes).unwrap();
        let ran = marf(&there, &["cache", "pull"]).exits(1);
        assert!(ran.stderr.contains("is damaged"), "{folder}: {}", ran.stderr);
        assert!(ran.stderr.contains(&world.url()), "{folder}: {}", ran.stderr);
        assert!(ran.stderr.contains("hint: "), "{folder}: {}", ran.stderr);
        std::fs::write(&path, whole).unwrap();
    }
    let path = world.file("packs", ".pack");
    let len = std::fs::metadata(&path).unwrap().len();
    std::fs::write(&path, vec![0; len as usize]).unwrap();
    let ran = marf(&there, &["run", "--json"]).exits(0);
    assert!(!ran.nodes("finished").is_empty());
    assert!(ran.stderr.contains("is damaged"), "{}", ran.stderr);
    marf(&there, &["cache", "fsck", "--read-data"]).exits(0);

    let ran = marf(&there, &["cache", "fsck", "--remote", "--read-data"]).exits(1);
    assert!(ran.stdout.contains("have another digest"), "{}", ran.stdout);
    marf(&there, &["cache", "fsck", "--remote", "--read-data", "--repair"]).exits(0);
    marf(&there, &["cache", "push"]).exits(0);
    world.cache(&there, &["fsck", "--read-data"]).exits(0);
    let gc = ["gc", "--grace", "0s", "--json"];
    let done = json(&world.cache(&there, &gc).exits(0));
    assert_eq!(done["collected"]["missing"], 0);
    let fresh = world.machine("fresh");
    world.cache(&fresh, &["pull"]).exits(0);
}

#[test]
fn what_is_not_there_is_told_with_the_way_out() {
    let world = World::new();
    let there = world.machine("there");
    let ran = world.cache(&there, &["pull"]).exits(1);
    assert!(
        ran.stderr.contains("there is no shared store at file://"),
        "{}",
        ran.stderr
    );
    let ran = world.cache(&there, &["push"]).exits(1);
    assert!(ran.stderr.contains("there is no"), "{}", ran.stderr);
    let ran = marf(&there, &["cache", "pull", "--remote", "http://user:secret@mars"]).exits(2);
    assert!(
        ran.stderr.contains("is not an address of a shared store"),
        "{}",
        ran.stderr
    );
    assert!(!ran.stderr.contains("secret"), "{}", ran.stderr);

    let here = world.machine("here");
    marf(&here, &["run"]).exits(0);
    world.cache(&here, &["push"]).exits(0);
    let url = world.url();
    let pipeline = std::fs::read_to_string(there.join("pipeline.toml")).unwrap();
    std::fs::write(
        there.join("other.toml"),
        pipeline.replacen("name = ", "name = \"other\" # ", 1),
    )
    .unwrap();
    let ran = marf(
        &there,
        &["cache", "pull", "--file", "other.toml", "--remote", &url],
    )
    .exits(1);
    assert!(
        ran.stderr.contains("has no run of the pipeline `other`"),
        "{}",
        ran.stderr
    );
    let run = ran
        .stderr
        .lines()
        .last()
        .unwrap()
        .rsplit(' ')
        .next()
        .unwrap()
        .to_owned();
    marf(
        &there,
        &["cache", "pull", "--run", &run, "--remote", &world.url()],
    )
    .exits(0);
}

#[test]
fn the_shared_store_is_in_no_key() {
    let world = World::new();
    let here = world.machine("here");
    marf(&here, &["run"]).exits(0);
    let ran = marf(&world.sharing_machine("here"), &["run", "--json"]).exits(0);
    assert_eq!(ran.nodes("finished"), Vec::<String>::new());
    assert!(
        !world.dir.path().join("shared").join("format").exists(),
        "nothing is asked or sent"
    );
}

#[test]
fn a_run_fetches_what_another_machine_has_made_and_sends_what_it_made() {
    let world = World::new();
    let (here, there) = (world.sharing_machine("here"), world.sharing_machine("there"));
    let first = marf(&here, &["run", "--json"]).exits(0);
    assert!(!first.stderr.contains("warning"), "{}", first.stderr);
    let second = marf(&there, &["run", "--json"]).exits(0);
    assert_eq!(
        second.nodes("finished"),
        Vec::<String>::new(),
        "{}",
        second.stderr
    );
    assert!(!first.nodes("finished").is_empty());
    marf(&there, &["cache", "fsck", "--read-data"]).exits(0);
    // What no machine has made is made, and comes back to the first.
    let run = |folder: &Path| marf(folder, &["run", "--json", "--set", "blur.min_share=0.1"]).exits(0);
    assert!(run(&there).nodes("finished").contains(&"blur".to_owned()));
    assert_eq!(run(&here).nodes("finished"), Vec::<String>::new());
}

#[test]
fn a_shared_store_that_is_away_is_told_once_and_stops_no_run() {
    let world = World::new();
    let here = world.sharing_machine("here");
    std::fs::write(world.dir.path().join("shared"), "a file").unwrap();
    let ran = marf(&here, &["run"]).exits(0);
    assert_eq!(
        ran.stderr.matches("goes on without the shared store").count(),
        1,
        "{}",
        ran.stderr
    );
}

/// Results without a signature of a named writer are made again. Signed results are fetched. The key is named in the environment
/// alone.
#[test]
fn results_of_named_writers_alone_are_believed() {
    const PRIVATE: &str = "-----BEGIN PRIVATE KEY-----\nMC4CAQAwBQYDK2VwBCIEIJ1hsZ3v/VpguoRK9JLsLMREScVpezJpGXA7rAMcrn9g\n\
        -----END PRIVATE KEY-----\n";
    const PUBLIC: &str = "-----BEGIN PUBLIC KEY-----\nMCowBQYDK2VwAyEA11qYAYKxCrfVS/7TyWQHOg7hcvPapiMlrwIaaPcHURo=\n\
        -----END PUBLIC KEY-----\n";
    let world = World::new();
    let (here, there) = (world.machine("here"), world.sharing_machine("there"));
    std::fs::write(here.join("key.pem"), PRIVATE).unwrap();
    marf(&here, &["run"]).exits(0);
    world.cache(&here, &["push"]).exits(0);
    let trusting = std::fs::read_to_string(there.join("pipeline.toml")).unwrap() + "trust = [\"pub.pem\"]\n";
    std::fs::write(there.join("pipeline.toml"), trusting).unwrap();
    let absent = marf(&there, &["run"]).exits(2);
    assert!(
        absent.stderr.contains("pub.pem cannot be read"),
        "{}",
        absent.stderr
    );
    std::fs::write(there.join("pub.pem"), PUBLIC).unwrap();
    let refused = world.cache(&there, &["pull"]).exits(1);
    assert!(
        refused.stderr.contains("signed by no key of `trust`"),
        "{}",
        refused.stderr
    );
    let own = marf(&there, &["run", "--to", "extract"]).exits(0);
    assert!(
        own.stderr.contains("signed by no key of `trust`"),
        "{}",
        own.stderr
    );

    let mut push = std::process::Command::new(env!("CARGO_BIN_EXE_marf"));
    push.current_dir(&here)
        .args(["cache", "push", "--remote", &world.url()])
        .env("MARF_SIGNING_KEY", "key.pem");
    assert!(push.output().unwrap().status.success());
    world.cache(&there, &["pull"]).exits(0);
    let ran = marf(&there, &["run", "--json"]).exits(0);
    assert_eq!(ran.nodes("finished"), Vec::<String>::new());
}

/// A key in the configuration folder signs what is sent, unless the user wants none.
#[test]
fn the_key_of_the_user_signs_what_is_sent() {
    let world = World::new();
    let (here, there) = (world.machine("here"), world.sharing_machine("there"));
    let configuration = world.machine("configuration");
    let marf_with_key = |folder: &Path, args: &[&str]| {
        let output = std::process::Command::new(env!("CARGO_BIN_EXE_marf"))
            .current_dir(folder)
            .args(args)
            .env("XDG_CONFIG_HOME", &configuration)
            .output()
            .unwrap();
        let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
        (output.status.code(), text(&output.stdout), text(&output.stderr))
    };
    let (code, made, said) = marf_with_key(&here, &["key", "new"]);
    assert_eq!(code, Some(0), "{said}");
    let key = configuration.join("marf/key.pem");
    assert!(made.contains(&key.display().to_string()), "{made}");
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt as _;
        let mode = std::fs::metadata(&key).unwrap().permissions().mode();
        assert_eq!(mode & 0o777, 0o600);
    }
    let before = std::fs::read(&key).unwrap();
    let (code, _, said) = marf_with_key(&here, &["key", "new"]);
    assert!(
        code == Some(1) && said.contains("A key is never replaced"),
        "{said}"
    );
    assert_eq!(std::fs::read(&key).unwrap(), before);

    std::fs::copy(key.with_extension("pub.pem"), there.join("pub.pem")).unwrap();
    let trusting = std::fs::read_to_string(there.join("pipeline.toml")).unwrap() + "trust = [\"pub.pem\"]\n";
    std::fs::write(there.join("pipeline.toml"), trusting).unwrap();
    marf(&here, &["run"]).exits(0);
    let url = world.url();
    let push = ["cache", "push", "--remote", url.as_str()];
    assert_eq!(
        marf_with_key(&here, &[&push[..], &["--no-sign"]].concat()).0,
        Some(0)
    );
    let refused = world.cache(&there, &["pull"]).exits(1);
    assert!(
        refused.stderr.contains("signed by no key of `trust`"),
        "{}",
        refused.stderr
    );
    assert_eq!(marf_with_key(&here, &push).0, Some(0));
    world.cache(&there, &["pull"]).exits(0);
}

/// Writers need no right to remove anything but leases, and readers no right to write.
#[test]
fn a_push_removes_and_changes_nothing_but_leases() {
    let world = World::new();
    let (here, there) = (world.machine("here"), world.machine("there"));
    let shared = world.dir.path().join("shared");
    let contents = || {
        let mut files = Vec::new();
        collect(&shared, &mut files);
        let is_kept = |file: &PathBuf| !file.starts_with(shared.join("leases"));
        let read = |file: PathBuf| (file.clone(), std::fs::read(file).unwrap());
        let kept = files.into_iter().filter(is_kept).map(read);
        kept.collect::<std::collections::BTreeMap<_, _>>()
    };
    marf(&here, &["run"]).exits(0);
    world.cache(&here, &["push"]).exits(0);
    let before = contents();
    marf(&there, &["run", "--set", "blur.min_share=0.01"]).exits(0);
    world.cache(&there, &["push"]).exits(0);
    let after = contents();
    assert!(after.len() > before.len(), "{} files", after.len());
    for (file, bytes) in &before {
        assert_eq!(after.get(file), Some(bytes), "{}", file.display());
    }
    let fresh = world.machine("fresh");
    world.cache(&fresh, &["pull"]).exits(0);
    assert_eq!(contents(), after);
}

#[test]
fn results_that_a_shared_store_lost_are_counted_by_a_collection_and_named_by_a_check() {
    let world = World::new();
    let here = world.machine("here");
    marf(&here, &["run"]).exits(0);
    world.cache(&here, &["push"]).exits(0);
    let path = world.file("records", "");
    std::fs::remove_file(&path).unwrap();
    let gc = world.cache(&here, &["gc", "--dry-run"]).exits(0).stderr;
    let said = "1 results that kept runs name are missing. `marf cache fsck --remote` lists the objects that refer to them";
    assert!(gc.contains(said), "{gc}");
    let name = |path: &Path| path.file_name().unwrap().to_string_lossy().into_owned();
    let key = name(path.parent().unwrap()) + &name(&path);
    let fsck = world.cache(&here, &["fsck"]).exits(1).stdout;
    assert!(fsck.contains(&key), "{key}: {fsck}");
}
