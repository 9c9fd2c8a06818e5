//! What is answered to whom.

use std::io::Read as _;
use std::process::Command;
use std::time::Instant;

use serde_json::json;

use super::common::marf;
use super::{Viewer, http, small_run};

/// Returns a request for a view of a run, from where its 3-D view begins.
fn view_of(viewer: &Viewer, width: u32) -> serde_json::Value {
    let scene = viewer.get("/scene/1/0").is(200).json();
    let mut camera = scene["camera"].clone();
    let factor = f64::from(width) / camera["width"].as_f64().unwrap();
    for key in ["fx_px", "fy_px", "cx_px", "cy_px"] {
        camera[key] = json!(camera[key].as_f64().unwrap() * factor);
    }
    camera["height"] = json!((camera["height"].as_f64().unwrap() * factor) as u32);
    camera["width"] = json!(width);
    json!({"run": 1, "field": 0, "viewer": 7, "mode": "color", "camera": camera, "cam_from_world": scene["start"]})
}

/// Returns width, height, divisor and PNG of each picture of an answer.
fn pictures(mut bytes: &[u8]) -> Vec<([u32; 3], Vec<u8>)> {
    let mut found = Vec::new();
    while !bytes.is_empty() {
        let number = |index: usize| u32::from_le_bytes(bytes[4 * index..4 * index + 4].try_into().unwrap());
        let (numbers, end) = ([0, 1, 2].map(number), 16 + number(3) as usize);
        found.push((numbers, bytes[16..end].to_vec()));
        bytes = &bytes[end..];
    }
    found
}

#[test]
fn the_page_is_the_report_with_addresses_in_place_of_pictures() {
    let viewer = Viewer::start(small_run(), &[]);
    let began = Instant::now();
    let page = viewer.get("/").is(200);
    println!("page: {} bytes after {:?}", page.body.len(), began.elapsed());
    let policy = page.header("content-security-policy").unwrap();
    assert!(
        policy.starts_with("default-src 'none'; script-src 'self'; style-src 'self';"),
        "{policy}"
    );
    let text = page.text();
    assert!(
        text.contains("id=\"heldout\"") && text.contains("id=\"view-stage\""),
        "{text}"
    );
    assert!(text.len() < 1_000_000, "{} bytes", text.len());
    let file = |address: &str| viewer.get(&format!("/{address}")).is(200);
    for part in text.split(" src=\"").skip(1).chain(text.split("<link ").skip(1)) {
        let address = part.split("href=\"").last().unwrap().split('"').next().unwrap();
        assert!(!address.starts_with('/') && !address.contains(':'), "{address}");
        assert!(!file(address).body.is_empty());
    }
    let digest = text
        .split("src=\"object/")
        .nth(1)
        .unwrap()
        .split('"')
        .next()
        .unwrap();
    assert!(
        file(&format!("object/{digest}"))
            .header("content-type")
            .unwrap()
            .starts_with("image/")
    );
}

#[test]
fn objects_are_those_of_the_run_and_bytes_are_not_opened() {
    let folder = small_run();
    let viewer = Viewer::start(folder, &[]);
    let run: serde_json::Value =
        serde_json::from_str(&marf(folder, &["status", "--json"]).exits(0).stdout).unwrap();
    let nodes = run["nodes"].as_array().unwrap();
    let node = |name: &str| nodes.iter().find(|node| node["name"] == name).unwrap();
    let weights = node("train")["outputs"]["weights"]["digest"].as_str().unwrap();
    let object = viewer.get(&format!("/object/{weights}")).is(200);
    assert_eq!(object.header("content-type"), Some("application/octet-stream"));
    assert_eq!(object.header("content-disposition"), Some("attachment"));
    assert_eq!(object.header("x-content-type-options"), Some("nosniff"));
    // The key of a node is a digest too, and its action an object that no page needs.
    let key = node("train")["key"].as_str().unwrap();
    let zeros = "0".repeat(64);
    for name in [key, &zeros, "..%2f..%2fpipeline.toml", "../pipeline.toml", "x"] {
        viewer.get(&format!("/object/{name}")).is(404);
    }
    viewer.get("/pipeline.toml").is(404);
}

#[test]
fn a_view_is_sent_in_four_sizes_and_the_same_view_is_the_same_picture() {
    let viewer = Viewer::start(small_run(), &[]);
    let view = view_of(&viewer, 160);
    let first = pictures(&viewer.post("/frames", &view).is(200).body);
    let sizes: Vec<[u32; 3]> = first.iter().map(|(numbers, _)| *numbers).collect();
    let height = view["camera"]["height"].as_u64().unwrap() as u32;
    let expected = [8, 4, 2, 1].map(|divisor| [160 / divisor, height.div_ceil(divisor), divisor]);
    assert_eq!(sizes, expected);
    for (numbers, png) in &first {
        let decoded = image::load_from_memory(png).unwrap();
        assert_eq!([decoded.width(), decoded.height()], [numbers[0], numbers[1]]);
    }
    assert_eq!(pictures(&viewer.post("/frames", &view).is(200).body), first);
    let photo = viewer.get("/scene/1/0").is(200).json()["photos"][0].clone();
    for mode in ["depth", "uncertainty", "difference"] {
        let mut other = view.clone();
        other["mode"] = json!(mode);
        other["photo"] = photo["image"].clone();
        let found = pictures(&viewer.post("/frames", &other).is(200).body);
        assert_eq!(found.len(), 4);
        assert_ne!(found[3].1, first[3].1, "{mode}");
    }
    let mut of_none = view.clone();
    of_none["mode"] = json!("difference");
    let refused = |view: &serde_json::Value| viewer.post("/frames", view).is(422).text();
    assert!(refused(&of_none).contains("the request names none"));
    of_none["photo"] = json!("0".repeat(64));
    assert!(refused(&of_none).contains("no such photo"));
}

