//! What hosts do wrong.

use std::time::Duration;

use super::*;
use marf_loopback::{Reply, Server};

#[test]
fn what_may_pass_is_tried_again() {
    let server = Server::start().unwrap();
    let client = client(&server);
    let body = noise(1, 5_000);
    server.file("/a", body.clone());
    let faults = [
        Reply::status(408),
        Reply::status(425),
        Reply::with(429, "Retry-After", "0"),
        Reply::status(500),
        Reply::status(503),
        Reply::with(304, "ETag", "\"unasked\""),
        Reply::Reset { after: 2_000 },
        Reply::Cut { after: 2_000 },
        Reply::Announce { more: 7 },
        Reply::Stall { after: 2_000 },
        Reply::Silent,
    ];
    for fault in faults {
        let name = format!("{fault:?}");
        let before = client.traffic();
        server.script("/a", vec![fault]);
        assert_eq!(bytes(one(&client, &download(&server, "/a"))), body, "{name}");
        let after = client.traffic();
        // A body that ends early looks like a cut at the very end: the rest is asked for, and there is none.
        let tries = if name.starts_with("Announce") { 2 } else { 1 };
        assert_eq!(
            (after.retries - before.retries, after.requests - before.requests),
            (tries, tries + 1),
            "{name}"
        );
    }
}

#[test]
fn five_tries_are_all() {
    let server = Server::start().unwrap();
    server.script("/a", vec![Reply::status(503).always()]);
    let error = kind(one(&client(&server), &download(&server, "/a")));
    assert_eq!(
        (error.tries, server.requests().len(), error.retryable),
        (5, 5, true),
        "{error}"
    );
    assert!(
        error.to_string().contains("/a: answers status 503 (5 tries in "),
        "{error}"
    );
}

#[test]
fn a_refusal_is_final_for_its_mirror_alone() {
    let (first, second) = (Server::start().unwrap(), Server::start().unwrap());
    let client = Client::new(permit(), quick(&[&first, &second])).unwrap();
    second.file("/a", *b"here");
    let mut both = download(&first, "/a");
    both.urls.push(Url::parse(&second.url("/a")).unwrap());
    for status in [400, 401, 403, 404, 410, 451] {
        first.clear();
        first.script("/a", vec![Reply::status(status)]);
        let Ok(Answer::Whole { bytes, url, .. }) = one(&client, &both) else {
            panic!("{status}")
        };
        assert_eq!(
            (bytes.as_slice(), url, first.requests().len()),
            (&b"here"[..], second.url("/a"), 1),
            "{status}"
        );
    }
}

#[test]
fn absent_is_what_no_mirror_has() {
    let (first, second) = (Server::start().unwrap(), Server::start().unwrap());
    let client = Client::new(permit(), quick(&[&first, &second])).unwrap();
    let mut both = download(&first, "/a");
    both.urls.push(Url::parse(&second.url("/a")).unwrap());
    second.script("/a", vec![Reply::status(410)]);
    let absent = Answer::Absent {
        status: 410,
        url: second.url("/a"),
    };
    assert_eq!(one(&client, &both).unwrap(), absent);
    second.script("/a", vec![Reply::status(503).always()]);
    let error = kind(one(&client, &both));
    assert!(
        error.retryable && *error.kind == NetErrorKind::Status(503),
        "{error}"
    );
    first.script("/a", vec![Reply::status(500).always()]);
    let error = kind(one(&client, &both));
    assert!(
        error.to_string().contains("Before that, http://127.0.0.1"),
        "{error}"
    );
    assert!(error.before[0].contains("status 500"), "{error}");
}

