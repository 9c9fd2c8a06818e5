//! A shared store in a bucket: an S3 server on a loopback port, and servers that misbehave.
//!
//! The server is moto, installed with pip into `target/moto`. Without Python or a package index its test says so and is
//! skipped.
#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "a test that cannot go on should stop; a skipped test says so"
)]

mod common;

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use common::{Ran, marf};

const PACKAGE: &str = "moto[server]==5.2.5";
const SECRET: &str = "do-not-show-this";

/// Filters of the built-in Mars, in a second.
const PIPELINE: &str = concat!(
    "name = \"shared\"\n[store]\nremote = \"s3://mars/team/results\"\n",
    "[archive.photos]\nkind = \"demo\"\nsols = \"1\"\nwidth = 160\n",
    include_str!("../labs/five_nodes.toml"),
);

fn machine() -> tempfile::TempDir {
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(dir.path().join("pipeline.toml"), PIPELINE).unwrap();
    dir
}

/// Returns the command `marf ARGS` with credentials for the server at this address.
fn command(server: SocketAddr, folder: &Path, args: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_marf"));
    command
        .current_dir(folder)
        .args(args)
        .stdin(Stdio::null())
        .env("AWS_ACCESS_KEY_ID", "id")
        .env("AWS_SECRET_ACCESS_KEY", SECRET)
        .env("AWS_ENDPOINT_URL", format!("http://{server}"))
        .env("AWS_ALLOW_HTTP", "true");
    command
}

/// Runs `marf ARGS` with credentials for the server at this address.
fn marf_at(server: SocketAddr, folder: &Path, args: &[&str]) -> Ran {
    let output = command(server, folder, args).output().unwrap();
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    let ran = Ran {
        code: output.status.code().unwrap_or(-1),
        stdout: text(&output.stdout),
        stderr: text(&output.stderr),
    };
    assert!(
        !ran.stdout.contains(SECRET) && !ran.stderr.contains(SECRET),
        "{}",
        ran.stderr
    );
    ran
}

/// A program that is killed at the end of the test.
struct Server {
    child: Child,
    address: SocketAddr,
}

impl Drop for Server {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Installs moto and returns its program. If it cannot be installed, prints the reason and returns `None`.
fn moto() -> Option<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("target/moto");
    let stamp = folder.join("installed.txt");
    if !std::fs::read_to_string(&stamp).is_ok_and(|installed| installed == PACKAGE) {
        let run = |program: &Path, args: &[&str]| {
            let done = Command::new(program)
                .args(args)
                .stdout(Stdio::null())
                .stderr(Stdio::null())
                .status();
            done.is_ok_and(|status| status.success())
        };
        let install = ["-m", "pip", "install", "--quiet", PACKAGE];
        if !run(Path::new("python3"), &["-m", "venv", folder.to_str().unwrap()])
            || !run(&folder.join("bin/python"), &install)
        {
            println!("skipped: {PACKAGE} cannot be installed");
            return None;
        }
        std::fs::write(&stamp, PACKAGE).unwrap();
    }
    Some(folder.join("bin/moto_server"))
}

/// Starts an S3 server with a bucket `mars`.
fn s3() -> Option<Server> {
    let program = moto()?;
    let address = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let child = Command::new(program)
        .args(["-H", "127.0.0.1", "-p", &address.port().to_string()])
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let server = Server { child, address };
    let began = Instant::now();
    while !make_bucket(address) {
        assert!(began.elapsed() < Duration::from_secs(60), "moto does not answer");
        std::thread::sleep(Duration::from_millis(100));
    }
    Some(server)
}

fn make_bucket(server: SocketAddr) -> bool {
    let Ok(mut stream) = TcpStream::connect(server) else {
        return false;
    };
    let request =
        format!("PUT /mars HTTP/1.1\r\nHost: {server}\r\nContent-Length: 0\r\nConnection: close\r\n\r\n");
    let mut answer = String::new();
    stream.write_all(request.as_bytes()).is_ok()
        && stream.read_to_string(&mut answer).is_ok()
        && answer.starts_with("HTTP/1.1 200")
}

