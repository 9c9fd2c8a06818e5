//! What hosts may expect of us.

use std::time::Duration;

use super::*;
use marf_loopback::{MODIFIED, Reply, Server};

#[test]
fn two_at_a_time_and_a_pause_between_starts() {
    const DELAY: Duration = Duration::from_millis(80);
    /// A request is seen when the server's thread wakes, not when it was sent.
    const JITTER: Duration = Duration::from_millis(60);
    const REQUESTS: u32 = 10;
    let server = Server::start().unwrap();
    let paths: Vec<String> = (0..REQUESTS).map(|index| format!("/f{index}")).collect();
    let every = Duration::from_millis(25);
    for path in &paths {
        server.file(path, noise(0, 4_000));
        server.script(path, vec![Reply::Drip { bytes: 500, every }]);
    }
    let client = Client::new(
        permit(),
        ClientSettings {
            delay: DELAY,
            ..quick(&[&server])
        },
    )
    .unwrap();
    let downloads: Vec<Download> = paths.iter().map(|path| download(&server, path)).collect();
    all(&client, &downloads)
        .into_iter()
        .for_each(|answer| assert_eq!(bytes(answer.unwrap()), noise(0, 4_000)));
    assert_eq!(server.most_at_once(), 2);
    let gap = server.smallest_gap().unwrap();
    assert!(gap + JITTER >= DELAY, "{gap:?}");
    let requests = server.requests();
    let span = requests.last().unwrap().at - requests[0].at;
    assert!(span + JITTER >= DELAY * (REQUESTS - 1), "{span:?}");
}

#[test]
fn a_host_that_many_redirect_to_is_asked_two_at_a_time_too() {
    let (one, two, three) = (
        Server::start().unwrap(),
        Server::start().unwrap(),
        Server::start().unwrap(),
    );
    let client = Client::new(permit(), quick(&[&one, &two, &three])).unwrap();
    let every = Duration::from_millis(20);
    let mut downloads = Vec::new();
    for index in 0..6 {
        let path = format!("/{index}");
        three.file(&path, noise(index, 3_000));
        three.script(&path, vec![Reply::Drip { bytes: 1_000, every }]);
        let first = if index % 2 == 0 { &one } else { &two };
        first.script(&path, vec![Reply::Redirect(three.url(&path))]);
        downloads.push(download(first, &path));
    }
    for (index, answer) in (0..6).zip(all(&client, &downloads)) {
        assert_eq!(bytes(answer.unwrap()), noise(index, 3_000));
    }
    assert_eq!(three.most_at_once(), 2);
}

#[test]
fn a_request_says_who_asks_and_nothing_else() {
    let server = Server::start().unwrap();
    server.file("/a", *b"a");
    bytes(one(&client(&server), &download(&server, "/a")));
    let request = &server.requests()[0];
    let mut names: Vec<&str> = request.headers.iter().map(|header| header.0.as_str()).collect();
    names.sort_unstable();
    assert_eq!(names, ["accept", "accept-encoding", "host", "user-agent"]);
    let agent = request.header("user-agent").unwrap();
    assert_eq!(
        agent,
        concat!("marf/", env!("CARGO_PKG_VERSION"), " (+https://example.org/marf)")
    );
}

#[test]
fn what_is_known_is_not_brought_again() {
    let server = Server::start().unwrap();
    let client = client(&server);
    server.file("/a", *b"one");
    let Ok(Answer::Whole { validators, .. }) = one(&client, &download(&server, "/a")) else {
        panic!()
    };
    assert_eq!(validators.modified.as_deref(), Some(MODIFIED));
    let mut known = download(&server, "/a");
    known.known = Some(validators.clone());
    assert_eq!(one(&client, &known).unwrap(), Answer::Unchanged);
    known.known = Some(Validators {
        etag: None,
        ..validators
    });
    assert_eq!(
        one(&client, &known).unwrap(),
        Answer::Unchanged,
        "by Last-Modified alone"
    );
    server.file_with(
        "/a",
        *b"two",
        Some("\"2\""),
        Some("Wed, 02 Mar 2022 10:20:00 GMT"),
    );
    assert_eq!(bytes(one(&client, &known)), b"two");
    let wild = Some("\"x\"\r\nX-Evil: 1".to_owned());
    known.known = Some(Validators {
        etag: wild,
        modified: None,
    });
    assert_eq!(bytes(one(&client, &known)), b"two");
    let last = server.requests().pop().unwrap();
    assert!(
        last.header("x-evil").is_none() && last.header("if-none-match").is_none(),
        "{last:?}"
    );
}

