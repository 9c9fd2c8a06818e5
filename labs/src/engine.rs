//! `engine`: a synthetic archive through the shipped paths: folder, filters, store, outputs.

use std::ops::Range;
use std::path::{Path, PathBuf};

use clap::Args;
use marf_engine::Cancel;
use marf_run::{Error, files};
use rayon::prelude::*;
use serde_json::{Map, Value, json};

use crate::output::{Result, eprint_line, go_on, print_json};
use crate::process::{absent, bytes_below, marf, run};
use crate::synthetic::{FIVE_NODES, Shade, picture, random};

/// The archive of the pipeline.
const ARCHIVE: &str = "name = \"bench\"\n[archive.photos]\nkind = \"folder\"\npath = \"photos\"\n";
/// Sols that are added later.
const NEW_SOLS: u32 = 10;
/// Width of a photo in pixels: files of about 12 KB.
const WIDTH_PX: u32 = 160;
/// Width of a photo that is too small.
const SMALL_PX: u32 = 64;
/// Photos of ten thousand that are too small, empty, or copies.
const FLAWED: u64 = 1_000;

/// Arguments of `engine`.
#[derive(Debug, Clone, Args)]
pub struct EngineArgs {
    /// Photos
    #[arg(long, default_value_t = 10_000)]
    photos: u64,
    /// Sols they are spread over
    #[arg(long, default_value_t = 1_000, value_parser = clap::value_parser!(u32).range(1..))]
    sols: u32,
    /// How often all is done, each time in a folder of its own
    #[arg(long, default_value_t = 3)]
    rounds: u32,
    /// Folder for photos and stores
    #[arg(long, value_name = "DIR", default_value = "bench-engine")]
    dir: PathBuf,
}

/// Makes photos and runs the pipeline on them: cold, without a change and with new sols. Prints one JSON line a
/// phase.
///
/// # Errors
/// Returns an error if a folder cannot be written, a run fails, or the user wants to stop.
pub fn engine(args: &EngineArgs, cancel: &Cancel) -> Result {
    let a_sol = args.photos / u64::from(args.sols);
    if a_sol == 0 {
        let (photos, sols) = (args.photos, args.sols);
        let message = format!("{photos} photos cannot fill {sols} sols: give each sol one at least");
        return Err(Error::usage(message).into());
    }
    let marf = marf()?;
    let phases = [
        ("cold", 0..args.sols),
        ("no change", 0..0),
        ("new sols", args.sols..args.sols + NEW_SOLS),
        ("no change after", 0..0),
    ];
    for round in 1..=args.rounds {
        let dir = absent(&args.dir.join(format!("round-{round}")))?;
        eprint_line(&format!("round {round} of {}", args.rounds));
        let (pipeline, photo_dir) = ([ARCHIVE, FIVE_NODES].concat(), dir.join("photos"));
        files::write(&dir.join("pipeline.toml"), pipeline.as_bytes())?;
        let mut sols = 0;
        for (phase, more) in &phases {
            sols += more.len() as u64;
            make_photos(&photo_dir, more.clone(), a_sol, cancel)?;
            let (cost, lines) = run(&marf, &dir, &["run", "--json"])?;
            print_json(&json!({
                "phase": phase, "round": round, "photos": sols * a_sol, "sols": sols,
                "wall_s": cost.wall_s, "cpu_s": cost.cpu_s, "peak_mb": cost.peak_mb,
                "store_bytes": bytes_below(&dir.join(".marf")), "photo_bytes": bytes_below(&photo_dir),
                "decided": decided(&lines),
            }))?;
        }
        std::fs::remove_dir_all(&dir)?;
    }
    Ok(())
}

/// Returns the sols that were decided, by node.
fn decided(events: &[Value]) -> Map<String, Value> {
    let finished = events.iter().filter(|event| event["event"] == "finished");
    let decided = finished.filter_map(|event| {
        let counts = &event["counts"];
        let decided = counts.get("decided").or_else(|| counts.get("fetched"))?;
        Some((event["node"].as_str()?.to_owned(), decided.clone()))
    });
    decided.collect()
}

/// Writes the photos of some sols.
fn make_photos(dir: &Path, sols: Range<u32>, a_sol: u64, cancel: &Cancel) -> Result {
    sols.into_par_iter().try_for_each(|sol| {
        go_on(cancel)?;
        (0..a_sol).try_for_each(|at| make_photo(dir, sol, a_sol, at))
    })
}

/// Writes one photo. Of the flawed ones a third each is small, empty, and a darker copy of the one before it.
fn make_photo(dir: &Path, sol: u32, a_sol: u64, at: u64) -> Result {
    let number = u64::from(sol) * a_sol + at;
    let is_flawed = random(number, 7) % 10_000 < FLAWED && at > 0;
    let (seed, width, shade) = match number % 3 {
        0 if is_flawed => (number, SMALL_PX, Shade::Full),
        1 if is_flawed => (number, WIDTH_PX, Shade::Empty),
        2 if is_flawed => (number - 1, WIDTH_PX, Shade::Dark),
        _ => (number, WIDTH_PX, Shade::Full),
    };
    let (sol, clock_s, ms) = (sol + 1, 600_000_000 + number * 13, number % 1000);
    let name = format!("NLF_{sol:04}_{clock_s:010}_{ms:03}ECM_N0000000NCAM00000_00_0LLJ.jpg");
    let picture = picture(seed, width, width * 3 / 4, shade)?;
    Ok(files::write(&dir.join(name), &picture)?)
}