/// Answers every request on a port of its own with `answer`. A server without an answer reads and says
/// nothing.
fn misbehaving(answer: Option<&'static str>) -> SocketAddr {
    listening(move |stream| serve(stream, answer))
}

fn serve(mut stream: TcpStream, answer: Option<&str>) {
    let mut buffer = [0; 1 << 16];
    while matches!(stream.read(&mut buffer), Ok(1..)) {
        if let Some(answer) = answer
            && stream.write_all(answer.as_bytes()).is_err()
        {
            return;
        }
    }
}

/// Announces more bytes than there are anywhere, and sends them for as long as somebody reads.
fn endless() -> SocketAddr {
    let head = "HTTP/1.1 200 OK\r\nContent-Length: 9000000000000000000\r\nETag: \"1\"\r\n\
        Last-Modified: Mon, 23 Nov 2026 17:00:00 GMT\r\n\r\n";
    listening(move |mut stream| {
        let _ = stream.read(&mut [0; 1 << 16]);
        let mut more = stream.write_all(head.as_bytes());
        while more.is_ok() {
            more = stream.write_all(&[b'x'; 1 << 16]);
        }
    })
}

/// Serves each connection to a port of its own on a thread of its own.
fn listening(serve: impl Fn(TcpStream) + Send + Sync + 'static) -> SocketAddr {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    let serve = std::sync::Arc::new(serve);
    std::thread::spawn(move || {
        for stream in listener.incoming().map_while(Result::ok) {
            let serve = std::sync::Arc::clone(&serve);
            std::thread::spawn(move || serve(stream));
        }
    });
    address
}

/// What happens between a program and its server to the requests with `method` for a name with `part`.
#[derive(Debug, Clone, Copy)]
struct Between {
    method: &'static str,
    part: &'static str,
    fault: Fault,
}

#[derive(Debug, Clone, Copy)]
enum Fault {
    /// Half of the body comes, then the connection breaks.
    Cut,
    /// Half of the body is stored, and the answer is a success.
    HalfStored,
    /// The answer begins with its second byte and ends with its first.
    Turned,
}

/// Passes requests on to a server, one a connection.
fn proxy(server: SocketAddr, between: Between) -> SocketAddr {
    listening(move |mut client| {
        // A client that has gone wants no answer.
        let _ = pass(&mut client, server, between);
    })
}

fn pass(client: &mut TcpStream, server: SocketAddr, between: Between) -> std::io::Result<()> {
    let (head, mut body) = message(client)?;
    let line = head.lines().next().unwrap_or_default();
    let is_meant = line.starts_with(between.method) && line.contains(between.part);
    let fault = is_meant.then_some(between.fault);
    if matches!(fault, Some(Fault::Cut)) {
        return Ok(());
    }
    if matches!(fault, Some(Fault::HalfStored)) {
        body.truncate(body.len() / 2);
    }
    let kept = head.lines().filter(|line| {
        let line = line.to_ascii_lowercase();
        !line.starts_with("content-length") && !line.starts_with("connection")
    });
    let kept: String = kept.map(|line| format!("{line}\r\n")).collect();
    let mut upstream = TcpStream::connect(server)?;
    write!(
        upstream,
        "{kept}Content-Length: {}\r\nConnection: close\r\n\r\n",
        body.len()
    )?;
    upstream.write_all(&body)?;
    let mut answer = Vec::new();
    upstream.read_to_end(&mut answer)?;
    if matches!(fault, Some(Fault::Turned)) {
        let end = answer
            .windows(4)
            .position(|bytes| bytes == b"\r\n\r\n")
            .unwrap_or(0);
        answer[end + 4..].rotate_left(1);
    }
    client.write_all(&answer)
}

