//! `--offline`: no archive on a server opens a connection, whatever it lacks.

use std::io::ErrorKind;
use std::net::TcpListener;

use super::*;

#[test]
fn an_archive_on_a_server_opens_no_connection_offline() {
    // Nobody answers here: what connects waits in the queue, where the test finds it.
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    listener.set_nonblocking(true).unwrap();
    let address = format!("http://{}", listener.local_addr().unwrap());
    let place = Place::new();
    let line = format!(
        "{{ sol = 1, name = \"A.png\", bytes = 7, blake3 = \"{}\", url = \"{address}/A.png\", fetched = \"now\" }}",
        "0".repeat(64)
    );
    let archive = |name: &str, asked: &str| {
        format!("[archive.{name}]\nasked = \"{asked}\"\nproducts = [\n  {line},\n]\n")
    };
    let lock = format!(
        "version = 1\n{}{}",
        archive("jezero", "pds perseverance mastcamz edr browse"),
        archive("raws", "feed perseverance navcam")
    );
    let server = Server::start().unwrap();
    let base = json!([address]);
    for archive in [place.archive(&server, "1"), place.feed(&server, "1")] {
        let archive = with(archive, "/base", base.clone());
        let archive = access(&with(archive, "/network/tries", json!(1)), Access::Offline);
        std::fs::write(place.dir.path().join("marf.lock"), "version = 1\n").unwrap();
        let nothing = place.list(&archive).unwrap_err().to_string();
        assert!(nothing.contains("no product"), "{nothing}");
        std::fs::write(place.dir.path().join("marf.lock"), &lock).unwrap();
        assert_eq!(place.list(&archive).unwrap().shards.len(), 1);
        let lacking = place.bring(&archive).err().unwrap().to_string();
        assert!(lacking.contains("not in the store"), "{lacking}");
        let waiting = listener.accept().map(|_| ()).unwrap_err();
        assert_eq!(waiting.kind(), ErrorKind::WouldBlock, "{}", archive.context.name);
        // The same archive connects where it may: the test can fail.
        assert!(place.bring(&access(&archive, Access::Locked)).is_err());
        assert!(listener.accept().is_ok());
        while listener.accept().is_ok() {}
    }
}
