//! Fetches the files of one sol. Pinned files in the store stay, the rest is downloaded, checked and pinned.

use std::path::PathBuf;
use std::time::{Duration, Instant, SystemTime};

use marf_cache::{Digest, Sha256};
use marf_stage::{Access, Ctx, LOCK_FILE, StageError};

use super::archive::{RemoteArchive, SolWork};
use super::catalog::{RemoteFile, SolFiles, changed};
use super::lock::{self, Change, Pin, SolPins};
use crate::archive::{ArchiveFile, FetchedFrom, ShardFiles};
use crate::net::{self, Answer, Download, Meter, NetErrorKind, Validators};

/// Interval at which fetched files are made durable: the blobs first, then the pins.
const SAVE_EVERY: Duration = Duration::from_secs(10);
/// How often what another process pinned of the same sol meanwhile is brought too.
const MERGES: usize = 3;

/// The download of one sol.
struct Sol<'a> {
    archive: &'a RemoteArchive,
    ctx: &'a Ctx<'a>,
    sol: u32,
    /// The pins as marf.lock has them.
    written: SolPins,
    pins: SolPins,
    /// Downloads that are pinned and not yet durable: their parts are kept until they are.
    unsaved: Vec<PathBuf>,
    saved: Instant,
    warnings: Vec<String>,
}

/// A file that could not be fetched.
struct Failure {
    name: String,
    cause: String,
}

/// Returns the files of a sol, downloading those that the store lacks.
///
/// # Errors
/// Files that could not be fetched (the others are kept), bytes that are not the locked ones, the wish to stop.
pub(super) fn sol(
    archive: &RemoteArchive,
    ctx: &Ctx<'_>,
    sol: u32,
    work: SolWork,
) -> Result<ShardFiles, StageError> {
    let mut listed = work.files;
    let mut work = Sol {
        archive,
        ctx,
        sol,
        written: work.written,
        pins: work.pins,
        unsaved: Vec::new(),
        saved: Instant::now(),
        warnings: Vec::new(),
    };
    work.settle(&listed)?;
    for _ in 0..MERGES {
        let fetched = work.fetch(&listed);
        work.pins.complete = match &fetched {
            Ok(failures) if failures.is_empty() => work.complete(),
            _ => None,
        };
        // What was fetched is kept, also where the rest failed.
        let merged = work.save();
        work.refuse(fetched?, &listed)?;
        if !merged? {
            break;
        }
        // What another process pinned meanwhile is of this sol too, under the addresses that gave it.
        for (name, file) in SolFiles::from_pins(&work.pins).files {
            listed.files.entry(name).or_insert(file);
        }
    }
    archive.remember(ctx, sol, &work.pins);
    Ok(ShardFiles {
        files: work.files(),
        fingerprint: Some(SolFiles::from_pins(&work.pins).fingerprint(&work.pins)),
        warnings: work.warnings,
    })
}

