//! An archive on a server: its catalog, and what marf.lock pins of it.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, OnceLock};

use marf_cache::{Digest, digest_of};
use marf_stage::{Access, Cancel, Ctx, LOCK_FILE, Listing, ParamError, Shard, StageError};
use parking_lot::{Mutex, MutexGuard};

use super::catalog::{Catalog, CatalogSource, Question, SolFiles, SolListing};
use super::lock::{self, Lock, OpenLock, SolPins};
use super::network::Network;
use super::online::Online;
use super::pages::Pages;
use super::summary::{Summaries, damaged};
use crate::archive::access::RemoteContext;
use crate::archive::check::Check;
use crate::check::Checkup;
use crate::net::{Client, ClientSettings};
use marf_stage::Sols;

/// Most tries of a request of a check, whose answer a person waits for.
const CHECK_TRIES: u32 = 2;

/// An archive on a server.
pub(crate) struct RemoteArchive {
    context: RemoteContext,
    lock: Lock,
    sols: Sols,
    settings: ClientSettings,
    source: Box<dyn CatalogSource>,
    client: OnceLock<Client>,
    state: Mutex<State>,
}

/// What a pipeline asks of a server.
pub(crate) struct Request<'a> {
    /// Kind, mission, camera and the like in words. Pins of marf.lock that were written for other words are not used.
    pub asked: String,
    /// The sols.
    pub sols: Sols,
    /// How the network is used.
    pub network: &'a Network,
    /// Addresses whose origins may be asked.
    pub allowed: &'a [String],
}

/// What was last listed.
#[derive(Default)]
struct State {
    survey: Option<Arc<Survey>>,
    pages: Option<Pages>,
}

/// The sols asked for, and where the pins lie.
struct Survey {
    sols: BTreeMap<u32, SolListing>,
    lock: OpenLock,
}

/// A sol to fetch.
pub(super) struct SolWork {
    /// What it has.
    pub files: SolFiles,
    /// What is pinned of it.
    pub pins: SolPins,
    /// What of that marf.lock has: nothing, where it is lost and the store remembers.
    pub written: SolPins,
}

impl RemoteArchive {
    /// Makes the archive. No request is sent.
    ///
    /// # Errors
    /// Names the key of `network` that is out of range, or the address that cannot be asked.
    pub fn new(
        context: RemoteContext,
        request: Request<'_>,
        source: Box<dyn CatalogSource>,
    ) -> Result<Self, ParamError> {
        Ok(Self {
            lock: Lock {
                path: context.lock().to_owned(),
                archive: context.name().to_owned(),
                asked: request.asked,
            },
            context,
            sols: request.sols,
            settings: request.network.settings(request.allowed)?,
            source,
            client: OnceLock::new(),
            state: Mutex::default(),
        })
    }

    /// Returns the name of the `[archive.*]` table.
    pub(super) fn name(&self) -> &str {
        self.context.name()
    }

    /// Returns the permitted use of the network.
    pub(super) fn access(&self) -> Access {
        self.context.access()
    }

    /// Returns the place of the pins.
    pub(super) fn lock(&self) -> &Lock {
        &self.lock
    }

    /// Returns in words which products of a sol are taken.
    pub(super) fn selection(&self) -> String {
        self.source.selection()
    }

    /// Returns the client, made at the first call.
    ///
    /// # Errors
    /// There is none under `--offline`.
    pub(super) fn client(&self) -> Result<&Client, StageError> {
        if let Some(client) = self.client.get() {
            return Ok(client);
        }
        let client = Client::new(self.context.permit()?, self.settings.clone())?;
        Ok(self.client.get_or_init(|| client))
    }

    /// Asks the server for one page of each kind, one label and one picture, and compares them with what the readers expect.
    ///
    /// # Errors
    /// There is no client under `--offline`. An address that is none, the wish to stop.
    pub(super) fn ask_for_one_of_each(&self, cancel: &Cancel) -> Result<Vec<Check>, StageError> {
        let settings = ClientSettings {
            tries: self.settings.tries.min(CHECK_TRIES),
            ..self.settings.clone()
        };
        let client = Client::new(self.context.permit()?, settings)?;
        let mut checkup = Checkup::new(&client, cancel);
        let listed = self.source.check(&self.sols, &mut checkup)?;
        checkup.product(listed.as_ref())?;
        Ok(checkup.into_checks())
    }

    /// Lists the sols asked for: as the server has them now, or as they are locked.
    ///
    /// # Errors
    /// A server that cannot be asked, a lock that cannot be read, no file of the sols asked for.
    pub(super) fn listing(&self, ctx: &Ctx<'_>) -> Result<Listing, StageError> {
        Ok(self.survey(ctx)?.0)
    }

    fn survey(&self, ctx: &Ctx<'_>) -> Result<(Listing, Arc<Survey>), StageError> {
        let (listing, survey) = match self.access() {
            Access::Online => self.list_online(ctx)?,
            Access::Locked | Access::Offline => self.list_locked(ctx)?,
        };
        let survey = Arc::new(survey);
        self.state.lock().survey = Some(Arc::clone(&survey));
        Ok((listing, survey))
    }