#[test]
fn a_newer_view_of_a_page_ends_the_older_one() {
    let viewer = Viewer::start(small_run(), &[]);
    let (large, small) = (view_of(&viewer, 1600), view_of(&viewer, 80));
    let origin = format!("http://{}", viewer.authority);
    let mut older = http::send(
        &viewer.authority,
        "POST",
        "/frames",
        &[("Origin", &origin)],
        large.to_string().as_bytes(),
    );
    // Its first picture is there, so that it is under way.
    let mut begin = [0; 1];
    older.read_exact(&mut begin).unwrap();
    assert_eq!(pictures(&viewer.post("/frames", &small).is(200).body).len(), 4);
    let mut rest = Vec::new();
    older.read_to_end(&mut rest).unwrap();
    let end = rest.windows(4).position(|window| window == b"\r\n\r\n").unwrap();
    let sizes: Vec<u32> = pictures(&rest[end + 4..])
        .iter()
        .map(|(numbers, _)| numbers[2])
        .collect();
    assert!(
        !sizes.contains(&1),
        "the finest picture of a view that nobody wants: {sizes:?}"
    );
}

#[test]
fn a_part_of_an_object_is_that_part() {
    let viewer = Viewer::start(small_run(), &[]);
    let text = viewer.get("/").is(200).text();
    let digest = text
        .split("src=\"object/")
        .nth(1)
        .unwrap()
        .split('"')
        .next()
        .unwrap();
    let path = format!("/object/{digest}");
    let whole = viewer.get(&path).is(200).body;
    let part = http::request(&viewer.authority, "GET", &path, &[("Range", "bytes=2-5")], b"").is(206);
    assert_eq!(part.body, whole[2..6]);
    let expected = format!("bytes 2-5/{}", whole.len());
    assert_eq!(part.header("content-range"), Some(expected.as_str()));
}

/// What a pixel shows is where the depth of its render ends, and a picture of a photo's pose has that photo's camera.
#[test]
fn a_picked_point_lies_on_the_ray_of_its_pixel() {
    let viewer = Viewer::start(small_run(), &[]);
    let mut view = view_of(&viewer, 160);
    let pixel = [80_u32, view["camera"]["height"].as_u64().unwrap() as u32 * 3 / 4];
    view["pixel"] = json!(pixel);
    let picked = viewer.post("/pick", &view).is(200).json();
    let point: Vec<f64> = serde_json::from_value(picked["point"].clone()).unwrap();
    let pose: Vec<Vec<f64>> = serde_json::from_value(view["cam_from_world"].clone()).unwrap();
    let seen: Vec<f64> = pose
        .iter()
        .map(|row| row[0] * point[0] + row[1] * point[1] + row[2] * point[2] + row[3])
        .collect();
    let camera = |key: &str| view["camera"][key].as_f64().unwrap();
    let column = camera("fx_px") * seen[0] / seen[2] + camera("cx_px");
    let row = camera("fy_px") * seen[1] / seen[2] + camera("cy_px");
    let away = (column - f64::from(pixel[0]) - 0.5).hypot(row - f64::from(pixel[1]) - 0.5);
    assert!(seen[2] > 0.0 && away < 1e-6, "{column} {row}");
    let mut other = view.clone();
    other["pixel"] = json!([20, pixel[1]]);
    let asked = json!({"run": 1, "field": 0, "marks": [view, other]});
    let found = viewer.post("/distance", &asked).is(200).json();
    let number = |key: &str| found[key].as_f64().unwrap();
    assert!(number("length") > 0.0 && number("spread") >= 0.0, "{found}");
    assert_eq!(found["members"], 2);
    if let Some(ends) = found["interval"].as_array() {
        let ends: Vec<f64> = ends.iter().map(|end| end.as_f64().unwrap()).collect();
        assert!(
            ends[0] < number("length") && number("length") < ends[1],
            "{found}"
        );
    }
    view["pixel"] = json!([160, 0]);
    assert!(
        viewer
            .post("/pick", &view)
            .is(422)
            .text()
            .contains("(160, 0) is outside")
    );
}

