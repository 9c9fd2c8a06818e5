//! `marf bench engine`: a synthetic archive through the shipped paths: folder, filters, store, outputs.

use std::path::{Path, PathBuf};

use marf_engine::Cancel;
use rayon::prelude::*;
use serde::Serialize;
use serde_json::Value;

use super::FIVE_NODES;
use super::args::EngineArgs;
use super::child::{Cost, bytes_below, random, run};
use super::pictures::{Shade, picture};
use crate::cli::global::Global;
use crate::terminal::{eprint_line, print_line};
use marf_run::files;
use marf_run::{Diagnostic, Error};

/// The archive of the pipeline.
const ARCHIVE: &str = "name = \"bench\"\n[archive.photos]\nkind = \"folder\"\npath = \"photos\"\n";

/// One phase of the bench.
#[derive(Debug, Serialize)]
struct Phase {
    phase: &'static str,
    /// Which repetition, from 1.
    round: u32,
    photos: u64,
    sols: u64,
    #[serde(flatten)]
    cost: Cost,
    /// Bytes of the store afterwards.
    store_bytes: u64,
    /// Bytes of the photos.
    photo_bytes: u64,
    /// Sols decided, by node.
    decided: serde_json::Map<String, Value>,
}

/// Runs `marf bench engine`: makes photos, runs the pipeline on them cold, without a change and with new sols; prints one
/// JSON line a phase.
///
/// # Errors
/// A folder that cannot be written, a run that fails, the wish to stop.
pub fn engine(global: &Global, args: &EngineArgs, cancel: &Cancel) -> Result<(), Error> {
    if args.sols == 0 || args.photos < u64::from(args.sols) {
        return Err(Error::usage(format!(
            "{} photos cannot fill {} sols; give each sol one at least",
            args.photos, args.sols
        )));
    }
    for round in 1..=args.rounds {
        let dir = args.dir.join(format!("round-{round}"));
        if dir.exists() {
            return Err(Error::usage(format!(
                "{} is there already; remove it or name another folder with --dir",
                dir.display()
            )));
        }
        eprint_line(&format!(
            "round {round} of {}: making {} photos",
            args.rounds, args.photos
        ));
        one_round(global, args, round, &dir, cancel)?;
        if !args.keep {
            remove(&dir)?;
        }
    }
    Ok(())
}

fn one_round(
    global: &Global,
    args: &EngineArgs,
    round: u32,
    dir: &Path,
    cancel: &Cancel,
) -> Result<(), Error> {
    let pipeline = [ARCHIVE, FIVE_NODES].concat();
    files::write(&dir.join("pipeline.toml"), pipeline.as_bytes())?;
    let photos = Photos {
        dir: dir.join("photos"),
        a_sol: args.photos / u64::from(args.sols),
        width: args.width,
        flawed: args.flawed,
    };
    let mut bench = Bench {
        global,
        dir,
        round,
        photos: 0,
        sols: 0,
    };
    if args.daily {
        for sol in 0..args.sols {
            photos.make(sol..sol + 1, cancel)?;
            bench.sols += 1;
            bench.photos += photos.a_sol;
            bench.phase("one more sol", cancel)?;
        }
        return Ok(());
    }
    photos.make(0..args.sols, cancel)?;
    bench.sols = u64::from(args.sols);
    bench.photos = bench.sols * photos.a_sol;
    bench.phase("cold", cancel)?;
    bench.phase("no change", cancel)?;
    let new = args.new_sols;
    photos.make(args.sols..args.sols + new, cancel)?;
    bench.sols += u64::from(new);
    bench.photos += u64::from(new) * photos.a_sol;
    bench.phase("new sols", cancel)?;
    bench.phase("no change after", cancel)
}

/// The state of a round.
struct Bench<'a> {
    global: &'a Global,
    dir: &'a Path,
    round: u32,
    photos: u64,
    sols: u64,
}

impl Bench<'_> {
    /// Runs the pipeline once as a program of its own and prints what it cost.
    fn phase(&mut self, phase: &'static str, cancel: &Cancel) -> Result<(), Error> {
        if cancel.is_set() {
            return Err(Error::Interrupted);
        }
        let threads = self.global.threads.map(|threads| threads.to_string());
        let mut arguments = vec!["--json", "run"];
        if let Some(threads) = &threads {
            arguments.extend(["--threads", threads]);
        }
        let (cost, lines) = run(self.dir, &arguments)?;
        let finished = lines.iter().filter(|line| line["event"] == "finished");
        let decided = finished.filter_map(|line| {
            let decided = line["counts"]
                .get("decided")
                .or_else(|| line["counts"].get("fetched"))?;
            Some((line["node"].as_str()?.to_owned(), decided.clone()))
        });
        let phase = Phase {
            phase,
            round: self.round,
            photos: self.photos,
            sols: self.sols,
            cost,
            store_bytes: bytes_below(&self.dir.join(".marf")),
            photo_bytes: bytes_below(&self.dir.join("photos")),
            decided: decided.collect(),
        };
        print_line(&serde_json::to_string(&phase).map_err(|error| Error::failed(error.to_string()))?);
        Ok(())
    }
}

/// Makes photos of squares in random colours, the same for the same numbers.
struct Photos {
    dir: PathBuf,
    a_sol: u64,
    width: u32,
    flawed: f64,
}

impl Photos {
    /// Writes the photos of some sols.
    fn make(&self, sols: std::ops::Range<u32>, cancel: &Cancel) -> Result<(), Error> {
        std::fs::create_dir_all(&self.dir).map_err(|error| unwritable(&self.dir, &error))?;
        sols.into_par_iter().try_for_each(|sol| {
            if cancel.is_set() {
                return Err(Error::Interrupted);
            }
            (0..self.a_sol).try_for_each(|at| self.write(sol, at))
        })
    }

    /// Writes one photo. Of the flawed ones a third each is small, empty, and a darker copy of the one before it.
    fn write(&self, sol: u32, at: u64) -> Result<(), Error> {
        let number = u64::from(sol) * self.a_sol + at;
        let share = (random(number, 7) % 10_000) as f64 / 10_000.0;
        let is_flawed = share < self.flawed && at > 0;
        let (seed, shade) = match (is_flawed, number % 3) {
            (true, 1) => (number, Shade::Empty),
            (true, 2) => (number - 1, Shade::Dark),
            _ => (number, Shade::Full),
        };
        let width = if is_flawed && number.is_multiple_of(3) {
            64
        } else {
            self.width
        };
        let bytes = picture(seed, width, width * 3 / 4, shade)?;
        let name = format!(
            "NLF_{sol:04}_{:010}_{:03}ECM_N0000000NCAM00000_00_0LLJ.jpg",
            600_000_000 + number * 13,
            number % 1000,
            sol = sol + 1
        );
        let path = self.dir.join(name);
        std::fs::write(&path, bytes).map_err(|error| unwritable(&path, &error))
    }
}

fn unwritable(path: &Path, error: &std::io::Error) -> Error {
    Error::Failed(Diagnostic {
        message: format!("cannot write {}", path.display()),
        cause: Some(error.to_string()),
        hint: Some("choose another place with --dir".to_owned()),
    })
}

fn remove(dir: &Path) -> Result<(), Error> {
    std::fs::remove_dir_all(dir).map_err(|error| unwritable(dir, &error))
}
