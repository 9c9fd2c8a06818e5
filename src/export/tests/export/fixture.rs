//! A run of four nodes: photos from an archive, a filter, a training that asks for a child, all as plain bytes.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use marf_cache::manifest::{Leaf, LeafRef, Root, Row};
use marf_cache::{ACTION_FORMAT, Action, Digest, Output, Record, RunMetadata, Sha256, Store};
use marf_engine::Cancel;
use marf_export::bag::{Bag, BagWriter};
use marf_export::verify::{Report, verify};
use marf_export::{CrateOptions, Data, Photos, write_crate};
use marf_keys::{PublicKey, SigningKey};
use marf_model::Run;
use marf_stage::{Origin, OriginKind, Verdict};
use serde_json::{Value, json};

/// Test 1 of RFC 8032, section 7.1.
pub const PRIVATE_PEM: &str = "-----BEGIN PRIVATE KEY-----\n\
    MC4CAQAwBQYDK2VwBCIEIJ1hsZ3v/VpguoRK9JLsLMREScVpezJpGXA7rAMcrn9g\n\
    -----END PRIVATE KEY-----\n";

pub fn signing_key() -> SigningKey {
    SigningKey::from_pem(PRIVATE_PEM).unwrap()
}

pub fn public_key() -> PublicKey {
    signing_key().public()
}

/// Objects of a store, and the run root that leads to them.
#[derive(Default)]
pub struct World {
    pub objects: BTreeMap<Digest, Vec<u8>>,
    nodes: Vec<Value>,
    origins: BTreeMap<String, Vec<Digest>>,
}

impl World {
    pub fn put(&mut self, bytes: &[u8]) -> Digest {
        let digest = Digest::from_content(bytes);
        self.objects.insert(digest, bytes.to_vec());
        digest
    }

    /// Stores a set of photos of one sol.
    pub fn set(&mut self, ids: &[&str]) -> Digest {
        let row = |id: &&str| Row {
            id: (*id).to_owned(),
            blobs: BTreeMap::from([("image".to_owned(), Digest::from_content(image(id).as_bytes()))]),
            facts: Value::Null,
        };
        let leaf = Leaf::new(ids.iter().map(row).collect()).unwrap().encode();
        self.leaf(&leaf, ids.len())
    }

    /// Stores the verdicts on photos of one sol.
    pub fn verdicts(&mut self, ids: &[&str], kept: &[&str]) -> Digest {
        let verdict = |id: &&str| Verdict {
            id: (*id).to_owned(),
            file: format!("{id}.png"),
            verdict: if kept.contains(id) { "keep" } else { "size" }.to_owned(),
            score: Some(0.1),
            threshold: Some(1.0),
            twin: None,
            reason: String::new(),
        };
        let lines = ids
            .iter()
            .map(|id| serde_json::to_string(&verdict(id)).unwrap() + "\n");
        let lines: String = lines.collect();
        self.leaf(lines.as_bytes(), ids.len())
    }

    fn leaf(&mut self, bytes: &[u8], rows: usize) -> Digest {
        let leaf = self.put(bytes);
        let leaves = vec![LeafRef {
            shard: 7,
            leaf,
            rows: rows as u32,
        }];
        Root { leaves }
            .write(|bytes| Ok::<_, ()>(self.put(bytes)))
            .unwrap()
    }

    /// Adds a node with a result and returns nothing: what it read is in `inputs`.
    pub fn node(&mut self, name: &str, params: Value, inputs: &[(&str, Digest)], outputs: &[(&str, Digest)]) {
        let stage = name
            .split('/')
            .next_back()
            .unwrap()
            .trim_end_matches(char::is_numeric);
        let action = Action {
            action: ACTION_FORMAT,
            stage: stage.trim_end_matches('-').to_owned(),
            version: 3,
            part: None,
            shard: None,
            params,
            inputs: inputs
                .iter()
                .map(|(name, digest)| ((*name).to_owned(), *digest))
                .collect(),
            backend: None,
            children: BTreeMap::new(),
        };
        let key = self.put(&action.encode());
        let edges: Vec<Value> = inputs
            .iter()
            .filter_map(|(key, digest)| Some(json!({"key": key, "upstream": self.maker(digest)?})))
            .collect();
        let outputs = outputs.iter().map(|(name, digest)| {
            let bytes = self.objects.get(digest).map_or(0, Vec::len);
            ((*name).to_owned(), json!({"digest": digest, "bytes": bytes}))
        });
        let outputs: serde_json::Map<String, Value> = outputs.collect();
        let read: BTreeMap<&str, Value> = inputs
            .iter()
            .map(|(name, digest)| (*name, json!({"digest": digest})))
            .collect();
        self.nodes.push(json!({
            "name": name, "stage": action.stage, "parent": name.split_once('/').map(|(parent, _)| parent),
            "edges": edges, "inputs": read, "key": key, "state": "finished", "reason": "never ran", "seconds": 2.5,
            "started_unix_s": 1_000_000_001_u64, "outputs": outputs, "counts": {},
        }));
    }