    fn summaries<'a>(&self, ctx: &Ctx<'_>, lock: &'a OpenLock) -> Summaries<'a> {
        let path = self.lock.path.to_string_lossy();
        let name = format!(
            "{path}\n{}\n{}\n{}",
            self.name(),
            self.lock.asked,
            self.selection()
        );
        Summaries::open(ctx.scratch, &name, lock)
    }

    /// Lists what marf.lock names of the sols asked for.
    fn list_locked(&self, ctx: &Ctx<'_>) -> Result<(Listing, Survey), StageError> {
        let lock = self.lock.open()?;
        if let Some(other) = &lock.other {
            return Err(self.of_other(other));
        }
        let present = lock.sols();
        let chosen = self.sols.choose(present);
        if chosen.is_empty() {
            return Err(self.nothing(present, &format!("`{}` has", self.lock.path.display())));
        }
        let summaries = self.summaries(ctx, &lock);
        let mut listing = Listing::default();
        for sol in &chosen {
            ctx.check()?;
            let fingerprint = match summaries.get(*sol) {
                Ok(found) => found.map(|found| found.fingerprint),
                Err(error) => Some(damaged(&mut listing, *sol, &error)),
            };
            listing.shards.extend(fingerprint.map(|fingerprint| Shard {
                shard: *sol,
                fingerprint,
            }));
        }
        summaries.save();
        let sols = chosen.into_iter().map(|sol| (sol, SolListing::Pinned)).collect();
        Ok((listing, Survey { sols, lock }))
    }

    /// Lists the archive on the server and compares it with the pins.
    fn list_online(&self, ctx: &Ctx<'_>) -> Result<(Listing, Survey), StageError> {
        let lock = self.lock.open()?;
        let summaries = self.summaries(ctx, &lock);
        let selection = self.selection();
        let complete = |sol: u32| summaries.get(sol).ok().flatten().and_then(|found| found.complete);
        let is_pinned = |sol: u32| complete(sol).as_ref() == Some(&selection);
        let mut state = self.state.lock();
        let pages = self.pages(ctx, &mut state);
        let question = Question {
            ctx,
            client: self.client()?,
            sols: &self.sols,
            is_pinned: &is_pinned,
        };
        let catalog = self.source.catalog(question, pages);
        pages.save();
        let mut catalog = catalog?;
        self.add_withdrawn(&mut catalog, lock.sols());
        let remembered = |sol: u32| self.remembered(ctx, sol);
        let mut online = Online {
            source: self.source.as_ref(),
            place: &self.lock,
            remembered: &remembered,
            ctx,
            pages,
            lock: &lock,
            summaries: &summaries,
            listing: Listing::default(),
            unpinned: 0,
            restored: Vec::new(),
        };
        for (sol, listing) in &catalog.sols {
            ctx.check()?;
            online.add(*sol, listing)?;
        }
        online.restore()?;
        let (mut listing, unpinned) = (online.listing, online.unpinned);
        if listing.shards.is_empty() {
            return Err(self.nothing(&catalog.present, "the archive has"));
        }
        listing.note = (unpinned > 0).then(|| format!("{unpinned} files to fetch"));
        summaries.save();
        let survey = Survey {
            sols: catalog.sols,
            lock,
        };
        Ok((listing, survey))
    }

    /// Adds the sols that are pinned and of which the server lists nothing any more, so that their products are reported.
    fn add_withdrawn(&self, catalog: &mut Catalog, pinned: &BTreeSet<u32>) {
        if catalog.sols.is_empty() || self.sols == Sols::Latest {
            return;
        }
        for sol in self.sols.choose(pinned) {
            let nothing = || SolListing::Pages(Vec::new());
            catalog.sols.entry(sol).or_insert_with(nothing);
        }
    }