impl Sol<'_> {
    fn fetch(&mut self, listed: &SolFiles) -> Result<Vec<Failure>, StageError> {
        let mut wanted: Vec<(&String, &RemoteFile)> = Vec::new();
        for (name, file) in &listed.files {
            self.ctx.check()?;
            if !self.is_here(name, file) {
                wanted.push((name, file));
            }
        }
        if wanted.is_empty() {
            return Ok(Vec::new());
        }
        self.pins.complete = None;
        if self.archive.access() == Access::Offline {
            let message = format!("{} files of sol {} are not in the store", wanted.len(), self.sol);
            return Err(StageError::new(message)
                .cause(format!("the first is `{}`", wanted[0].0))
                .hint("run once without --offline"));
        }
        self.download(&wanted)
    }

    fn refuse(&self, failures: Vec<Failure>, listed: &SolFiles) -> Result<(), StageError> {
        let Some(first) = failures.first() else {
            return Ok(());
        };
        let message = format!(
            "{} of {} files of sol {} could not be fetched",
            failures.len(),
            listed.files.len(),
            self.sol
        );
        Err(StageError::new(message)
            .cause(format!("`{}`: {}", first.name, first.cause))
            .hint("run again: fetched files stay, and partial downloads continue"))
    }

    /// Returns the selection that the sol is complete for. Under a lock it is unchanged.
    fn complete(&self) -> Option<String> {
        match self.archive.access() {
            Access::Online => Some(self.archive.selection()),
            Access::Locked | Access::Offline => self.written.complete.clone(),
        }
    }

    /// Takes what came with the listing, and drops pins of files that are listed no more.
    fn settle(&mut self, listed: &SolFiles) -> Result<(), StageError> {
        self.pins.files.retain(|name, _| listed.files.contains_key(name));
        self.pins.gone.retain(|name, _| listed.files.contains_key(name));
        self.pins.left_out.clone_from(&listed.left_out);
        for (name, file) in &listed.files {
            let Some(bytes) = &file.bytes else {
                continue;
            };
            let blake3 = self.ctx.put(bytes)?;
            let pinned = self.pins.files.get(name);
            if pinned.is_some_and(|pin| pin.blake3 == blake3) {
                continue;
            }
            // A record may be revised: the new one is used, the old one is kept.
            let before = pinned
                .into_iter()
                .flat_map(|pin| pin.others.iter().copied().chain([pin.blake3]));
            let pin = Pin {
                bytes: bytes.len() as u64,
                blake3,
                sha256: Sha256::from_content(bytes),
                url: lock::WITH_LISTING.to_owned(),
                fetched: now(),
                validators: Validators::default(),
                listed: None,
                others: before.collect(),
            };
            self.pins.files.insert(name.clone(), pin);
        }
        Ok(())
    }

    fn is_here(&self, name: &str, file: &RemoteFile) -> bool {
        let Some(pin) = self.pins.files.get(name) else {
            return false;
        };
        let same = changed(pin.listed.as_deref(), file.listed.as_deref()).is_none();
        same && self.ctx.get(&pin.blake3).is_ok()
    }

    fn download(&mut self, wanted: &[(&String, &RemoteFile)]) -> Result<Vec<Failure>, StageError> {
        let wants: Vec<Download> = wanted.iter().map(|(name, file)| self.want(name, file)).collect();
        let (mut failures, mut meter, began) = (Vec::new(), Meter::new(), Instant::now());
        let (mut done, mut bytes) = (0, 0);
        let client = self.archive.client()?;
        client.get_all(self.ctx.cancel, &wants, &mut |index, answer| {
            let (name, file) = wanted[index];
            let outcome = match answer {
                Ok(answer) => {
                    bytes += length(&answer);
                    self.take(name, file, &wants[index], answer)?
                }
                Err(error) => match *error.kind {
                    // A firewall refuses a file that is there once, a bucket refuses one that is not there each time. A
                    // refusal is final when the next run gets it too.
                    NetErrorKind::Status(status) if !error.retryable => {
                        if self.pins.gone.insert(name.clone(), status) == Some(status) {
                            Ok(())
                        } else {
                            Err(error.to_string())
                        }
                    }
                    _ => Err(error.to_string()),
                },
            };
            done += 1;
            if let Err(cause) = outcome {
                failures.push(Failure {
                    name: name.clone(),
                    cause,
                });
            }
            let note = meter.note(began.elapsed(), bytes);
            let traffic = client.traffic();
            let note = format!(
                "sol {}, {note}, {} requests, {} tried again",
                self.sol, traffic.requests, traffic.retries
            );
            self.ctx.progress.at(done, wanted.len() as u64, &note);
            if self.saved.elapsed() >= SAVE_EVERY {
                self.save().map(drop)
            } else {
                Ok(())
            }
        })?;
        Ok(failures)
    }

    fn want(&self, name: &str, file: &RemoteFile) -> Download {
        let pin = self.pins.files.get(name);
        // A pin with its bytes in the store is requested conditionally, one without them in full.
        let here = pin.filter(|pin| self.ctx.get(&pin.blake3).is_ok());
        // The one part of a server's name that reaches the disk is its digest.
        let key = Digest::from_content(name.as_bytes());
        Download {
            urls: file.urls.clone(),
            cap_bytes: file.cap_bytes,
            known: here.map(|pin| pin.validators.clone()),
            part: Some(self.ctx.scratch.join("downloads").join(format!("{key}.part"))),
        }
    }

    /// Stores and pins the file of a download. The inner error is of this one file.
    fn take(
        &mut self,
        name: &str,
        file: &RemoteFile,
        want: &Download,
        answer: Answer,
    ) -> Result<Result<(), String>, StageError> {
        match answer {
            Answer::Unchanged => {
                if let Some(pin) = self.pins.files.get_mut(name) {
                    pin.listed.clone_from(&file.listed);
                }
            }
            Answer::Absent { status, .. } => {
                self.pins.gone.insert(name.to_owned(), status);
            }
            Answer::Whole {
                bytes,
                url,
                validators,
            } => {
                if is_page(&bytes) {
                    want.part.iter().for_each(|part| net::forget(part));
                    return Ok(Err(format!("{url} answered a web page, not the file")));
                }
                let blake3 = self.ctx.put(&bytes)?;
                let fresh = Pin {
                    bytes: bytes.len() as u64,
                    blake3,
                    sha256: Sha256::from_content(&bytes),
                    url,
                    fetched: now(),
                    validators,
                    listed: file.listed.clone(),
                    others: Default::default(),
                };
                self.unsaved.extend(want.part.clone());
                return self.pin(name, fresh);
            }
        }
        Ok(Ok(()))
    }

    /// Pins new bytes. If they differ from pinned ones, they are kept with the pin and never used.
    fn pin(&mut self, name: &str, fresh: Pin) -> Result<Result<(), String>, StageError> {
        self.pins.gone.remove(name);
        let Some(old) = self.pins.files.get_mut(name) else {
            self.pins.files.insert(name.to_owned(), fresh);
            return Ok(Ok(()));
        };
        if old.blake3 == fresh.blake3 {
            let others = std::mem::take(&mut old.others);
            *old = Pin { others, ..fresh };
            return Ok(Ok(()));
        }
        old.others.insert(fresh.blake3);
        old.listed.clone_from(&fresh.listed);
        if self.ctx.get(&old.blake3).is_ok() && self.archive.access() == Access::Online {
            return Ok(Ok(()));
        }
        let file = self.archive.lock().file(self.sol)?;
        Err(StageError::new(format!(
            "`{name}` of sol {} is not what `{}` pins",
            self.sol, LOCK_FILE
        ))
        .cause(format!(
            "{} gave {} bytes with blake3 {}, locked are {} bytes with {}",
            fresh.url, fresh.bytes, fresh.blake3, old.bytes, old.blake3
        ))
        .hint(format!(
            "the archive changed a product without a new version; to accept it, delete its line from `{}` \
                           and run without --locked",
            file.display()
        )))
    }

    /// Makes fetched files durable, writes their pins, then deletes the parts of the downloads. Returns whether
    /// another process had pinned other files meanwhile, which are now among the pins.
    fn save(&mut self) -> Result<bool, StageError> {
        let online = self.archive.access() == Access::Online;
        let changed = online && self.pins != self.written;
        if changed || !self.unsaved.is_empty() {
            self.ctx.blobs.commit()?;
        }
        let mut merged = false;
        if changed {
            let change = Change {
                sol: self.sol,
                base: self.written.clone(),
                pins: self.pins.clone(),
            };
            let written = self.archive.lock().write(self.ctx, vec![change])?;
            if let Some(pins) = written.into_iter().next() {
                merged = pins != self.pins;
                (self.written, self.pins) = (pins.clone(), pins);
            }
        }
        self.saved = Instant::now();
        self.unsaved.drain(..).for_each(|part| net::forget(&part));
        Ok(merged)
    }

    fn files(&self) -> Vec<ArchiveFile> {
        let here = self.pins.files.iter().map(|(name, pin)| {
            let from = FetchedFrom {
                url: (pin.url != lock::WITH_LISTING).then(|| pin.url.clone()),
                time: pin.fetched.clone(),
            };
            ArchiveFile::stored(name.clone(), pin.blake3, from)
        });
        let changed = self.pins.files.iter().flat_map(|(name, pin)| {
            pin.others.iter().map(move |other| {
                let reason = match pin.url.as_str() {
                    lock::WITH_LISTING => format!("the feed has revised this record since (blake3 {other} before): both are kept"),
                    _ => format!(
                        "alarm: the archive also gave other bytes under this name (blake3 {other}). Both are kept, those \
                         fetched first are used"
                    ),
                };
                ArchiveFile::left_out(format!("{name} (other bytes)"), reason)
            })
        });
        let gone = self.pins.gone.iter().map(|(name, status)| {
            let reason = format!("listed, but the server answered {status}");
            ArchiveFile::left_out(name.clone(), reason)
        });
        let left_out = self
            .pins
            .left_out
            .iter()
            .map(|(name, why)| ArchiveFile::left_out(name.clone(), why.clone()));
        here.chain(changed).chain(gone).chain(left_out).collect()
    }
}

fn length(answer: &Answer) -> u64 {
    match answer {
        Answer::Whole { bytes, .. } => bytes.len() as u64,
        _ => 0,
    }
}

/// Whether the bytes are a web page, as a firewall sends with status 200 instead of a file.
fn is_page(bytes: &[u8]) -> bool {
    let start: Vec<u8> = bytes.iter().take(64).map(u8::to_ascii_lowercase).collect();
    let start = start.trim_ascii_start();
    start.starts_with(b"<!doctype html") || start.starts_with(b"<html")
}

/// Returns the current time, `unknown` before 1970.
fn now() -> String {
    let now = SystemTime::now();
    if now < SystemTime::UNIX_EPOCH {
        "unknown".to_owned()
    } else {
        humantime::format_rfc3339_seconds(now).to_string()
    }
}