    /// Returns the first node that made an output.
    fn maker(&self, digest: &Digest) -> Option<String> {
        let has = |node: &&Value| {
            let outputs = node["outputs"].as_object().unwrap();
            outputs.values().any(|output| output["digest"] == json!(digest))
        };
        let maker = self.nodes.iter().find(has)?;
        Some(maker["name"].as_str().unwrap().to_owned())
    }

    /// Notes which files a source read.
    pub fn read(&mut self, source: &str, ids: &[&str]) {
        let origin = |id: &&str| Origin {
            file: format!("{id}.png"),
            kind: OriginKind::Photo,
            blake3: Digest::from_content(image(id).as_bytes()),
            bytes: Some(image(id).len() as u64),
            sha256: Some(Sha256::from_content(image(id).as_bytes())),
            url: Some(format!("https://archive.example/{id}.png")),
            fetched: Some("2026-01-01T00:00:00Z".to_owned()),
            reason: None,
        };
        let list = Origin::encode(&ids.iter().map(origin).collect::<Vec<_>>());
        let list = self.put(&list);
        self.origins.entry(source.to_owned()).or_default().push(list);
    }

    /// Returns a store with the objects and the run that leads to them, which is run 1.
    pub fn stored(&mut self) -> (tempfile::TempDir, Store) {
        let pipeline = self.put(b"[node.extract]\n");
        let root = json!({
            "format": marf_engine::RUN_FORMAT, "id": "6e10105061dd45eb", "pipeline": "small", "command": "marf run",
            "program": "marf 0.1.0", "started_unix_s": 1_000_000_000_u64, "seconds": 9.0, "outcome": "done",
            "source": {"kind": "pipeline", "file": "pipeline.toml"}, "digest": Digest::from_content(b"declared"), "threads": 2,
            "nodes": self.nodes, "latest": {},
            "build": {"commit": "abc", "blake3": Digest::from_content(b"program"), "bytes": 7, "os": "linux", "arch": "x86_64"},
            "documents": {"pipeline.toml": {"digest": pipeline, "bytes": 15}},
        });
        let dir = tempfile::tempdir().unwrap();
        let store = Store::open(dir.path().join(".marf")).unwrap();
        for bytes in self.objects.values() {
            store.put(bytes).unwrap();
        }
        for node in &self.nodes {
            if let Some(lists) = self.origins.get(node["name"].as_str().unwrap()) {
                record(&store, node, lists);
            }
        }
        store.put_run(&serde_json::to_vec_pretty(&root).unwrap()).unwrap();
        (dir, store)
    }

    /// Writes a crate of the run and returns its folder.
    pub fn write(&mut self, dir: &Path, options: &CrateOptions<'_>) -> PathBuf {
        let (_dir, store) = self.stored();
        let folder = dir.join("crate");
        write_crate(&Run::open(&store, 1).unwrap(), options, &folder).unwrap();
        folder
    }
}

/// Stores the record of a source, with a part for each list of files that it read.
fn record(store: &Store, node: &Value, lists: &[Digest]) {
    let mut parts = Root::default();
    for (shard, list) in (7..).zip(lists) {
        let part = Record {
            key: store
                .put(format!("part {shard} of {}", node["key"]).as_bytes())
                .unwrap(),
            stage: node["stage"].as_str().unwrap().to_owned(),
            outputs: BTreeMap::new(),
            needs: None,
            parts: None,
            children: BTreeMap::new(),
            origins: Some(*list),
            metadata: RunMetadata::default(),
        };
        parts.leaves.push(LeafRef {
            shard,
            leaf: part.key,
            rows: 0,
        });
        store.put_record(part);
    }
    let outputs: BTreeMap<String, Output> = serde_json::from_value(node["outputs"].clone()).unwrap();
    store.put_record(Record {
        key: serde_json::from_value(node["key"].clone()).unwrap(),
        stage: node["stage"].as_str().unwrap().to_owned(),
        outputs,
        needs: None,
        parts: Some(parts.write(|bytes| store.put(bytes)).unwrap()),
        children: BTreeMap::new(),
        origins: None,
        metadata: RunMetadata {
            program: "marf 0.1.0".to_owned(),
            device: "cpu".to_owned(),
            ..RunMetadata::default()
        },
    });
}

