//! The client against an archive that misbehaves.

#[path = "../../tests/common/server.rs"]
mod server;

mod faults;
mod manners;
mod parts;
mod redirects;

use std::path::PathBuf;
use std::time::Duration;

use marf_stage::StageError;
use marf_stage::harness::Harness;

use super::*;
use crate::archive::access::NetworkPermit;
use server::Server;

fn permit() -> NetworkPermit {
    NetworkPermit::for_tests()
}

/// A conduct of short waits that may ask these servers.
fn quick(servers: &[&Server]) -> Conduct {
    let origins = servers
        .iter()
        .map(|server| Origin::parse(&server.origin()).unwrap());
    Conduct {
        delay: Duration::ZERO,
        first_wait: Duration::from_millis(2),
        longest_wait: Duration::from_millis(10),
        stall: Duration::from_millis(700),
        ..Conduct::polite(origins.collect(), Some("https://example.org/marf"))
    }
}

fn client(server: &Server) -> Client {
    Client::new(permit(), quick(&[server])).unwrap()
}

/// A want of a path, 1 MB at most.
fn want(server: &Server, path: &str) -> Want {
    Want {
        urls: vec![Url::parse(&server.url(path)).unwrap()],
        cap_bytes: 1_000_000,
        known: None,
        part: None,
    }
}

type Answers = Vec<Option<Result<Answer, NetError>>>;

/// Brings all, answers in the order of the wants.
fn all(client: &Client, wants: &[Want]) -> Answers {
    let mut answers: Answers = vec![None; wants.len()];
    let harness = Harness::default();
    let keep = &mut |index: usize, answer| {
        assert!(answers[index].is_none(), "{index} ended twice");
        answers[index] = Some(answer);
        Ok(())
    };
    client.get_all(&harness.ctx(), wants, keep).unwrap();
    answers
}

fn one(client: &Client, want: &Want) -> Result<Answer, NetError> {
    all(client, std::slice::from_ref(want)).remove(0).unwrap()
}

fn bytes(answer: Result<Answer, NetError>) -> Vec<u8> {
    match answer {
        Ok(Answer::Whole { bytes, .. }) => bytes,
        other => panic!("{other:?}"),
    }
}

fn trouble(answer: Result<Answer, NetError>) -> NetError {
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
