//! `--offline`: no archive on a server opens a connection, even if files are missing.

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
    let zeros = "0".repeat(64);
    let sol = format!(
        "version = 2\nsol = 1\nproducts = [\n  {{ name = \"A.png\", bytes = 7, blake3 = \"{zeros}\", sha256 = \"{zeros}\", \
         url = \"{address}/A.png\", fetched = \"now\" }},\n]\n"
    );
    let server = Server::start().unwrap();
    let base = json!([address]);
    let archives = [
        (
            place.archive(&server, "1"),
            "pds perseverance mastcamz edr browse",
        ),
        (place.feed(&server, "1"), "feed perseverance navcam"),
    ];
    for (archive, asked) in archives {
        let archive = with(archive, "/base", base.clone());
        let archive = access(&with(archive, "/network/tries", json!(1)), Access::Offline);
        let nothing = place.list(&archive).unwrap_err().to_string();
        assert!(nothing.contains("no product"), "{nothing}");
        let folder = place.dir.path().join("marf.lock").join(&archive.context.name);
        std::fs::create_dir_all(&folder).unwrap();
        let head = format!("version = 2\nasked = \"{asked}\"\n");
        std::fs::write(folder.join("archive.toml"), head).unwrap();
        std::fs::write(folder.join("sol-00001.toml"), &sol).unwrap();
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
