//! Hosts whose TLS cannot be trusted, or never comes about.

use std::io::{Read as _, Write as _};
use std::net::{TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, channel};

use rustls::pki_types::{CertificateDer, PrivateKeyDer};

use super::*;

/// A certificate for 127.0.0.1 that signs itself, and its key. Neither is used anywhere else.
const CERTIFICATE: &[u8] = include_bytes!("untrusted.cert.der");
const KEY: &[u8] = include_bytes!("untrusted.key.der");

/// Serves each connection. Returns the origin, and what `serve` returned.
fn host<T: Send + 'static>(serve: impl Fn(TcpStream) -> T + Send + 'static) -> (String, Receiver<T>) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let origin = format!("https://{}", listener.local_addr().unwrap());
    let (sender, served) = channel();
    std::thread::spawn(move || {
        for stream in listener.incoming().map_while(Result::ok) {
            if sender.send(serve(stream)).is_err() {
                return;
            }
        }
    });
    (origin, served)
}

/// Downloads from an origin in two tries. `None` on a machine that trusts nobody.
fn asked(origin: &str) -> Option<NetError> {
    let settings = ClientSettings {
        allowed: vec![Origin::parse(origin).unwrap()],
        tries: 2,
        ..quick(&[])
    };
    let client = match Client::new(permit(), settings) {
        Ok(client) => client,
        Err(error) => {
            println!("skipped: {error}");
            return None;
        }
    };
    let wanted = Download {
        urls: vec![Url::parse(&format!("{origin}/a")).unwrap()],
        cap_bytes: 1_000,
        known: None,
        part: None,
    };
    Some(kind(one(&client, &wanted)))
}

#[test]
fn a_host_that_nobody_vouches_for_gets_no_request_and_is_not_asked_again() {
    let provider = Arc::new(rustls::crypto::ring::default_provider());
    let config = rustls::ServerConfig::builder_with_provider(provider)
        .with_safe_default_protocol_versions()
        .unwrap()
        .with_no_client_auth()
        .with_single_cert(
            vec![CertificateDer::from(CERTIFICATE)],
            PrivateKeyDer::try_from(KEY).unwrap(),
        )
        .unwrap();
    let config = Arc::new(config);
    let (origin, served) = host(move |mut stream| {
        let mut tls = rustls::ServerConnection::new(Arc::clone(&config)).unwrap();
        let mut request = Vec::new();
        let ended = rustls::Stream::new(&mut tls, &mut stream).read_to_end(&mut request);
        (request, ended.is_err())
    });
    let Some(error) = asked(&origin) else { return };
    assert!(matches!(*error.kind, NetErrorKind::Certificate(_)), "{error}");
    assert_eq!((error.tries, error.retryable), (1, false), "{error}");
    assert_eq!(served.recv().unwrap(), (Vec::new(), true));
    assert!(served.try_recv().is_err(), "asked once");
}

#[test]
fn a_greeting_that_is_cut_garbled_or_never_answered_ends_in_its_time() {
    type Serve = fn(TcpStream) -> Option<TcpStream>;
    let faults: [(&str, Serve); 3] = [
        ("cut", |_| None),
        ("garbled", |mut stream| {
            stream.write_all(&[7; 300]).ok()?;
            Some(stream)
        }),
        ("silent", Some),
    ];
    for (name, serve) in faults {
        let (origin, held) = host(serve);
        let Some(error) = asked(&origin) else { return };
        assert_eq!((error.tries, error.retryable), (2, true), "{name}: {error}");
        assert!(error.took < Duration::from_secs(10), "{name}: {error}");
        drop(held);
    }
}