/// The bytes of a photo.
pub fn image(id: &str) -> String {
    format!("pixels of {id}")
}

pub const IDS: [&str; 3] = ["a", "b", "name with spaces"];
pub const KEPT: [&str; 2] = ["a", "b"];

/// A run in which all is as it should be.
pub fn world() -> World {
    let mut world = World::default();
    for id in IDS {
        world.put(image(id).as_bytes());
    }
    let listing = Root {
        leaves: vec![LeafRef {
            shard: 7,
            leaf: Digest::from_content(b"fingerprint"),
            rows: 0,
        }],
    };
    let listing = listing.write(|bytes| Ok::<_, ()>(world.put(bytes))).unwrap();
    let (all, kept) = (world.set(&IDS), world.set(&KEPT));
    let (read, decided) = (world.verdicts(&IDS, &IDS), world.verdicts(&IDS, &KEPT));
    world.node(
        "extract",
        json!({"white": 0.125}),
        &[("listing", listing)],
        &[("photos", all), ("verdicts", read)],
    );
    world.read("extract", &IDS);
    world.node(
        "size",
        json!({"min_bytes": 3000, "by_hand": {"keep": []}}),
        &[("photos", all)],
        &[("photos", kept), ("verdicts", decided)],
    );
    let (weights, picture) = (world.put(b"weights"), world.put(b"picture"));
    let child = world.put(b"weights of a child");
    world.node(
        "fit",
        json!({"seed": 0}),
        &[("photos", kept)],
        &[("weights.bin", weights), ("maps/a b.png", picture)],
    );
    world.node(
        "fit/member-00",
        json!({"seed": 1}),
        &[("photos", kept)],
        &[("weights.bin", child)],
    );
    world
}

pub fn options() -> CrateOptions<'static> {
    CrateOptions {
        data: Data::Included,
        photos: Photos::All,
        file_name: |name| name.contains('.').then_some(name),
        license: None,
        key: None,
    }
}

pub fn check(folder: &Path) -> Report {
    verify(folder, None, &Cancel::default()).unwrap()
}

/// Makes a new bag from the files of its payload, as a forger would who knows BagIt.
pub fn rebag(folder: &Path) {
    let payload = folder.join("data");
    let info = std::fs::read_to_string(folder.join("bag-info.txt")).unwrap();
    let info: Vec<(&str, String)> = info
        .lines()
        .filter_map(|line| line.split_once(": "))
        .filter(|(label, _)| *label != "Payload-Oxum")
        .map(|(label, value)| (label, value.to_owned()))
        .collect();
    let target = folder.with_extension("new");
    let mut bag = BagWriter::create(&target).unwrap();
    for entry in walkdir::WalkDir::new(&payload) {
        let entry = entry.unwrap();
        if entry.file_type().is_file() {
            let path = entry
                .path()
                .strip_prefix(&payload)
                .unwrap()
                .to_string_lossy()
                .into_owned();
            bag.add(&path, &std::fs::read(entry.path()).unwrap()).unwrap();
        }
    }
    bag.seal().unwrap();
    if let Ok(attestation) = std::fs::read(folder.join("attestation.dsse.json")) {
        bag.tag("attestation.dsse.json", &attestation).unwrap();
    }
    bag.finish(&info).unwrap();
    std::fs::remove_dir_all(folder).unwrap();
    std::fs::rename(&target, folder).unwrap();
    assert_eq!(Bag::read(folder, &Cancel::default()).faults, []);
}

/// Changes the graph of a crate and makes a new bag.
pub fn edit_graph(folder: &Path, edit: impl FnOnce(&mut Vec<Value>)) {
    let path = folder.join("data/ro-crate-metadata.json");
    let mut graph: Value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
    edit(graph["@graph"].as_array_mut().unwrap());
    std::fs::write(&path, graph.to_string()).unwrap();
    rebag(folder);
}

/// Returns the entity of this id.
pub fn entity<'a>(graph: &'a mut [Value], id: &str) -> &'a mut Value {
    graph
        .iter_mut()
        .find(|entity| entity["@id"] == id)
        .unwrap_or_else(|| panic!("no `{id}`"))
}
