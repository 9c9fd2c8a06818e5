use super::*;
#[test]
fn dump() {
    let Ok(dir) = std::env::var("DUMP") else { return };
    let options = DemoOptions { width_px: std::env::var("W").map_or(640, |w| w.parse().unwrap()), ..Default::default() };
    let t = std::time::Instant::now();
    let demo = Demo::new(DemoOptions { height_px: options.width_px * 3 / 4, ..options }).unwrap();
    for file in demo.archive(1..=std::env::var("S").map_or(1, |w| w.parse().unwrap()), &|_, _| (), &|| false).unwrap() {
        let path = std::path::Path::new(&dir).join(&file.name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, file.bytes).unwrap();
    }
    println!("{:?}", t.elapsed());
}