/// Reads a request. Returns its head and its body.
fn message(client: &mut TcpStream) -> std::io::Result<(String, Vec<u8>)> {
    let mut bytes = Vec::new();
    let mut buffer = vec![0; 1 << 16];
    loop {
        let count = client.read(&mut buffer)?;
        if count == 0 {
            return Err(std::io::ErrorKind::UnexpectedEof.into());
        }
        bytes.extend_from_slice(&buffer[..count]);
        let Some(end) = bytes.windows(4).position(|bytes| bytes == b"\r\n\r\n") else {
            continue;
        };
        let head = String::from_utf8_lossy(&bytes[..end]).into_owned();
        let length = head.lines().find_map(|line| {
            line.to_ascii_lowercase()
                .strip_prefix("content-length:")?
                .trim()
                .parse()
                .ok()
        });
        let mut body = bytes.split_off(end + 4);
        let here = body.len();
        body.resize(length.unwrap_or(here), 0);
        if let Some(rest) = body.get_mut(here..) {
            client.read_exact(rest)?;
        }
        return Ok((head, body));
    }
}

/// An upload that ends halfway leaves nothing that names what is not there.
#[test]
fn a_partial_upload_is_no_upload() {
    let Some(server) = s3() else { return };
    let here = machine();
    marf(here.path(), &["run", "--offline"]).exits(0);
    let at = |folder: &tempfile::TempDir, args: &[&str]| marf_at(server.address, folder.path(), args);
    at(&here, &["cache", "push"]).exits(0);
    for (number, part) in [".pack", ".idx", "/records/", "/runs/"].into_iter().enumerate() {
        let between = Between {
            method: "PUT",
            part,
            fault: Fault::Cut,
        };
        let share = format!("blur.min_share=0.{}", number + 1);
        let ran = marf_at(
            proxy(server.address, between),
            here.path(),
            &["run", "--set", &share],
        )
        .exits(0);
        assert!(
            ran.stderr.contains("without the shared store"),
            "{part}: {}",
            ran.stderr
        );
        at(&here, &["cache", "fsck", "--remote", "--read-data"]).exits(0);
    }
    at(&here, &["cache", "push"]).exits(0);
    let there = machine();
    at(&there, &["cache", "pull"]).exits(0);
    marf(there.path(), &["cache", "fsck", "--read-data"]).exits(0);
}

/// A server that stores half and a server that gives other bytes than those of the range are found by the digests.
#[test]
fn a_server_that_lies_of_bytes_is_found_and_repaired() {
    let Some(server) = s3() else { return };
    let (here, there) = (machine(), machine());
    marf(here.path(), &["run", "--offline"]).exits(0);
    let at = |folder: &tempfile::TempDir, args: &[&str]| marf_at(server.address, folder.path(), args);
    let half = Between {
        method: "PUT",
        part: ".pack",
        fault: Fault::HalfStored,
    };
    marf_at(proxy(server.address, half), here.path(), &["cache", "push"]).exits(0);
    let pulled = at(&there, &["cache", "pull"]).exits(1);
    assert!(pulled.stderr.contains("is damaged"), "{}", pulled.stderr);
    at(&here, &["cache", "fsck", "--remote", "--read-data", "--repair"]).exits(0);
    at(&here, &["cache", "push"]).exits(0);
    for part in [".pack", ".idx", "/records/", "/runs/"] {
        let turned = Between {
            method: "GET",
            part,
            fault: Fault::Turned,
        };
        let fresh = machine();
        let pulled = marf_at(proxy(server.address, turned), fresh.path(), &["cache", "pull"]).exits(1);
        assert!(pulled.stderr.contains("is damaged"), "{part}: {}", pulled.stderr);
    }
    at(&there, &["cache", "pull"]).exits(0);
    marf(there.path(), &["cache", "fsck", "--read-data"]).exits(0);
}

