//! Where hosts send us.

use super::*;
use marf_loopback::{Reply, Server};

fn sent_to(server: &Server, location: &str) -> NetError {
    server.clear();
    server.script("/a", vec![Reply::Redirect(location.to_owned()).always()]);
    kind(one(&client(server), &download(server, "/a")))
}

#[test]
fn a_redirect_inside_the_list_is_followed_and_told() {
    let (first, second) = (Server::start().unwrap(), Server::start().unwrap());
    let client = Client::new(permit(), quick(&[&first, &second])).unwrap();
    second.file("/moved/a", *b"moved");
    for status in [301, 302, 303, 307, 308] {
        first.script(
            "/a",
            vec![Reply::with(status, "Location", &second.url("/moved/a"))],
        );
        let Ok(Answer::Whole { bytes, url, .. }) = one(&client, &download(&first, "/a")) else {
            panic!("{status}")
        };
        assert_eq!((bytes.as_slice(), url), (&b"moved"[..], second.url("/moved/a")));
    }
    let headers = &second.requests()[0].headers;
    assert!(headers.iter().all(|header| header.0 != "referer"), "{headers:?}");
}

#[test]
fn hostile_redirects_are_refused_without_a_request() {
    let (server, other) = (Server::start().unwrap(), Server::start().unwrap());
    other.file("/a", *b"secret");
    let foreign = [
        other.url("/a"),
        "http://10.0.0.1/a".to_owned(),
        "http://169.254.169.254/latest/meta-data".to_owned(),
        "http://[::1]:1/a".to_owned(),
        "http://example.org/a".to_owned(),
        "https://example.org/a".to_owned(),
        "file:///etc/passwd".to_owned(),
        "gopher://example.org/".to_owned(),
        server.url("/a").replace("127.0.0.1", "me:pw@127.0.0.1"),
        server.url("/a").replace("127.0.0.1", "localhost"),
    ];
    for location in foreign {
        let error = sent_to(&server, &location);
        let text = error.to_string();
        assert!(
            matches!(*error.kind, NetErrorKind::Redirect(_)) && !error.retryable,
            "{location}: {text}"
        );
        let from = server.url("/a");
        assert!(
            text.contains(&format!("redirect from {from} to ")) && text.contains(" refused: "),
            "{text}"
        );
        assert_eq!(server.requests().len(), 1, "{location}: final, not tried again");
    }
    assert!(other.requests().is_empty());
}

#[test]
fn five_hops_are_followed_and_no_sixth() {
    let server = Server::start().unwrap();
    for hop in 0..6 {
        server.script(
            &format!("/{hop}"),
            vec![Reply::Redirect(format!("/{}", hop + 1)).always()],
        );
    }
    server.file("/6", *b"end");
    let client = client(&server);
    assert_eq!(bytes(one(&client, &download(&server, "/1"))), b"end");
    server.clear();
    let error = kind(one(&client, &download(&server, "/0")));
    assert!(
        matches!(*error.kind, NetErrorKind::TooManyRedirects(_)) && !error.retryable,
        "{error}"
    );
    assert_eq!(server.requests().len(), 6, "one request and five hops");
    let batch = sent_to(&server, "/a");
    assert!(
        matches!(*batch.kind, NetErrorKind::TooManyRedirects(_)),
        "{batch}"
    );
}

#[test]
fn a_redirect_without_a_target_is_an_error() {
    let server = Server::start().unwrap();
    server.script("/a", vec![Reply::status(302)]);
    let error = kind(one(&client(&server), &download(&server, "/a")));
    assert_eq!(*error.kind, NetErrorKind::NoLocation(302));
    let error = sent_to(&server, "http://[");
    assert!(error.to_string().contains("not an address"), "{error}");
}
