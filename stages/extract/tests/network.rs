//! Who may reach the network: one module opens sockets, one file makes permits.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on should stop")]

use std::path::{Path, PathBuf};

fn sources(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).unwrap().map(Result::unwrap) {
        match entry.path() {
            path if path.is_dir() => sources(&path, found),
            path => found.push(path),
        }
    }
}

/// Returns the files below `src` that hold one of the words, as relative paths.
fn files_with(words: &[&str]) -> Vec<String> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut files = Vec::new();
    sources(&root, &mut files);
    let mut found: Vec<String> = files
        .into_iter()
        .filter(|path| path.extension().is_some_and(|extension| extension == "rs"))
        .filter(|path| {
            let text = std::fs::read_to_string(path).unwrap();
            words.iter().any(|word| text.contains(word))
        })
        .map(|path| {
            path.strip_prefix(&root)
                .unwrap()
                .to_string_lossy()
                .replace('\\', "/")
        })
        .collect();
    found.sort();
    found
}

#[test]
fn only_the_client_opens_sockets() {
    let files = files_with(&["reqwest", "TcpStream", "UdpSocket", "tokio::net"]);
    assert!(files.len() > 3, "{files:?}");
    for file in files {
        assert!(file.starts_with("net/"), "{file}");
    }
}

#[test]
fn a_permit_is_made_in_one_file_and_a_client_needs_one() {
    assert_eq!(files_with(&["NetworkPermit(()"]), ["archive/access.rs"]);
    let client = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/net/client.rs");
    let text = std::fs::read_to_string(client).unwrap();
    assert!(text.contains("fn new(_permit: NetworkPermit, "));
}