#[test]
fn bodies_end_at_their_cap() {
    let server = Server::start().unwrap();
    let client = client(&server);
    let mut small = download(&server, "/a");
    small.cap_bytes = 50_000;
    server.file("/a", noise(1, 50_000));
    assert_eq!(bytes(one(&client, &small)).len(), 50_000);
    let before = client.traffic().bytes;
    server.file("/a", noise(1, 50_001));
    let error = kind(one(&client, &small));
    assert_eq!(
        *error.kind,
        NetErrorKind::TooLarge {
            bytes: 50_001,
            cap: 50_000
        }
    );
    assert_eq!(client.traffic().bytes, before, "announced, so not read");
    server.script("/a", vec![Reply::Endless]);
    let error = kind(one(&client, &small));
    assert!(matches!(*error.kind, NetErrorKind::TooLarge { .. }), "{error}");
    assert!(
        client.traffic().bytes < before + 500_000,
        "{:?}",
        client.traffic()
    );
}

#[test]
fn drips_and_silence_are_given_up() {
    let server = Server::start().unwrap();
    let client = Client::new(
        permit(),
        ClientSettings {
            tries: 1,
            slow_after: Duration::from_millis(400),
            slowest: 20_000,
            ..quick(&[&server])
        },
    )
    .unwrap();
    server.file("/a", noise(1, 900_000));
    let every = Duration::from_millis(20);
    server.script("/a", vec![Reply::Drip { bytes: 100, every }]);
    let error = kind(one(&client, &download(&server, "/a")));
    assert!(
        matches!(*error.kind, NetErrorKind::Slow { slowest: 20_000, .. }) && error.retryable,
        "{error}"
    );
    server.script("/a", vec![Reply::Stall { after: 1_234 }]);
    let error = kind(one(&client, &download(&server, "/a")));
    assert!(
        matches!(*error.kind, NetErrorKind::Stalled { at: 1_234, .. }),
        "{error}"
    );
    server.script("/a", vec![Reply::Silent]);
    let error = kind(one(&client, &download(&server, "/a")));
    assert!(
        matches!(*error.kind, NetErrorKind::Stalled { at: 0, .. }),
        "{error}"
    );
}

/// HTTP reads as many bytes as announced. Bytes beyond belong neither to the body nor to the next answer.
#[test]
fn bytes_beyond_the_announced_are_never_an_answer() {
    let server = Server::start().unwrap();
    let client = client(&server);
    server.file("/a", noise(1, 1_000));
    server.file("/b", noise(2, 1_000));
    server.script("/a", vec![Reply::Announce { more: -400 }]);
    assert_eq!(
        bytes(one(&client, &download(&server, "/a"))),
        noise(1, 1_000)[..600]
    );
    assert_eq!(bytes(one(&client, &download(&server, "/b"))), noise(2, 1_000));
}

#[test]
fn an_encoded_body_is_refused() {
    let server = Server::start().unwrap();
    server.script(
        "/a",
        vec![Reply::Status(
            200,
            vec![("Content-Encoding".into(), "gzip".into())],
            vec![31; 10],
        )],
    );
    let error = kind(one(&client(&server), &download(&server, "/a")));
    assert_eq!(*error.kind, NetErrorKind::Encoded("gzip".into()));
    assert_eq!(server.requests()[0].header("accept-encoding"), Some("identity"));
}

/// The caller checks whether a page is the wanted file.
#[test]
fn a_firewall_page_that_calls_itself_a_success_is_a_body() {
    let server = Server::start().unwrap();
    server.script("/a.IMG", vec![Reply::firewall()]);
    let page = bytes(one(&client(&server), &download(&server, "/a.IMG")));
    assert!(String::from_utf8(page).unwrap().contains("Request Rejected"));
}