#[test]
fn photos_of_the_scene_are_shown_and_views_that_cannot_be_are_refused_with_a_sentence() {
    let viewer = Viewer::start(small_run(), &[]);
    let scene = viewer.get("/scene/1/0").is(200).json();
    let image = scene["photos"][0]["image"].as_str().unwrap();
    let photo = viewer.get(&format!("/photo/1/0/{image}")).is(200);
    assert_eq!(photo.header("content-type"), Some("image/jpeg"));
    viewer.get(&format!("/photo/1/0/{}", "0".repeat(64))).is(404);
    assert!(viewer.get("/scene/1/9").is(404).text().contains("no such field"));
    assert!(viewer.get("/scene/9/0").is(404).text().contains("run 9"));
    let mut view = view_of(&viewer, 160);
    view["camera"]["width"] = json!(100_000);
    view["camera"]["height"] = json!(100_000);
    assert!(
        viewer
            .post("/frames", &view)
            .is(400)
            .text()
            .contains("10000000000 pixels are too many")
    );
    view["cam_from_world"] = json!([[9, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]]);
    viewer.post("/frames", &view).is(400);
    viewer.post("/frames", &json!({"run": 1})).is(400);
    viewer
        .post("/frames", &json!({"more": "x".repeat(20_000)}))
        .is(413);
}

#[test]
fn foreign_hosts_and_foreign_pages_are_refused() {
    let viewer = Viewer::start(small_run(), &[]);
    let get = |host: &str| http::request(&viewer.authority, "GET", "/", &[("Host", host)], b"");
    get("localhost:9000").is(200);
    get("evil.example").is(403);
    let post =
        |origin: &str| http::request(&viewer.authority, "POST", "/frames", &[("Origin", origin)], b"{}");
    post("http://evil.example").is(403);
    post("null").is(403);
    http::request(&viewer.authority, "POST", "/frames", &[], b"{}").is(403);
    let own = format!("http://{}", viewer.authority);
    post(&own).is(400);
}

#[test]
fn a_token_comes_with_the_address_and_stays_in_a_cookie() {
    let viewer = Viewer::start(small_run(), &["--token", "0123456789abcdef"]);
    assert!(
        viewer.address.ends_with("/?token=0123456789abcdef"),
        "{}",
        viewer.address
    );
    viewer.get("/").is(401);
    viewer.get("/?token=0123456789abcdee").is(401);
    let let_in = viewer.get("/?token=0123456789abcdef").is(303);
    assert_eq!(let_in.header("location"), Some("./"));
    let cookie = let_in.header("set-cookie").unwrap();
    assert!(cookie.ends_with("; HttpOnly; SameSite=Strict"), "{cookie}");
    let pair = cookie.split(';').next().unwrap();
    http::request(&viewer.authority, "GET", "/", &[("Cookie", pair)], b"").is(200);
    let evil = [("Host", "evil.example"), ("Cookie", pair)];
    http::request(&viewer.authority, "GET", "/?token=0123456789abcdef", &evil, b"").is(403);
}

#[test]
fn below_a_prefix_all_is_there_and_nothing_beside_it() {
    let viewer = Viewer::start(small_run(), &["--prefix", "/mars/run"]);
    assert_eq!(
        viewer.get("/mars/run").is(303).header("location"),
        Some("/mars/run/")
    );
    viewer.get("/mars/run/").is(200);
    viewer.get("/mars/run/view.js").is(200);
    viewer.get("/mars/run/scene/1/0").is(200);
    viewer.get("/").is(404);
    viewer.get("/view.js").is(404);
}

#[test]
fn what_cannot_be_served_is_one_sentence_and_a_way_out() {
    let folder = small_run();
    let refused = |args: &[&str], code: i32| marf(folder, args).exits(code).stderr;
    let open = refused(&["view", "--host", "0.0.0.0"], 2);
    assert!(
        open.contains("needs a token") && open.contains("ssh -L"),
        "{open}"
    );
    assert!(refused(&["view", "--token", "short"], 2).contains("16 or more"));
    assert!(refused(&["view", "--prefix", "mars"], 2).contains("`mars` is not a path"));
    assert!(refused(&["view", "--run", "9"], 1).contains("run 9"));
    let viewer = Viewer::start(folder, &[]);
    let port = viewer.authority.rsplit(':').next().unwrap();
    let taken = refused(&["view", "--port", port], 1);
    assert!(taken.contains(port) && taken.contains("`--port 0`"), "{taken}");
    let empty = tempfile::tempdir().unwrap();
    assert!(
        marf(empty.path(), &["view"])
            .exits(1)
            .stderr
            .contains("there is no store")
    );
}

#[cfg(unix)]
#[test]
fn ctrl_c_ends_it_well_also_while_a_page_is_open() {
    let mut viewer = Viewer::start(small_run(), &[]);
    let _open = http::send(&viewer.authority, "GET", "/events", &[], b"");
    let pid = viewer.child.id().to_string();
    assert!(
        Command::new("kill")
            .args(["-INT", &pid])
            .status()
            .unwrap()
            .success()
    );
    assert_eq!(viewer.child.wait().unwrap().code(), Some(0));
}
