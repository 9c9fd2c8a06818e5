//! demo (in work)
#![allow(missing_docs, dead_code)]
mod ground;
mod lens;
mod light;
mod math;
mod render;
mod rocks;
mod tour;
mod world;

#[cfg(test)]
mod peek {
    use super::{render::Shot, tour::Eye, *};
    #[test]
    fn peek() {
        let t = std::time::Instant::now();
        let world = world::World::new(1);
        eprintln!("world {:?}", t.elapsed());
        let display = math::Display::new();
        let size = (640, 480);
        let sols: Vec<u32> = std::env::var("SOLS").unwrap_or("1".into()).split(',').map(|s| s.parse().unwrap()).collect();
        for sol in sols {
        let stops = tour::stops(&world, 1, sol);
        for (i, pointing) in tour::pointings().iter().enumerate() {
            let taken = tour::take(&stops[pointing.stop], pointing, Eye::Left, size, 1);
            let shot = Shot { world: &world, lens: taken.site, width: size.0, height: size.1 };
            let t = std::time::Instant::now();
            let image = shot.photo(&display);
            eprintln!("photo {i} {:?} {:?}", t.elapsed(), tour::error_of(&stops[pointing.stop], &taken));
            std::fs::write(format!("/tmp/look/p{sol}_{i}.png"), marf_scene::encode_png(&image).unwrap()).unwrap();
        }
        }
    }
}