#[test]
fn a_burst_of_403_stops_the_host() {
    let server = Server::start().unwrap();
    let client = Client::new(
        permit(),
        ClientSettings {
            per_host: 1,
            ..quick(&[&server])
        },
    )
    .unwrap();
    server.file("/ok", *b"ok");
    let paths: Vec<String> = (0..9).map(|index| format!("/{index}")).collect();
    for path in &paths {
        server.script(path, vec![Reply::status(403)]);
    }
    let downloads: Vec<Download> = paths.iter().map(|path| download(&server, path)).collect();
    let answers = all(&client, &downloads);
    assert_eq!(server.requests().len(), 5);
    let last = kind(answers.into_iter().next_back().unwrap().unwrap());
    assert!(
        last.retryable && last.to_string().contains("403 5 times in a row"),
        "{last}"
    );
    let ok = kind(one(&client, &download(&server, "/ok")));
    assert!(matches!(*ok.kind, NetErrorKind::HostStopped { .. }), "{ok}");
}

#[test]
fn a_dead_host_is_left_alone() {
    let server = Server::start().unwrap();
    let client = Client::new(
        permit(),
        ClientSettings {
            tries: 2,
            per_host: 1,
            ..quick(&[&server])
        },
    )
    .unwrap();
    let downloads: Vec<Download> = (0..40)
        .map(|index| download(&server, &format!("/{index}")))
        .collect();
    drop(server);
    let answers = all(&client, &downloads);
    assert!(client.traffic().requests <= 12, "{:?}", client.traffic());
    let first = kind(answers[0].clone().unwrap());
    assert!(
        matches!(*first.kind, NetErrorKind::Broken(_)) && first.retryable,
        "{first}"
    );
    let last = kind(answers[39].clone().unwrap());
    assert!(last.to_string().contains("is asked no more"), "{last}");
}

#[test]
fn retry_after_is_waited_up_to_ten_minutes() {
    let server = Server::start().unwrap();
    let client = client(&server);
    server.file("/a", *b"a");
    server.script("/a", vec![Reply::with(429, "Retry-After", "1")]);
    assert_eq!(bytes(one(&client, &download(&server, "/a"))), b"a");
    let gap = server.smallest_gap().unwrap();
    assert!(gap >= Duration::from_millis(990), "{gap:?}");
    assert!(
        client.traffic().waited >= Duration::from_secs(1),
        "{:?}",
        client.traffic()
    );
    for value in ["3600", "Fri, 31 Dec 9999 23:59:59 GMT"] {
        let server = Server::start().unwrap();
        let client = Client::new(permit(), quick(&[&server])).unwrap();
        server.script("/a", vec![Reply::with(503, "Retry-After", value)]);
        let error = kind(one(&client, &download(&server, "/a")));
        assert!(
            error.retryable && error.to_string().contains("marf waits at most 600 s"),
            "{error}"
        );
        let other = kind(one(&client, &download(&server, "/b")));
        assert!(matches!(*other.kind, NetErrorKind::Later { .. }), "{other}");
        assert_eq!(server.requests().len(), 1, "the host is not asked until then");
    }
}

#[test]
fn a_fifth_of_faults_changes_no_byte() {
    const FILES: u8 = 200;
    let server = Server::start().unwrap();
    let paths: Vec<String> = (0..FILES).map(|index| format!("/f{index}")).collect();
    for (index, path) in (0..FILES).zip(&paths) {
        server.file(path, noise(index, 1_000 + 31 * usize::from(index)));
    }
    let downloads: Vec<Download> = paths.iter().map(|path| download(&server, path)).collect();
    let patient = ClientSettings {
        tries: 8,
        ..quick(&[&server])
    };
    let good: Vec<Vec<u8>> = all(&Client::new(permit(), patient.clone()).unwrap(), &downloads)
        .into_iter()
        .map(|answer| bytes(answer.unwrap()))
        .collect();
    server.faults(1, 0.2);
    let client = Client::new(permit(), patient).unwrap();
    let spoilt: Vec<Vec<u8>> = all(&client, &downloads)
        .into_iter()
        .map(|answer| bytes(answer.unwrap()))
        .collect();
    assert!(good == spoilt && good[7] == noise(7, 1_217));
    let traffic = client.traffic();
    assert!((30..90).contains(&traffic.retries), "{traffic:?}");
    assert!(traffic.resumed > 0, "{traffic:?}");
}
