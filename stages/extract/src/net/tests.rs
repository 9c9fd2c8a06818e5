//! The client against an archive that misbehaves.

mod faults;
mod parts;
mod politeness;
mod redirects;
mod tls;

use std::path::PathBuf;
use std::time::Duration;

use marf_stage::{Cancel, StageError};

use super::*;
use crate::archive::access::NetworkPermit;
use marf_loopback::Server;

fn permit() -> NetworkPermit {
    NetworkPermit::for_tests()
}

/// A settings of short waits that may ask these servers.
fn quick(servers: &[&Server]) -> ClientSettings {
    let origins = servers
        .iter()
        .map(|server| Origin::parse(&server.origin()).unwrap());
    ClientSettings {
        delay: Duration::ZERO,
        first_wait: Duration::from_millis(2),
        longest_wait: Duration::from_millis(10),
        stall: Duration::from_millis(700),
        ..ClientSettings::polite(origins.collect(), Some("https://example.org/marf"))
    }
}

fn client(server: &Server) -> Client {
    Client::new(permit(), quick(&[server])).unwrap()
}

/// A download of a path, 1 MB at most.
fn download(server: &Server, path: &str) -> Download {
    Download {
        urls: vec![Url::parse(&server.url(path)).unwrap()],
        cap_bytes: 1_000_000,
        known: None,
        part: None,
    }
}

type Answers = Vec<Option<Result<Answer, NetError>>>;

/// Brings all, answers in the order of the downloads.
fn all(client: &Client, downloads: &[Download]) -> Answers {
    let mut answers: Answers = vec![None; downloads.len()];
    let keep = &mut |index: usize, answer| {
        assert!(answers[index].is_none(), "{index} ended twice");
        answers[index] = Some(answer);
        Ok(())
    };
    client.get_all(&Cancel::default(), downloads, keep).unwrap();
    answers
}

fn one(client: &Client, download: &Download) -> Result<Answer, NetError> {
    all(client, std::slice::from_ref(download)).remove(0).unwrap()
}

fn bytes(answer: Result<Answer, NetError>) -> Vec<u8> {
    match answer {
        Ok(Answer::Whole { bytes, .. }) => bytes,
        other => panic!("{other:?}"),
    }
}

fn kind(answer: Result<Answer, NetError>) -> NetError {
    match answer {
        Err(error) => error,
        Ok(Answer::Whole { bytes, url, .. }) => panic!("{} bytes of {url}", bytes.len()),
        Ok(other) => panic!("{other:?}"),
    }
}

/// Bytes that differ from place to place and from seed to seed.
fn noise(seed: u8, length: usize) -> Vec<u8> {
    (0..length)
        .map(|at| (at as u32).wrapping_mul(2_654_435_761).to_be_bytes()[0] ^ seed)
        .collect()
}
