//! Runs the pairs with true disparities in a folder and prints a table.
#![allow(clippy::unwrap_used, clippy::print_stdout, reason = "a benchmark")]

use std::path::{Path, PathBuf};

use marf_depth::{NONE, Picture, Raster, Search, match_pair};

struct Pair {
    name: &'static str,
    files: [&'static str; 3],
    /// What the true disparities are multiplied by in their file.
    scale: f32,
    count: usize,
}

const PAIRS: [Pair; 5] = [
    Pair {
        name: "cones",
        files: ["cones/im2.png", "cones/im6.png", "cones/disp2.png"],
        scale: 4.0,
        count: 64,
    },
    Pair {
        name: "teddy",
        files: ["teddy/im2.png", "teddy/im6.png", "teddy/disp2.png"],
        scale: 4.0,
        count: 64,
    },
    Pair {
        name: "Cloth3",
        files: ["Cloth3/view1.png", "Cloth3/view5.png", "Cloth3/disp1.png"],
        scale: 2.0,
        count: 128,
    },
    Pair {
        name: "aloe",
        files: ["aloeL.jpg", "aloeR.jpg", "aloeGT.png"],
        scale: 1.0,
        count: 256,
    },
    Pair {
        name: "playground",
        files: ["playground/im0.png", "playground/im1.png", "playground/disp0.pfm"],
        scale: 1.0,
        count: 64,
    },
];

fn grey(path: &Path) -> Raster<u8> {
    let picture = image::open(path).unwrap().to_rgb8();
    let (width, height) = picture.dimensions();
    let values = picture.pixels().map(|p| {
        let [r, g, b] = p.0.map(u32::from);
        ((r * 4899 + g * 9617 + b * 1868 + 8192) >> 14) as u8
    });
    Raster {
        width: width as usize,
        height: height as usize,
        values: values.collect(),
    }
}

fn truth(path: &Path, scale: f32) -> Raster<f32> {
    if path.extension().unwrap() == "pfm" {
        return pfm(path);
    }
    let grey = grey(path);
    let values = grey
        .values
        .iter()
        .map(|&v| if v == 0 { NONE } else { f32::from(v) / scale });
    Raster {
        width: grey.width,
        height: grey.height,
        values: values.collect(),
    }
}

fn pfm(path: &Path) -> Raster<f32> {
    let bytes = std::fs::read(path).unwrap();
    let ends: Vec<usize> = (0..bytes.len()).filter(|&i| bytes[i] == b'\n').take(3).collect();
    let size = std::str::from_utf8(&bytes[ends[0] + 1..ends[1]]).unwrap();
    let size: Vec<usize> = size.split_whitespace().map(|n| n.parse().unwrap()).collect();
    let mut rows: Vec<Vec<f32>> = bytes[ends[2] + 1..]
        .chunks_exact(4 * size[0])
        .map(|row| {
            row.as_chunks::<4>()
                .0
                .iter()
                .map(|b| f32::from_le_bytes(*b))
                .collect()
        })
        .collect();
    rows.reverse();
    let values = rows
        .concat()
        .into_iter()
        .map(|v| if v.is_finite() && v > 0.0 { v } else { NONE });
    Raster {
        width: size[0],
        height: size[1],
        values: values.collect(),
    }
}

/// CPU seconds of this process.
fn cpu_seconds() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap();
    let fields: Vec<&str> = stat.rsplit(')').next().unwrap().split_whitespace().collect();
    (fields[11].parse::<f64>().unwrap() + fields[12].parse::<f64>().unwrap()) / 100.0
}

fn peak_mib() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap();
    let line = status.lines().find(|line| line.starts_with("VmHWM")).unwrap();
    line.split_whitespace().nth(1).unwrap().parse::<u64>().unwrap() / 1024
}

fn save(out: &Option<PathBuf>, name: &str, map: &Raster<f32>, count: usize) {
    let Some(out) = out else { return };
    let picture = image::RgbImage::from_fn(map.width as u32, map.height as u32, |x, y| {
        let d = map.at(x as usize, y as usize);
        if d == NONE {
            return image::Rgb([0, 0, 0]);
        }
        let t = (d / count as f32).clamp(0.0, 1.0);
        let c = |shift: f32| (255.0 * (1.5 - (4.0 * t - shift).abs()).clamp(0.0, 1.0)) as u8;
        image::Rgb([c(3.0).max(30), c(2.0), c(1.0)])
    });
    picture.save(out.join(format!("{name}.png"))).unwrap();
}

fn score(disparity: &Raster<f32>, truth: &Raster<f32>) -> [f64; 5] {
    let (mut known, mut valid, mut good, mut squares, mut locked, mut bias) = (0., 0., 0., 0., 0., 0.);
    for (&d, &t) in disparity.values.iter().zip(&truth.values) {
        if t == NONE {
            continue;
        }
        known += 1.0;
        if d == NONE {
            continue;
        }
        valid += 1.0;
        locked += f64::from((d - d.round()).abs() <= 0.125);
        let e = f64::from(d - t);
        if e.abs() <= 1.0 {
            good += 1.0;
            squares += e * e;
            bias += e;
        }
    }
    print!("bias {:.3} ", bias / good);
    [
        valid / known,
        good / known,
        1.0 - good / valid,
        (squares / good).sqrt(),
        locked / valid,
    ]
}

fn main() {
    let arguments: Vec<PathBuf> = std::env::args_os().skip(1).map(PathBuf::from).collect();
    let root = &arguments[0];
    let out = arguments.get(1).cloned();
    let mut sums = [0.0; 5];
    for pair in &PAIRS {
        let [left, right, file] = pair.files.map(|file| root.join(file));
        let (left, right) = (Picture::new(grey(&left)), Picture::new(grey(&right)));
        let truth = truth(&file, pair.scale);
        let cpu = cpu_seconds();
        let found = match_pair(
            &left,
            &right,
            Search {
                first: 0,
                count: pair.count,
            },
        );
        let cpu = cpu_seconds() - cpu;
        save(&out, pair.name, &found.disparity, pair.count);
        save(&out, &format!("{}-truth", pair.name), &truth, pair.count);
        let raw = score(&found.raw, &truth);
        let s = score(&found.disparity, &truth);
        for (sum, s) in sums.iter_mut().zip(s) {
            *sum += s / PAIRS.len() as f64;
        }
        println!(
            "| {:10} | {:.3} | {:.3} | {:.3} | {:.3} | {:.3} | {:.2} | raw {:.3?}",
            pair.name, s[0], s[1], s[2], s[3], s[4], cpu, raw
        );
    }
    println!("| mean | {:.3?} | peak {}", sums, peak_mib());
    if std::env::var("BIG").is_ok() {
        let big = |name: &str| {
            let picture = image::open(root.join(name)).unwrap().to_rgb8();
            let picture =
                image::imageops::resize(&picture, 1648, 1200, image::imageops::FilterType::Triangle);
            let path = std::env::temp_dir().join(format!("{name}.big.png"));
            picture.save(&path).unwrap();
            Picture::new(grey(&path))
        };
        let (left, right) = (big("aloeL.jpg"), big("aloeR.jpg"));
        let cpu = cpu_seconds();
        match_pair(&left, &right, Search { first: 0, count: 256 });
        println!(
            "1648x1200x256 cpu {:.2} peak MiB {}",
            cpu_seconds() - cpu,
            peak_mib()
        );
    }
}
