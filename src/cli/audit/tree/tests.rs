//! Lines of an audit have the numbers of what they are about.

use marf_cache::Digest;
use marf_provenance::verify::Lost;
use serde_json::json;

use super::*;

fn digest() -> Digest {
    Digest::from_content(b"x")
}

fn lines(add: impl FnOnce(&mut Vec<String>)) -> Vec<String> {
    let mut text = Vec::new();
    add(&mut text);
    text
}

#[test]
fn what_was_verified_is_counted() {
    let lost = Lost {
        digest: digest(),
        of: "train".to_owned(),
        role: "weights",
    };
    let verified = Verified {
        objects: 12,
        bytes: 3000,
        products: 1,
        faults: Vec::new(),
        missing: vec![lost],
    };
    assert_eq!(
        lines(|text| add_verified(text, &verified)),
        [
            format!(
                "checked 12 objects ({}), 1 archive file by SHA-256: 0 faults, 1 missing",
                size(3000)
            ),
            format!("  weights of train ({}) is not in the store", digest().short()),
        ]
    );
}

#[test]
fn a_short_answer_counts_what_it_leaves_out() {
    assert_eq!(lines(|text| add_rest(text, 8, "steps")), [""; 0]);
    assert_eq!(
        lines(|text| add_rest(text, 11, "steps")),
        ["    and 3 more steps"]
    );
}

#[test]
fn places_have_their_sol_and_node() {
    let (node, sol) = ("extract".to_owned(), 7);
    for (found, said) in [
        (
            Place::Sol {
                node: node.clone(),
                output: "photos".to_owned(),
                sol,
            },
            "sol 7 of output `photos` of node `extract`",
        ),
        (
            Place::Product {
                node: node.clone(),
                sol,
                id: "A".to_owned(),
                role: "label".to_owned(),
            },
            "the label of product A of sol 7, read by node `extract`",
        ),
        (
            Place::File {
                node,
                sol,
                file: "A.txt".to_owned(),
            },
            "the file A.txt of sol 7, met by node `extract`",
        ),
    ] {
        assert_eq!(place(&found), said);
    }
}

#[test]
fn a_step_its_products_and_their_changes_have_their_numbers() {
    let step = Step {
        node: "train".to_owned(),
        stage: "train".to_owned(),
        parent: None,
        key: Some(digest()),
        version: Some(4),
        device: Some("CPU".to_owned()),
        params: json!({"seed": 3}),
        started_unix_s: None,
        seconds: 2.0,
        inputs: Default::default(),
        lost: Vec::new(),
    };
    assert_eq!(
        about(&step),
        format!(
            "train (train v4, CPU, {}, seed 3, key {})",
            duration(2.0),
            digest().short()
        )
    );
    let source = Products {
        node: "extract".to_owned(),
        photos: 5,
        sols: 2,
        listed: vec![Product {
            id: "A".to_owned(),
            shard: 7,
            blobs: [("image".to_owned(), digest())].into(),
            facts: json!({}),
            origins: Default::default(),
        }],
        lost_sols: vec![9],
    };
    assert_eq!(
        lines(|text| add_products(text, &source, "")),
        [
            "5 photos of 2 sols:".to_owned(),
            "  A of sol 7".to_owned(),
            format!("    image blake3 {}", digest()),
            "  the products of sol 9 are not in the store any more".to_owned(),
        ]
    );
    let origin = |url: serde_json::Value| {
        let file = json!({"file": "A.png", "kind": "photo", "blake3": digest(), "bytes": 3000, "url": url,
                          "fetched": "2026-01-02T03:04:05Z"});
        let line = Product {
            id: "A".to_owned(),
            shard: 7,
            blobs: [("image".to_owned(), digest())].into(),
            facts: json!({}),
            origins: [("image".to_owned(), serde_json::from_value(file).unwrap())].into(),
        };
        file_of(&line, "image")
    };
    assert_eq!(
        origin(json!("https://a.example/A.png")),
        format!(
            ", {}, file A.png, from https://a.example/A.png at 2026-01-02T03:04:05Z",
            size(3000)
        )
    );
    assert_eq!(
        origin(json!(null)),
        format!(
            ", {}, file A.png, with the listing at 2026-01-02T03:04:05Z",
            size(3000)
        )
    );
    let changed = Changed {
        file: "A.txt".to_owned(),
        sol: 7,
        used: digest(),
        now: vec!["it is gone".to_owned()],
    };
    assert_eq!(
        lines(|text| add_changed(text, &changed)),
        [
            format!("A.txt of sol 7, used was blake3 {}:", digest()),
            "  it is gone".to_owned(),
        ]
    );
}