#[test]
fn only_named_origins_are_asked() {
    let (server, other) = (Server::start().unwrap(), Server::start().unwrap());
    let client = client(&server);
    for url in [
        other.url("/a"),
        server.url("/a").replace("127.0.0.1", "localhost"),
        server.url("/a").replace("http:", "https:"),
        server.url("/a").replace("127", "me@127"),
        "file:///etc/passwd".to_owned(),
        "data:text/plain,x".to_owned(),
    ] {
        let wanted = Download {
            urls: vec![Url::parse(&url).unwrap()],
            ..download(&server, "/a")
        };
        let error = kind(one(&client, &wanted));
        assert_eq!(
            (&*error.kind, error.retryable),
            (&NetErrorKind::NotAllowed, false),
            "{url}"
        );
    }
    let nothing = Download {
        urls: Vec::new(),
        ..download(&server, "/a")
    };
    assert_eq!(*kind(one(&client, &nothing)).kind, NetErrorKind::NoAddress);
    assert!(server.requests().is_empty() && other.requests().is_empty());
}

/// A host that answers a TLS greeting in the clear gets no request.
#[test]
fn https_is_never_spoken_in_the_clear() {
    let server = Server::start().unwrap();
    server.file("/a", *b"a");
    let origin = server.origin().replace("http:", "https:");
    let settings = ClientSettings {
        allowed: vec![Origin::parse(&origin).unwrap()],
        tries: 1,
        ..quick(&[])
    };
    let error = match Client::new(permit(), settings) {
        Ok(client) => {
            let mut secure = download(&server, "/a");
            secure.urls = vec![Url::parse(&format!("{origin}/a")).unwrap()];
            kind(one(&client, &secure))
        }
        // A machine that trusts nobody says so.
        Err(error) => error,
    };
    println!("{error}");
    assert!(error.to_string().len() > 20, "{error}");
    assert!(server.requests().is_empty(), "{:?}", server.requests());
}

#[test]
fn no_wants_are_no_work_and_done_can_stop() {
    let server = Server::start().unwrap();
    let client = client(&server);
    assert!(all(&client, &[]).is_empty());
    server.file("/a", *b"a");
    let downloads = vec![download(&server, "/a"); 50];
    let mut ended = 0;
    let stop = client.get_all(&Cancel::default(), &downloads, &mut |_, _| {
        ended += 1;
        Err(StageError::new("the store is full"))
    });
    assert_eq!(
        (stop.unwrap_err().to_string().as_str(), ended),
        ("the store is full", 1)
    );
    assert!(server.requests().len() < 10, "{}", server.requests().len());
}

#[test]
fn listings_and_feeds_of_the_test_archive_are_as_an_archive_s() {
    let server = Server::start().unwrap();
    let client = client(&server);
    let long = "ZL0_0012_0668000000_100EBY_N0030000ZCAM00001_0340LMJ01.png";
    server.file(&format!("/data/sol/00012/{long}"), noise(0, 3_200));
    server.folder("/data/sol/00013/");
    server.feed("/api", |path, query| {
        (query != "none").then(|| format!("{path}?{query}").into_bytes())
    });
    let page = String::from_utf8(bytes(one(&client, &download(&server, "/data/sol/00012/")))).unwrap();
    assert_eq!(page.matches(&format!("<a href=\"{long}\">")).count(), 2, "{page}");
    for part in [
        "?C=N;O=D",
        "<a href=\"/data/sol/\">Parent Directory",
        "ZL0_0012_0668000000_100EBY_..&gt;",
        "3.1K",
    ] {
        assert!(page.contains(part), "{part}: {page}");
    }
    let sols = String::from_utf8(bytes(one(&client, &download(&server, "/data/sol")))).unwrap();
    assert!(
        sols.contains("\"00012/\"") && sols.contains("\"00013/\""),
        "{sols}"
    );
    let root = String::from_utf8(bytes(one(&client, &download(&server, "/")))).unwrap();
    assert!(root.contains("<a href=\"data/\">"), "{root}");
    assert_eq!(
        bytes(one(&client, &download(&server, "/api?page=0&x=%20"))),
        b"/api?page=0&x=%20"
    );
    let absent = one(&client, &download(&server, "/api?none")).unwrap();
    assert!(matches!(absent, Answer::Absent { status: 404, .. }), "{absent:?}");
}
