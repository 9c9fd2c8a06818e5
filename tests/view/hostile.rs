//! Clients that say half of what they want, ask for too much, or come in crowds.

use std::io::{ErrorKind, Read as _, Write as _};
use std::net::TcpStream;
use std::time::{Duration, Instant};

use super::{Viewer, http, small_run};

/// Begins a request.
fn begin(viewer: &Viewer, text: &str) -> TcpStream {
    let mut stream = TcpStream::connect(&viewer.authority).unwrap();
    stream.set_read_timeout(Some(Duration::from_secs(60))).unwrap();
    stream.write_all(text.as_bytes()).unwrap();
    stream
}

/// Reads until the server ends the connection.
fn rest(stream: &mut TcpStream) -> String {
    let mut bytes = Vec::new();
    match stream.read_to_end(&mut bytes) {
        Err(error) if error.kind() != ErrorKind::ConnectionReset => panic!("{error}"),
        _ => String::from_utf8_lossy(&bytes).into_owned(),
    }
}

#[test]
fn half_requests_end_after_ten_seconds_and_leave_room_for_others() {
    let viewer = Viewer::start(small_run(), &[]);
    let authority = &viewer.authority;
    let start = Instant::now();
    let head = format!("POST /frames HTTP/1.1\r\nHost: {authority}\r\nOrigin: http://{authority}\r\n");
    let mut crowd: Vec<TcpStream> = (0..300)
        .map(|_| begin(&viewer, "GET / HTTP/1.1\r\nHost:"))
        .collect();
    viewer.get("/").is(200);
    let answered = start.elapsed();
    assert!(answered < Duration::from_secs(10), "{answered:?}");
    let mut half_head = begin(&viewer, &head);
    let mut half_body = begin(&viewer, &format!("{head}Content-Length: 100\r\n\r\n{{"));
    crowd.push(begin(&viewer, "GET"));
    for stream in &mut crowd {
        let text = rest(stream);
        assert!(text.is_empty() || text.contains(" 408 "), "{text}");
    }
    rest(&mut half_head);
    let text = rest(&mut half_body);
    assert!(text.contains(" 408 ") && text.contains("too slow"), "{text}");
    let ended = start.elapsed();
    assert!(ended < Duration::from_secs(30), "{ended:?}");
    viewer.get("/").is(200);
}

#[test]
fn headers_and_bodies_without_end_are_refused() {
    let viewer = Viewer::start(small_run(), &[]);
    let long = "x".repeat(1 << 20);
    let mut stream = TcpStream::connect(&viewer.authority).unwrap();
    stream.set_read_timeout(Some(Duration::from_secs(60))).unwrap();
    // The server may close before all is sent.
    let _ = stream.write_all(format!("GET / HTTP/1.1\r\nLong: {long}").as_bytes());
    let text = rest(&mut stream);
    assert!(text.is_empty() || text.contains(" 431 "), "{text}");
    let origin = format!("http://{}", viewer.authority);
    let headers = [("Origin", origin.as_str()), ("Transfer-Encoding", "chunked")];
    let chunk = format!("5000\r\n{}\r\n", "x".repeat(0x5000));
    let text = format!(
        "POST /frames HTTP/1.1\r\nHost: {}\r\n{}\r\n{chunk}",
        viewer.authority,
        headers
            .map(|(name, value)| format!("{name}: {value}\r\n"))
            .concat()
    );
    let text = rest(&mut begin(&viewer, &text));
    assert!(text.contains(" 413 "), "{text}");
}

#[test]
fn a_part_that_the_file_does_not_have_is_an_error_with_its_length() {
    let viewer = Viewer::start(small_run(), &[]);
    let text = viewer.get("/").is(200).text();
    let digest = text.split("src=\"object/").nth(1).unwrap();
    let path = format!("/object/{}", digest.split('"').next().unwrap());
    let length = viewer.get(&path).is(200).body.len();
    let range = format!("bytes={length}-");
    let refused = http::request(&viewer.authority, "GET", &path, &[("Range", &range)], b"").is(416);
    let expected = format!("bytes */{length}");
    assert_eq!(refused.header("content-range"), Some(expected.as_str()));
    assert!(
        refused.text().contains(&format!("the file has {length} bytes")),
        "{}",
        refused.text()
    );
}

#[test]
fn a_token_below_a_prefix_leads_to_the_prefix() {
    let viewer = Viewer::start(
        small_run(),
        &["--prefix", "/mars/run", "--token", "0123456789abcdef"],
    );
    for (path, location) in [("/mars/run", "/mars/run/"), ("/mars/run/", "./")] {
        let let_in = viewer.get(&format!("{path}?token=0123456789abcdef")).is(303);
        assert_eq!(let_in.header("location"), Some(location));
    }
}

#[test]
fn what_is_not_a_digest_is_refused_with_what_names_a_file() {
    let viewer = Viewer::start(small_run(), &[]);
    for digest in ["0", &"0".repeat(63), &"0".repeat(65), &"g".repeat(64)] {
        for (path, what) in [
            (format!("/object/{digest}"), "an object"),
            (format!("/photo/1/0/{digest}"), "a photo"),
        ] {
            let said = viewer.get(&path).is(404).text();
            let sentence = format!("{what} is named by the 64 hexadecimal digits of its digest");
            assert!(said.contains(&sentence), "{path}: {said}");
        }
    }
    // 64 digits are a digest, of which the run has no file.
    let said = viewer.get(&format!("/object/{}", "0".repeat(64))).is(404).text();
    assert!(!said.contains("64 hexadecimal"), "{said}");
}

#[test]
fn a_port_that_another_program_has_is_named() {
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let port = taken.local_addr().unwrap().port();
    // Viewers of tests ask for port 0 and get a free one. This one asks for that port alone.
    let said = super::common::marf(small_run(), &["view", "--port", &port.to_string()])
        .exits(1)
        .stderr;
    assert!(
        said.contains(&format!("port {port} of 127.0.0.1 cannot be opened: ")),
        "{said}"
    );
    let viewer = Viewer::start(small_run(), &[]);
    assert!(!viewer.authority.ends_with(":0"), "{}", viewer.authority);
}

#[test]
fn a_token_of_fewer_letters_than_the_help_says_is_refused() {
    let short = ["view", "--port", "0", "--token", "0123456789abcde"];
    let said = super::common::marf(small_run(), &short).exits(2).stderr;
    assert!(said.contains("token"), "{said}");
    let viewer = Viewer::start(small_run(), &["--token", "0123456789abcdef"]);
    assert!(viewer.address.contains("0123456789abcdef"), "{}", viewer.address);
    viewer.get("/").is(401);
}
