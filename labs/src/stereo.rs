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
    let values = grey
        .values
        .iter()
        .map(|&v| if v == 0 { NONE } else { f32::from(v) / scale });
    Ok(Raster {
        width: grey.width,
        height: grey.height,
        values: values.collect(),
    })
}

fn pfm(path: &Path) -> Result<Raster<f32>> {
    let bytes = read(path, FileKind::Result, Links::Followed)?;
    let mut rest = bytes.as_slice();
    let mut lines = Vec::new();
    while lines.len() < 3 {
        let end = rest
            .iter()
            .position(|byte| *byte == b'\n')
            .ok_or("a PFM file without its head")?;
        lines.push(std::str::from_utf8(&rest[..end])?);
        rest = &rest[end + 1..];
    }
    let (width, height) = lines[1].split_once(' ').ok_or("a PFM file without its size")?;
    let (width, height) = (width.trim().parse::<usize>()?, height.trim().parse::<usize>()?);
    let numbers = rest
        .as_chunks::<4>()
        .0
        .iter()
        .map(|bytes| f32::from_le_bytes(*bytes));
    let numbers: Vec<f32> = numbers
        .map(|value| {
            if value.is_finite() && value > 0.0 {
                value
            } else {
                NONE
            }
        })
        .collect();
    let mut rows: Vec<&[f32]> = numbers.chunks_exact(width).take(height).collect();
    rows.reverse();
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

/// What is printed of a pair.
#[derive(Default)]
struct Score {
    valid: f64,
    good: f64,
    bad: f64,
    rms: f64,
    locked: f64,
    one_sigma: f64,
    two_sigma: f64,
    cpu: f64,
}

impl Score {
    fn new(found: &Disparities, truth: &Raster<f32>, cpu: f64) -> Self {
        let mut s = Self {
            cpu,
            ..Self::default()
        };
        let mut known = 0.0;
        for (i, &t) in truth.values.iter().enumerate().filter(|(_, t)| **t != NONE) {
            known += 1.0;
            if found.class.values[i] == Class::None {
                continue;
            }
            let (d, sigma) = (found.disparity.values[i], found.sigma.values[i]);
            let error = (d - t).abs();
            s.valid += 1.0;
            s.locked += f64::from((d - d.round()).abs() <= 0.125);
            s.one_sigma += f64::from(error <= sigma);
            s.two_sigma += f64::from(error <= 2.0 * sigma);
            if error <= 1.0 {
                s.good += 1.0;
                s.rms += f64::from(error * error);
            }
        }
        s.rms = (s.rms / s.good).sqrt();
        s.bad = 1.0 - s.good / s.valid;
        for share in [&mut s.locked, &mut s.one_sigma, &mut s.two_sigma] {
            *share /= s.valid;
        }
        s.valid /= known;
        s.good /= known;
        s
    }

    fn fields(&self) -> [f64; 8] {
        let Self {
            valid,
            good,
            bad,
            rms,
            locked,
            cpu,
            one_sigma,
            two_sigma,
        } = *self;
        [valid, good, bad, rms, locked, cpu, one_sigma, two_sigma]
    }
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
        let sizes = [&left, &right].map(|picture| [picture.grey.width, picture.grey.height]);
        if sizes[0] != sizes[1] {
            let [[width, height], [other_width, other_height]] = sizes;
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
        let score = Score::new(&found, &truth, cpu_s() - cpu);
        if let Some(out) = &args.out {
            save(
                &out.join(format!("{}.png", pair.name)),
                &found.disparity,
                pair.count,
            )?;
            save(&out.join(format!("{}-truth.png", pair.name)), &truth, pair.count)?;
        }
        print_row(pair.name, score.fields());
        for (mean, field) in means.iter_mut().zip(score.fields()) {
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
    print_line(&format!(
        "| marf | 1648x1200x256 | CPU s {:.2} | peak MB {} |",
        cpu_s() - cpu,
        peak_mb()
    ));
    Ok(())
}