#[test]
fn a_run_travels_through_a_bucket() {
    let Some(server) = s3() else { return };
    let (here, there) = (machine(), machine());
    marf(here.path(), &["run", "--offline"]).exits(0);
    let at = |folder: &tempfile::TempDir, args: &[&str]| marf_at(server.address, folder.path(), args);
    at(&here, &["cache", "push"]).exits(0);
    let again = at(&here, &["cache", "push", "--json"]).exits(0);
    assert!(again.stdout.contains("\"results\": 0"), "{}", again.stdout);
    at(&there, &["cache", "pull"]).exits(0);
    let ran = marf(there.path(), &["run", "--offline", "--json"]).exits(0);
    assert_eq!(ran.nodes("finished"), Vec::<String>::new());
    at(&there, &["cache", "fsck", "--remote", "--read-data"]).exits(0);

    // During a run: a result of one machine is fetched by another.
    let fresh = machine();
    let set = ["run", "--json", "--set", "blur.min_share=0.1"];
    let made = at(&here, &set).exits(0);
    assert_eq!(made.nodes("finished"), ["blur"]);
    let fetched = at(&fresh, &set).exits(0);
    assert_eq!(
        fetched.nodes("finished"),
        Vec::<String>::new(),
        "{}",
        fetched.stderr
    );
    at(
        &here,
        &["cache", "gc", "--remote", "--keep-last", "1", "--grace", "0s"],
    )
    .exits(0);
    at(&machine(), &["cache", "pull"]).exits(0);
}

#[test]
fn a_server_that_refuses_fails_is_silent_or_has_no_end_is_one_clear_error_and_stops_no_run() {
    let refuses = "HTTP/1.1 403 Forbidden\r\nContent-Length: 22\r\n\r\n<Key>do-not-show-this</";
    let fails = "HTTP/1.1 503 Service Unavailable\r\nContent-Length: 0\r\n\r\n";
    let cut = "HTTP/1.1 200 OK\r\nContent-Length: 1000\r\nETag: \"1\"\r\nLast-Modified: Mon, 23 Nov 2026 17:00:00 GMT\r\nConnection: close\r\n\r\nhalf";
    let nobody = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let servers = [
        (misbehaving(Some(refuses)), "does not allow"),
        (misbehaving(Some(fails)), "503"),
        (misbehaving(Some(cut)), "cannot"),
        (misbehaving(None), "cannot"),
        (endless(), "sends more than"),
        (nobody, "cannot"),
    ];
    let folder = machine();
    marf(folder.path(), &["run", "--offline"]).exits(0);
    for (number, (server, text)) in servers.into_iter().enumerate() {
        let share = format!("blur.min_share=0.{}", number + 1);
        let began = Instant::now();
        let ran = marf_at(server, folder.path(), &["run", "--json", "--set", &share]).exits(0);
        let took = began.elapsed();
        assert_eq!(ran.nodes("finished"), ["blur"], "{text}");
        assert!(ran.stderr.contains(text), "{text}: {}", ran.stderr);
        let told = ran.stderr.matches("goes on without the shared store").count();
        assert_eq!(told, 1, "{text}: {}", ran.stderr);
        assert!(took < Duration::from_secs(60), "{text}: {took:?}");
    }
}

#[test]
fn without_credentials_a_verb_says_so_and_a_run_goes_on() {
    let folder = machine();
    let ran = marf(folder.path(), &["cache", "pull"]).exits(2);
    assert!(ran.stderr.contains("AWS_ACCESS_KEY_ID"), "{}", ran.stderr);
    let ran = marf(folder.path(), &["run"]).exits(0);
    assert!(ran.stderr.contains("no credentials"), "{}", ran.stderr);
}

#[cfg(target_os = "linux")]
#[test]
fn ctrl_c_ends_the_wait_for_a_server_that_is_silent() {
    let folder = machine();
    marf(folder.path(), &["run", "--offline"]).exits(0);
    for words in [
        &["cache", "push"][..],
        &["cache", "pull"],
        &["run", "--set", "blur.min_share=0.1"],
    ] {
        let silent = TcpListener::bind("127.0.0.1:0").unwrap();
        let program = command(silent.local_addr().unwrap(), folder.path(), words)
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let _held = silent.accept().unwrap();
        let asked = Instant::now();
        let kill = format!("kill -INT {}", program.id());
        assert!(Command::new("sh").args(["-c", &kill]).status().unwrap().success());
        let output = program.wait_with_output().unwrap();
        let text = String::from_utf8_lossy(&output.stderr);
        assert!(
            asked.elapsed() <= Duration::from_secs(10),
            "{words:?}: {:?}",
            asked.elapsed()
        );
        assert_eq!(output.status.code(), Some(130), "{words:?}: {text}");
    }
}