    fn pages<'a>(&self, ctx: &Ctx<'_>, state: &'a mut MutexGuard<'_, State>) -> &'a mut Pages {
        let name = format!("{}\n{}", self.lock.asked, self.source.name());
        state.pages.get_or_insert_with(|| Pages::open(ctx.scratch, &name))
    }

    /// Returns the files of a listed sol and its pins.
    ///
    /// # Errors
    /// Pins that cannot be read, a server that cannot be asked, a sol that is not there.
    pub(super) fn sol(&self, ctx: &Ctx<'_>, sol: u32) -> Result<SolWork, StageError> {
        if let Some(work) = self.listed_sol(ctx, sol)? {
            return Ok(work);
        }
        // The pages that list it are lost: they are asked for again.
        let lost = || {
            StageError::new(format!(
                "what lists sol {sol} cannot be kept in `{}`",
                ctx.scratch.display()
            ))
        };
        self.listed_sol(ctx, sol)?.ok_or_else(lost)
    }

    fn listed_sol(&self, ctx: &Ctx<'_>, sol: u32) -> Result<Option<SolWork>, StageError> {
        let known = self.state.lock().survey.clone();
        let survey = match known {
            Some(survey) => survey,
            None => self.survey(ctx)?.1,
        };
        let listing = survey.sols.get(&sol).ok_or_else(|| {
            StageError::new(format!("archive `{}` has no sol {sol} any more", self.name()))
                .hint("run again to list it again")
        })?;
        let written = survey.lock.pins(sol)?;
        let pins = written
            .clone()
            .or_else(|| self.remembered(ctx, sol))
            .unwrap_or_default();
        let files = match listing {
            SolListing::Pinned => Some(SolFiles::from_pins(&pins)),
            SolListing::Pages(paths) => {
                let mut state = self.state.lock();
                let pages = self.pages(ctx, &mut state);
                let files = self.source.files(pages, sol, paths)?;
                if files.is_none() {
                    pages.forget(paths);
                    state.survey = None;
                }
                files.map(|files| files.with_history(&pins))
            }
        };
        let Some(mut files) = files else {
            return Ok(None);
        };
        if self.access() == Access::Locked {
            self.find_records(ctx, sol, &mut files, &pins)?;
        }
        Ok(Some(SolWork {
            files,
            pins,
            written: written.unwrap_or_default(),
        }))
    }

    /// Returns the pins of a sol that an earlier run kept in the store, for a lock that is lost.
    pub(super) fn remembered(&self, ctx: &Ctx<'_>, sol: u32) -> Option<SolPins> {
        if self.access() != Access::Online {
            return None;
        }
        let bytes = ctx.memos.load(&self.memo_key(sol))?;
        lock::read_sol(std::str::from_utf8(&bytes).ok()?, sol).ok()
    }

    /// Keeps the pins of a sol in the store, where a run whose lock is lost finds them.
    pub(super) fn remember(&self, ctx: &Ctx<'_>, sol: u32, pins: &SolPins) {
        let (key, text) = (self.memo_key(sol), lock::write_sol(self.name(), sol, pins));
        if ctx.memos.load(&key).as_deref() != Some(text.as_bytes()) {
            ctx.memos.save(&key, text.as_bytes());
        }
    }

    fn memo_key(&self, sol: u32) -> Digest {
        digest_of(&(LOCK_FILE, (self.name(), self.lock.asked.as_str(), sol)))
    }

    /// Asks the server again for records that are locked and not in the store: they come with the listing only.
    fn find_records(
        &self,
        ctx: &Ctx<'_>,
        sol: u32,
        files: &mut SolFiles,
        pins: &SolPins,
    ) -> Result<(), StageError> {
        let with_listing = pins.files.iter().filter(|(_, pin)| pin.url == lock::WITH_LISTING);
        let lost: Vec<_> = with_listing
            .filter(|(_, pin)| ctx.get(&pin.blake3).is_err())
            .collect();
        let Some((first, _)) = lost.first() else {
            return Ok(());
        };
        let changed = |name: &str| {
            StageError::new(format!(
                "record `{name}` of sol {sol} is not what `{LOCK_FILE}` pins"
            ))
            .cause("the feed gives it with other content now, or no longer")
            .hint("run without --locked to take the current record of the feed")
        };
        let mut state = self.state.lock();
        let pages = self.pages(ctx, &mut state);
        let question = Question {
            ctx,
            client: self.client()?,
            sols: &Sols::Ranges(vec![(sol, sol)]),
            is_pinned: &|_| false,
        };
        let catalog = self.source.catalog(question, pages)?;
        pages.save();
        let now = match catalog.sols.get(&sol) {
            Some(SolListing::Pages(paths)) => self.source.files(pages, sol, paths)?,
            _ => None,
        };
        let now = now.ok_or_else(|| changed(first))?;
        for (name, pin) in lost {
            let bytes = now.files.get(name).and_then(|file| file.bytes.clone());
            let bytes = bytes
                .filter(|bytes| Digest::from_content(bytes) == pin.blake3)
                .ok_or_else(|| changed(name))?;
            if let Some(file) = files.files.get_mut(name) {
                file.bytes = Some(bytes);
            }
        }
        Ok(())
    }

    fn of_other(&self, other: &str) -> StageError {
        let message = format!("`{LOCK_FILE}` pins other products of archive `{}`", self.name());
        StageError::new(message)
            .cause(format!(
                "it was written for `{other}`, the pipeline asks for `{}`",
                self.lock.asked
            ))
            .hint("run once without --locked and --offline")
    }

    /// Returns the error that the requested sols have no product. `who` is the source that lists the present ones.
    fn nothing(&self, present: &BTreeSet<u32>, who: &str) -> StageError {
        let there = match (present.first(), present.last()) {
            (Some(first), Some(last)) => format!("{who} {} sols from {first} to {last}", present.len()),
            _ => format!("{who} no sol at all"),
        };
        StageError::new(format!(
            "archive `{}` has no product of the sols asked for",
            self.name()
        ))
        .cause(there)
        .hint("change `sols` of the archive")
    }
}
