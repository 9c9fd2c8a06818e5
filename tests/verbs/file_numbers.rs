//! Lines of exports and renders have the numbers of the files that were written.

use serde_json::Value;

use super::common::{SURFACE, marf, ran};
use super::numbers::{bytes, document, elements, files, told};
use marf_progress::format::{count, number, size};

const LOOSE: &str = "--cell 0.05 --most-spread 5 --least-photos 1";

#[test]
fn exports_of_a_surface_print_the_numbers_of_their_files() {
    let dir = ran("numbers", SURFACE);
    let dir = dir.path();
    let mesh = told(dir, &format!("export mesh --out mesh.ply {LOOSE}"));
    let ply = bytes(dir, "mesh.ply");
    let photos = count(mesh.whole("/surface/photos"), "photo");
    let head = String::from_utf8_lossy(&ply[..4096]).into_owned();
    let scene = document(dir, "out/train/scene.json");
    let site: Value = scene["site"].clone();
    let at = |axis: usize| site["origin_m"][axis].as_f64().unwrap();
    for comment in [
        format!(
            "surface where the mean signed distance of {} views of the field is 0 (Curless and Levoy 1996)",
            mesh.whole("/surface/photos")
        ),
        "least photos: 1; largest spread: 5".to_owned(),
        format!(
            "; in the frame of site {} (metres) the origin is ({} {} {})",
            site["site"],
            at(0),
            at(1),
            at(2)
        ),
    ] {
        assert!(head.contains(&comment), "`{comment}` is not in {head}");
    }
    mesh.says(&format!(
        "{} and {} vertices, samples 0.05 m apart, from {photos}",
        count(elements(&ply, "face"), "triangle"),
        number(elements(&ply, "vertex") as f64)
    ));
    let known = mesh.float("/surface/uncertainty/known_share");
    assert!(known > 0.0 && known <= 1.0, "{known}");
    let where_known = if known < 1.0 {
        format!("the {:.1} % of the vertices where it is known", 100.0 * known)
    } else {
        "the vertices".to_owned()
    };
    mesh.says(&format!(
        "no bootstrap: the views of the field differ by at most {} m at half of {where_known}, by at most {} m at 95 %",
        number(mesh.float("/surface/uncertainty/median")),
        number(mesh.float("/surface/uncertainty/scale_end"))
    ));

    let points = told(dir, &format!("export points --out points.ply {LOOSE}"));
    let cloud = elements(&bytes(dir, "points.ply"), "vertex");
    points.says(&format!(
        "{} in cells of 0.05 m, from {photos}",
        count(cloud, "point")
    ));

    let height = told(dir, &format!("export height --out height.png {LOOSE}"));
    let map = image::open(dir.join("height.png")).unwrap().to_luma16();
    let covered = map.pixels().filter(|pixel| pixel[0] > 0).count();
    assert_eq!(
        map.pixels()
            .map(|pixel| pixel[0])
            .filter(|value| *value > 0)
            .min(),
        Some(1),
        "the lowest is 1"
    );
    height.says(&format!(
        "{} x {} pixels of 0.05 m, {:.0} % with a surface, heights from {:.3} m in steps of {} m",
        map.width(),
        map.height(),
        100.0 * covered as f64 / f64::from(map.width() * map.height()),
        height.float("/surface/map/lowest_m"),
        number(height.float("/surface/map/interval_m"))
    ));

    let depth = told(dir, &format!("export depth --out depth {LOOSE}"));
    let (pictures, _) = files(&dir.join("depth"));
    depth.says(&format!(
        "depths in metres at the views of {}, ",
        count(pictures, "photo")
    ));
    depth.says(&format!("wrote {} to depth", count(pictures, "file")));

    // The photos that must show a point by default: one for splats, two for others.
    let splats = |more: &str| {
        let line = format!("export splats --out few.ply --cell 0.2 --most-spread 5{more}");
        marf(dir, &line.split(' ').collect::<Vec<_>>()).exits(0)
    };
    splats("");
    assert_eq!(splats(" --least-photos 1").done(), [""; 0]);
    assert_eq!(marf_schema::surface::SurfaceParams::default().least_photos, 2);

    let splats = told(dir, &format!("export splats --out splats.ply {LOOSE}"));
    let of = |name: &str| splats.float(&format!("/surface/splats/{name}"));
    splats.says(&format!(
        "{}, standard deviations {} to {} m, from {photos}. Left out: {} floating in front of the surface, the sky, and colours by direction",
        count(elements(&bytes(dir, "splats.ply"), "vertex"), "splat"),
        number(of("finest")),
        number(of("coarsest")),
        of("floating")
    ));
    splats.says(&format!(
        "against the field at {} photos trained on: PSNR {:.2} dB, {:.2} the worst, over the {:.0} % of the pixels where it shows a surface",
        of("trained_on/photos"),
        of("trained_on/mean_db"),
        of("trained_on/least_db"),
        100.0 * of("trained_on/share")
    ));
    assert!(of("trained_on/least_db") <= of("trained_on/mean_db"));
    let head = String::from_utf8_lossy(&bytes(dir, "splats.ply")[..4096]).into_owned();
    let comment = format!(
        "against the field's own pictures at the views of {} photos trained on, where these show a surface: PSNR {:.2} dB",
        of("trained_on/photos"),
        of("trained_on/mean_db")
    );
    assert!(head.contains(&comment), "`{comment}` is not in {head}");

    // What was made from a run is listed as made from it, and a run for a file of the same content is of the same one.
    let log = marf(dir, &["log"]).exits(0).stdout;
    assert!(
        log.lines().any(|line| line.ends_with("(export of run 1)")),
        "{log}"
    );
}

