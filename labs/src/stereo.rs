//! `stereo`: dense disparities of the pairs with true disparities in a folder, as a table.

use std::path::{Path, PathBuf};

use clap::Args;
use marf_cache::file::{FileKind, Links, read};
use marf_depth::{Class, Disparities, Picture, Raster, Search, match_pair};
use marf_engine::Cancel;

use crate::output::{Result, go_on, print_line};
use crate::process::{cpu_s, peak_mb};

/// Arguments of `stereo`.
#[derive(Debug, Clone, Args)]
pub struct StereoArgs {
    /// Folder with the pairs cones, teddy, Cloth3, aloe and playground
    dir: PathBuf,
    /// Folder for pictures of the disparities
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
}

/// No true disparity.
const NONE: f32 = f32::NEG_INFINITY;

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

fn grey(path: &Path) -> Result<Raster<u8>> {
    let picture = image::open(path)?.to_rgb8();
    let (width, height) = picture.dimensions();
    let values = picture.pixels().map(|p| {
        let [r, g, b] = p.0.map(u32::from);
        ((r * 4899 + g * 9617 + b * 1868 + 8192) >> 14) as u8
    });
    Ok(Raster {
        width: width as usize,
        height: height as usize,
        values: values.collect(),
    })
}

fn truth(path: &Path, scale: f32) -> Result<Raster<f32>> {
    if path.extension().is_some_and(|extension| extension == "pfm") {
        return pfm(path);
    }
    let grey = grey(path)?;
    let disparity = |&v: &u8| if v == 0 { NONE } else { f32::from(v) / scale };
    Ok(Raster {
        width: grey.width,
        height: grey.height,
        values: grey.values.iter().map(disparity).collect(),
    })
}

fn pfm(path: &Path) -> Result<Raster<f32>> {
    let bytes = read(path, FileKind::Result, Links::Followed)?;
    let mut newlines = (0..bytes.len()).filter(|at| bytes[*at] == b'\n');
    let end = newlines.nth(2).ok_or("a PFM file without its head")?;
    let size = std::str::from_utf8(&bytes[..end])?.split('\n').nth(1);
    let size = size.and_then(|size| size.split_once(' '));
    let (width, height) = size.ok_or("a PFM file without its size")?;
    let (width, height) = (width.trim().parse()?, height.trim().parse()?);
    let (numbers, _) = bytes[end + 1..].as_chunks::<4>();
    let is_known = |value: f32| value.is_finite() && value > 0.0;
    let known = |value: f32| if is_known(value) { value } else { NONE };
    let values = numbers.iter().map(|bytes| known(f32::from_le_bytes(*bytes)));
    let values: Vec<f32> = values.collect();
    let rows: Vec<&[f32]> = values.chunks_exact(width).take(height).rev().collect();
    Ok(Raster {
        width,
        height,
        values: rows.concat(),
    })
}

/// Writes disparities as colours from blue (far) to red (near), black where there is none.
fn save(path: &Path, map: &Raster<f32>, count: usize) -> Result {
    let picture = image::RgbImage::from_fn(map.width as u32, map.height as u32, |x, y| {
        let d = map.at(x as usize, y as usize);
        if d <= 0.0 {
            return image::Rgb([0, 0, 0]);
        }
        let t = (d / count as f32).clamp(0.0, 1.0);
        let c = |shift: f32| (255.0 * (1.5 - (4.0 * t - shift).abs()).clamp(0.0, 1.0)) as u8;
        image::Rgb([c(3.0).max(30), c(2.0), c(1.0)])
    });
    Ok(picture.save(path)?)
}

/// Returns the columns of a pair in the table.
fn scores(found: &Disparities, truth: &Raster<f32>, cpu: f64) -> [f64; 8] {
    let [mut known, mut valid, mut good, mut squares] = [0.0; 4];
    let [mut locked, mut one_sigma, mut two_sigma] = [0.0; 3];
    for (i, &t) in truth.values.iter().enumerate().filter(|(_, t)| **t != NONE) {
        known += 1.0;
        if found.class.values[i] == Class::None {
            continue;
        }
        let (d, sigma) = (found.disparity.values[i], found.sigma.values[i]);
        let error = (d - t).abs();
        valid += 1.0;
        locked += f64::from((d - d.round()).abs() <= 0.125);
        one_sigma += f64::from(error <= sigma);
        two_sigma += f64::from(error <= 2.0 * sigma);
        if error <= 1.0 {
            good += 1.0;
            squares += f64::from(error * error);
        }
    }
    [
        valid / known,
        good / known,
        1.0 - good / valid,
        (squares / good).sqrt(),
        locked / valid,
        cpu,
        one_sigma / valid,
        two_sigma / valid,
    ]
}

fn print_row(name: &str, fields: [f64; 8]) {
    let fields: Vec<String> = fields.iter().map(|field| format!("{field:.3}")).collect();
    print_line(&format!("| marf | {name} | {} |", fields.join(" | ")));
}

/// `marf-labs stereo`: matches every pair, then the largest at the size of a photo of Mars.
///
/// # Errors
/// A file that is absent or not a picture, a folder that cannot be written, the wish to stop.
pub fn stereo(args: &StereoArgs, cancel: &Cancel) -> Result {
    print_line(
        "| | pair | valid | valid and within 1 px | bad of valid | rms px | locked | CPU s | 1 sigma | 2 sigma |",
    );
    print_line("|---|---|---|---|---|---|---|---|---|---|");
    let mut means = [0.0; 8];
    for pair in &PAIRS {
        go_on(cancel)?;
        let [left, right, file] = pair.files.map(|file| args.dir.join(file));
        let (left, right) = (Picture::new(grey(&left)?), Picture::new(grey(&right)?));
        let [[width, height], [other_width, other_height]] =
            [&left, &right].map(|picture| [picture.grey.width, picture.grey.height]);
        if [width, height] != [other_width, other_height] {
            return Err(format!(
                "{}: the left picture has {width} x {height} pixels, the right one {other_width} x {other_height}",
                pair.name
            )
            .into());
        }
        let truth = truth(&file, pair.scale)?;
        let search = Search {
            first: 0,
            count: pair.count,
        };
        let cpu = cpu_s();
        let found = match_pair(&left, &right, search)?;
        let scores = scores(&found, &truth, cpu_s() - cpu);
        if let Some(out) = &args.out {
            for (kind, map) in [("", &found.disparity), ("-truth", &truth)] {
                save(&out.join(format!("{}{kind}.png", pair.name)), map, pair.count)?;
            }
        }
        print_row(pair.name, scores);
        for (mean, field) in means.iter_mut().zip(scores) {
            *mean += field / PAIRS.len() as f64;
        }
    }
    print_row("mean", means);
    large(&args.dir)
}

/// The largest pair, enlarged to the size of a Mars photo.
fn large(root: &Path) -> Result {
    let picture = |name: &str| -> Result<Picture> {
        let picture = image::open(root.join(name))?.to_luma8();
        let kind = image::imageops::FilterType::Triangle;
        let picture = image::imageops::resize(&picture, 1648, 1200, kind);
        Ok(Picture::new(Raster {
            width: 1648,
            height: 1200,
            values: picture.into_raw(),
        }))
    };
    let (left, right) = (picture("aloeL.jpg")?, picture("aloeR.jpg")?);
    let cpu = cpu_s();
    match_pair(&left, &right, Search { first: 0, count: 256 })?;
    let (cpu, peak) = (cpu_s() - cpu, peak_mb());
    print_line(&format!(
        "| marf | 1648x1200x256 | CPU s {cpu:.2} | peak MB {peak} |"
    ));
    Ok(())
}