#[test]
fn cameras_crates_and_renders_print_the_numbers_of_their_files() {
    let dir = ran("numbers", SURFACE);
    let dir = dir.path();
    let cameras = told(dir, "export cameras --out cameras");
    let scene = document(dir, "cameras/transforms.json");
    let frames = scene["frames"].as_array().unwrap().len();
    // Cameras of labels are in metres.
    cameras.says(&format!(
        "wrote cameras: {} with cameras, transforms.json (nerfstudio, instant-ngp), sparse/0 (COLMAP), points.ply (one unit is 1 m)",
        count(frames, "photo")
    ));
    for file in ["sparse/0/cameras.bin", "sparse/0/images.bin", "points.ply"] {
        assert!(dir.join("cameras").join(file).is_file(), "{file}");
    }

    let table = marf(dir, &["photos", "--json"]).exits(0).stdout;
    let table: Value = serde_json::from_str(&table).unwrap();
    let chosen = table["photos"][0]["product"].as_str().unwrap();
    let written = marf(dir, &["export", "crate", "crate", "--items", chosen])
        .exits(0)
        .stdout;
    let (in_crate, bytes_of_crate) = files(&dir.join("crate/data"));
    let checked = told(dir, "verify crate");
    let named = checked.whole("/named");
    assert!(named > 0, "the other photos");
    let line = format!(
        " of surface, {} ({}) in data/, {named} more named by digest only",
        count(in_crate, "file"),
        size(bytes_of_crate)
    );
    assert!(
        written.contains("wrote crate: run ") && written.contains(&line),
        "{line}: {written}"
    );
    checked.says(&format!(
        "{} in data/, {named} named by digest only, {} checked against their keys",
        count(in_crate, "file"),
        count(checked.whole("/actions"), "action")
    ));

    // What the crate says of itself.
    let root: Value = document(dir, "crate/data/ro-crate-metadata.json");
    let graph = root["@graph"].as_array().unwrap();
    let of = |id: &str| {
        graph
            .iter()
            .find(|entity| entity["@id"] == id)
            .unwrap_or(&Value::Null)
    };
    let name = format!("marf run {} of surface", checked.json["run"].as_str().unwrap());
    assert_eq!(of("./")["name"], Value::from(name.clone()));
    let said = of("./")["description"].as_str().unwrap();
    assert!(said.starts_with("One run of the pipeline `surface`: "), "{said}");
    let info = String::from_utf8(bytes(dir, "crate/bag-info.txt")).unwrap();
    assert!(
        info.contains(&format!("External-Description: {name}\n")),
        "{info}"
    );
    let made = graph.iter().filter_map(|entity| entity["description"].as_str());
    let made: Vec<&str> = made.filter(|said| said.starts_with("made by ")).collect();
    let by = format!("made by marf {} on cpu in this run", env!("CARGO_PKG_VERSION"));
    assert!(
        !made.is_empty() && made.iter().all(|said| *said == by),
        "{made:?}"
    );

    let render = told(
        dir,
        "render --path orbit --frames 3 --width 40 --out film --device cpu",
    );
    let (pictures, _) = files(&dir.join("film"));
    render.says(&format!(
        "wrote {} to film, video.mp4 among them",
        count(pictures, "file")
    ));
    render.says(&format!(
        "3 viewpoints of 40 x {} pixels: colour",
        render.whole("/height")
    ));
    assert!(dir.join("film/video.mp4").is_file() && dir.join("film/rgb/0003.png").is_file());
    // The defaults that the help names.
    let trained = scene["frames"].as_array().unwrap().len();
    let help = marf(dir, &["render", "--help"]).exits(0).stdout;
    assert!(help.contains("[default: 96, all photos"), "{help}");
    let orbit = told(dir, "render --path orbit --width 16 --out orbit --device cpu");
    assert_eq!(orbit.whole("/pictures"), 96);
    let train = told(dir, "render --path train --width 16 --out train --device cpu");
    let heldout = told(dir, "render --path heldout --width 16 --out heldout --device cpu");
    assert_eq!(train.whole("/pictures") + heldout.whole("/pictures"), trained);
    let half = told(
        dir,
        "render --path orbit --frames 1 --scale 0.5 --out half --device cpu",
    );
    let whole = told(
        dir,
        "render --path orbit --frames 1 --scale 1 --out whole --device cpu",
    );
    // An odd width has no half.
    assert!(whole.whole("/width").abs_diff(2 * half.whole("/width")) <= 1);
    let photos = document(dir, "out/train/scene.json");
    let mut photos = photos["frames"].as_array().unwrap().iter();
    assert!(photos.any(|frame| frame["camera"]["width"] == whole.json["width"]));
    assert_eq!(marf_schema::render::RenderParams::default().width, 640);
}
